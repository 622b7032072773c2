"""Results by what they depend on, so that a case whose inputs did not change is not rendered again.

An entry is a folder: the outcome, a line with its checksum as the journal has it, and the case's files. They are
hard links to the report's where the file system allows it, so that neither keeping nor giving them copies anything.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import warnings
from pathlib import Path

from mrm_nodes import cachefolder
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.journal import Entry, Sums, checksum, entry_for, entry_of, line_of
from mrm_nodes.regression.outcome import Outcome

LIMIT = 4 << 30
"""Bytes that a cache may take; the entries that were used longest ago go first."""

CACHED = ("pass", "fail", "undecided")
"""Verdicts that are worth keeping: an error may have had its cause in the machine."""

_OUTCOME = "outcome"


def default_folder() -> Path:
    """Where results are kept for this user; a temporary folder of his alone where he has no other.

    Raises:
        MrmError: there can be none.
    """
    folder = cachefolder.of_user() or cachefolder.private()
    if folder is None:
        raise MrmError("results can be cached nowhere: name a folder with --cache, or say --no-cache")
    return folder / "results"


class Cache:
    """A folder of results by their keys; see `inputs.key`. A fault in it costs time, never a run.

    Args:
        folder: made with the first entry.
        limit: bytes that it may take after `prune`.
    """

    def __init__(self, folder: Path, limit: int = LIMIT) -> None:
        self._folder, self._limit = folder, limit
        self._works = True
        self._added = False

    def get(self, key: str, folder: Path) -> tuple[Entry, bytes] | None:
        """Put a result's files below a folder and return the result, and its line of a journal; None if there is none.

        Warns (MrmWarning) of an entry that is damaged, and removes it.

        Raises:
            OSError: the files cannot be written.
        """
        place = self._place(key)
        try:
            line = (place / _OUTCOME).read_bytes()
        except OSError:  # there is none, or none that can be read
            return None
        entry = entry_of(line.rstrip(b"\n"))
        if entry is None or not _is_intact(place, entry.sums):
            warnings.warn(
                f"{place}: the cached result is damaged; the case is run again", MrmWarning, stacklevel=2
            )
            shutil.rmtree(place, ignore_errors=True)
            return None
        with contextlib.suppress(OSError):
            os.utime(place / _OUTCOME)
        for number, name in enumerate(entry.sums):
            _link(f"{place}/{number}", f"{folder}/{name}")
        return entry, line

    def put(self, key: str, outcome: Outcome, folder: Path, sums: Sums) -> None:
        """Keep an outcome and its files, which lie below a folder. Warns (MrmWarning) once where that fails."""
        if outcome.verdict not in CACHED or not self._works:
            return
        place = self._place(key)
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            unfinished = Path(tempfile.mkdtemp(dir=place.parent, prefix="."))
            try:
                for number, name in enumerate(sums):
                    _link(f"{folder}/{name}", f"{unfinished}/{number}")
                (unfinished / _OUTCOME).write_bytes(line_of(entry_for(outcome, sums)))
                # An earlier entry was not good enough to be used.
                shutil.rmtree(place, ignore_errors=True)
                with contextlib.suppress(FileExistsError):  # another run was quicker
                    unfinished.rename(place)
            finally:
                shutil.rmtree(unfinished, ignore_errors=True)
            self._added = True
        except OSError as error:
            self._works = False
            warnings.warn(
                f"{self._folder}: results are not cached: {error.strerror or error}", MrmWarning, stacklevel=2
            )

    def prune(self) -> None:
        """Remove the entries that were used longest ago until the rest takes no more than the limit."""
        if not self._added:
            return
        with contextlib.suppress(OSError):
            found = [
                (
                    (place / _OUTCOME).stat().st_mtime_ns,
                    sum(file.stat().st_size for file in place.iterdir()),
                    place,
                )
                for place in self._folder.glob("??/[!.]*")
            ]
            size = sum(each for _, each, _ in found)
            for _, each, place in sorted(found):
                if size <= self._limit:
                    return
                shutil.rmtree(place, ignore_errors=True)
                size -= each

    def _place(self, key: str) -> Path:
        return self._folder / key[:2] / key


def _is_intact(place: Path, sums: Sums) -> bool:
    try:
        return all(checksum(f"{place}/{number}") == each for number, each in enumerate(sums.values()))
    except OSError:
        return False


def _link(source: str, target: str) -> None:
    """Put a file in place of whatever is there, as a link or, on another file system, as a copy."""
    try:
        os.link(source, target)
    except FileExistsError:
        os.unlink(target)  # noqa: PTH108
        _link(source, target)
    except FileNotFoundError:
        os.makedirs(os.path.dirname(target))  # noqa: PTH103, PTH120
        _link(source, target)
    except OSError:
        shutil.copyfile(source, target)
