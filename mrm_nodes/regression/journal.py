"""The journal of a run: each outcome as it comes, so that a run that was ended can go on.

It is a text file in the report's folder: a line about the run, then one for each outcome, each line with its
checksum. A line that a kill tore off, or that was damaged later, is no line; its case is run again.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.files import write_text
from mrm_nodes.regression.outcome import Outcome, as_record, from_record

NAME = "journal"
FORMAT = 1
_LOCK = ".lock"

Sums = dict[str, list[int]]
"""By a file's name relative to the report's folder: its size and CRC-32."""


@dataclass(frozen=True)
class Entry:
    """One outcome of a journal, and its files' checksums."""

    outcome: Outcome
    sums: Sums

    def is_intact(self, folder: Path) -> bool:
        """Whether the case's files still hold what they held when the outcome was written."""
        return all(_sum_or_none(folder / name) == each for name, each in self.sums.items())


def checksum(contents: bytes) -> list[int]:
    """Size and CRC-32 of a file's contents."""
    return [len(contents), zlib.crc32(contents)]


def _sum_or_none(path: Path) -> list[int] | None:
    try:
        return checksum(path.read_bytes())
    except OSError:
        return None


@dataclass(frozen=True)
class Past:
    """What an earlier run left: its header, and the outcomes that it came to."""

    header: Mapping[str, Any]
    entries: list[Entry]


class Journal:
    """A journal that is being written: `add` an outcome, and it will be there after any kill."""

    def __init__(self, folder: Path, header: Mapping[str, Any], entries: Sequence[Entry]) -> None:
        self._path = folder / NAME
        lines = [_line({**header, "format": FORMAT}), *(_entry(each.outcome, each.sums) for each in entries)]
        # Written anew, so that a torn last line is gone before the next one is added.
        write_text(self._path, "".join(lines))
        try:
            self._file = os.open(self._path, os.O_WRONLY | os.O_APPEND)
        except OSError as error:
            raise MrmError(f"{self._path}: cannot be written: {error.strerror}") from None

    def add(self, outcome: Outcome, sums: Sums) -> None:
        """Add an outcome and the checksums of its files.

        Raises:
            OSError: there is no room.
        """
        line = _entry(outcome, sums).encode()
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
        lines = path.read_bytes().split(b"\n")
    except OSError:
        return None
    records = [_parsed(line) for line in lines[:-1]]
    if not records or records[0] is None or records[0].get("format") != FORMAT:
        warnings.warn(f"{path}: cannot be read; every case is run again", MrmWarning, stacklevel=2)
        return None
    damaged = sum(record is None for record in records)
    if damaged:
        warnings.warn(f"{path}: {damaged} damaged lines; their cases are run again", MrmWarning, stacklevel=2)
    entries = [
        Entry(from_record(record["outcome"]), record["files"]) for record in records[1:] if record is not None
    ]
    return Past(records[0], entries)


def _entry(outcome: Outcome, sums: Sums) -> str:
    return _line({"outcome": as_record(outcome), "files": sums})


def _line(record: Mapping[str, Any]) -> str:
    text = json.dumps(record)
    return f"{zlib.crc32(text.encode()):08x} {text}\n"


def _parsed(line: bytes) -> dict[str, Any] | None:
    sum_, _, text = line.partition(b" ")
    if sum_ != b"%08x" % zlib.crc32(text):
        return None
    record: dict[str, Any] = json.loads(text)
    return record


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder for as long as the block lasts, or this process lives.

    Raises:
        MrmError: another run is there.
    """
    try:
        file = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise MrmError(f"{folder}: cannot be written: {error.strerror}; choose another with -o") from None
    try:
        try:
            # The kernel drops the lock with the process: a lock is never stale.
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.pread(file, 20, 0).decode(errors="replace").strip() or "unknown"
            raise MrmError(
                f"{folder}: another run is writing there (process {owner}); wait for it, "
                "or choose another folder with -o"
            ) from None
        except OSError as error:
            raise MrmError(f"{folder}: cannot be locked: {error.strerror}; choose another with -o") from None
        os.ftruncate(file, 0)
        os.pwrite(file, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        os.close(file)
