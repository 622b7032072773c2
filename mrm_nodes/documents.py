"""Documents: how a .mtlx file is read, what of it is rendered, and whether that is sound."""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes import cycles, external, filenames, library, xmltext
from mrm_nodes.errors import MrmError, MrmWarning, unknown

LARGEST = 64 << 20
"""Bytes of a document with all that it includes."""
MOST_ELEMENTS = 500_000
"""Elements of a document with all that it includes, each include counted."""
MOST_NAMELESS = 2000
"""Elements without a name in one file: MaterialX looks for a free name for each, which takes the square in time."""
LONGEST = 60.0
"""Seconds for reading a document with all that it includes."""


def read_document(
    path: str | os.PathLike[str],
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
) -> mx.Document:
    """Read a .mtlx file, with MaterialX's standard libraries and ours beside it.

    libraries: a MaterialX `libraries` folder in place of the installed MaterialX's.
    allow_external: whether it may include documents and name images outside of its folder and the node libraries.

    Raises:
        MrmError: the file is missing, is not MaterialX, is too large, or names a file that it may not read.
    """
    file = Path(path)
    document = _Reading(file, allow_external).document
    external.check_images(document, file, allow_external)
    document.setDataLibrary(library.shared_library(libraries))
    cycles.check_cycles(document, str(file))
    return document


def files_of(path: Path, document: mx.Document) -> list[Path]:
    """Every file of a material: its documents and its images."""
    files = [*included_documents(path), *external.check_images(document, path, True)]
    return list(dict.fromkeys(Path(os.path.abspath(file)) for file in files))  # noqa: PTH100


def parse_document(content: bytes, path: Path, allow_external: bool = False) -> mx.Document:
    """The document that a file with this content would be; no library goes with it.

    Raises:
        MrmError: as `read_document`.
    """
    return _Reading(path, allow_external, content).document


def included_documents(path: Path) -> list[Path]:
    """A .mtlx file and all that it includes, all the way down.

    Raises:
        MrmError: as `read_document`.
    """
    return _Reading(path, allow_external=True).files


