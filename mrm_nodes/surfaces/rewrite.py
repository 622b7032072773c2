"""Documents that use MaterialX's surfaces and its boolean `retroreflective`, moved over to ours."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import MaterialX as mx

from mrm_nodes import documents, elements, external, filenames, library, xmltext
from mrm_nodes.errors import MrmError, MrmWarning, suggestion
from mrm_nodes.files import write_bytes
from mrm_nodes.substitution import SUBSTITUTES, SWITCH, WEIGHT, Surface, known_surfaces, twin_with
from mrm_nodes.surfaces.markup import Edits, Tag, parse
from mrm_nodes.surfaces.names import fitting, named_for_code, path_of
from mrm_nodes.surfaces.weights import (
    Weight,
    check_weights,
    find_image,
    is_path,
    names_beside,
    node_setting,
    relative,
    warn_of_both,
)


def retrofit_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    weights: Mapping[str, Weight] | None = None,
    allow_external: bool = False,
) -> list[str]:
    """Write a copy of a .mtlx file whose surfaces are ours, and return the names of the nodes that changed.

    Everything else stays byte for byte: comments, layout, order. MaterialX's microfacet BSDFs with
    `retroreflective` on become ours at weight 1. A name that no shading language takes becomes one that they do,
    and what refers to it follows, with a warning.

    Args:
        source: a MaterialX document with open_pbr_surface, gltf_pbr or standard_surface nodes.
        target: the file to write; it may exist, but may not be `source`.
        weights: of the new inputs, such as `{"specular_retroreflectivity": 0.8}`; text names a node beside the
            surface (`node` or `node/output`), else an image file, which is named relative to `target` then.
        allow_external: whether it may name files outside of its folder and the node libraries.

    Raises:
        MrmError: `source` is missing, is not MaterialX, refers to something that is missing, or has nothing to
            retrofit; a weight is unknown, not from 0 to 1, or no float; `target` cannot be written. Then nothing is.
    """
    source, target, where = Path(source), Path(target), os.fspath(source)
    document = documents.read_document(source, allow_external=allow_external)
    _check_textures(document, source)
    if target.exists() and target.samefile(source):
        raise MrmError(f"{target}: is the file to read; name another one to write")
    content, renamed = named_for_code(source.read_bytes(), where)
    if renamed:
        document = documents.parse_document(content, source, allow_external)
        document.setDataLibrary(library.shared_library())
    included = _included_surfaces(source)
    rewriting = _Rewriting(content, where, dict(weights or {}), document, target.parent, renamed, included)
    _check_result(document, rewriting.text(), source, target, allow_external)
    if _has_relative_textures(document) and target.resolve().parent != source.resolve().parent:
        warnings.warn(
            f"{target}: its textures are named relative to {source.parent}; copy them too",
            MrmWarning,
            stacklevel=2,
        )
    for old, new in renamed.items():
        warnings.warn(
            f"{target}: {old} is named {new} now; shading languages take no such name",
            MrmWarning,
            stacklevel=2,
        )
    if included:
        warnings.warn(
            f"{source}: the surfaces in {', '.join(included)}, which it includes, stay as they are; "
            f"retrofit {_it(included)} too, and include what comes out",
            MrmWarning,
            stacklevel=2,
        )
    write_bytes(target, rewriting.text())
    return rewriting.changed


def retrofit_text(
    text: bytes, where: str, weights: Mapping[str, float] | None = None
) -> tuple[bytes, list[str]]:
    """Return the text of a MaterialX document with its surfaces exchanged for ours, and the changed nodes.

    Raises:
        MrmError: not XML, nothing to retrofit, or a weight that is unknown or not from 0 to 1.
    """
    rewriting = _Rewriting(text, where, dict(weights or {}))
    return rewriting.text(), rewriting.changed


def at_zero(content: bytes, where: str) -> list[str]:
    """The inputs by which surfaces in a document's text would be retroreflective, where none is set."""
    names = {surface.name: surface.input for surface in known_surfaces().values()}
    unset: dict[str, None] = {}
    for tag in parse(xmltext.decode(content, where)[0], where).walk():
        own = names.get(tag.attributes.get("node", "") if tag.name == _OLD_SHADER else tag.name)
        present = None if own is None else tag.child(_port(tag), own)
        if own is not None and present is not None and present.attributes.get("value", "1").strip("0. "):
            return []
        if own is not None:
            unset[own] = None
    return list(unset)


