"""Stored images: where no model gives the truth, what somebody looked at and accepted.

A case has `NAME.exr` and `NAME.json`, its provenance, in one folder beside the suite. Only `accept` writes them.
`log.jsonl` gets a line for every decision and is only ever appended to; whoever holds its lock decides.
"""

from __future__ import annotations

import datetime
import errno
import getpass
import hashlib
import json
import os
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mrm_nodes import jsontext
from mrm_nodes.errors import MrmError
from mrm_nodes.files import (
    clear,
    lock,
    open_ordinary,
    read_bytes,
    replace_durably,
    sync_folder,
    write_durably,
)
from mrm_nodes.regression.cases.digests import by_name, home_of
from mrm_nodes.render.images import read_image

LOG = "log.jsonl"
FORMAT = 1

PATIENCE = 30.0
"""Seconds to wait while another process accepts."""

_OF_JUDGEMENT = ("truth", "reason", "tolerance", "mask", "baselines", "allow_external", "layering")
"""Parts of a case's description that its render does not depend on."""


class Missing(MrmError):
    """A case has no stored image yet."""


class BaselineCase(Protocol):
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


def fingerprint(case: BaselineCase) -> str:
    """The digest of what a render of a case depends on: its description and the contents of its files.

    Raises:
        MrmError: a file is missing.
    """
    setup = {name: value for name, value in case.describe().items() if name not in _OF_JUDGEMENT}
    digests = {path: hashlib.sha256(_bytes(path)).hexdigest() for path in case.sources()}
    files = by_name(digests, home_of(case))
    return hashlib.sha256(json.dumps([setup, files], sort_keys=True).encode()).hexdigest()


def digest_of(image: Path) -> str:
    """What an image file is known by.

    Raises:
        MrmError: it cannot be read.
    """
    return hashlib.sha256(_bytes(image)).hexdigest()


def _bytes(path: Path) -> bytes:
    try:
        return read_bytes(path)
    except OSError as error:
        raise MrmError(f"{path}: cannot be read: {error.strerror}") from None