class _Reading:
    """A document as MaterialX's own reader reads it; what it finds to include, it asks for here.

    So there is one reader, and none that sees an include which the other does not.
    """

    def __init__(self, file: Path, allow_external: bool, content: bytes | None = None) -> None:
        self._folder = file.resolve().parent
        self._allow_external = allow_external
        self._until = time.monotonic() + LONGEST
        self._bytes = self._elements = 0
        self._read: dict[Path, tuple[mx.Document, int]] = {}
        self._open: dict[Path, Path] = {}
        self.files: list[Path] = []
        if content is None and not filenames.is_file(file):
            raise MrmError(f"{file}: no such file")
        self.document = self._of(file, content)

    def _of(self, file: Path, content: bytes | None = None) -> mx.Document:
        """The document of a file; each is read once."""
        key = file.resolve()
        if key in self._open:
            raise MrmError(f"{file}: includes itself")
        if key not in self._read:
            self._open[key] = file
            self.files.append(file)
            document = mx.createDocument()
            self._parse(document, file, self._content(file) if content is None else content)
            self._read[key] = document, sum(1 for _ in document.traverseTree())
            del self._open[key]
        document, count = self._read[key]
        # What is included twice is copied twice.
        self._elements += count
        self._check_limits(file)
        return document

    def _content(self, file: Path) -> bytes:
        try:
            self._bytes += file.stat().st_size
            self._check_limits(file)
            return file.read_bytes()
        except OSError as error:
            raise MrmError(f"{file}: cannot be read: {error.strerror}") from None

    def _parse(self, document: mx.Document, file: Path, content: bytes) -> None:
        text, _ = xmltext.decode(content, str(file))
        self._check_amount(text, file)
        options = mx.XmlReadOptions()
        options.readXIncludeFunction = self._include
        # By this MaterialX and the shader's source know where the document lies.
        document.setSourceUri(str(file))
        try:
            # The mark keeps MaterialX from decoding again what the text declares.
            mx.readFromXmlString(document, "\ufeff" + text.lstrip("\ufeff"), mx.FileSearchPath(), options)
        except MrmError:
            raise
        except Exception as error:  # MaterialX's own exception types differ between versions
            raise MrmError(f"{file}: not a MaterialX document: {one_line(error)}") from None

    def _include(self, into: mx.Document, name: mx.FilePath, *_: object) -> None:
        *outer, including = self._open.values()
        folders = [*(each.parent for each in reversed(outer)), self._folder]
        found = external.included_file(name.asString(), including, folders, self._allow_external)
        included = self._of(found)
        into.setSourceUri(str(found))
        into.copyContentFrom(included)

    def _check_amount(self, text: str, file: Path) -> None:
        """Check what MaterialX's reader has no limit for, before it reads."""
        elements = nameless = 0
        for token in xmltext.tokens(text, str(file)):
            if token.opens or not token.closes:
                elements += 1
                nameless += not xmltext.attributes_of(token.attributes).get("name")
        if elements == 0:
            raise MrmError(f"{file}: not a MaterialX document: no element found")
        if nameless > MOST_NAMELESS:
            raise MrmError(f"{file}: has more than {MOST_NAMELESS} elements without a name")
        if elements > MOST_ELEMENTS:
            raise MrmError(f"{file}: more than {MOST_ELEMENTS} elements, which is no material")

    def _check_limits(self, file: Path) -> None:
        among = "" if len(self.files) == 1 else " with what includes it"
        if self._bytes > LARGEST:
            raise MrmError(f"{file}: larger than {LARGEST >> 20} MiB{among}, which is no material")
        if self._elements > MOST_ELEMENTS:
            raise MrmError(f"{file}: more than {MOST_ELEMENTS} elements{among}, which is no material")
        if time.monotonic() > self._until:
            raise MrmError(f"{file}: takes longer than {LONGEST:g} s to read{among}")


def find_renderable(document: mx.Document, where: str, element: str | None) -> mx.Element:
    """Return the element to generate: the one named, or the only one that can be rendered.

    Raises:
        MrmError: no such element, none that can be rendered, or several.
    """
    # A graph that implements a definition, as the library's do, is not the document's own output.
    renderables = [
        found
        for found in mx_gen_shader.findRenderableElements(document)
        if not found.getParent().getAttribute("nodedef")
    ]
    names = [renderable.getNamePath() for renderable in renderables]
    if element is not None:
        found = document.getDescendant(element) if element else None
        if found is None:
            raise MrmError(f"{where}: {unknown('element', element, names)}")
        return found
    if not renderables:
        raise MrmError(f"{where}: nothing to render: no material, shader or output")
    if len(renderables) > 1:
        raise MrmError(
            f"{where}: several elements can be rendered; name one with --element: {', '.join(names)}"
        )
    return renderables[0]


#: Where a literal value of our nodes' inputs is clamped, and why; MaterialX's own nodes clamp the same way.
_RANGES: dict[str, tuple[float, float]] = {
    "roughness": (1e-8, 1.0),
    "retroreflectivity": (0.0, 1.0),
    "tint": (0.0, math.inf),
    "color0": (0.0, math.inf),
    "color82": (0.0, math.inf),
    "color90": (0.0, math.inf),
}

#: Types whose values are numbers, and what such a value is.
_NUMBERS = {
    "boolean": "true or false",
    "integer": "an integer",
    "float": "a finite number",
    **{f"{kind}{n}": f"{n} finite numbers" for kind in ("vector", "color") for n in (2, 3, 4)},
    "matrix33": "9 finite numbers",
    "matrix44": "16 finite numbers",
}


