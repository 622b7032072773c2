"""Results by what they depend on, so that a case whose inputs did not change is not rendered again.

An entry is a folder: a line that says which case it is of, the outcome, a line with its checksum as the journal has it,
and the case's files. Whoever can write to the folder decides what passes; with a secret, only who knows that.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import hmac
import os
import shutil
import time
import uuid
import warnings
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mrm_nodes import cachefolder
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import place_in, read_bytes, write_plainly
from mrm_nodes.regression.run.journal import Entry, entry_of, line_with_sum, parsed
from mrm_nodes.regression.verdict.outcome import Task, plain

LIMIT = 4 << 30
"""Bytes that a cache may take; the entries that were used longest ago go first."""

CACHED = ("pass", "fail", "undecided")
"""Verdicts that are worth keeping: an error may have had its cause in the machine."""

SECRET_VARIABLE = "MRM_CACHE_SECRET"
"""Signs entries, and has only those used that it signed: for a cache that others can write to."""

_OUTCOME = "outcome"
_UNFINISHED = 86_400.0
"""Seconds after which nobody still writes an entry."""


def default_folder() -> Path:
    """Where results are kept for this user; a temporary folder of his alone where he has no other.

    Raises:
        MrmError: there can be none.
    """
    folder = cachefolder.of_user() or cachefolder.private()
    if folder is None:
        raise MrmError("results can be cached nowhere: name a folder with --cache, or say --no-cache")
    return folder / "results"


class _Missing(Exception):
    """An entry, or a file of it, is not there or is not what was put in."""


class Cache:
    """A folder of results by their keys; see `inputs.key`. A fault in it costs time, never a run.

    Args:
        folder: made with the first entry. Its modes follow the umask, so that a group can share it.
        limit: bytes that it may take after `prune`.
        link: whether its files may be the report's own, as hard links: nothing is copied, and who edits one edits both.
        secret: see `SECRET_VARIABLE`.
    """

    def __init__(
        self, folder: Path, limit: int = LIMIT, link: bool = False, secret: str | None = None
    ) -> None:
        self._folder, self._limit, self._link = folder, limit, link
        self._secret = (os.environ.get(SECRET_VARIABLE, "") if secret is None else secret).encode()
        self._works = True
        self._added = False

    def get(
        self, key: str, folder: Path, task: Task | None = None, backend: str = ""
    ) -> tuple[Entry, bytes] | None:
        """Put a result's files below a folder and return the result, and its line of a journal; None if there is none.

        Warns (MrmWarning) of an entry that is damaged or another case's, and removes it.

        Args:
            key: of the task's inputs; see `inputs.key`.
            folder: the report's.
            task: whose result it has to be.
            backend: where that was drawn.

        Raises:
            OSError: the files cannot be written.
        """
        place = self._place(key)
        try:
            about, line = _read(place / _OUTCOME).splitlines(keepends=True)
        except (_Missing, ValueError):
            about, line = b"", b""
        if not line and not place.exists():
            return None
        entry = entry_of(line.rstrip(b"\n"))
        header = parsed(about.rstrip(b"\n"))
        if self._secret and not self._is_signed(about, line):
            return None
        try:
            if (
                entry is None
                or header is None
                or header.get("key") != key
                or not _is_of(entry, task, backend)
            ):
                raise _Missing
            digests = header["digests"] if self._secret else [None] * len(entry.sums)
            parents: dict[str, str] = {}
            for number, (name, sum_) in enumerate(entry.sums.items()):
                self._give(f"{place}/{number}", _place_for(folder, name, parents), sum_, digests[number])
        except (_Missing, KeyError, IndexError, TypeError):
            if (place / _OUTCOME).exists():  # else it was evicted meanwhile
                warnings.warn(
                    f"{place}: the cached result is damaged; the case is run again", MrmWarning, stacklevel=2
                )
                _remove(place)
            return None
        with contextlib.suppress(OSError):
            os.utime(place / _OUTCOME)
        return entry, line

    def put(self, key: str, entry: Entry, folder: Path) -> None:
        """Keep an outcome and its files by their key. Warns (MrmWarning) once where that fails.

        Args:
            key: of the task's inputs; see `inputs.key`.
            entry: what the journal holds of the outcome.
            folder: the report's, below which the files lie.
        """
        record = entry.record
        if record["verdict"] not in CACHED or not self._works:
            return
        place = self._place(key)
        try:
            unfinished = _hidden(place)
            try:
                unfinished.mkdir()
            except FileNotFoundError:
                place.parent.mkdir(parents=True, exist_ok=True)
                unfinished.mkdir()
            try:
                digests = [
                    self._keep(f"{folder}/{name}", f"{unfinished}/{number}")
                    for number, name in enumerate(entry.sums)
                ]
                header: dict[str, Any] = {"key": key, "name": record["name"], "backend": record["backend"]}
                if self._secret:
                    header |= {"digests": digests}
                    header |= {"signature": self._signature(line_with_sum(header), entry.line)}
                write_plainly(f"{unfinished}/{_OUTCOME}", line_with_sum(header) + entry.line)
                if place.exists():
                    # An earlier entry was not good enough to be used.
                    _remove(place)
                try:
                    unfinished.rename(place)
                except OSError as error:
                    if error.errno not in (errno.EEXIST, errno.ENOTEMPTY):  # another run was quicker
                        raise
                    shutil.rmtree(unfinished, ignore_errors=True)
            except BaseException:
                shutil.rmtree(unfinished, ignore_errors=True)
                raise
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
            for left in self._folder.glob("??/.*"):
                if left.lstat().st_mtime < time.time() - _UNFINISHED:
                    shutil.rmtree(left, ignore_errors=True)
        found = sorted(self._entries())
        size = sum(each for _, each, _ in found)
        for _, each, place in found:
            if size <= self._limit:
                return
            _remove(place)
            size -= each

    def _entries(self) -> Iterator[tuple[int, int, Path]]:
        """When each was used last, its bytes, and its folder; those that go meanwhile are left out."""
        for place in self._folder.glob("??/[!.]*"):
            with contextlib.suppress(OSError), os.scandir(place) as files:
                found = {file.name: file.stat(follow_symlinks=False) for file in files}
                if _OUTCOME in found:
                    yield found[_OUTCOME].st_mtime_ns, sum(each.st_size for each in found.values()), place

    def _place(self, key: str) -> Path:
        return self._folder / key[:2] / key

    def _signature(self, header: bytes, line: bytes) -> str:
        return hmac.new(self._secret, header + line, hashlib.sha256).hexdigest()

    def _is_signed(self, about: bytes, line: bytes) -> bool:
        header = parsed(about.rstrip(b"\n")) or {}
        signature = header.pop("signature", None)
        expected = self._signature(line_with_sum(header), line)
        return isinstance(signature, str) and hmac.compare_digest(signature.encode(), expected.encode())

    def _keep(self, source: str, target: str) -> str:
        """Put a report's file into an entry, and return its digest, where there is a secret."""
        is_linked = self._link and _linked(source, target)
        contents = b"" if is_linked and not self._secret else read_bytes(source)
        if not is_linked:
            write_plainly(target, contents)
        return hashlib.sha256(contents).hexdigest() if self._secret else ""

    def _give(self, source: str, target: str, sum_: Sequence[int], digest: str | None) -> None:
        """Put an entry's file in a report, in place of whatever is there, as it was put in."""
        contents = _read(source)
        if [len(contents), zlib.crc32(contents)] != sum_:
            raise _Missing
        if digest is not None and hashlib.sha256(contents).hexdigest() != digest:
            raise _Missing
        # Not into what is there, which may be a link, or another case's file.
        with contextlib.suppress(FileNotFoundError):
            os.unlink(target)  # noqa: PTH108
        if not (self._link and _linked(source, target)):
            write_plainly(target, contents)


