"""Results by what they depend on, so that a case whose inputs did not change is not rendered again.

An entry is one zip file, which brings its checksums along: the outcome, and the case's files.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import warnings
import zipfile
from pathlib import Path

import platformdirs

from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.journal import Sums, checksum
from mrm_nodes.regression.outcome import Outcome, as_record, from_record

LIMIT = 4 << 30
"""Bytes that a cache may take; the entries that were used longest ago go first."""

CACHED = ("pass", "fail", "undecided")
"""Verdicts that are worth keeping: an error may have had its cause in the machine."""

_OUTCOME = "outcome.json"


def default_folder() -> Path:
    """Where results are kept for this user."""
    return Path(platformdirs.user_cache_dir("mrm-nodes")) / "results"


class Cache:
    """A folder of results by their keys; see `inputs.key`. A fault in it costs time, never a run.

    Args:
        folder: made with the first entry.
        limit: bytes that it may take after `prune`.
    """

    def __init__(self, folder: Path, limit: int = LIMIT) -> None:
        self._folder, self._limit = folder, limit
        self._works = True

    def get(self, key: str, folder: Path) -> tuple[Outcome, Sums] | None:
        """Write a result's files below a folder and return its outcome and their checksums; None if there is none.

        Warns (MrmWarning) of an entry that is damaged, and removes it.

        Raises:
            OSError: the files cannot be written.
        """
        path = self._path(key)
        try:
            with zipfile.ZipFile(path) as entry:
                contents = {name: entry.read(name) for name in entry.namelist()}
            outcome = from_record(json.loads(contents.pop(_OUTCOME)))
            os.utime(path)
        except FileNotFoundError:
            return None
        except Exception as error:  # zipfile raises many types for damaged files
            warnings.warn(
                f"{path}: the cached result is damaged ({error}); the case is run again",
                MrmWarning,
                stacklevel=2,
            )
            with contextlib.suppress(OSError):
                path.unlink()
            return None
        sums = {}
        for name, data in contents.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            _write(target, data)
            sums[name] = checksum(data)
        return outcome, sums

    def put(self, key: str, outcome: Outcome, folder: Path, names: Sums) -> None:
        """Keep an outcome and its files, which lie below a folder. Warns (MrmWarning) once where that fails."""
        if outcome.verdict not in CACHED or not self._works:
            return
        path = self._path(key)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
                try:
                    with zipfile.ZipFile(file, "w") as entry:
                        entry.writestr(_OUTCOME, json.dumps(as_record(outcome)))
                        for name in names:
                            entry.write(folder / name, name)
                    file.close()
                    Path(file.name).replace(path)
                except BaseException:
                    Path(file.name).unlink(missing_ok=True)
                    raise
        except OSError as error:
            self._works = False
            warnings.warn(
                f"{self._folder}: results are not cached: {error.strerror or error}", MrmWarning, stacklevel=2
            )

    def prune(self) -> None:
        """Remove the entries that were used longest ago until the rest takes no more than the limit."""
        with contextlib.suppress(OSError):
            found = [(file, file.stat()) for file in self._folder.glob("??/*.zip")]
            size = sum(stat.st_size for _, stat in found)
            for file, stat in sorted(found, key=lambda each: each[1].st_mtime_ns):
                if size <= self._limit:
                    return
                file.unlink(missing_ok=True)
                size -= stat.st_size

    def _path(self, key: str) -> Path:
        return self._folder / key[:2] / f"{key}.zip"


def _write(path: Path, contents: bytes) -> None:
    """Write a file that appears complete or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        temporary.write_bytes(contents)
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
