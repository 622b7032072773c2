"""The files that a document's names mean: those that MaterialX's reading and its image handler would take for them.

A name is text: `~`, `$` and `%20` stand for themselves. Slashes and backslashes both divide it. A file prefix and
`[tokens]` are put in as MaterialX puts them in, but an absolute name takes no prefix. A relative one is looked for
in folders, in their order, and at last where the program runs.
"""

from __future__ import annotations

import glob
import os
import re
import unicodedata
import urllib.parse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import MaterialX as mx

from mrm_nodes import library
from mrm_nodes.errors import MrmError, suggestion

Tile = tuple[int, int]
"""Column and row of a square of texture coordinates: their integer parts, (0, 0) for those from 0 to 1."""

UDIM, UVTILE = "<UDIM>", "<UVTILE>"
_COLUMNS = 10
"""Tiles of one row that UDIM has numbers for."""

LONGEST = 4096
"""Letters of a file's name with its folders: no system opens a longer one."""

_TOKENS = {UDIM: r"(?P<udim>[1-9][0-9]{3})", UVTILE: r"(?P<uvtile>u[1-9][0-9]*_v[1-9][0-9]*)"}
_GROUPS = {UDIM: "udim", UVTILE: "uvtile"}
_ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")
_DRIVE = re.compile(r"[A-Za-z]:")
_FOREIGN_TOKEN = re.compile(
    r"<(udim|uvtile|f|f4|u|v|frame)>|%\(?[0-9]*\w*\)?d|\$F|#{2,}|_MAPID_", re.IGNORECASE
)
"""How other programs write that a name stands for several files."""


@dataclass(frozen=True)
class Files:
    """What a name stands for: one file, or one for each tile of texture coordinates; or nothing that is there."""

    name: str
    """As MaterialX resolves it, with slashes."""
    file: Path | None = None
    tiles: Mapping[Tile, Path] = field(default_factory=dict)
    """Of a name with <UDIM> or <UVTILE>, the files that are there."""
    instead: Path | None = None
    """What has the name and is no file: a folder, a device. It hides a file of that name in a later folder."""

    def all(self) -> list[Path]:
        """Every file."""
        return [*self.tiles.values()] if self.file is None else [self.file]


def udim(tile: Tile) -> int:
    """The number by which UDIM knows a tile."""
    column, row = tile
    return 1001 + column + _COLUMNS * row


def is_tiled(name: str) -> bool:
    """Whether a name stands for one file for each tile."""
    return any(token in name for token in _TOKENS)


def resolved(port: mx.ValueElement, value: str | None = None) -> str:
    """The name that a value of type `filename` gives, prefix and tokens put in; empty where it names no file.

    value: what stands in place of the port's own.
    """
    text = port.getValueString() if value is None else value
    if not text:
        return ""
    resolver = port.createStringResolver()
    if mx.FilePath(text).isAbsolute():
        resolver.setFilePrefix("")
    return str(resolver.resolve(text, port.getType()))


def with_slashes(name: str) -> str:
    """A name as MaterialX writes it on this system: `tex\\a.png` and `tex//a.png` are `tex/a.png`."""
    return str(mx.FilePath(name).asString())


def is_absolute(name: str) -> bool:
    """Whether MaterialX looks for a name in no folder; a drive's letter makes it so on every system."""
    return bool(mx.FilePath(name).isAbsolute())


def is_address(name: str) -> bool:
    """Whether a name is an address in a network or the like (`http:`, `data:`); a drive's letter is none."""
    return _ADDRESS.match(name) is not None


def is_file(path: Path) -> bool:
    """Whether there is such a file; a name that no file can have is none, and no OSError."""
    return os.path.isfile(path)  # noqa: PTH113


def check_text(path: Path) -> None:
    """Check that a file's name is text, as names are to MaterialX.

    Raises:
        MrmError: it has bytes that are no UTF-8.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        shown = os.fsencode(path).decode(errors="backslashreplace")
        raise MrmError(f"{shown}: the name of a file or folder on the way is not UTF-8: rename it") from None


def folder_of(path: Path) -> Path:
    """The folder of a document; where the document is a link, the link's."""
    return Path(os.path.abspath(path)).parent  # noqa: PTH100


def absolute(file: Path) -> Path:
    """A file's absolute name without `..`; links stay as they are written where the name still means that file."""
    plain, real = os.path.abspath(file), os.path.realpath(file)  # noqa: PTH100
    return Path(plain if os.path.realpath(plain) == real else real)


def image_folders(folder: Path) -> list[Path]:
    """Where the images of a document in a folder are looked for, in this order."""
    return [folder, *search_folders()]


def search_folders() -> list[Path]:
    """Where MaterialX looks for what is not beside the document: its libraries, ours, and MATERIALX_SEARCH_PATH."""
    return [*folders_of(library.search_path()), *folders_of(mx.getEnvironmentPath())]


def folders_of(path: mx.FileSearchPath) -> list[Path]:
    """The folders of a search path, in its order."""
    return [Path(folder) for folder in path.asString().split(os.pathsep) if folder]


