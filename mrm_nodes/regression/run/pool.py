"""Worker processes, and who of them does which task.

What was judged is handed back as it comes. A task that costs its worker (the process dies, hangs, or loses its
OpenGL) is tried once more on a fresh one, and is an error after that.
"""

from __future__ import annotations

import contextlib
import functools
import heapq
import itertools
import multiprocessing.connection
import os
import shutil
import subprocess
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from mrm_nodes.allowance import MEMORY_VARIABLE, usual_memory
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.verdict.outcome import (
    Fault,
    Outcome,
    Task,
    needs_evaluator,
    outcome_of,
    time_limit_of,
)

TIME_LIMIT = 600.0
"""Seconds that a case may take."""

_START_LIMIT = 120.0
"""Seconds that a worker process may take to start."""

_COMPILE_LIMIT = 1800.0
"""Seconds that numba may compile at a time: what takes longer will not end."""

_STARTS = 3
"""Times that a worker process may die as it starts, with no sign of life from any, before the run is given up."""

UNSOUND = "the worker's OpenGL no longer draws"

_ENVIRONMENT_LIGHTS = 2000
"""What the reference of an environment costs, in lights."""

_SECONDS_A_POINT = 4e-6
"""A shaded point with one light, on one processor: only the order of tasks hangs on it."""


@dataclass(frozen=True)
class Judged:
    """A task, what became of it, the folder below which its files lie, and what its worker warned of.

    Who takes it over takes the files away: the folder is used again.
    """

    task: Task
    outcome: Outcome
    folder: Path
    warnings: Sequence[str] = ()


def estimate(task: Task) -> float:
    """Seconds that a task may take, from the points that it shades: a guess, to start with the longest."""
    setup = task.describe()
    width, height = setup.get("size") or (0, 0)
    lights = _ENVIRONMENT_LIGHTS if setup.get("environment") else max(1, len(setup.get("lights") or ()))
    points: int = width * height * lights + setup.get("configurations", 0)
    return _SECONDS_A_POINT * points


class Queue:
    """Tasks that wait: the longest first, and those that share shaders to one worker as far as possible.

    Structures lie in heaps, those that no worker has in one, and those that a worker has in its own: what a hand-out
    takes grows with the workers, and hardly with the tasks.
    """

    def __init__(self, tasks: Iterable[Task], seconds: Callable[[Task], float] = estimate) -> None:
        ordered = sorted(((seconds(task), task) for task in tasks), key=lambda each: -each[0])
        self._waiting: dict[Any, _Group] = {}
        for expected, task in ordered:
            group = self._waiting.setdefault(task.structure, _Group(len(self._waiting)))
            group.tasks.append((expected, task))
        self._free = [group.entry() for group in self._waiting.values()]
        self._held: dict[Any, list[_Entry]] = {}

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def take(self, worker: Any, workers: Iterable[Any]) -> Task:
        """The next task for a worker.

        It is the longest whose structure the worker has or no other has; one that only others have comes last.

        Args:
            workers: who there is; a worker has the structures of the tasks that it took.
        """
        for gone in self._held.keys() - set(workers):
            self._forget(gone)
        own = self._held.setdefault(worker, [])
        # The worker's own comes first among equals.
        best = min((heap for heap in (own, self._free) if self._settled(heap)), key=_longest, default=None)
        if best is None:
            others = [heap for heap in self._held.values() if self._settled(heap)]
            best = min(others, key=lambda heap: heap[0])
        group = best[0][2]
        _, task = group.tasks.popleft()
        if best is not own:
            if best is self._free:
                heapq.heappop(best)
            if group.tasks:
                heapq.heappush(own, group.entry())
            group.holders.add(worker)
        if not group.tasks:
            del self._waiting[task.structure]
        return task

    @staticmethod
    def _settled(heap: list[_Entry]) -> bool:
        """Whether a heap has a group; its first entry is then up to date, whoever took from the group since."""
        while heap:
            group = heap[0][2]
            if not group.tasks:
                heapq.heappop(heap)
            elif group.entry() != heap[0]:
                heapq.heapreplace(heap, group.entry())
            else:
                return True
        return False

    def _forget(self, worker: Any) -> None:
        """Have nobody hold what a worker held that is gone."""
        for _, _, group in self._held.pop(worker):
            group.holders.discard(worker)
            if group.tasks and not group.holders:
                heapq.heappush(self._free, group.entry())


@dataclass(eq=False)
class _Group:
    """Tasks that share shaders, the longest first, and the workers that have those shaders."""

    number: int
    tasks: deque[tuple[float, Task]] = field(default_factory=deque)
    holders: set[Any] = field(default_factory=set)

    def entry(self) -> _Entry:
        """What a heap has of it, the longest first; among equals the group that came first."""
        return -self.tasks[0][0], self.number, self


_Entry = tuple[float, int, _Group]


def _longest(heap: list[_Entry]) -> float:
    return heap[0][0]


@dataclass(frozen=True)
class Compiling:
    """What a worker process says as numba begins to compile in it, or has ended; `when` by `time.monotonic()`."""

    begins: bool
    when: float


