"""A regression run: which backends, who does which task, and where the results go."""

from __future__ import annotations

import datetime
import importlib.metadata
import multiprocessing
import os
import platform
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.files import prepare_folder
from mrm_nodes.regression.outcome import Outcome, Task, outcome_of
from mrm_nodes.regression.report import write_report
from mrm_nodes.regression.worker import Worker
from mrm_nodes.render.context import BackendReport, probe_backends

REQUIRE_VARIABLE = "MRM_REQUIRE_BACKENDS"
"""Names the backends, with commas, whose absence is an error and not skipped: for continuous integration."""

VERSIONED = ("MaterialX", "moderngl", "numba", "numpy", "OpenImageIO")


@dataclass(frozen=True)
class Plan:
    """The backends to run, by name the driver of each, and the others with the reason."""

    drivers: Mapping[str, str]
    skipped: Mapping[str, str]


def plan_backends(request: str, probes: Sequence[BackendReport], required: Sequence[str] = ()) -> Plan:
    """Which backends a request means here.

    `auto` is the first that works; `all` is each that works, the others being skipped with their reason.

    Raises:
        MrmError: an unknown backend; one asked for by name or required that does not work; none that works.
    """
    known = {probe.backend: probe for probe in probes}
    if request not in ("auto", "all", *known):
        raise MrmError(f"unknown backend {request}; known: auto, all, {', '.join(known)}")
    for name in required:
        if name not in known:
            raise MrmError(f"{REQUIRE_VARIABLE} names {name}; known: {', '.join(known)}")
    working = [name for name, probe in known.items() if probe.works]
    wanted = {"auto": working[:1] or list(known), "all": list(known)}.get(request, [request])
    missing = {name: f"{known[name].reason}; {known[name].hint}" for name in wanted if name not in working}
    for name, reason in missing.items():
        if name in required or not working or request == name:
            raise MrmError(f"backend {name} does not work here: {reason}")
    drivers = {
        name: f"{known[name].renderer}, OpenGL {known[name].version}" for name in wanted if name in working
    }
    return Plan(drivers, missing)


def required_backends() -> list[str]:
    """The backends that the environment insists on."""
    return [name.strip() for name in os.environ.get(REQUIRE_VARIABLE, "").split(",") if name.strip()]


def run_suite(
    tasks: Sequence[Task],
    folder: Path,
    backend: str = "auto",
    jobs: int = 1,
    on_outcome: Callable[[Outcome, int, int], None] = lambda outcome, done, total: None,
) -> dict[str, Any]:
    """Run tasks on backends, write the report into a folder, and return what report.json holds.

    Args:
        tasks: cases and clouds; see `suites`.
        folder: made where it does not exist; an earlier report's files in it are replaced.
        backend: `egl`, `osmesa`, `auto` or `all`.
        jobs: worker processes, each with a GL context of its own.
        on_outcome: called with each outcome as it comes, how many there are, and how many there will be.

    Raises:
        MrmError: the folder cannot be written, or the backends are not there.
    """
    start = time.perf_counter()
    prepare_folder(folder)
    plan = plan_backends(backend, probe_backends(), required_backends())
    warm_up()
    total = len(tasks) * (len(plan.drivers) + len(plan.skipped))
    outcomes: list[Outcome] = []
    for name, reason in plan.skipped.items():
        outcomes += [outcome_of(task, name, "skipped", message=reason) for task in tasks]
    backend_seconds = {}
    for name in plan.drivers:
        backend_start = time.perf_counter()
        for outcome in _run_backend(tasks, folder, name, jobs):
            outcomes.append(outcome)
            on_outcome(outcome, len(outcomes), total)
        backend_seconds[name] = round(time.perf_counter() - backend_start, 3)
    environment = {**describe_environment(plan), "jobs": jobs, "backend_seconds": backend_seconds}
    return write_report(folder, environment, outcomes, time.perf_counter() - start)


def describe_environment(plan: Plan) -> dict[str, Any]:
    """Where and with what a run took place."""
    versions = {name: importlib.metadata.version(name) for name in VERSIONED}
    return {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "platform": platform.platform(),
        "processors": os.cpu_count(),
        "backends": dict(plan.drivers),
        "versions": {
            "mrm-nodes": importlib.metadata.version("mrm-nodes"),
            "Python": platform.python_version(),
            **versions,
        },
    }


def _run_backend(tasks: Sequence[Task], folder: Path, backend: str, jobs: int) -> Iterator[Outcome]:
    """The outcomes of tasks on one backend, as worker processes give them.

    A worker gets tasks whose shaders it has already, as long as there are some. One that dies costs the task
    that it was at, and is replaced.
    """
    threads = max(1, (os.cpu_count() or 1) // jobs)
    limits = {"LP_NUM_THREADS": str(threads), "NUMBA_NUM_THREADS": str(threads)}
    waiting = list(tasks)
    crew = [_Crew(backend) for _ in range(min(jobs, len(waiting)))]
    running: dict[Future[Outcome], tuple[_Crew, Task]] = {}
    try:
        while waiting or running:
            busy = [member for member, _ in running.values()]
            for member in [each for each in crew if each not in busy][: len(waiting)]:
                task = waiting.pop(_next_task(waiting, member, crew))
                with _environment(limits):
                    running[member.submit(task, folder)] = (member, task)
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                member, task = running.pop(future)
                try:
                    yield future.result()
                except BrokenProcessPool:
                    yield outcome_of(task, backend, "error", message="the worker process died")
                    member.restart()
    finally:
        for member in crew:
            member.stop()


class _Crew:
    """One worker process, and the structures whose shaders it has."""

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self.restart()

    def restart(self) -> None:
        """Start afresh; the process itself starts with the first task."""
        # A GL context does not survive a fork.
        context = multiprocessing.get_context("spawn")
        self.structures: set[Any] = set()
        self._pool = ProcessPoolExecutor(1, context, _start_worker, (self.backend,))

    def submit(self, task: Task, folder: Path) -> Future[Outcome]:
        self.structures.add(task.structure)
        return self._pool.submit(_run_task, task, folder)

    def stop(self) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)


def _next_task(waiting: Sequence[Task], member: _Crew, crew: Sequence[_Crew]) -> int:
    """Index of the task that costs a worker least: of a structure it has, else of one that nobody has."""
    elsewhere = {structure for each in crew for structure in each.structures} - member.structures

    def cost(index: int) -> int:
        structure = waiting[index].structure
        return 0 if structure in member.structures else 2 if structure in elsewhere else 1

    return min(range(len(waiting)), key=cost)


_worker: Worker | None = None
"""Of this process, where it is a worker process."""


def _start_worker(backend: str) -> None:
    global _worker
    # Ctrl-C reaches every process of the terminal; the parent alone decides what ends.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _worker = Worker(backend)


def _run_task(task: Task, folder: Path) -> Outcome:
    if _worker is None:
        raise RuntimeError("not a worker process")
    return _worker.run(task, folder)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for the processes started in the block; what the user has set stays."""
    added = {name: value for name, value in variables.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def warm_up() -> None:
    """Have the evaluator's compiled code in its cache, so that not every worker compiles it."""
    from mrm_nodes import reference

    up = (0.0, 0.0, 1.0)
    bsdf = reference.Dielectric(1.5, 0.5, energy_compensation="materialx-1.39.5")
    bsdf.eval(up, up)
    bsdf.sample(up, (0.5, 0.5, 0.5))
    bsdf.throughput(up, up)
