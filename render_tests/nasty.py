"""Tasks that harm the process that judges them, each in its own way."""

import ctypes
import os
import signal
import time
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from mrm_nodes import compiling
from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.run import worker
from mrm_nodes.render.context import get_context


def _die(workshop):
    os.kill(os.getpid(), signal.SIGKILL)


def _hang(workshop):
    # Inside of C, where no signal handler of Python's can run: as in a draw that never ends.
    ctypes.PyDLL(None).sleep(10_000)


def _exhaust_memory(workshop):
    np.ones(1 << 50)


def _make_nothing_current():
    """As a driver leaves it that was reset: every call to OpenGL does nothing."""
    egl = ctypes.CDLL("libEGL.so.1")
    egl.eglGetCurrentDisplay.restype = ctypes.c_void_p
    egl.eglMakeCurrent.argtypes = [ctypes.c_void_p] * 4
    egl.eglMakeCurrent(egl.eglGetCurrentDisplay(), None, None, None)


def _lose_context(workshop):
    get_context(workshop.renderer.backend).run(_make_nothing_current)
    raise RuntimeError("the context is lost")


def _raise(workshop):
    raise RuntimeError("a fault of the case's own")


def _compile(workshop):
    """As numba does, and for longer than the tests' time limit."""
    compiling.begin()
    time.sleep(8.0)
    compiling.end()


def _warn(text):
    """A deed that does no harm."""
    warnings.warn(text, MrmWarning, stacklevel=1)
    warnings.warn("of no interest to a user", DeprecationWarning, stacklevel=1)


DEEDS = {
    "die": _die,
    "hang": _hang,
    "exhaust memory": _exhaust_memory,
    "lose context": _lose_context,
    "raise": _raise,
}

HARMLESS = {"compile": _compile}


@dataclass(frozen=True)
class Nasty:
    """A task that does its deed, always or once, and otherwise leaves a file with what it read."""

    name: str
    deed: str = ""
    marker: Path | None = None
    """Where this file is, the deed was done; it is done once."""
    file: Path | None = None
    """Its contents end up in the case's file."""
    edits: bool = False
    """Whether it changes its file once it was read."""
    warning: str = ""
    kind: ClassVar[str] = "nasty"
    node: ClassVar[str] = "none"
    target: ClassVar[str] = "glsl"
    structure: ClassVar[str] = "nasty"

    def describe(self):
        return {"deed": self.deed, "file": str(self.file)}

    def files(self):
        return () if self.file is None else (self.file,)

    def moved(self, root):
        return self if self.file is None else replace(self, file=root / self.file.relative_to("/"))


def judge(task, workshop, outcome, folder):
    if task.deed and not (task.marker and task.marker.exists()):
        if task.marker:
            task.marker.write_text("done")
        {**DEEDS, **HARMLESS}[task.deed](workshop)
    if task.warning:
        _warn(task.warning)
    contents = task.file.read_bytes() if task.file else b""
    if task.edits:
        task.file.write_text("edited")
    place = folder / "cases" / task.name
    place.mkdir(parents=True)
    (place / "read.txt").write_bytes(contents + task.name.encode())
    outcome.verdict = "pass"
    outcome.files = {"read": f"cases/{task.name}/read.txt"}


# A worker process has this module from unpickling its first such task.
worker.JUDGES["nasty"] = judge