def find(name: str, folders: Sequence[Path]) -> Files:
    """The file, or the tiles' files, that a resolved name means.

    folders: where a relative name is looked for before the folder in which the program runs: the document's own,
        then `search_folders`.
    """
    text = with_slashes(name)
    if is_tiled(text):
        tiles: dict[Tile, Path] = {}
        for place in _places(text, folders):
            tiles = {**_tiles(text, place), **tiles}
        return Files(text, tiles=dict(sorted(tiles.items())))
    for place in _places(text, folders):
        if is_file(place / text):
            return Files(text, place / text)
        if os.path.exists(place / text):  # noqa: PTH110  no error for a name that no file can have
            return Files(text, instead=place / text)
    return Files(text)


def _places(name: str, folders: Sequence[Path]) -> list[Path]:
    if not name or "\0" in name or len(name) > LONGEST:
        return []
    return [Path()] if is_absolute(name) else [*folders, Path()]


def _tiles(name: str, place: Path) -> dict[Tile, Path]:
    """The files below one folder that a name with tokens stands for, by tile."""
    wild, pattern = "", ""
    for part in re.split(f"({UDIM}|{UVTILE})", name):
        group = _GROUPS.get(part)
        wild += "*" if group else glob.escape(part)
        # A token that comes twice is the same tile twice.
        pattern += (
            f"(?P={group})" if group and f"<{group}>" in pattern else _TOKENS.get(part, re.escape(part))
        )
    found = {}
    for file in glob.glob(wild, root_dir=None if is_absolute(name) else place):  # noqa: PTH207
        match = re.fullmatch(pattern, file)
        tile = _tile_of(match.groupdict()) if match else None
        if tile is not None and is_file(place / file):
            found[tile] = place / file
    return found


def _tile_of(told: Mapping[str, str]) -> Tile | None:
    """The tile that a file's name is of; None where two tokens disagree, or for no number of UDIM's."""
    found = set()
    if "udim" in told:
        row, column = divmod(int(told["udim"]) - 1001, _COLUMNS)
        found.add((column, row))
    if "uvtile" in told:
        first, second = told["uvtile"][1:].split("_v")
        found.add((int(first) - 1, int(second) - 1))
    tile = found.pop()
    return tile if not found and min(tile) >= 0 else None


def absence(name: str, folders: Sequence[Path]) -> str:
    """Why a resolved name means no file, and what to write: what an error says after the name."""
    text = with_slashes(name)
    if "\0" in name:
        return "a NUL character is in no file's name"
    if len(name) > LONGEST:
        return f"its {len(name)} letters are more than the {LONGEST} that a file's name can have"
    instead = find(text, folders).instead
    if instead is not None:
        return f"is {'a folder' if instead.is_dir() else 'a device, a pipe or the like'}, and no file"
    if _DRIVE.match(name) or name.startswith("\\\\"):
        return f"is a Windows path, which means nothing on this system: {_by_its_last(text, folders)}"
    if is_address(name):
        return "is an address and is no file: only files are read"
    reasons = ["no file of any tile" if is_tiled(text) else "no such file"]
    near = next((each for each in (_near(text, folder) for folder in folders) if each), None)
    foreign = _FOREIGN_TOKEN.search(text)
    if near:
        reasons.append(f"there is {near}, whose name is written otherwise (case, spaces, % or accents)")
    elif foreign and not is_tiled(text):
        reasons.append(f"MaterialX does not know {foreign[0]}: a set of tiles is named by {UDIM} or {UVTILE}")
    elif text.startswith("~") or re.search(r"\$\{?\w|%\w+%", text):
        reasons.append("`~`, `$` and `%` are plain text in MaterialX: write the folder out")
    elif is_absolute(text):
        reasons.append(_by_its_last(text, folders))
    elif folders and os.path.normpath(text).startswith(".."):
        reasons.append(
            f"it would lie outside of {folders[0]}, where only --allow-external lets a material read"
        )
    elif folders:
        reasons.append(_beside(text, folders[0]))
    return "; ".join(reasons)


def _by_its_last(name: str, folders: Sequence[Path]) -> str:
    last = name.rpartition("/")[2]
    there = find(last, folders).all() if last else []
    return f"{last} lies beside the document, name it so" if there else "name it relative to the document"


def _key(part: str) -> str:
    """Equal for spellings that other systems, or other programs, take for one name."""
    return unicodedata.normalize("NFC", urllib.parse.unquote(part)).strip().casefold()


def _near(name: str, folder: Path) -> str | None:
    """A file below a folder whose name differs from the one given in its spelling only."""
    parts = name.split("/")
    if is_absolute(name) or ".." in parts:
        return None
    place = folder
    for part in parts:
        alike = [each for each in _listed(place) if _key(each) == _key(part)]
        place /= part if part in alike or not alike else alike[0]
    return place.relative_to(folder).as_posix() if is_file(place) else None


def _beside(name: str, folder: Path) -> str:
    """What there is where a name looks first."""
    parent = Path(name).parent
    if ".." in parent.parts or not os.path.isdir(folder / parent):  # noqa: PTH112
        return f"looked from {folder}"
    endings = Path(name).suffix.lower()
    known = [
        (parent / each).as_posix() for each in _listed(folder / parent) if each.lower().endswith(endings)
    ]
    return f"looked from {folder}" + (f"; {suggestion(name, known)}" if known else "")


def _listed(folder: Path) -> list[str]:
    try:
        return sorted(os.listdir(folder))  # noqa: PTH208
    except OSError:
        return []
