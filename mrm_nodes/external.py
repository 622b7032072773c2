"""Which files a material reads, and that they lie where it may read: in its own folder or in a node library."""

from __future__ import annotations

import filecmp
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import MaterialX as mx

from mrm_nodes import filenames, library
from mrm_nodes.errors import MrmError

FLAG = "--allow-external"

LARGEST_SOURCE = 8 << 20
"""Bytes of a file of source code."""

_TOKEN, _TOKEN_VALUES = "$fileTransformUv", ("mx_transform_uv.glsl", "mx_transform_uv_vflip.glsl")
"""What MaterialX's generators put in for a file's name, by how images are handed over."""

_LIBRARIES = ("libraries", "mtlx", "glsl")
"""Folders of node libraries: MaterialX's, and ours."""


def included_file(name: str, including: Path, folders: Iterable[Path], allow_external: bool) -> Path:
    """The file that a document includes by a name: beside it, in one of the folders, or where MaterialX looks.

    Raises:
        MrmError: there is none, or it lies outside of the last folder and the node libraries.
    """
    folders = [including.parent, *folders]
    places = [*folders, *filenames.search_folders()]
    found = filenames.find(name, places).file
    if found is None:
        raise MrmError(
            f"{including}: includes {name[: filenames.LONGEST]}: {filenames.absence(name, places)}"
        )
    check_inside(found, name, str(including), folders[-1], allow_external)
    return found


def _shared_folders() -> list[Path]:
    """Where every material may read: the node libraries, and what the user put on MaterialX's search path."""
    return [*_library_folders(), *filenames.folders_of(mx.getEnvironmentPath())]


def _library_folders() -> list[Path]:
    """The node libraries. In a checkout the folder that ours are found from is the whole repository."""
    return [root / name for root in filenames.folders_of(library.search_path()) for name in _LIBRARIES]


def check_inside(file: Path, name: str, where: str, folder: Path, allow_external: bool) -> None:
    """Check that a file lies in a folder or a node library.

    Raises:
        MrmError: it does not, and may not.
    """
    if allow_external:
        return
    resolved = Path(os.path.realpath(file))
    roots = [Path(os.path.realpath(each)) for each in (folder, *_shared_folders())]
    if not any(resolved.is_relative_to(root) for root in roots):
        raise MrmError(
            f"{where}: {name} is {resolved}, outside of {folder} and the node libraries; "
            f"{FLAG} lets a material read it"
        )


def check_files(document: mx.Document, path: Path, allow_external: bool = False) -> list[Path]:
    """Every file beside the documents that a document's shaders are made of, where it is there.

    These are the images, all tiles of a set, and the source code of its own implementations with what that includes.

    Raises:
        MrmError: one lies outside of the document's folder and the node libraries, is an address in a network, or is
            source that cannot be looked through. It is named, and nothing of it quoted.
    """
    ports, implementations = list(_filenames(document)), _implementations(document)
    if not ports and not implementations:
        return []
    check = _Check(path, allow_external)
    for port in ports:
        check.image(filenames.resolved(port), port.getNamePath())
    for implementation in implementations:
        check.source(implementation.getFile(), implementation)
    return list(dict.fromkeys(map(filenames.absolute, check.found)))


class _Check:
    """Collects the files that one document names, each looked at before it is read."""

    def __init__(self, path: Path, allow_external: bool) -> None:
        self._path = path
        self._allow_external = allow_external
        self._folder = filenames.folder_of(path)
        self._image_folders = filenames.image_folders(self._folder)
        self._source_folders = filenames.folders_of(library.search_path())
        self._sources: set[Path] = set()
        self.found: dict[Path, None] = {}
        self.absent: dict[str, str] = {}
        """Names of source code that is not there, and where each stands."""

    def image(self, name: str, where: str) -> None:
        """Collect the files of an image's name."""
        files = filenames.find(name, self._image_folders).all()
        if filenames.is_address(name) and not files:
            why = filenames.absence(name, self._image_folders)
            raise MrmError(f"{self._path}: {where}: {name} {why}")
        for file in files:
            check_inside(file, name, f"{self._path}: {where}", self._folder, self._allow_external)
            self.found[file] = None

    def source(self, name: str, implementation: mx.Implementation) -> None:
        """Collect the file of an implementation and all that it includes, as MaterialX's generators do."""
        uri = implementation.getActiveSourceUri()
        waiting = [(name, Path(uri), f"{self._path}: {implementation.getName()}")]
        while waiting:
            name, beside, where = waiting.pop()
            file = self._source_file(name, beside, where)
            if file is None:
                self.absent.setdefault(name, where)
            if file is None or file in self._sources:
                continue
            self._sources.add(file)
            check_inside(file, name, where, self._folder, self._allow_external)
            # The node libraries' own source comes with their version.
            if not any(file.is_relative_to(each) for each in _library_folders()):
                self.found[file] = None
                waiting += [(each, file, str(file)) for each in _included_by(file)]

    def _source_file(self, name: str, beside: Path, where: str) -> Path | None:
        """The file that MaterialX's generators read for a name that stands in another file."""
        folders = self._source_folders if beside.parent == Path() else [beside.parent, *self._source_folders]
        found = filenames.find(name, folders)
        if found.instead is not None:
            raise MrmError(f"{where}: {name} {filenames.absence(name, folders)}")
        # They find the name as it is and read it without its `..`: not the same thing below a link.
        file = found.file and Path(os.path.normpath(found.file))
        if file is not None and not filenames.is_file(file):
            raise MrmError(f"{where}: {name}: MaterialX reads {file}, which is no file; name it without `..`")
        return file


