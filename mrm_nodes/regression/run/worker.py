"""One process's share of a run: a task at a time, and whatever goes wrong with it becomes its verdict."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from mrm_nodes import compiling
from mrm_nodes.allowance import limit_memory, out_of_memory
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.processes import end_with_parent
from mrm_nodes.regression.cases import cloud, digests, material_case
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.run.pool import Compiled, Compiling
from mrm_nodes.regression.verdict.outcome import Outcome, Task, fault_of, outcome_of
from mrm_nodes.render.context import get_context
from mrm_nodes.shadergen import Shader

JUDGES: Mapping[str, Callable[[Any, Workshop, Outcome, Path], None]] = {
    "cloud": cloud.judge,
    "material": material_case.judge,
}
"""By a task's kind: renders and compares it, completes its outcome, and writes its files below a folder."""


class Worker:
    """Judges tasks on one backend.

    Args:
        backend: `egl` or `osmesa`.
        edit: changes each generated shader before it is compiled: for tests that plant faults.

    Raises:
        MrmError: the backend does not work here.
    """

    def __init__(self, backend: str, edit: Callable[[Shader], Shader] = lambda shader: shader) -> None:
        self.backend = backend
        self.is_sound = True
        """Whether the next task may be judged here: false once memory ran out or OpenGL no longer draws."""
        self._workshop = Workshop(backend, edit)

    @property
    def driver(self) -> str:
        """Name of the OpenGL that renders."""
        info = get_context(self.backend).ctx.info
        return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"

    def run(self, task: Task, folder: Path) -> Outcome:
        """Run a task and write its files below `folder`; a fault becomes the verdict, never an exception."""
        outcome = outcome_of(task, self.backend, "error")
        try:
            JUDGES[task.kind](task, self._workshop, outcome, folder)
        except MrmError as error:
            outcome.verdict, outcome.message, outcome.fault = "error", str(error), fault_of(error)
        except MemoryError as error:
            outcome.verdict, outcome.message, outcome.fault = "error", out_of_memory(), fault_of(error)
        except Exception as error:  # one broken case must not cost the others
            outcome.verdict, outcome.message = "error", f"{type(error).__name__}: {error}"
            outcome.fault = fault_of(error)
        self.is_sound = outcome.fault != "memory"
        if outcome.verdict in ("fail", "error"):
            # A context that is lost draws black without a word.
            self.is_sound = self.is_sound and self._workshop.still_draws()
        return outcome


def serve(descriptor: int, backend: str, evaluates: bool) -> None:
    """Judge the tasks that come through a connection until it ends: what a worker process does.

    It sends the name of its OpenGL when it is ready, or the MrmError that keeps it from working; then, for each
    task and folder, the outcome, what it warned of, and whether the worker is still sound. In between it says when
    numba compiles, which is no task's time.

    evaluates: whether the evaluator is to be compiled, where it is not, before it is ready.
    """
    end_with_parent()
    limit_memory()
    # What a start warns of, the parent has said.
    warnings.simplefilter("ignore")
    with Connection(descriptor) as connection, contextlib.suppress(BrokenPipeError):

        def say(message: Any) -> None:
            # Without a parent nothing is waited for.
            with contextlib.suppress(OSError):
                connection.send(message)

        compiling.tell(lambda begins, when: say(Compiling(begins, when)))
        try:
            worker = Worker(backend)
            if evaluates:
                # A run that finds all in the cache imports this module, and has no need of numba.
                from mrm_nodes.reference.warmup import warm_up

                warm_up(lambda *done: say(Compiled(*done)))
        except MrmError as error:
            connection.send(error)
            return
        connection.send(worker.driver)
        while True:
            try:
                task, folder = connection.recv()
            except EOFError:
                return
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always", MrmWarning)
                outcome = worker.run(task, folder)
            connection.send((outcome, _messages(caught, task), worker.is_sound))


def _messages(caught: Sequence[warnings.WarningMessage], task: Task) -> list[str]:
    """The texts of our own warnings, each once; files are named as their task names them."""
    own = [str(each.message) for each in caught if issubclass(each.category, MrmWarning)]
    return list(dict.fromkeys(text.replace(f"{digests.root_of(task)}/", "") for text in own))
