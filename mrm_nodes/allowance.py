"""What a process may take of its machine, memory and time, when it works on what others wrote."""

from __future__ import annotations

import contextlib
import os
import resource
import select
import signal
import sys
from pathlib import Path
from types import FrameType

from mrm_nodes.errors import MrmError
from mrm_nodes.processes import end_with_parent

MEMORY_VARIABLE = "MRM_MEMORY_LIMIT"
"""Megabytes that a process may take, where no option says so: worker processes have theirs by it."""

_SHARE, _LEAST = 0.75, 2048
"""Of the machine's memory, and megabytes."""
_CONTROL_GROUPS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def usual_memory(processes: int = 1) -> int:
    """Megabytes that each of so many processes may take: together three quarters of the machine's or container's."""
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    for file in _CONTROL_GROUPS:
        with contextlib.suppress(OSError, ValueError):  # `max` is no limit
            total = min(total, int(Path(file).read_text()))
    return max(_LEAST, int(total * _SHARE / processes) >> 20)


def limit_memory(megabytes: int | None = None) -> int:
    """Have this process take no more memory than that, or `MRM_MEMORY_LIMIT`, or the usual; returns what it may take.

    What goes beyond it is a MemoryError, or a crash in code that does not look.
    """
    if megabytes is None:
        text = os.environ.get(MEMORY_VARIABLE, "")
        megabytes = int(text) if text.isdecimal() and int(text) else usual_memory()
    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = megabytes << 20
    if most != resource.RLIM_INFINITY:
        wanted = min(wanted, most)
    # Not RLIMIT_AS: drivers and runtimes reserve addresses that they never use.
    resource.setrlimit(resource.RLIMIT_DATA, (wanted, most))
    return wanted >> 20


def out_of_memory() -> str:
    """What to say where memory ran out."""
    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    allowed = (
        "the machine has" if limit == resource.RLIM_INFINITY else f"the {limit >> 20} MB that it may take"
    )
    return f"needs more memory than {allowed}: --memory-limit MB sets the limit"


def go_on_within(seconds: float, megabytes: int | None) -> int | None:
    """Go on in a process of its own that may take so much time and memory.

    Call it before anything is loaded: a fork has none of its parent's threads.

    Returns:
        None in that process, which is to do the work and exit; in the first one, when it has ended, its exit status.

    Raises:
        MrmError: in the first one, where the other took too long, or was ended by a signal.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    ended, held = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ended)
        # Signals come from the first process, once.
        os.setpgid(0, 0)
        end_with_parent()
        limit_memory(megabytes)
        return None
    os.close(held)
    with contextlib.closing(os.fdopen(ended)):
        return _waited_for(child, ended, seconds)


def _waited_for(child: int, ended: int, seconds: float) -> int:
    passed_on: list[int] = []

    def pass_on(number: int, frame: FrameType | None) -> None:
        passed_on.append(number)
        with contextlib.suppress(OSError):
            os.kill(child, number)

    before = {
        number: signal.signal(number, pass_on) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        # Nobody writes there: it ends with the process.
        in_time, _, _ = select.select([ended], [], [], seconds)
        if not in_time:
            with contextlib.suppress(OSError):
                os.killpg(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    if not in_time:
        raise MrmError(
            f"no result within the time limit of {seconds:g} s: the document may be vast, or a loop in its shader "
            "endless; --time-limit SECONDS sets the limit"
        )
    if os.WIFEXITED(status):
        return os.WEXITSTATUS(status)
    ending = os.WTERMSIG(status)
    if ending in passed_on:
        signal.signal(ending, signal.SIG_DFL)
        os.kill(os.getpid(), ending)
    raise MrmError(
        f"the process that was to do it ended by signal {ending} ({signal.Signals(ending).name}): a crash in MaterialX "
        "or the driver, as where memory runs out; --memory-limit MB sets the limit"
    )