def made_by(record: Mapping[str, Any]) -> str:
    """The version of this package that rendered what a provenance is of; empty where it does not say."""
    versions = record.get("versions")
    return str(versions.get("mrm-nodes", "")) if isinstance(versions, dict) else ""


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
                f"{name} has no baseline yet: look at its render, then "
                f"`mrm-nodes baseline accept {name} --reason ...`"
            )
        try:
            record = jsontext.loads(_bytes(path))
            if record["format"] != FORMAT:
                raise MrmError(
                    f"{path}: a baseline of format {record['format']}; this version reads {FORMAT}"
                )
            for key, kind in (("sha256", str), ("inputs", str), ("accepted", dict)):
                if not isinstance(record[key], kind):
                    raise TypeError(key)
        except (ValueError, KeyError, TypeError):
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
            if path.is_file() and digest_of(path) == digest:
                return path
        return None

    def _pending(self, name: str) -> Path:
        return self.folder / f".{name}.accepted.exr"

    def standing(self, name: str) -> str:
        """The digest of what is recorded of a case's stored image; empty where there is none.

        Two records differ even where one image was accepted twice.
        """
        path = self.paths(name)[1]
        return hashlib.sha256(_bytes(path)).hexdigest() if path.is_file() else ""

    def accept(
        self,
        name: str,
        image: Path,
        provenance: Mapping[str, Any],
        reason: str | None,
        replaces: str | None = None,
        render: str | None = None,
    ) -> None:
        """Make an image file the baseline of a case, and record it.

        Args:
            image: an EXR file.
            provenance: what it was made of and with; `inputs` is the case's fingerprint.
            replaces: the `standing` that whoever accepts has seen; by default that at this call.
            render: the `digest_of` the image that is meant; by default of the one that is there.

        Raises:
            MrmError: it cannot be read or written, or another acceptance came first: then nothing is changed.
        """
        contents = _bytes(image)
        seen = self.standing(name) if replaces is None else replaces
        digest = hashlib.sha256(contents).hexdigest()
        if render not in (None, digest):
            raise MrmError(f"{image}: not the render that the run came to: go on with regress --resume")
        accepted = _decision(reason)
        record = {"format": FORMAT, "case": name, "sha256": digest, "accepted": accepted, **provenance}
        path, beside = self.paths(name)
        pending = self._pending(name)
        with self._deciding("accept", name, digest, accepted) as log:
            self._finish(name, log)
            if self.standing(name) != seen:
                raise MrmError(f"{name}: {self._rival(name)}: look at that image, run again, and then accept")
            # The provenance is what decides: until it is replaced the old image counts, and from then on the new.
            try:
                write_durably(pending, contents)
                write_durably(beside, (json.dumps(record, indent=2) + "\n").encode())
            except OSError:
                if self._digest(name) != digest:
                    pending.unlink(missing_ok=True)
                raise
            replace_durably(pending, path)

    def _rival(self, name: str) -> str:
        """Who accepted another image meanwhile."""
        try:
            accepted = self.provenance(name)["accepted"]
        except MrmError:
            return "its baseline was removed or damaged meanwhile"
        return f"{accepted.get('who')} accepted another image meanwhile ({accepted.get('when')})"

    def _digest(self, name: str) -> str:
        """Of the image that is accepted; empty where none is, or its record is damaged."""
        try:
            return str(self.provenance(name)["sha256"])
        except MrmError:
            return ""

    def _finish(self, name: str, log: int) -> None:
        """Put an image in its place, and its decision into the log, that an acceptance which was cut short left."""
        try:
            record = self.provenance(name)
        except MrmError:
            return
        if self._image(name, record["sha256"]) == self._pending(name):
            replace_durably(self._pending(name), self.paths(name)[0])
        number = record["accepted"].get("number")
        if number and str(number).encode() not in _bytes(self.folder / LOG):
            _append(log, "accept", name, record["sha256"], record["accepted"])

    @contextmanager
    def _deciding(self, what: str, name: str, digest: str, decision: Mapping[str, Any]) -> Iterator[int]:
        """Be the only one who decides in this folder; append the decision to the log once the block has carried it out.

        Raises:
            MrmError: the folder or the log cannot be written, or somebody else decides for too long; then before
                the block.
        """
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True, exist_ok=True)
                sync_folder(self.folder.parent)
            # A link would have a line written into somebody else's file.
            log = open_ordinary(self.folder / LOG, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW)
            try:
                if not lock(log, PATIENCE):
                    raise MrmError(
                        f"{self.folder}: somebody else has been accepting there for {PATIENCE:g} s; try again"
                    )
                clear(self.folder)
                yield log
                try:
                    _append(log, what, name, digest, decision)
                except OSError as error:
                    raise MrmError(
                        f"{self.folder / LOG}: {name}: the {what} counts, but could not be logged: {error.strerror}"
                    ) from None
            finally:
                os.close(log)
        except OSError as error:
            raise MrmError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def reject(self, name: str, image: Path, reason: str | None) -> None:
        """Record that an image is not to be the baseline of a case; the baseline stays as it is.

        Raises:
            MrmError: the image cannot be read, or the log cannot be written.
        """
        with self._deciding("reject", name, digest_of(image), _decision(reason)):
            pass

    def decisions(self) -> Iterator[dict[str, Any]]:
        """The log's lines, the oldest first; one that is damaged is left out."""
        path = self.folder / LOG
        if not path.is_file():
            return
        for line in _bytes(path).decode("utf-8", errors="replace").splitlines():
            try:
                entry = jsontext.loads(line)
            except ValueError:
                continue
            if isinstance(entry, dict):
                yield entry


_RESTORE = "restore it, or accept a new one with `mrm-nodes baseline accept`"


def _append(log: int, what: str, name: str, digest: str, decision: Mapping[str, Any]) -> None:
    """Raises OSError where there is no room."""
    line = (json.dumps({"what": what, "case": name, "sha256": digest, **decision}) + "\n").encode()
    size = os.fstat(log).st_size
    if size and os.pread(log, 1, size - 1) != b"\n":  # the line before was cut short
        line = b"\n" + line
    if os.write(log, line) != len(line):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    os.fsync(log)


def _decision(reason: str | None) -> dict[str, Any]:
    """Who decided, when and why, and a number that no other decision has."""
    return {"who": _who(), "when": _now(), "why": reason, "number": uuid.uuid4().hex}


def _who() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user without a name, as in containers
        return f"user {os.getuid()}"


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
