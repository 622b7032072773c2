"""The journal of a run: each outcome as it comes, so that a run that was ended can go on.

It is a text file in the report's folder: a line about the run, then one for each outcome, each line with its
checksum. A line that a kill tore off, or that was damaged later, is no line; its case is run again.
"""

from __future__ import annotations

import errno
import functools
import json
import os
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from mrm_nodes import jsontext
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import clear, lock, open_ordinary, read_bytes, write_text
from mrm_nodes.regression.verdict.outcome import Outcome, as_record, from_record

NAME = "journal"
FORMAT = 1

_PIECE = 1 << 16
"""Bytes that are read at a time: what a processor's own memory holds."""

_LOCK = ".lock"

Sums = dict[str, list[int]]
"""By a file's name relative to the report's folder: its size and CRC-32."""


@dataclass(frozen=True)
class Entry:
    """One outcome of a journal, as `as_record` has it, and its files' checksums."""

    record: Mapping[str, Any]
    sums: Sums

    @functools.cached_property
    def outcome(self) -> Outcome:
        """The outcome itself."""
        return from_record(self.record)

    @functools.cached_property
    def line(self) -> bytes:
        """The entry as a line with its checksum."""
        return line_with_sum({"outcome": self.record, "files": self.sums})

    def is_intact(self, folder: Path) -> bool:
        """Whether the case's files still hold what they held when the outcome was written."""
        try:
            return all(checksum(folder / name) == each for name, each in self.sums.items())
        except OSError:
            return False


def checksum(path: str | Path) -> list[int]:
    """Size and CRC-32 of a file.

    Raises:
        OSError: it cannot be read.
    """
    size = sum_ = 0
    file = open_ordinary(path)
    try:
        while piece := os.read(file, _PIECE):
            sum_ = zlib.crc32(piece, sum_)
            size += len(piece)
    finally:
        os.close(file)
    return [size, sum_]


@dataclass(frozen=True)
class Past:
    """What an earlier run left: its header, and the outcomes that it came to."""

    header: Mapping[str, Any]
    entries: list[Entry]


class Journal:
    """A journal that is being written: add an outcome, and it will be there after any kill."""

    def __init__(self, folder: Path, header: Mapping[str, Any], entries: Sequence[Entry]) -> None:
        self._path = folder / NAME
        lines = [line_with_sum({**header, "format": FORMAT}), *(each.line for each in entries)]
        # Written anew, so that a torn last line is gone before the next one is added.
        write_text(self._path, b"".join(lines).decode())
        try:
            self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise MrmError(f"{self._path}: cannot be written: {error.strerror}") from None

    def add_line(self, line: bytes) -> None:
        """Add an outcome: the line of its entry.

        Raises:
            OSError: there is no room.
        """
        if os.write(self._file, line) != len(line):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self) -> None:
        os.close(self._file)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def read(folder: Path) -> Past | None:
    """What a run left in a folder: None where there is no journal, or its first line is lost.

    Warns (MrmWarning) where lines are damaged; the last one may be torn without a word, as a kill leaves it.
    """
    path = folder / NAME
    try:
        lines = read_bytes(path).split(b"\n")
    except FileNotFoundError:
        return None
    except OSError:
        lines = [b""]
    header = parsed(lines[0])
    if header is None or header.get("format") != FORMAT or not _is_header(header):
        warnings.warn(f"{path}: cannot be read; every case is run again", MrmWarning, stacklevel=2)
        return None
    entries = [entry_of(line) for line in lines[1:-1]]
    whole = [entry for entry in entries if entry is not None]
    if len(whole) < len(entries):
        warnings.warn(
            f"{path}: {len(entries) - len(whole)} damaged lines; their cases are run again",
            MrmWarning,
            stacklevel=2,
        )
    return Past(header, whole)


def entry_for(outcome: Outcome, sums: Sums) -> Entry:
    """What a journal holds of an outcome."""
    return Entry(as_record(outcome), sums)


def entry_of(line: bytes) -> Entry | None:
    """The entry of a line, without the line's end; None if it is damaged, or a name leads out of its folder."""
    record = parsed(line)
    try:
        entry = Entry(record["outcome"], record["files"]) if record else None
        if entry is None or not all(map(_is_sum, entry.sums.values())):
            return None
        outcome = entry.outcome
        names = [*entry.sums, *(each for each in outcome.files.values() if isinstance(each, str))]
        return entry if all(map(is_inside, names)) else None
    except (AttributeError, KeyError, TypeError, ValueError):
        return None


def is_inside(name: str) -> bool:
    """Whether a relative name stays below the folder that it is relative to, links aside."""
    parts = name.split("/")
    return bool(name) and "\0" not in name and "\\" not in name and not {"", ".", ".."} & {*parts}


def _is_sum(value: Any) -> bool:
    return isinstance(value, list) and [type(each) for each in value] == [int, int]


def _is_header(header: Mapping[str, Any]) -> bool:
    form = {"suite": str, "shard": list, "conditions": dict, "keys": dict, "environment": dict}
    return all(isinstance(header.get(name), kind) for name, kind in form.items()) and _is_sum(header["shard"])


def line_with_sum(record: Mapping[str, Any]) -> bytes:
    """A record as a line with its checksum."""
    text = json.dumps(record).encode()
    return b"%08x %b\n" % (zlib.crc32(text), text)


def parsed(line: bytes) -> dict[str, Any] | None:
    """What `line_with_sum` wrote, without the end of the line; None if it is damaged."""
    sum_, _, text = line.partition(b" ")
    if sum_ != b"%08x" % zlib.crc32(text):
        return None
    try:
        record = jsontext.loads(text)
    except ValueError:
        return None
    return record if isinstance(record, dict) else None


def _why(error: OSError) -> str:
    return "it is a link" if error.errno == errno.ELOOP else str(error.strerror)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder for as long as the block lasts, or this process lives.

    Raises:
        MrmError: another run is there.
    """
    try:
        # A link would have somebody else's file emptied.
        file = open_ordinary(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW)
    except OSError as error:
        raise MrmError(
            f"{folder / _LOCK}: cannot be written: {_why(error)}; choose another folder with -o"
        ) from None
    try:
        try:
            free = lock(file)
        except OSError as error:
            raise MrmError(f"{folder}: cannot be locked: {error.strerror}; choose another with -o") from None
        if not free:
            owner = os.pread(file, 20, 0).decode(errors="replace").strip() or "unknown"
            raise MrmError(
                f"{folder}: another run is writing there (process {owner}); wait for it, "
                "or choose another folder with -o"
            )
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        clear(folder)
        yield
    finally:
        os.close(file)
