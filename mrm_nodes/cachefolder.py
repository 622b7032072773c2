"""Where caches lie, also where there is no home or nothing of it can be written: in containers, and for users without a
name.
"""

from __future__ import annotations

import functools
import os
import stat
import sys
import tempfile
import warnings
from pathlib import Path

import platformdirs

from mrm_nodes.errors import MrmWarning

_NUMBA = "NUMBA_CACHE_DIR"


def of_user(application: str = "mrm-nodes") -> Path | None:
    """A user's own cache folder of an application; None where it cannot be written, or he has no home."""
    try:
        folder = Path(platformdirs.user_cache_dir(application))
    except RuntimeError:  # no home
        return None
    # Older releases say `~/.cache` then, which would become a folder of that name wherever the program runs.
    return folder if folder.is_absolute() and is_writable(folder) else None


@functools.cache
def private() -> Path | None:
    """A temporary folder for this user alone, the same for each of his processes; None where there can be none."""
    try:
        folder = Path(tempfile.gettempdir()) / f"mrm-nodes-{os.geteuid()}"
        folder.mkdir(0o700, exist_ok=True)
        found = folder.lstat()
        is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & 0o077
        return folder if is_own else Path(tempfile.mkdtemp(prefix="mrm-nodes-"))
    except OSError:
        return None


def is_writable(folder: Path) -> bool:
    """Whether files can be written in a folder, or it can be made."""
    there = next(each for each in (folder, *folder.parents) if os.path.lexists(each) or each == each.parent)
    return there.is_dir() and os.access(there, os.W_OK | os.X_OK)


@functools.cache
def choose_numbas() -> bool:
    """Have numba keep machine code in a private temporary folder, here and in processes that this one starts, where it
    could keep it nowhere else. False where there is no such folder.

    Warns (MrmWarning) where it comes to that.
    """
    named = os.environ.get(_NUMBA)
    beside = Path(__file__).parent / "reference" / "__pycache__"
    if is_writable(Path(named)) if named else is_writable(beside) or of_user("numba") is not None:
        return True
    places = named or f"{beside} and this user's cache folder"
    folder = private()
    if folder is None:
        warnings.warn(
            f"{places} cannot be written: each process compiles the evaluator anew, for a minute; "
            f"set {_NUMBA} to a folder that can be written",
            MrmWarning,
            stacklevel=2,
        )
        return False
    os.environ[_NUMBA] = str(folder / "numba")
    if "numba" in sys.modules:  # it has read its environment
        vars(sys.modules["numba"].config)["CACHE_DIR"] = os.environ[_NUMBA]
    warnings.warn(
        f"{places} cannot be written: the compiled evaluator is kept in {os.environ[_NUMBA]}; "
        f"set {_NUMBA} to a folder that stays",
        MrmWarning,
        stacklevel=2,
    )
    return True
