"""How a .mtlx file is read: as MaterialX's own reader does, within limits, and no file that it may not read."""

from __future__ import annotations

import os
import time
from pathlib import Path

import MaterialX as mx

from mrm_nodes import cycles, external, filenames, library, xmltext
from mrm_nodes.errors import MrmError

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
    allow_external: whether it may name files outside of its folder and the node libraries: documents, images, source.

    Raises:
        MrmError: the file is missing, is not MaterialX, is too large, or names a file that it may not read.
    """
    document, _ = read_with_files(path, libraries, allow_external)
    return document


def read_with_files(
    path: str | os.PathLike[str],
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
) -> tuple[mx.Document, list[Path]]:
    """As `read_document`, and the `files_of` the document, each of which is looked for once."""
    file = Path(path)
    reading = _Reading(file, allow_external)
    document = reading.document
    _drop_empty(document)
    named = external.check_files(document, file, allow_external)
    document.setDataLibrary(library.shared_library(libraries))
    cycles.check_cycles(document, str(file))
    return document, _listed([*reading.files, *named])


#: Types that only a node has; no text is a value of theirs.
_OF_NODES = frozenset(
    ("BSDF", "EDF", "VDF", "surfaceshader", "displacementshader", "volumeshader", "lightshader", "material")
)


def _drop_empty(document: mx.Document) -> None:
    """Remove the inputs that are an empty text where a node could be: exporters write them, some generators fail."""
    connections = ("nodename", "nodegraph", "interfacename", "output")
    of_nodes = [
        each
        for each in document.traverseTree()
        if isinstance(each, mx.Input)
        and each.getType() in _OF_NODES
        and isinstance(each.getParent(), mx.Node)
    ]
    for port in of_nodes:
        if not any(port.getAttribute(name) for name in ("value", *connections)):
            port.getParent().removeInput(port.getName())


def files_of(path: Path, document: mx.Document) -> list[Path]:
    """Every file that a material's shaders are made of: documents, images, and the source code of its own nodes."""
    return _listed([*included_documents(path), *external.check_files(document, path, True)])


def _listed(files: list[Path]) -> list[Path]:
    return list(dict.fromkeys(map(filenames.absolute, files)))


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
        self._folder = filenames.folder_of(file)
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
        filenames.check_text(file)
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
        shaders: set[str] = set()
        # No more elements than this: then no names are looked at.
        is_small = text.count("<") <= MOST_NAMELESS
        for token in xmltext.tokens(text, str(file)):
            if token.opens or not token.closes:
                elements += 1
                if is_small:
                    continue
                name = xmltext.name_in(token.attributes)
                is_reference = token.name == "shaderref"
                # MaterialX makes nodes of an old document's shader references, all in one place.
                nameless += not name or (is_reference and name in shaders)
                if is_reference:
                    shaders.add(name)
        if elements == 0:
            raise MrmError(f"{file}: not a MaterialX document: no element found")
        if nameless > MOST_NAMELESS:
            raise MrmError(f"{file}: has more than {MOST_NAMELESS} elements without a name of their own")
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


def one_line(error: Exception) -> str:
    """What an exception of MaterialX says."""
    return " ".join(str(error).split())
