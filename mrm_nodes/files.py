"""Files that appear complete or not at all, and files that one process holds at a time."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import stat
import tempfile
import time
import uuid
from collections.abc import Mapping
from pathlib import Path

from mrm_nodes.errors import MrmError

UNFINISHED = ".mrm-unfinished-"
"""What the names of files and folders begin with that are being written."""

ABANDONED = 86_400.0
"""Seconds after which nobody still writes such a one."""


def write_text(path: Path, text: str) -> None:
    """Write a file that appears complete or not at all.

    Raises:
        MrmError: it cannot be written.
    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, contents: bytes) -> None:
    """As `write_text`."""
    try:
        _write(path, contents, durably=False)
    except OSError as error:
        raise MrmError(f"{path}: cannot be written: {error.strerror}") from None


def write_together(files: Mapping[Path, bytes]) -> None:
    """Write several files, none of which appears before all are written.

    Raises:
        MrmError: one cannot be written; says which are there already, where that came so late.
    """
    unfinished: dict[Path, Path] = {}
    placed: list[Path] = []
    path = Path()
    try:
        for path, contents in files.items():
            unfinished[path] = path.with_name(f"{UNFINISHED}{uuid.uuid4().hex}")
            with unfinished[path].open("xb") as file:
                file.write(contents)
        for path, temporary in unfinished.items():
            temporary.replace(path)
            placed.append(path)
    except OSError as error:
        before = f"; written before it: {', '.join(map(str, placed))}" if placed else ""
        raise MrmError(f"{path}: cannot be written: {error.strerror}{before}") from None
    finally:
        for temporary in unfinished.values():
            temporary.unlink(missing_ok=True)


def write_durably(path: Path, contents: bytes) -> None:
    """Write a file that appears complete or not at all, and that a power cut after this does not take away.

    Raises:
        OSError: it cannot be written; what was there before is still there, unless it was only the folder that
            could not be written through to the disk.
    """
    _write(path, contents, durably=True)


def _write(path: Path, contents: bytes, durably: bool) -> None:
    temporary = path.with_name(f"{UNFINISHED}{uuid.uuid4().hex}")
    try:
        with temporary.open("xb") as file:
            file.write(contents)
            if durably:
                file.flush()
                os.fsync(file.fileno())
        if durably:
            replace_durably(temporary, path)
        else:
            temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def replace_durably(old: Path, new: Path) -> None:
    """Rename a file whose contents are on the disk, over another if there is one, so that a power cut keeps the name.

    Raises:
        OSError: it cannot be renamed, or the folder not be written through to the disk.
    """
    old.replace(new)
    sync_folder(new.parent)


def sync_folder(folder: Path) -> None:
    """Have the disk hold the names that a folder has.

    Raises:
        OSError: it cannot.
    """
    file = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(file)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system that has no such thing
            raise
    finally:
        os.close(file)


LARGEST = 1 << 30
"""Bytes of a file of ours: one that claims more is somebody's trap."""


def open_ordinary(path: str | Path, flags: int = os.O_RDONLY) -> int:
    """Open a file as `os.open` does, but nothing that one could wait for or read without an end.

    Raises:
        OSError: it cannot be opened, or is a pipe, a device, a folder or the like.
    """
    handle = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "no ordinary file", os.fspath(path))
    return handle


def read_bytes(path: str | Path, flags: int = 0) -> bytes:
    """The contents of an ordinary file.

    Raises:
        OSError: it cannot be read, is none, or is larger than `LARGEST`.
    """
    file = open_ordinary(path, os.O_RDONLY | flags)
    try:
        size = os.fstat(file).st_size
        if size > LARGEST:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG), os.fspath(path))
        # One read more sees the end, of a file that grows meanwhile too.
        pieces = []
        while piece := os.read(file, size + 1):
            pieces.append(piece)
        return pieces[0] if len(pieces) == 1 else b"".join(pieces)
    finally:
        os.close(file)


def write_plainly(path: str | Path, contents: bytes, flags: int = os.O_EXCL) -> None:
    """Write a file that nobody looks at yet, and that is not there; with `os.O_TRUNC`, over one that is.

    Raises:
        OSError: it cannot be written.
    """
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | flags, 0o666)
    try:
        left = memoryview(contents)
        while left:
            left = left[os.write(file, left) :]
    finally:
        os.close(file)


def place_in(folder: Path, name: str) -> Path:
    """Where a file or folder of a relative name goes in a folder, whose own folders are made.

    A link that lies on the way is removed: it leads elsewhere.

    Raises:
        OSError: a folder cannot be made.
    """
    folder.mkdir(parents=True, exist_ok=True)
    *above, last = name.split("/")
    for each in above:
        folder /= each
        if folder.is_symlink():
            folder.unlink()
        if not folder.is_dir():
            folder.mkdir()
    place = folder / last
    if place.is_symlink():
        place.unlink()
    return place


def lock(file: int, patience: float = 0.0) -> bool:
    """Take the lock of an open file, which goes with its descriptor or with the process: it is never stale.

    Args:
        file: the descriptor.
        patience: seconds to wait for whoever has it.

    Returns:
        False where somebody has it still.

    Raises:
        OSError: the file system has no locks.
    """
    end = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if time.monotonic() >= end:
                return False
            time.sleep(0.005)


def clear(folder: Path, age: float = 0.0) -> None:
    """Remove what a kill left of files and folders that were being written.

    age: the seconds that they were left alone: none where nobody else may be writing.
    """
    with contextlib.suppress(OSError):
        for left in folder.glob(f"{UNFINISHED}*"):
            if age and left.lstat().st_mtime > time.time() - age:
                continue
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)


def reason(error: OSError) -> str:
    """Why files could not be written: the first reason, where `shutil` gathered several."""
    if isinstance(error, shutil.Error) and error.args and error.args[0]:
        first = error.args[0][0]
        return str(first[-1] if isinstance(first, tuple) else first)
    return error.strerror or str(error)


def prepare_folder(folder: Path, hint: str = "choose another with -o") -> None:
    """Make a folder, and see that files can be written there.

    hint: what to do where they cannot.

    Raises:
        MrmError: they cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        clear(folder, ABANDONED)
    except OSError as error:
        raise MrmError(f"{folder}: cannot be written: {error.strerror}; {hint}") from None
