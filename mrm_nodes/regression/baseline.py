"""Stored images: where no model gives the truth, what somebody looked at and accepted.

A case has `NAME.exr` and `NAME.json`, its provenance, in one folder beside the suite. Only `accept` writes them.
`log.jsonl` gets a line for every decision and is only ever appended to.
"""

from __future__ import annotations

import datetime
import getpass
import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.files import write_text
from mrm_nodes.render.images import read_image

LOG = "log.jsonl"
FORMAT = 1

_OF_JUDGEMENT = ("truth", "reason", "tolerance", "mask", "baselines", "allow_external")
"""Parts of a case's description that its render does not depend on."""


class Missing(MrmError):
    """A case has no stored image yet."""


class Case(Protocol):
    """What a stored image belongs to."""

    @property
    def name(self) -> str:
        """The case's."""

    @property
    def root(self) -> Path:
        """What its file names are relative to."""

    def describe(self) -> dict[str, Any]:
        """What it is."""

    def sources(self) -> tuple[Path, ...]:
        """The files that its render depends on."""


def fingerprint(case: Case) -> str:
    """The digest of what a render of a case depends on: its description and the contents of its files.

    Raises:
        MrmError: a file is missing.
    """
    setup = {name: value for name, value in case.describe().items() if name not in _OF_JUDGEMENT}
    files = {
        os.path.relpath(path, case.root): hashlib.sha256(_bytes(path)).hexdigest() for path in case.sources()
    }
    return hashlib.sha256(json.dumps([setup, files], sort_keys=True).encode()).hexdigest()


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise MrmError(f"{path}: cannot be read: {error.strerror}") from None


def holds_baselines(folder: Path) -> bool:
    """Whether stored images lie in a folder, so that nothing else may be written there."""
    return (folder / LOG).exists()


@dataclass(frozen=True)
class Store:
    """A folder of stored images."""

    folder: Path

    def paths(self, name: str) -> tuple[Path, Path]:
        """The image and the provenance of a case."""
        return self.folder / f"{name}.exr", self.folder / f"{name}.json"

    def names(self) -> list[str]:
        """The cases that have a stored image."""
        return sorted(path.stem for path in self.folder.glob("*.json"))

    def provenance(self, name: str) -> dict[str, Any]:
        """What is recorded of a case's stored image.

        Raises:
            Missing: there is none.
            MrmError: it is damaged.
        """
        _, path = self.paths(name)
        if not path.is_file():
            raise Missing(
                f"{name} has no baseline yet: look at its render, then `mrm-nodes baseline accept {name}`"
            )
        try:
            record = json.loads(_bytes(path))
            if record["format"] != FORMAT:
                raise MrmError(
                    f"{path}: a baseline of format {record['format']}; this version reads {FORMAT}"
                )
            for key, kind in (("sha256", str), ("inputs", str), ("accepted", dict)):
                if not isinstance(record[key], kind):
                    raise TypeError(key)
        except (ValueError, KeyError, TypeError, RecursionError):
            raise MrmError(f"{path}: the baseline's provenance is damaged: {_RESTORE}") from None
        return dict(record)

    def read(self, name: str, shape: tuple[int, ...] | None = None) -> NDArray[np.float32]:
        """The stored image of a case, (h, w, 3).

        Args:
            shape: what it has to have.

        Raises:
            Missing: there is none.
            MrmError: it is damaged, is not what was accepted, or has another shape.
        """
        digest = self.provenance(name)["sha256"]
        path = self._image(name, digest)
        if path is None:
            raise MrmError(
                f"{self.paths(name)[0]}: the baseline is not the image that was accepted: {_RESTORE}"
            )
        pixels = read_image(path)
        if pixels.shape[-1] != 3 or not np.isfinite(pixels).all():
            raise MrmError(f"{path}: the baseline is damaged: {_RESTORE}")
        if shape is not None and pixels.shape != shape:
            sizes = [f"{w} × {h}" for h, w, *_ in (pixels.shape, shape)]
            raise MrmError(
                f"{path}: the baseline has {sizes[0]} pixels, but the case {sizes[1]}: accept a new one"
            )
        return pixels

    def _image(self, name: str, digest: str) -> Path | None:
        """The file that holds an accepted image: an acceptance that was cut short left it under the second name."""
        for path in (self.paths(name)[0], self._pending(name)):
            if path.is_file() and hashlib.sha256(_bytes(path)).hexdigest() == digest:
                return path
        return None

    def _pending(self, name: str) -> Path:
        return self.folder / f".{name}.accepted.exr"

    def accept(self, name: str, image: Path, provenance: Mapping[str, Any], reason: str | None) -> None:
        """Make an image file the baseline of a case, and record it.

        Args:
            image: an EXR file.
            provenance: what it was made of and with; `inputs` is the case's fingerprint.

        Raises:
            MrmError: it cannot be read or written.
        """
        contents = _bytes(image)
        accepted = {"who": _who(), "when": _now(), "why": reason}
        digest = hashlib.sha256(contents).hexdigest()
        record = {"format": FORMAT, "case": name, "sha256": digest, "accepted": accepted, **provenance}
        path, beside = self.paths(name)
        pending = self._pending(name)
        with self._log("accept", name, digest, accepted):
            self._finish(name)
            # The provenance is what decides: until it is replaced the old image counts, and from then on the new.
            try:
                with pending.open("wb") as file:
                    file.write(contents)
                    file.flush()
                    os.fsync(file.fileno())
                write_text(beside, json.dumps(record, indent=2) + "\n")
            except (OSError, MrmError):
                pending.unlink(missing_ok=True)
                raise
            pending.replace(path)

    def _finish(self, name: str) -> None:
        """Put an image in its place that an acceptance which was cut short left under the second name."""
        with suppress(MrmError):
            if self._image(name, self.provenance(name)["sha256"]) == self._pending(name):
                self._pending(name).replace(self.paths(name)[0])

    @contextmanager
    def _log(self, what: str, name: str, digest: str, decision: Mapping[str, Any]) -> Iterator[None]:
        """Append a decision to the log once the block has carried it out.

        Raises:
            MrmError: the folder or the log cannot be written; then before the block.
        """
        line = json.dumps({"what": what, "case": name, "sha256": digest, **decision}) + "\n"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with (self.folder / LOG).open("a", encoding="utf-8") as log:
                yield
                log.write(line)
        except OSError as error:
            raise MrmError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def reject(self, name: str, image: Path, reason: str | None) -> None:
        """Record that an image is not to be the baseline of a case; the baseline stays as it is.

        Raises:
            MrmError: the image cannot be read, or the log cannot be written.
        """
        decision = {"who": _who(), "when": _now(), "why": reason}
        with self._log("reject", name, hashlib.sha256(_bytes(image)).hexdigest(), decision):
            pass

    def decisions(self) -> Iterator[dict[str, Any]]:
        """The log's lines, the oldest first; one that is damaged is left out."""
        path = self.folder / LOG
        if not path.is_file():
            return
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                entry = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(entry, dict):
                yield entry


_RESTORE = "restore it, or accept a new one with `mrm-nodes baseline accept`"


def _who() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in containers
        return f"user {os.getuid()}"


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