@dataclass(frozen=True)
class Compiled:
    """What a worker process says before its first task of each loop of the evaluator that was not compiled before."""

    name: str
    """The loop that is there now; none before the first."""
    done: int
    total: int


class Lost(Exception):
    """A worker process is gone, or must go: says why, and what of the machine is at fault."""

    def __init__(self, reason: str, fault: Fault = "worker") -> None:
        super().__init__(reason)
        self.fault = fault

    @classmethod
    def by(cls, outcome: Outcome) -> Self:
        """A worker that cannot be trusted with another task after this outcome."""
        return cls(outcome.message or UNSOUND, outcome.fault or "opengl")


class WorkerProcess:
    """A process with a GL context that judges one task at a time.

    It is a program of its own, not a fork (a GL context does not survive one), and not multiprocessing's: that
    cannot be used from Dask's workers. It ends with the process that started it.

    Time in which numba compiles counts for no task: the first that needs a formula is not at fault.

    Args:
        backend: `egl` or `osmesa`.
        variables: environment variables; what the user has set stays.
        evaluates: whether the evaluator is compiled, where it is not, before the first task.
    """

    _PROGRAM = (
        "import sys; from mrm_nodes.regression.run.worker import serve;"
        "serve(int(sys.argv[1]), sys.argv[2], sys.argv[3] == 'True')"
    )

    def __init__(self, backend: str, variables: Mapping[str, str], evaluates: bool = True) -> None:
        self.task: Task | None = None
        self.folder = Path()
        self.driver = ""
        """Name of its OpenGL, which is what it says when it is ready."""
        self.surroundings = dict(os.environ)
        """The environment variables of the moment in which it was started."""
        self.connection, far = multiprocessing.connection.Pipe()
        # The child must find this package, and whatever a task is made of, wherever this process found it.
        path = os.pathsep.join(path for path in sys.path if path)
        command = [sys.executable, "-P", "-c", self._PROGRAM, str(far.fileno()), backend, str(evaluates)]
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            env={**variables, **os.environ, "PYTHONPATH": path},
            pass_fds=[far.fileno()],
            # Ctrl-C reaches every process of the terminal; the parent alone decides what ends.
            start_new_session=True,
        )
        far.close()
        self._limit = _START_LIMIT
        self._started = time.monotonic()
        self._compiling_since: float | None = None

    @property
    def pid(self) -> int:
        return self._process.pid

    def is_alive(self) -> bool:
        return self._process.poll() is None

    @property
    def seconds_left(self) -> float:
        """Until it has taken too long."""
        if self._compiling_since is not None:
            return self._compiling_since + _COMPILE_LIMIT - time.monotonic()
        return self._started + self._limit - time.monotonic()

    def give(self, task: Task, folder: Path, time_limit: float) -> None:
        """Start a task, whose files go below an empty folder."""
        self.task, self.folder = task, folder
        self._limit, self._started = time_limit_of(task, time_limit), time.monotonic()
        # A process that just died says so when its answer is asked for.
        with contextlib.suppress(OSError):
            self.connection.send((task, folder))

    def taken(self) -> Task:
        """The task that was given, which is done with."""
        assert self.task is not None
        task, self.task = self.task, None
        return task

    def wait_for_answer(self) -> Any:
        """What the process sends next: the name of its OpenGL; then, for each task, the outcome, what it warned of,
        and whether the process can be trusted with another.

        Raises:
            Lost: the process died, or took longer than it may.
            MrmError: the backend does not work there.
        """
        while True:
            message = self.next_message()
            if not isinstance(message, Compiling | Compiled):
                return message

    def next_message(self) -> Any:
        """As `wait_for_answer`, or a word on what is compiled before there is an answer."""
        if not self.connection.poll(max(0.0, self.seconds_left)):
            if self._compiling_since is not None:
                raise Lost(f"numba has compiled for {_COMPILE_LIMIT:g} s without an end", "time")
            what = "no result" if self.driver else "no start of the worker process"
            raise Lost(f"{what} within the time limit of {self._limit:g} s", "time")
        try:
            message = self.connection.recv()
        except (EOFError, OSError):
            raise Lost(f"the worker process died ({self._how_it_ended()})") from None
        if isinstance(message, Compiling):
            if message.begins:
                self._compiling_since = message.when
            elif self._compiling_since is not None:
                self._started += message.when - max(self._compiling_since, self._started)
                self._compiling_since = None
        if isinstance(message, MrmError):
            raise message
        return message

    def _how_it_ended(self) -> str:
        try:
            status = self._process.wait(5)
        except subprocess.TimeoutExpired:
            return "it stopped answering"
        return f"signal {-status}" if status < 0 else f"exit status {status}"

    def stop(self) -> None:
        """End it at once."""
        self._process.kill()
        self._process.wait()
        self.connection.close()


