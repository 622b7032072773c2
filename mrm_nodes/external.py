"""Which files a material reads, and that they lie where it may read: in its own folder or in a node library."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import MaterialX as mx

from mrm_nodes import filenames, library
from mrm_nodes.errors import MrmError

FLAG = "--allow-external"

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
        raise MrmError(f"{including}: includes {name}: {filenames.absence(name, places)}")
    check_inside(found, name, str(including), folders[-1], allow_external)
    return found


def _shared_folders() -> list[Path]:
    """Where every material may read: the node libraries, and what the user put on MaterialX's search path.

    In a checkout the library's own folder is the whole repository, of which the nodes are a part.
    """
    libraries = [root / name for root in filenames.folders_of(library.search_path()) for name in _LIBRARIES]
    return [*libraries, *filenames.folders_of(mx.getEnvironmentPath())]


def check_inside(file: Path, name: str, where: str, folder: Path, allow_external: bool) -> None:
    """Check that a file lies in a folder or a node library.

    Raises:
        MrmError: it does not, and may not.
    """
    if allow_external:
        return
    resolved = Path(os.path.realpath(file))
    roots = [folder, *(Path(os.path.realpath(each)) for each in _shared_folders())]
    if not any(resolved.is_relative_to(root) for root in roots):
        raise MrmError(
            f"{where}: {name} is {resolved}, outside of {folder} and the node libraries; "
            f"{FLAG} lets a material read it"
        )


def check_images(document: mx.Document, path: Path, allow_external: bool = False) -> list[Path]:
    """The image files that a document names and that exist.

    Raises:
        MrmError: one lies outside of the document's folder and the node libraries, or is an address in a network.
    """
    folder = path.resolve().parent
    folders = [folder, *filenames.search_folders()]
    found: dict[Path, None] = {}
    for port in _filenames(document):
        name = filenames.resolved(port)
        files = filenames.find(name, folders).all()
        if filenames.is_address(name) and not files:
            raise MrmError(f"{path}: {port.getNamePath()}: {name} {filenames.absence(name, folders)}")
        for file in files:
            check_inside(file, name, f"{path}: {port.getNamePath()}", folder, allow_external)
            found[file] = None
    return list(found)


def _filenames(document: mx.Document) -> Iterator[mx.ValueElement]:
    for element in document.traverseTree():
        if isinstance(element, mx.ValueElement) and element.getType() == "filename":
            yield element


def move_images(document: mx.Document, old: Path, new: Path) -> None:
    """Have the images that a document names by absolute names below one folder read below another."""
    for element in (document, *document.traverseTree()):
        if element.hasFilePrefix():
            element.setFilePrefix(moved_name(element.getFilePrefix(), old, new))
    for port in _filenames(document):
        moved = moved_name(port.getValueString(), old, new)
        if moved != port.getValueString():
            port.setValueString(moved)


def moved_name(name: str, old: Path, new: Path) -> str:
    """An absolute file name or prefix below one folder as it is below another; any other as it is."""
    text = filenames.with_slashes(name)
    file = Path(os.path.normpath(text))
    if not filenames.is_absolute(name) or not file.is_relative_to(old):
        return name
    return str(new / file.relative_to(old)) + ("/" if name.endswith(("/", "\\")) else "")


def check_travelled(files: list[Path], path: Path, root: Path) -> None:
    """Check that a material which came from another machine reads only what came with it.

    Raises:
        MrmError: a file lies neither below `root` nor in a node library.
    """
    for file in files:
        try:
            check_inside(file, str(file), str(path), Path(os.path.realpath(root)), False)
        except MrmError:
            raise MrmError(
                f"{path}: {file} did not come along to the cluster's worker: name it relative to the material"
            ) from None