class _Rewriting:
    """The edits of one document."""

    def __init__(
        self,
        content: bytes,
        where: str,
        weights: dict[str, Weight],
        document: mx.Document | None = None,
        folder: Path = Path(),
        renamed: Mapping[str, str] | None = None,
        included: Sequence[str] = (),
    ) -> None:
        check_weights(weights)
        self._text, self._codec = xmltext.decode(content, where)
        self._where, self._weights, self._document, self._folder = where, weights, document, folder
        self._renamed = renamed or {}
        self._root = parse(self._text, where)
        self._edits = Edits(self._text)
        self._used: set[str] = set()
        self._added: dict[tuple[int, str], str] = {}
        self.changed: list[str] = []
        for tag in self._root.walk():
            self._rewrite(tag)
        if not self.changed:
            raise MrmError(f"{where}: {_why_nothing(self._root, included)}")
        for unused in sorted(set(weights) - self._used):
            raise MrmError(f"{where}: no surface in it has an input {unused}")

    def text(self) -> bytes:
        """The document as it will be."""
        return self._edits.apply().encode(self._codec, "xmlcharrefreplace")

    def _rewrite(self, tag: Tag) -> None:
        own = tag.attributes.get("node")
        if tag.name == "nodedef" and own in (*_our_nodes(), *known_surfaces()):
            raise MrmError(f"{self._where}: defines a node {own} itself; rename it first")
        surface = _surface_of(tag)
        if surface is not None:
            _rename(self._edits, tag, surface.node, surface.name)
            if surface.input in self._weights:
                self._set_weight(tag, surface.input)
                self._used.add(surface.input)
        elif _is_switched(tag):
            _rename(self._edits, tag, tag.name, SUBSTITUTES[tag.name])
            _replace_switch(self._edits, tag)
        elif tag.name in SUBSTITUTES and any(
            twin_with(tag.name, child.attributes.get("name", "")) for child in tag.children
        ):
            _rename(self._edits, tag, tag.name, SUBSTITUTES[tag.name])
        else:
            return
        self.changed.append(tag.attributes.get("name", tag.name))

    def _set_weight(self, tag: Tag, name: str) -> None:
        weight = self._weights[name]
        setting = {"value": f"{weight:g}"} if not isinstance(weight, str) else self._driver(tag, name, weight)
        if tag.name == _OLD_SHADER and "nodename" in setting:
            raise MrmError(
                f"{self._where}: {path_of(tag)}: a <{_OLD_SHADER}> takes a number or an output of a graph; "
                "upgrade the document to connect a node"
            )
        element = _element(_port(tag), name, setting)
        present = tag.child(_port(tag), name)
        if present is None:
            self._edits.add_child(tag, element)
        else:
            self._edits.replace(present.start, present.end_end, element)

    def _driver(self, tag: Tag, name: str, text: str) -> dict[str, str]:
        """The attributes that connect an input of a surface to what text names: a node, else an image."""
        assert self._document is not None and tag.parent is not None
        scope = tag.parent if tag.parent.name == "nodegraph" else self._root
        graph = self._document if scope is self._root else self._document.getNodeGraph(path_of(scope))
        setting = None if is_path(text) else self._node(tag, scope, graph, name, text)
        if setting is not None:
            if filenames.is_file(Path(text)) and name not in self._used:
                warn_of_both(name, text)
            return setting
        file = find_image(name, text)
        if not file:
            raise MrmError(
                f"--set {name}={text}: there is no such file, and no such node beside {path_of(tag)}"
                f"{_near(text, names_beside(graph))}"
            )
        return {"nodename": self._image(tag, scope, name, file)}

    def _node(
        self, tag: Tag, scope: Tag, graph: mx.GraphElement, name: str, text: str
    ) -> dict[str, str] | None:
        node, slash, output = text.partition("/")
        place = "" if scope is self._root else f"{path_of(scope)}/"
        setting = node_setting(graph, name, self._renamed.get(place + node, node) + slash + output)
        if setting is not None or scope is self._root:
            return setting
        assert self._document is not None
        outer = node_setting(self._document, name, self._renamed.get(node, node) + slash + output)
        if outer is None or outer.get("nodegraph") == path_of(scope):
            return None
        if "nodedef" in scope.attributes:
            raise MrmError(
                f"--set {name}={text}: {path_of(tag)} is in a graph that implements a definition, which sees no "
                f"nodes but its own"
            )
        if (id(scope), name) not in self._added:
            socket = fitting(name, {child.attributes.get("name", "") for child in scope.children})
            self._added[id(scope), name] = socket
            self._edits.add_before(scope.children[0], _element("input", socket, outer))
        return {"interfacename": self._added[id(scope), name]}

    def _image(self, tag: Tag, scope: Tag, name: str, file: str) -> str:
        """Add a node for an image before a surface, one in each scope, and return its name."""
        if (id(scope), name) in self._added:
            return self._added[id(scope), name]
        image = fitting(f"{name}_image", {child.attributes.get("name", "") for child in scope.children})
        self._added[id(scope), name] = image
        around = (scope, self._root)
        plain = ' fileprefix=""' if any("fileprefix" in each.attributes for each in around) else ""
        named = quoteattr(relative(file, self._folder))
        socket = f'<input name="file" type="filename" value={named} colorspace="none" />'
        self._edits.add_before(tag, f'<image name="{image}" type="float"{plain}>{socket}</image>')
        return image


def _element(category: str, name: str, setting: Mapping[str, str]) -> str:
    attributes = "".join(f" {key}={quoteattr(value)}" for key, value in setting.items())
    return f'<{category} name="{name}" type="float"{attributes} />'


def _near(text: str, names: list[str]) -> str:
    return f"; {suggestion(text, names)}" if names else ""


