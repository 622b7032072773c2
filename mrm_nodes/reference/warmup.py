"""The evaluator compiled before anybody waits for a number: every loop that it registers, by several processes.

What was compiled is kept at once, so that nothing of it is lost when a process is killed. Processes that have the
same in mind share the work.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from mrm_nodes.cachefolder import choose_numbas
from mrm_nodes.processes import end_with_parent

from . import image_light, refracted_light  # noqa: F401  they register loops that nothing else here imports
from .compiled import KERNELS, thread_count

_PROGRAM = "from mrm_nodes.reference.warmup import help_out; help_out()"


def warm_up(
    told: Callable[[str, int, int], None] = lambda name, done, total: None, processes: int | None = None
) -> int:
    """Compile what is in no cache yet, and return how many loops that were.

    Args:
        told: called with the name of each loop that is there now, how many are, and how many were missing; before
            the first with no name. Not called where nothing was.
        processes: that compile, this one included; by default one for each thread of the evaluator.
    """
    if not choose_numbas():
        # What other processes compile is nothing to this one.
        processes = 1
    missing = [kernel for kernel in KERNELS if not kernel.is_kept()]
    if not missing:
        return 0
    told("", 0, len(missing))
    helpers = [
        # What this process would find, they must find.
        subprocess.Popen(
            [sys.executable, "-P", "-c", _PROGRAM],
            stdin=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
            start_new_session=True,
        )
        for _ in range(min(processes or thread_count(), len(missing)) - 1)
    ]
    try:
        done = 0
        # What others are about comes last.
        for wait in (False, True):
            for kernel in list(missing):
                if kernel.prepare(wait):
                    missing.remove(kernel)
                    done += 1
                    told(kernel.name, done, done + len(missing))
        return done
    finally:
        for helper in helpers:
            helper.kill()
            helper.wait()


def help_out() -> None:
    """Compile what is missing and nobody else is about: what the processes of `warm_up` do."""
    end_with_parent()
    for kernel in KERNELS:
        if not kernel.is_kept():
            kernel.prepare(wait=False)


def folder() -> Path | None:
    """Where machine code is kept; None where that can be nowhere."""
    return KERNELS[0].folder()
