"""Documents that use MaterialX's surfaces and its boolean `retroreflective`, moved over to ours."""

from __future__ import annotations

import math
import os
import tempfile
import warnings
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import MaterialX as mx

from mrm_nodes import documents, elements, library, xmltext
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.surfaces.markup import Edits, Tag, parse
from mrm_nodes.surfaces.substitution import SUBSTITUTES, SWITCH, WEIGHT, Surface, known_surfaces


def retrofit_file(
    source: str | os.PathLike[str], target: str | os.PathLike[str], weights: Mapping[str, float] | None = None
) -> list[str]:
    """Write a copy of a .mtlx file whose surfaces are ours, and return the names of the nodes that changed.

    Everything else stays byte for byte: comments, layout, order. MaterialX's microfacet BSDFs with
    `retroreflective` on become ours at weight 1.

    Args:
        source: a MaterialX document with open_pbr_surface, gltf_pbr or standard_surface nodes.
        target: the file to write; it may exist, but may not be `source`.
        weights: values of the new inputs, such as `{"specular_retroreflectivity": 0.8}`.

    Raises:
        MrmError: `source` is missing, is not MaterialX, refers to something that is missing, or has nothing
            to retrofit; a weight is unknown or not from 0 to 1; `target` cannot be written. Then nothing is.
    """
    source, target = Path(source), Path(target)
    document = documents.read_document(source)
    elements.check_document(document, os.fspath(source))
    _check_textures(document, source)
    if target.exists() and target.samefile(source):
        raise MrmError(f"{target}: is the file to read; name another one to write")
    text, changed = retrofit_text(source.read_bytes(), os.fspath(source), weights)
    _check_result(document, text, os.fspath(source))
    if _has_relative_textures(document) and target.resolve().parent != source.resolve().parent:
        warnings.warn(
            f"{target}: its textures are named relative to {source.parent}; copy them too",
            MrmWarning,
            stacklevel=2,
        )
    write_whole(target, text)
    return changed


def retrofit_text(
    text: bytes, where: str, weights: Mapping[str, float] | None = None
) -> tuple[bytes, list[str]]:
    """Return the text of a MaterialX document with its surfaces exchanged for ours, and the changed nodes.

    Raises:
        MrmError: not XML, nothing to retrofit, or a weight that is unknown or not from 0 to 1.
    """
    weights = dict(weights or {})
    _check_weights(weights)
    content, codec = xmltext.decode(text, where)
    root = parse(content, where)
    edits = Edits(content)
    changed, used = [], set()
    for tag in root.walk():
        if tag.name == "nodedef" and tag.attributes.get("node") in _our_nodes():
            raise MrmError(f"{where}: defines a node {tag.attributes['node']} itself; rename it first")
        surface = _surface_of(tag)
        if surface is not None:
            _rename(edits, tag, surface.node, surface.name)
            if surface.input in weights:
                _set_weight(edits, tag, surface.input, weights[surface.input])
                used.add(surface.input)
            changed.append(tag.attributes.get("name", tag.name))
        elif tag.name in SUBSTITUTES and _is_switched(tag):
            _rename(edits, tag, tag.name, SUBSTITUTES[tag.name])
            _replace_switch(edits, tag)
            changed.append(tag.attributes.get("name", tag.name))
    if not changed:
        raise MrmError(f"{where}: {_why_nothing(root)}")
    for unused in sorted(set(weights) - used):
        raise MrmError(f"{where}: no surface in it has an input {unused}")
    return edits.apply().encode(codec, "xmlcharrefreplace"), changed


def write_whole(target: Path, content: bytes) -> None:
    """Write a file all at once: whoever looks sees the old one or the new one.

    Raises:
        MrmError: it cannot be written.
    """
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.resolve().parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        mask = os.umask(0)
        os.umask(mask)
        Path(temporary).chmod(0o666 & ~mask)
        Path(temporary).replace(target)
    except OSError as error:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)
        raise MrmError(f"{target}: cannot be written ({error.strerror})") from None


def _surface_of(tag: Tag) -> Surface | None:
    is_node = tag.attributes.get("type") == "surfaceshader" and tag.parent is not None
    return known_surfaces().get(tag.name) if is_node else None


def _is_switched(tag: Tag) -> bool:
    switch = tag.child("input", SWITCH)
    if tag.attributes.get("type") != "BSDF" or switch is None:
        return False
    return _connection(switch) != "" or switch.attributes.get("value") == "true"


def _connection(tag: Tag) -> str:
    """Return the attributes of an input that connect it, as they are written."""
    names = ("interfacename", "nodename", "nodegraph", "output")
    return " ".join(f"{name}={quoteattr(tag.attributes[name])}" for name in names if name in tag.attributes)


def _rename(edits: Edits, tag: Tag, node: str, name: str) -> None:
    edits.rename(tag, name)
    definition = tag.attributes.get("nodedef")
    if definition is not None:
        edits.set_attribute(tag, "nodedef", definition.replace(node, name, 1))


def _set_weight(edits: Edits, tag: Tag, name: str, weight: float) -> None:
    element = f'<input name="{name}" type="float" value="{weight:g}" />'
    present = tag.child("input", name)
    if present is None:
        edits.add_child(tag, element)
    else:
        edits.replace(present.start, present.end_end, element)


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


def _why_nothing(root: Tag) -> str:
    present = next((tag for tag in root.walk() if tag.name in _our_nodes()), None)
    if root.name != "materialx":
        return f"is <{root.name}>, not <materialx>"
    if present is not None:
        return f"is retrofitted already: {present.attributes.get('name')} is a {present.name}"
    known = ", ".join(known_surfaces())
    if any(tag.name.endswith(":include") for tag in root.walk()):
        return f"has none of {known} itself; retrofit the files that it includes"
    return f"has nothing to retrofit: none of {known}, and no BSDF with {SWITCH} on"


def _check_weights(weights: Mapping[str, float]) -> None:
    known = sorted({surface.input for surface in known_surfaces().values()})
    for name, weight in weights.items():
        if name not in known:
            raise MrmError(f"unknown input {name}; one that can be set is {' or '.join(known)}")
        if not (math.isfinite(weight) and 0.0 <= weight <= 1.0):
            raise MrmError(f"{name}: {weight:g} is not from 0 to 1")


def _filenames(document: mx.Document) -> list[mx.Input]:
    inputs = [element for element in document.traverseTree() if isinstance(element, mx.Input)]
    return [one for one in inputs if one.getType() == "filename" and one.getValueString()]


def _check_textures(document: mx.Document, source: Path) -> None:
    """Check that every image that the document names is there, but for names with tokens (<UDIM>)."""
    search_path = library.search_path()
    search_path.prepend(mx.FilePath(str(source.resolve().parent)))
    for one in _filenames(document):
        name = one.getResolvedValueString()
        if "<" in name or "{" in name:
            continue
        if not search_path.find(mx.FilePath(name)).exists():
            raise MrmError(f"{source}: {one.getNamePath()}: there is no texture {name}")


def _has_relative_textures(document: mx.Document) -> bool:
    return any(not Path(one.getResolvedValueString()).is_absolute() for one in _filenames(document))


def _check_result(document: mx.Document, text: bytes, where: str) -> None:
    """Check that a document that was valid still is."""
    result = documents.parse_document(text, Path(where))
    result.setDataLibrary(library.shared_library())
    valid, message = result.validate()
    if not valid and document.validate()[0]:
        raise MrmError(f"{where}: would not be valid once retrofitted: {' '.join(message.split())}")
