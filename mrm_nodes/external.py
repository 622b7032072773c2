"""Which files a material reads, and that they lie where it may read: in its own folder or in a node library."""

from __future__ import annotations

import os
import re
import xml.parsers.expat
from collections.abc import Iterator
from pathlib import Path

import MaterialX as mx

from mrm_nodes import library
from mrm_nodes.errors import MrmError

DEEPEST = 100
"""Elements within elements: MaterialX's own reader has no limit but the stack."""
LARGEST = 64 << 20
"""Bytes of a document."""

FLAG = "--allow-external"

_LIBRARIES = ("libraries", "mtlx", "glsl")
"""Folders of node libraries: MaterialX's, and ours."""


def check_includes(path: Path, allow_external: bool = False) -> list[Path]:
    """The documents that a .mtlx file includes, all the way down, itself first: before MaterialX reads any of them.

    Raises:
        MrmError: one is not XML, is nested too deeply, has a document type, or includes a file from outside.
    """
    return list(_included(path, path.resolve().parent, allow_external, ()))


def _included(path: Path, folder: Path, allow_external: bool, above: tuple[Path, ...]) -> Iterator[Path]:
    if path.resolve() in above:
        raise MrmError(f"{path}: includes itself")
    yield path
    for name in _include_names(path):
        found = _candidates(name, folder, path.parent)
        if not found:
            raise MrmError(f"{path}: includes {name}, which does not exist")
        for file in found:
            _check_inside(file, name, str(path), folder, allow_external)
            yield from _included(file, folder, allow_external, (*above, path.resolve()))


def _include_names(path: Path) -> list[str]:
    """What a document's `xi:include` elements name."""
    names: list[str] = []
    depth = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > DEEPEST:
            raise MrmError(f"{path}: more than {DEEPEST} elements within each other")
        if tag == "xi:include":
            names.append(attributes.get("href", ""))

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def doctype(*what: object) -> None:
        # Its entities would name files that only one of two readers sees.
        raise MrmError(f"{path}: has a document type (<!DOCTYPE …>), which no MaterialX document needs")

    parser = xml.parsers.expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.StartDoctypeDeclHandler = doctype
    try:
        if path.stat().st_size > LARGEST:
            raise MrmError(f"{path}: larger than {LARGEST >> 20} MiB, which is no material")
        parser.Parse(path.read_bytes(), True)
    except OSError as error:
        raise MrmError(f"{path}: cannot be read: {error.strerror}") from None
    except xml.parsers.expat.ExpatError as error:
        raise MrmError(f"{path}: not a MaterialX document: line {error.lineno}: {error}") from None
    except (ValueError, LookupError) as error:  # an encoding that Python does not have
        raise MrmError(f"{path}: not a MaterialX document: {error}") from None
    return names


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have is none, and no OSError."""
    return os.path.isfile(path)  # noqa: PTH113


def _candidates(name: str, *folders: Path) -> list[Path]:
    """Every file that MaterialX could take for a name; at last, one relative to where the program runs."""
    found = [
        root / name for root in (*folders, *_search_folders(), Path()) if name and (root / name).is_file()
    ]
    return list({os.path.realpath(file): file for file in reversed(found)}.values())[::-1]


def _search_folders() -> list[Path]:
    return [*_folders(library.search_path()), *_folders(mx.getEnvironmentPath())]


def _folders(path: mx.FileSearchPath) -> list[Path]:
    return [Path(folder) for folder in path.asString().split(os.pathsep) if folder]


def _shared_folders() -> list[Path]:
    """Where every material may read: the node libraries, and what the user put on MaterialX's search path.

    In a checkout the library's own folder is the whole repository, of which the nodes are a part.
    """
    libraries = [root / name for root in _folders(library.search_path()) for name in _LIBRARIES]
    return [*libraries, *_folders(mx.getEnvironmentPath())]


def _check_inside(file: Path, name: str, where: str, folder: Path, allow_external: bool) -> None:
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
    found: dict[Path, None] = {}
    for port in _filenames(document):
        name = port.getResolvedValueString()
        if not name:
            continue
        if re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name):
            raise MrmError(
                f"{path}: {port.getNamePath()}: {name} is no file; images are read from files only"
            )
        for file in _candidates(name, folder)[:1]:
            _check_inside(file, name, f"{path}: {port.getNamePath()}", folder, allow_external)
            found[file] = None
    return list(found)


def _filenames(document: mx.Document) -> Iterator[mx.ValueElement]:
    for element in document.traverseTree():
        if isinstance(element, mx.ValueElement) and element.getType() == "filename":
            yield element


def files_of(path: Path, document: mx.Document) -> list[Path]:
    """Every file of a material: its documents and its images."""
    files = [*check_includes(path, True), *check_images(document, path, True)]
    return list(dict.fromkeys(Path(os.path.abspath(file)) for file in files))  # noqa: PTH100


def move_images(document: mx.Document, old: Path, new: Path) -> None:
    """Have the images that a document names by absolute names below one folder read below another."""
    named = [(port, port.getResolvedValueString()) for port in _filenames(document)]
    for element in (document, *document.traverseTree()):
        # Prefixes are part of the resolved names.
        element.removeAttribute("fileprefix")
    for port, name in named:
        if name:
            port.setValueString(moved_name(name, old, new))


def moved_name(name: str, old: Path, new: Path) -> str:
    """An absolute file name below one folder as it is below another; any other name as it is."""
    file = Path(os.path.normpath(name))
    return str(new / file.relative_to(old)) if file.is_absolute() and file.is_relative_to(old) else name


def check_travelled(files: list[Path], path: Path, root: Path) -> None:
    """Check that a material which came from another machine reads only what came with it.

    Raises:
        MrmError: a file lies neither below `root` nor in a node library.
    """
    for file in files:
        try:
            _check_inside(file, str(file), str(path), Path(os.path.realpath(root)), False)
        except MrmError:
            raise MrmError(
                f"{path}: {file} did not come along to the cluster's worker: name it relative to the material"
            ) from None
