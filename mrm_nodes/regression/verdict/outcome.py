"""What became of one task: the record that everything after a run is made from."""

from __future__ import annotations

import errno
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, Protocol, Self

import numpy as np

from mrm_nodes import compiling
from mrm_nodes.regression.verdict.compare import Figures, Verdict

STAGES = ("generate", "compile", "render", "reference", "compare")
FIGURES_OWED = ("max_abs", "max_rel", "p999_rel", "rmse")
"""Null in the record of what was not compared; the other figures are left out."""


Fault = Literal["", "disk", "memory", "worker", "time", "opengl", "change"]
"""A full disk, no memory, a worker that was killed or died, one that took too long, an OpenGL that no longer draws, and
a file that was changed during the run."""

_ERRNO: Mapping[int, Fault] = {
    errno.ENOSPC: "disk",
    errno.EDQUOT: "disk",
    errno.EIO: "disk",
    errno.ENOMEM: "memory",
    errno.EMFILE: "memory",
    errno.ENFILE: "memory",
}


def fault_of(error: BaseException | None) -> Fault:
    """What of the machine is behind an exception, or behind those that it was raised for."""
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError):
            return "memory"
        if isinstance(error, OSError) and (error.errno or 0) in _ERRNO:
            return _ERRNO[error.errno or 0]
        error = error.__cause__ or error.__context__
    return ""


class Task(Protocol):
    """What a run consists of: an image or a cloud to render, compare and report. Picklable, and only data."""

    @property
    def name(self) -> str:
        """Its own in a suite."""

    @property
    def node(self) -> str:
        """What is proven: the report filters by it."""

    @property
    def kind(self) -> str:
        """Who judges it: a key of `worker.JUDGES`."""

    @property
    def target(self) -> str:
        """The target whose shader is run."""

    @property
    def structure(self) -> Any:
        """Tasks whose structure is equal share their shaders."""

    def describe(self) -> dict[str, Any]:
        """What it is, for the report: words and numbers, fit for JSON."""

    def files(self) -> tuple[Path, ...]:
        """The user's files that its result depends on: material, includes, textures, mesh, environment."""

    def moved(self, root: Path) -> Self:
        """The same task with its files below another folder."""


@dataclass
class Outcome:
    """What became of one task on one backend: a line of the report."""

    name: str
    """The task's."""
    node: str
    """The node that it is about, or the material's document."""
    backend: str
    """Where it was drawn: `egl` or `osmesa`."""
    verdict: Verdict
    """What came of it; see `compare.VERDICTS`."""
    kind: str = "material"
    """The task's: `cloud` or `material`; in reports of before also `image`."""
    target: str = "glsl"
    """What its shader was generated for."""
    message: str = ""
    """Why, where the verdict is error, skipped or undecided."""
    fault: Fault = ""
    """What of the machine was at fault, where an error says nothing of the case: it is run again by --resume."""
    truth: str = "physics"
    """What it was compared with: `physics` (the evaluator), `baseline` (a stored image) or `mirror`."""
    figures: Figures | None = None
    """The errors that were found."""
    tolerance: Mapping[str, float] = field(default_factory=dict)
    """What was asked of them."""
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    """Seconds of each stage."""
    files: Mapping[str, Any] = field(default_factory=dict)
    """File names, relative to the report's folder, and the pictures' exposure."""
    setup: Mapping[str, Any] = field(default_factory=dict)
    """What the task was, in words and numbers."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """A cloud's figures by decade, its worst configuration, its counts."""


def time_limit_of(task: Task, usual: float) -> float:
    """Seconds that a task may take: its own limit, where it has one."""
    own: float | None = getattr(task, "time_limit", None)
    return usual if own is None else own


def needs_evaluator(task: Task) -> bool:
    """Whether a task is compared with the evaluator and not with a stored image."""
    return getattr(task, "truth", "physics") != "baseline"


def outcome_of(task: Task, backend: str, verdict: Verdict, **others: Any) -> Outcome:
    """An outcome that says which task it belongs to."""
    return Outcome(
        task.name, task.node, backend, verdict, task.kind, task.target, setup=task.describe(), **others
    )


def as_record(outcome: Outcome) -> dict[str, Any]:
    """An outcome as JSON has it, in report.json and elsewhere; what is not finite becomes null."""
    compared = outcome.figures.as_dict() if outcome.figures else dict.fromkeys(FIGURES_OWED)
    at_fault = {"fault": outcome.fault} if outcome.fault else {}
    record: dict[str, Any] = plain(
        {
            "name": outcome.name,
            "kind": outcome.kind,
            "node": outcome.node,
            "target": outcome.target,
            "backend": outcome.backend,
            "truth": outcome.truth,
            "verdict": outcome.verdict,
            "passed": outcome.verdict == "pass",
            **compared,
            "tolerance": outcome.tolerance,
            "seconds": outcome.seconds,
            "message": outcome.message,
            **at_fault,
            "setup": outcome.setup,
            "files": outcome.files,
            "details": outcome.details,
        }
    )
    return record


def from_record(record: Mapping[str, Any]) -> Outcome:
    """The outcome of a record: `as_record` of it is that record again. A figure that is null was not finite.

    Raises:
        KeyError, TypeError: it is no such record.
    """
    figures = None
    if "used" in record:
        told: dict[str, Any] = {each.name: record.get(each.name) for each in fields(Figures)}
        for each in fields(Figures):
            if told[each.name] is None and each.default is not None:
                told[each.name] = np.inf
        figures = Figures(**told)
    own = {each.name: record[each.name] for each in fields(Outcome) if each.name not in ("figures", "fault")}
    return Outcome(**own, figures=figures, fault=record.get("fault", ""))


def plain(value: Any) -> Any:
    """Words, numbers, lists and dicts of them: JSON without NaN and infinity, which become null."""
    # Nearly all are these, and to ask whether something is a mapping takes long.
    if value is None or type(value) in (str, int, bool):
        return value
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    if isinstance(value, dict | Mapping):
        return {str(name): plain(each) for name, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return value if isinstance(value, bool | int | str) else str(value)


@contextmanager
def timed(outcome: Outcome, stage: str) -> Iterator[None]:
    """Add the time that the block takes to a stage of the outcome, without what numba takes to compile."""
    start, compiled = time.perf_counter(), compiling.seconds()
    try:
        yield
    finally:
        outcome.seconds[stage] += time.perf_counter() - start - (compiling.seconds() - compiled)
