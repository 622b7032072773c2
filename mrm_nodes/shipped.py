"""What comes with the package: where it lies, and the finished materials by their names. Loads nothing heavy."""

from __future__ import annotations

import difflib
import os
import warnings
from pathlib import Path
from xml.etree import ElementTree

from mrm_nodes.errors import MrmError, MrmWarning

DOCUMENTS = (".mtlx", ".gltf", ".glb")
"""Endings of files with materials."""


def root_path() -> Path:
    """Return the folder that holds `mtlx` and `glsl`: the checkout, or the data of an installed wheel."""
    package = Path(__file__).resolve().parent
    for root in (package / "data", package.parent):
        if (root / "mtlx" / "mrm").is_dir() and (root / "glsl").is_dir():
            return root
    raise MrmError(f"{package}: the node library (mtlx, glsl) is missing; reinstall mrm-nodes")


def materials_path() -> Path:
    """Return the folder of the finished materials (.mtlx) that come with the package."""
    return root_path() / "mtlx" / "materials"


def materials() -> dict[str, Path]:
    """The finished materials' files by their names, such as `traffic_cone`."""
    return {file.stem: file for file in sorted(materials_path().glob("*.mtlx"))}


def about(material: Path) -> str:
    """What a finished material says of itself: the `doc` of its surfacematerial."""
    found = ElementTree.parse(material).find("surfacematerial[@doc]")
    return "" if found is None else found.attrib["doc"]


def material_file(name_or_path: str | os.PathLike[str]) -> Path:
    """Return the document that is meant: a file, or a finished material by its name.

    Where a file has the name of a finished material, the file is taken, and a warning (MrmWarning) says so, unless it
    is named with a folder (`./traffic_cone`).

    Raises:
        MrmError: neither; with the names that are like it.
    """
    name = os.fspath(name_or_path)
    path, known = Path(name), materials()
    if os.path.isfile(name):  # noqa: PTH113  (of a name that no file can have, pathlib raises OSError)
        if name in known:
            warnings.warn(
                f"{name}: the file is taken, not the finished material {known[name]}; ./{name} says that it is meant",
                MrmWarning,
                stacklevel=2,
            )
        # `./traffic_cone` is `traffic_cone` to a Path: who gives it back here must get the same file.
        return path.absolute() if str(path) in known else path
    if name in known:
        return known[name]
    folder = path.parent
    if os.path.isdir(name):  # noqa: PTH112
        here = _documents(path)
        raise MrmError(f"{name}: is a folder; name {_one_of(here) if here else 'a document'}")
    if os.sep not in name and path.stem in known:
        raise MrmError(
            f"{name}: no such file; the material that comes with mrm-nodes is named {path.stem}, without an ending"
        )
    nearby = [os.fspath(each) if os.sep in name else each.name for each in _documents(folder)]
    close = difflib.get_close_matches(name[:200], [*(known if os.sep not in name else ()), *nearby])
    if close:
        raise MrmError(f"{name}: no such file; did you mean {' or '.join(close)}?")
    if os.sep not in name and path.suffix.lower() not in DOCUMENTS:
        raise MrmError(
            f"{name}: no such file, nor a material that comes with mrm-nodes; known: {', '.join(known)}"
        )
    raise MrmError(f"{name}: no such file")


_SHOWN = 5
"""Files that an error names."""


def _documents(folder: Path) -> list[Path]:
    try:
        return sorted(each for each in folder.iterdir() if each.suffix.lower() in DOCUMENTS)
    except (OSError, ValueError):
        return []


def _one_of(files: list[Path]) -> str:
    more = f", or one of {len(files) - _SHOWN} more" if len(files) > _SHOWN else ""
    return " or ".join(map(os.fspath, files[:_SHOWN])) + more
