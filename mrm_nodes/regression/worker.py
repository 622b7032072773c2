"""One process's share of a run: a task at a time, and whatever goes wrong with it becomes its verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mrm_nodes.errors import MrmError
from mrm_nodes.regression import cloud, image_case
from mrm_nodes.regression.outcome import Outcome, Task, outcome_of
from mrm_nodes.regression.workshop import Workshop
from mrm_nodes.shadergen import Shader

JUDGES: Mapping[str, Callable[[Any, Workshop, Outcome, Path], None]] = {
    "image": image_case.judge,
    "cloud": cloud.judge,
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
        self._workshop = Workshop(backend, edit)

    def run(self, task: Task, folder: Path) -> Outcome:
        """Run a task and write its files below `folder`; a fault becomes the verdict, never an exception."""
        outcome = outcome_of(task, self.backend, "error")
        try:
            JUDGES[task.kind](task, self._workshop, outcome, folder)
        except MrmError as error:
            outcome.verdict, outcome.message = "error", str(error)
        except Exception as error:  # one broken case must not cost the others
            outcome.verdict, outcome.message = "error", f"{type(error).__name__}: {error}"
        return outcome