def _included_by(file: Path) -> list[str]:
    """What a file of source code includes, by the rule of MaterialX's generators, to which comments are code.

    Raises:
        MrmError: it is too large, cannot be read, or includes by a name whose meaning is not known here.
    """
    try:
        if file.stat().st_size > LARGEST_SOURCE:
            raise MrmError(
                f"{file}: larger than {LARGEST_SOURCE >> 20} MiB, which is no source code of a node"
            )
        lines = file.read_bytes().split(b"\n")
    except OSError as error:
        raise MrmError(f"{file}: cannot be read: {error.strerror}") from None
    names: list[str] = []
    for number, line in enumerate(lines, 1):
        first, last = line.find(b'"'), line.rfind(b'"')
        if b"#include" not in line or last - first < 2:
            continue
        try:
            name = line[first + 1 : last].decode("utf-8")
        except UnicodeDecodeError:
            raise MrmError(f"{file}: line {number}: the name of an included file is not UTF-8") from None
        known = [name.replace(_TOKEN, each) for each in _TOKEN_VALUES] if _TOKEN in name else [name]
        if "$" in known[0]:
            raise MrmError(f"{file}: line {number}: a `$` in an included file's name; only {_TOKEN} is known")
        names += known
    return names


def absent_source(document: mx.Document, path: Path) -> dict[str, str]:
    """Names of source code that a document's implementations, or what they include, give and that is not there.

    Returns:
        by name, the file or the implementation in which it stands.

    Raises:
        MrmError: as `check_files`.
    """
    check = _Check(path, allow_external=True)
    for implementation in _implementations(document):
        check.source(implementation.getFile(), implementation)
    return check.absent


def _filenames(document: mx.Document) -> Iterator[mx.ValueElement]:
    for element in document.traverseTree():
        if isinstance(element, mx.ValueElement) and element.getType() == "filename":
            yield element


def _implementations(document: mx.Document) -> list[mx.Implementation]:
    """A document's own: the hundreds of its data library are that library's."""
    return [each for each in document.getChildren() if isinstance(each, mx.Implementation)]


def move_names(document: mx.Document, old: Path, new: Path) -> None:
    """Have what a document names by absolute names below one folder read below another."""
    for element in (document, *document.traverseTree()):
        if element.hasFilePrefix():
            element.setFilePrefix(moved_name(element.getFilePrefix(), old, new))
    for port in _filenames(document):
        moved = moved_name(port.getValueString(), old, new)
        if moved != port.getValueString():
            port.setValueString(moved)
    for implementation in _implementations(document):
        if implementation.hasFile():
            implementation.setFile(moved_name(implementation.getFile(), old, new))


def moved_name(name: str, old: Path, new: Path) -> str:
    """An absolute file name or prefix below one folder as it is below another; any other as it is."""
    text = filenames.with_slashes(name)
    file = Path(os.path.normpath(text))
    if not filenames.is_absolute(name) or not file.is_relative_to(old):
        return name
    return str(new / file.relative_to(old)) + ("/" if name.endswith(("/", "\\")) else "")


def check_travelled(files: list[Path], path: Path, old: Path, new: Path) -> None:
    """Check that a material which came from another machine reads only what came with it, or the same contents.

    Args:
        old: the folder above all of its files where they came from.
        new: the folder that has them here.

    Raises:
        MrmError: a file lies neither below `new` nor in a node library, and is not what it was below `old`.
    """
    roots = [Path(os.path.realpath(each)) for each in (new, *_library_folders())]
    for file in files:
        if any(Path(os.path.realpath(file)).is_relative_to(root) for root in roots):
            continue
        # Found on MATERIALX_SEARCH_PATH, say, which both machines have.
        twin = Path(moved_name(os.path.abspath(file), old, new))  # noqa: PTH100
        travelled = twin.is_relative_to(new) and filenames.is_file(twin)
        if not travelled or not filecmp.cmp(file, twin, shallow=False):
            raise MrmError(
                f"{path}: {file} did not come along to the cluster's worker: name it relative to the material"
            )
