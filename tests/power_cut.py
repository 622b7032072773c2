"""What a disk may hold after a power cut, by the order of the changes that were made to it.

A change to a folder's names, or to a file's contents, is sure to be there once that folder or file was synced. Until
then it may be there or not, whatever came after it.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random

Keep = Callable[[str], bool]
"""Whether a change that was not synced is there: of the kind `names` or `data`."""


@dataclass(frozen=True)
class Names:
    """What became of names in folders, all at once: (folder, name, what it stands for)."""

    entries: Sequence[tuple[int, str, int | None]]


@dataclass(frozen=True)
class Data:
    """Bytes in a file at a place; where there are none, the file was cut off there."""

    file: int
    at: int
    data: bytes | None


@dataclass(frozen=True)
class Sync:
    """A file or a folder was written through to the disk."""

    what: int


class Volume:
    """A folder as it was, and every change to it that a log of `disk_faults.c` tells of."""

    def __init__(self, root: Path, log: Path) -> None:
        """root: as it was before the first change."""
        self._root = str(root)
        self._number = itertools.count()
        self._folders: dict[int, dict[str, int]] = {}
        self._inodes: dict[int, int] = {}
        self._first: dict[int, bytes] = {}
        self._top = self._known(root)
        self._initial = {each: dict(names) for each, names in self._folders.items()}
        self.changes: list[Names | Data | Sync] = []
        self._log = log

    def _known(self, path: Path) -> int:
        number = next(self._number)
        self._inodes[path.stat().st_ino] = number
        if path.is_dir():
            self._folders[number] = {each.name: self._known(each) for each in sorted(path.iterdir())}
        else:
            self._first[number] = path.read_bytes()
        return number

    def read_log(self) -> None:
        """Take in the changes that were made."""
        text = self._log.read_bytes()
        at = 0
        while at < len(text):
            end = text.index(b"\n", at)
            what, inode, number, size, one, other = text[at:end].decode().split("\t")
            data = text[end + 1 : end + 1 + int(size)]
            at = end + 1 + int(size)
            self._take(what, int(inode), int(number), data, one, other)

    def _place(self, path: str) -> tuple[int, str]:
        """The folder of a path, and its name there."""
        *above, name = path.removeprefix(self._root).strip("/").split("/")
        folder = self._top
        for each in above:
            folder = self._folders[folder][each]
        return folder, name

    def _take(self, what: str, inode: int, number: int, data: bytes, one: str, other: str) -> None:
        entries: list[tuple[int, str, int | None]] = []
        if what in ("create", "mkdir"):
            new = self._inodes[inode] = next(self._number)
            if what == "mkdir":
                self._folders[new] = {}
            if one:
                entries = [(*self._place(one), new)]
        elif what == "unlink":
            entries = [(*self._place(one), None)]
        elif what in ("rename", "link"):
            old, new_place = self._place(one), self._place(other)
            moved = self._folders[old[0]][old[1]]
            entries = [(*new_place, moved), *([(*old, None)] if what == "rename" else [])]
        elif what == "write":
            self.changes.append(Data(self._inodes[inode], number, data))
        elif what == "truncate":
            self.changes.append(Data(self._inodes[inode], number, None))
        elif what == "sync":
            self.changes.append(Sync(self._inodes[inode]))
        else:
            raise ValueError(what)
        if entries:
            self.changes.append(Names(entries))
            _apply(self._folders, entries)

    def after_a_cut(self, count: int, keep: Keep) -> dict[str, bytes | None]:
        """What is there, by its path, if the power goes after so many changes; None is a folder."""
        made = self.changes[:count]
        synced: set[int] = set()
        is_there = []
        for change in reversed(made):
            if isinstance(change, Sync):
                synced.add(change.what)
                is_there.append(False)
            elif isinstance(change, Names):
                is_there.append(bool(synced & {each[0] for each in change.entries}) or keep("names"))
            else:
                is_there.append(change.file in synced or keep("data"))
        folders = {each: dict(names) for each, names in self._initial.items()}
        files = {each: bytearray(data) for each, data in self._first.items()}
        for change, kept in zip(made, reversed(is_there), strict=True):
            if isinstance(change, Names) and kept:
                _apply(folders, change.entries)
            elif isinstance(change, Data) and kept:
                data = files.setdefault(change.file, bytearray())
                end = change.at + len(change.data or b"")
                data.extend(bytes(max(0, end - len(data))))
                if change.data is None:
                    del data[change.at :]
                else:
                    data[change.at : end] = change.data
        found: dict[str, bytes | None] = {}

        def walk(folder: int, path: str) -> None:
            for name, each in folders.get(folder, {}).items():
                if each in self._folders:
                    found[f"{path}{name}"] = None
                    walk(each, f"{path}{name}/")
                else:
                    found[f"{path}{name}"] = bytes(files.get(each, b""))

        walk(self._top, "")
        return found


def _apply(folders: dict[int, dict[str, int]], entries: Sequence[tuple[int, str, int | None]]) -> None:
    for folder, name, what in entries:
        if what is None:
            folders.setdefault(folder, {}).pop(name, None)
        else:
            folders.setdefault(folder, {})[name] = what


def ways(random: Random) -> Iterator[Keep]:
    """Ways in which a disk may lose what was not synced: everything; contents alone, as journalling file systems do;
    names alone; and by chance.
    """
    yield lambda kind: False
    yield lambda kind: kind == "names"
    yield lambda kind: kind == "data"
    yield lambda kind: random.random() < 0.5
    yield lambda kind: random.random() < 0.9


def lay_out(state: dict[str, bytes | None], folder: Path) -> None:
    """Make a folder that holds what a disk was left with."""
    folder.mkdir(parents=True)
    for name, data in state.items():
        if data is None:
            (folder / name).mkdir()
        else:
            (folder / name).write_bytes(data)