def check_document(document: mx.Document, where: str = "document") -> None:
    """Check that every node, input, value and connection is sound; warn of values that the nodes will clamp.

    Raises:
        MrmError: an unknown node; an input that its node does not have, or of another type; a value that is
            malformed, NaN or infinite; a connection to something that does not exist or has another type.
    """
    for node in nodes_of(document):
        if node.getNodeDef() is None:
            raise MrmError(f"{where}: node {node.getNamePath()}: {_why_undefined(node, document)}")
    for port in _ports(document):
        _check_port(port, f"{where}: {port.getNamePath()}")


def _own(document: mx.Document) -> list[mx.Element]:
    """Return the elements of a document that are no library's."""
    shared = library.shared_library()
    return [child for child in document.getChildren() if shared.getChild(child.getName()) is None]


def nodes_of(document: mx.Document) -> Iterator[mx.Node]:
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getNodes()
        elif child.isA(mx.Node):
            yield child


def _ports(document: mx.Document) -> Iterator[mx.Input | mx.Output]:
    """Yield the inputs and outputs of the document itself, of node graphs and, last, of nodes."""
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getInputs()
            yield from child.getOutputs()
        elif child.isA(mx.Input) or child.isA(mx.Output):
            yield child
    for node in nodes_of(document):
        yield from node.getInputs()


def _why_undefined(node: mx.Node, document: mx.Document) -> str:
    """Say what keeps a node from having a definition: its name, its type, or one of its inputs."""
    category = node.getCategory()
    definitions = {definition.getName(): definition for definition in document.getNodeDefs()}
    definitions |= {each.getName(): each for each in library.shared_library().getNodeDefs()}
    alike = [each for each in definitions.values() if each.getNodeString() == category]
    if not alike:
        return unknown("node", category, {each.getNodeString() for each in definitions.values()})
    of_type = [each for each in alike if each.getType() == node.getType()]
    if not of_type:
        return f"{category} has no type {node.getType()}; known: {_listed(each.getType() for each in alike)}"
    for port in node.getInputs():
        name = port.getName()
        types = {each.getActiveInput(name).getType() for each in of_type if each.getActiveInput(name)}
        if not types:
            known = {each.getName() for definition in of_type for each in definition.getActiveInputs()}
            return f"{category}: {unknown('input', name, known)}"
        if port.getType() not in types:
            return f"input {name} has type {port.getType()}, not {_listed(types)}"
    return f"no {category} has these inputs together"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(sorted(set(names)))


def _check_port(port: mx.Input | mx.Output, place: str) -> None:
    text = port.getValueString()
    if text and port.getValue() is None and port.getType() in _NUMBERS:
        raise MrmError(f"{place}: {text} is not {_NUMBERS[port.getType()]}")
    source = port.getAttribute("nodename") or port.getAttribute("nodegraph")
    # Generation would go on without it, or end in the compiler. Other complaints it can live with.
    if source and "port connection" in port.validate()[1]:
        output = port.getOutputString()
        raise MrmError(
            f"{place}: connected to {source}{'/' + output if output else ''}, "
            f"which does not exist here or is no {port.getType()}"
        )
    node = port.getParent()
    if text and port.isA(mx.Input) and node.isA(mx.Node) and port.getType() == "string":
        choices = node.getNodeDef().getActiveInput(port.getName()).getAttribute("enum")
        known = [choice.strip() for choice in choices.split(",")] if choices else [text]
        if text not in known:
            raise MrmError(f"{place}: {unknown('value', text, known)}")
    if node.getCategory().startswith("mrm_") and port.getName() in _RANGES:
        _warn_of_clamping(port, place)


def _warn_of_clamping(port: mx.Input, place: str) -> None:
    low, high = _RANGES[port.getName()]
    # Through a graph's interface, what is set there reaches the node.
    source = port.getInterfaceInput() or port
    text = source.getValueString() if source.getValue() is not None else ""
    if any(not low <= float(number) <= high for number in text.replace(",", " ").split()):
        limits = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
        warnings.warn(f"{place}: {text} is clamped to its range, {limits}", MrmWarning, stacklevel=5)


def one_line(error: Exception) -> str:
    """What an exception of MaterialX says."""
    return " ".join(str(error).split())