#: How documents before 1.38 have a shader, with <bindinput> for its inputs.
_OLD_SHADER = "shaderref"


def _port(tag: Tag) -> str:
    return "bindinput" if tag.name == _OLD_SHADER else "input"


def _surface_of(tag: Tag) -> Surface | None:
    if tag.name == _OLD_SHADER:
        return known_surfaces().get(tag.attributes.get("node", ""))
    is_node = tag.attributes.get("type") == "surfaceshader" and tag.parent is not None
    return known_surfaces().get(tag.name) if is_node else None


def _is_switched(tag: Tag) -> bool:
    switch = tag.child("input", SWITCH)
    if tag.name not in SUBSTITUTES or tag.attributes.get("type") != "BSDF" or switch is None:
        return False
    return _connection(switch) != "" or switch.attributes.get("value") == "true"


def _connection(tag: Tag) -> str:
    """Return the attributes of an input that connect it, as they are written."""
    names = ("interfacename", "nodename", "nodegraph", "output")
    return " ".join(f"{name}={quoteattr(tag.attributes[name])}" for name in names if name in tag.attributes)


def _rename(edits: Edits, tag: Tag, node: str, name: str) -> None:
    if tag.name == _OLD_SHADER:
        edits.set_attribute(tag, "node", name)
    else:
        edits.rename(tag, name)
    definition = tag.attributes.get("nodedef")
    if definition is not None:
        edits.set_attribute(tag, "nodedef", definition.replace(node, name, 1))


def _replace_switch(edits: Edits, tag: Tag) -> None:
    """Make the input `retroreflective` a weight: 1, or the boolean that it is connected to as a number."""
    switch = tag.child("input", SWITCH)
    assert switch is not None
    connection = _connection(switch)
    if not connection:
        source = 'value="1.0"'
    else:
        names = {sibling.attributes.get("name") for sibling in tag.parent.children} if tag.parent else set()
        name = converted = f"{tag.attributes.get('name', tag.name)}_{WEIGHT}"
        count = 1
        while name in names:
            count += 1
            name = f"{converted}{count}"
        inner = f'<input name="in" type="boolean" {connection} />'
        edits.add_before(tag, f'<convert name="{name}" type="float">{inner}</convert>')
        source = f'nodename="{name}"'
    edits.replace(switch.start, switch.end_end, f'<input name="{WEIGHT}" type="float" {source} />')


def _our_nodes() -> set[str]:
    return {surface.name for surface in known_surfaces().values()} | set(SUBSTITUTES.values())


def _why_nothing(root: Tag, included: Sequence[str]) -> str:
    present = next((tag for tag in root.walk() if tag.name in _our_nodes()), None)
    if root.name != "materialx":
        return f"is <{root.name}>, not <materialx>"
    known = ", ".join(known_surfaces())
    if included:
        return (
            f"has none of {known} itself; retrofit {', '.join(included)}, which it includes, and include what "
            "comes out"
        )
    if present is not None:
        return f"is retrofitted already: {present.attributes.get('name')} is a {present.name}"
    return f"has nothing to retrofit: none of {known}, and no BSDF with {SWITCH} on"


def _it(files: Sequence[str]) -> str:
    return "it" if len(files) == 1 else "them"


def _included_surfaces(source: Path) -> list[str]:
    """The documents that a document includes, all the way down, in which there are surfaces to retrofit."""
    found = []
    for file in documents.included_documents(source)[1:]:
        text, _ = xmltext.decode(file.read_bytes(), str(file))
        if any(_surface_of(tag) for tag in parse(text, str(file)).walk()):
            found.append(os.path.relpath(file, source.parent))
    return list(dict.fromkeys(found))


def _filenames(document: mx.Document) -> list[mx.Input]:
    inputs = [element for element in document.traverseTree() if isinstance(element, mx.Input)]
    return [one for one in inputs if one.getType() == "filename" and one.getValueString()]


def _check_textures(document: mx.Document, source: Path) -> None:
    """Check that every image that the document names is there."""
    folders = filenames.image_folders(filenames.folder_of(source))
    for port in _filenames(document):
        name = filenames.resolved(port)
        if not filenames.find(name, folders).all():
            raise MrmError(
                f"{source}: {port.getNamePath()}: there is no texture {name}: {filenames.absence(name, folders)}"
            )


def _has_relative_textures(document: mx.Document) -> bool:
    return any(not filenames.is_absolute(filenames.resolved(port)) for port in _filenames(document))


def _check_result(
    document: mx.Document, text: bytes, source: Path, target: Path, allow_external: bool
) -> None:
    """Check that a document is sound, that it reads no file from outside, and that one that was valid still is."""
    result = documents.parse_document(text, source, allow_external)
    result.setDataLibrary(library.shared_library())
    elements.check_document(result, os.fspath(source))
    external.check_files(result, target, allow_external)
    valid, message = result.validate()
    if not valid and document.validate()[0]:
        raise MrmError(f"{source}: would not be valid once retrofitted: {' '.join(message.split())}")