def run_locally(
    tasks: Sequence[Task],
    backend: str,
    scratch: Path,
    jobs: int = 1,
    time_limit: float = TIME_LIMIT,
    seconds: Callable[[Task], float] = estimate,
    on_compiled: Callable[[int, int], None] = lambda done, total: None,
) -> Generator[Judged]:
    """Judge tasks in worker processes of this machine.

    Args:
        scratch: an existing folder for their files.
        jobs: worker processes; they share the processors.
        time_limit: seconds a task.
        seconds: what a task is expected to take.
        on_compiled: called where the evaluator is compiled before the first task, with how many of its loops are,
            and how many were not.

    Raises:
        MrmError: worker processes cannot start.
    """
    queue = Queue(tasks, seconds)
    again: deque[Task] = deque()
    lost: Counter[str] = Counter()
    new_folders = (scratch / str(number) for number in itertools.count())
    used_folders: deque[Path] = deque()
    crew = _Crew(backend, min(jobs, len(tasks)), jobs, any(map(needs_evaluator, tasks)), on_compiled)

    def hand_out() -> None:
        for member in crew.idle():
            if not (again or queue):
                break
            task = again.popleft() if again else queue.take(member, crew.members)
            folder = used_folders.popleft() if used_folders else next(new_folders)
            folder.mkdir(exist_ok=True)
            member.give(task, folder, time_limit)

    try:
        hand_out()
        while queue or again or crew.busy():
            done: list[Judged] = []
            for member, answer in crew.answers():
                task = member.taken()
                if not isinstance(answer, Lost):
                    outcome, warned, is_sound = answer
                    if is_sound:
                        done.append(Judged(task, outcome, member.folder, warned))
                        continue
                    answer = Lost.by(outcome)
                crew.replace(member)
                lost[task.name] += 1
                if lost[task.name] == 1:
                    # Its next worker is a fresh process, or another one.
                    again.append(task)
                    continue
                shutil.rmtree(member.folder, ignore_errors=True)
                outcome = outcome_of(task, backend, "error", message=f"{answer}, twice", fault=answer.fault)
                done.append(Judged(task, outcome, member.folder))
            # Workers go on while their results are taken over.
            hand_out()
            for each in done:
                yield each
                used_folders.append(each.folder)
    finally:
        crew.stop()


def threads(jobs: int) -> dict[str, str]:
    """Environment variables that give each of so many processes its share of the processors, and of the memory."""
    each = str(max(1, len(os.sched_getaffinity(0)) // jobs))
    return {"LP_NUM_THREADS": each, "NUMBA_NUM_THREADS": each, MEMORY_VARIABLE: str(usual_memory(jobs))}


class _Crew:
    """Worker processes of one backend, each replaced when it is lost."""

    def __init__(
        self,
        backend: str,
        count: int,
        jobs: int,
        evaluates: bool,
        on_compiled: Callable[[int, int], None],
    ) -> None:
        self._start = functools.partial(WorkerProcess, backend, threads(jobs), evaluates)
        self._on_compiled = on_compiled
        self._compiled: set[str] = set()
        self._missing = 0
        self._failed_starts = 0
        self.members: list[WorkerProcess] = []
        for _ in range(count):
            self.members.append(self._start())

    def busy(self) -> bool:
        return any(member.task for member in self.members)

    def idle(self) -> list[WorkerProcess]:
        """Members that wait for a task. One that died while it waited is replaced, at no task's cost."""
        idle = [member for member in self.members if member.driver and member.task is None]
        for member in idle:
            if not member.is_alive():
                self.replace(member)
        return [member for member in idle if member in self.members]

    def answers(self) -> list[tuple[WorkerProcess, Any]]:
        """Wait until members answer their tasks; where one is lost, that is its answer.

        Raises:
            MrmError: processes do not start.
        """
        waited_for = [member for member in self.members if member.task or not member.driver]
        patience = max(0.0, min(member.seconds_left for member in waited_for))
        spoken = multiprocessing.connection.wait([member.connection for member in waited_for], patience)
        answers: list[tuple[WorkerProcess, Any]] = []
        for member in waited_for:
            if member.connection not in spoken and member.seconds_left > 0:
                continue
            try:
                answer = member.next_message()
            except Lost as lost:
                if member.driver:
                    answers.append((member, lost))
                    continue
                self._failed_starts += 1
                if self._failed_starts >= _STARTS:
                    raise MrmError(f"worker processes do not start: {lost}; see `mrm-nodes doctor`") from None
                self.replace(member)
                continue
            self._failed_starts = 0
            if isinstance(answer, Compiled):
                self._announce(answer)
            elif isinstance(answer, Compiling):
                pass
            elif member.driver:
                answers.append((member, answer))
            else:
                member.driver = answer
        return answers

    def _announce(self, compiled: Compiled) -> None:
        """Say how far the evaluator is compiled: members share the work, and each says what is there."""
        self._compiled |= {compiled.name} - {""}
        self._missing = max(self._missing, compiled.total)
        self._on_compiled(len(self._compiled), self._missing)

    def replace(self, member: WorkerProcess) -> None:
        """Put a fresh process in a member's place."""
        member.stop()
        self.members[self.members.index(member)] = self._start()

    def stop(self) -> None:
        for member in self.members:
            member.stop()