def _is_of(entry: Entry, task: Task | None, backend: str) -> bool:
    """Whether a result is a task's."""
    if task is None:
        return True
    expected = {
        "name": task.name,
        "kind": task.kind,
        "node": task.node,
        "target": task.target,
        "backend": backend,
        "setup": plain(task.describe()),
    }
    return all(entry.record[name] == value for name, value in expected.items())


def _place_for(folder: Path, name: str, parents: dict[str, str]) -> str:
    """Where a file of a case goes in a report.

    parents: the folders of the case that are made, by their names: they are looked at once.
    """
    parent, _, last = name.rpartition("/")
    if parent not in parents:
        parents[parent] = str(place_in(folder, name).parent)
    return f"{parents[parent]}/{last}"


def _read(file: str | Path) -> bytes:
    """The contents of an ordinary file that is no link.

    Raises:
        _Missing: there is none, or it cannot be read.
    """
    try:
        return read_bytes(file, os.O_NOFOLLOW)
    except OSError:
        raise _Missing from None


def _linked(source: str | Path, target: str | Path) -> bool:
    """Make a hard link, where the file systems allow it."""
    try:
        os.link(source, target, follow_symlinks=False)
    except OSError:
        return False
    return True


def _hidden(place: Path) -> Path:
    """A name beside an entry's that no reader looks at, and no other run has."""
    return place.with_name(f".{uuid.uuid4().hex}")


def _remove(place: Path) -> None:
    """Remove an entry: it goes at once, so that nobody reads half of it."""
    hidden = _hidden(place)
    with contextlib.suppress(OSError):
        place.rename(hidden)
        shutil.rmtree(hidden, ignore_errors=True)
