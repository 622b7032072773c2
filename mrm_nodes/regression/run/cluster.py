"""A run beyond this machine: tasks and files go to the workers of any executor of `concurrent.futures`.

Files travel by content: a worker keeps what it got, and gets nothing twice.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import shutil
import tempfile
import threading
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mrm_nodes.errors import MrmError
from mrm_nodes.files import write_plainly
from mrm_nodes.regression.cases import digests
from mrm_nodes.regression.run.journal import is_inside
from mrm_nodes.regression.run.pool import Judged, Lost, WorkerProcess, estimate
from mrm_nodes.regression.verdict.outcome import (
    Outcome,
    Task,
    as_record,
    from_record,
    needs_evaluator,
    outcome_of,
)

_IN_FLIGHT = 64
"""Tasks that an executor has at a time: enough for many workers, and few enough to hold their images in memory."""

_ONE_THREAD = {"LP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
"""Whoever set the executor up has given each processor a worker."""


@dataclass(frozen=True)
class Cluster:
    """Where tasks go instead of this machine's own worker processes.

    Args:
        executor: any executor of `concurrent.futures`. Its workers keep worker processes of their own, so that no
            case can harm them.
        ship: hands contents over apart from the tasks that need them, so that they travel to each worker once;
            where there is none, a worker asks for contents that it has not got.
    """

    executor: Executor
    ship: Callable[[bytes], Any] | None = None


@contextlib.contextmanager
def dask_cluster(address: str, workers: int = 2, security: Path | None = None) -> Iterator[Cluster]:
    """A Dask cluster by the address of its scheduler, or `local`, one of this machine for as long as the block lasts.

    Args:
        workers: processes of a local cluster.
        security: a file of Dask's configuration that names the certificates for `tls://`; see `_security`.

    Raises:
        MrmError: Dask is not installed, no scheduler answers there, or it and the certificates do not fit.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise MrmError("--dask needs Dask: pip install 'mrm-nodes[dask]'") from None
    if security is not None and not address.startswith("tls://"):
        raise MrmError(f"--dask {address}: --dask-security is for a scheduler's tls:// address")
    with contextlib.ExitStack() as stack:
        certificates = None if security is None else _security(distributed, security)
        try:
            place: Any = address
            if address == "local":
                place = stack.enter_context(
                    distributed.LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
                )
            client = stack.enter_context(distributed.Client(place, timeout="10s", security=certificates))
        except (OSError, ValueError, TypeError) as error:
            hint = (
                "; --dask-security FILE names its certificates"
                if _lacks_certificates(address, security)
                else ""
            )
            told = " ".join(str(error).split())
            raise MrmError(f"--dask {address}: no scheduler answers there: {told}{hint}") from None
        # Dask names what it is given by its contents: what was sent once is not sent again.
        yield Cluster(client.get_executor(), functools.partial(client.scatter, hash=True))


def _lacks_certificates(address: str, security: Path | None) -> bool:
    return security is None and address.startswith("tls://")


_CERTIFICATES = {
    "tls_ca_file": ("ca-file",),
    "tls_client_cert": ("client", "cert"),
    "tls_client_key": ("client", "key"),
}
"""What Dask calls a client's certificates, and where its configuration has them, below distributed.comm.tls."""


def _security(distributed: Any, file: Path) -> Any:
    """The certificates that a file of Dask's configuration (YAML) names, relative to the file.

    Raises:
        MrmError: it cannot be read, or lacks one that is needed.
    """
    yaml: Any = importlib.import_module("yaml")
    try:
        content = yaml.safe_load(file.read_text("utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise MrmError(f"--dask-security {file}: cannot be read: {reason}") from None
    found: dict[str, str] = {}
    for name, keys in _CERTIFICATES.items():
        value = content
        for key in ("distributed", "comm", "tls", *keys):
            value = value.get(key) if isinstance(value, dict) else None
        if not isinstance(value, str):
            path = ".".join(("distributed.comm.tls", *keys))
            raise MrmError(f"--dask-security {file}: names no {path}")
        found[name] = str(file.parent / value)
    for certificate in found.values():
        if not Path(certificate).is_file():
            raise MrmError(f"--dask-security {file}: {certificate}: no such file")
    return distributed.Security(require_encryption=True, **found)


@dataclass(frozen=True)
class Order:
    """What a worker is asked for: a task, and which contents its files have."""

    task: Task
    backend: str
    digests: Mapping[str, str]
    """By absolute path, of the files that are there."""
    conditions: str
    """The digest of `digests.conditions`: a worker with others would give other results."""
    time_limit: float


@dataclass(frozen=True)
class MissingContents:
    """Contents that a worker has not got, by their digests."""

    digests: frozenset[str]


@dataclass(frozen=True)
class Result:
    """What comes back from a worker: an outcome's record, its files, and what was warned of."""

    record: dict[str, Any]
    files: Mapping[str, bytes]
    warnings: Sequence[str] = ()


def run_on(
    cluster: Cluster,
    tasks: Sequence[Task],
    backend: str,
    scratch: Path,
    files: digests.Inputs,
    around: Mapping[str, str],
    time_limit: float,
    seconds: Callable[[Task], float] = estimate,
) -> Generator[Judged]:
    """Judge tasks on a cluster's workers.

    Args:
        scratch: an existing folder for what comes back.
        files: the tasks' files by content.
        around: the conditions that every worker must have; see `digests.conditions`.
        time_limit, seconds: as in `run_locally`.

    Raises:
        MrmError: the executor is broken.
    """
    expected = digests.digest_of(dict(around))
    waiting = deque(sorted(tasks, key=seconds, reverse=True))
    flying: dict[Future[Any], Task] = {}
    lost: Counter[str] = Counter()
    shipped: dict[str, Any] = {}

    def submit(task: Task, wanted: frozenset[str] = frozenset()) -> None:
        known = {str(path): files.digest(path) for path in task.files()}
        known = {path: each for path, each in known.items() if each != digests.MISSING}
        contents: dict[str, Any] = {}
        for path, each in known.items():
            if cluster.ship is not None:
                if each not in shipped:
                    shipped[each] = cluster.ship(Path(path).read_bytes())
                contents[each] = shipped[each]
            elif each in wanted:
                contents[each] = Path(path).read_bytes()
        order = Order(task, backend, known, expected, time_limit)
        try:
            flying[cluster.executor.submit(judge_elsewhere, order, contents)] = task
        except Exception as error:  # an executor's own faults have many types
            raise MrmError(
                f"the executor takes no more tasks: {type(error).__name__}: {error}; go on with --resume"
            ) from None

    try:
        while waiting or flying:
            while waiting and len(flying) < _IN_FLIGHT:
                submit(waiting.popleft())
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                task = flying.pop(future)
                try:
                    answer = future.result()
                except Exception as error:
                    lost[task.name] += 1
                    if lost[task.name] == 1:
                        submit(task)
                        continue
                    reason = f"the worker was lost ({type(error).__name__}: {error}), twice"
                    outcome = outcome_of(task, backend, "error", message=reason, fault="worker")
                    answer = Result(as_record(outcome), {})
                if isinstance(answer, MissingContents):
                    submit(task, answer.digests)
                    continue
                folder = scratch / "arrived"
                made: set[str] = set()
                told = [each for each in answer.record["files"].values() if isinstance(each, str)]
                for name in (*answer.files, *told):
                    if not is_inside(name):
                        raise MrmError(
                            f"a worker sent a file {name!r}, which leads outside of the report's folder"
                        )
                for name, data in answer.files.items():
                    parent, _, _ = name.rpartition("/")
                    if parent not in made:
                        (folder / parent).mkdir(parents=True, exist_ok=True)
                        made.add(parent)
                    write_plainly(f"{folder}/{name}", data, os.O_TRUNC)
                outcome = from_record({**answer.record, "setup": task.describe()})
                yield Judged(task, outcome, folder, answer.warnings)
    finally:
        for future in flying:
            future.cancel()


class ShippedFiles:
    """The files that a worker got, each under the digest of its contents."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mrm-nodes-store-")
        self._lock = threading.Lock()
        self.root = Path(self._folder.name)

    def missing(self, files: Mapping[str, str], contents: Mapping[str, bytes]) -> frozenset[str]:
        """Those contents that are neither here nor given."""
        return frozenset(
            each for each in files.values() if each not in contents and not (self.root / each).is_file()
        )

    def lay_out(self, files: Mapping[str, str], contents: Mapping[str, bytes]) -> Path:
        """A folder that has the files below it as they lie below the root of the machine that they come from."""
        with self._lock:
            for each, data in contents.items():
                if not (self.root / each).is_file():
                    (self.root / each).write_bytes(data)
            tree = self.root / "trees" / digests.digest_of(dict(files))
            for path, each in files.items():
                file = tree / Path(path).relative_to(Path(path).anchor)
                if not file.exists():
                    file.parent.mkdir(parents=True, exist_ok=True)
                    file.hardlink_to(self.root / each)
            return tree


@functools.cache
def _store() -> ShippedFiles:
    """The one of this process."""
    return ShippedFiles()


_idle: dict[tuple[int, str], deque[WorkerProcess]] = {}
"""Worker processes that wait, by the process that started them and backend: a fork inherits what is not its own."""


def judge_elsewhere(order: Order, contents: Mapping[str, bytes]) -> Result | MissingContents:
    """Judge a task in a worker process of this worker: what `run_on` has an executor's workers do."""
    store = _store()
    missing = store.missing(order.digests, contents)
    if missing:
        return MissingContents(missing)
    tree = store.lay_out(order.digests, contents)
    with tempfile.TemporaryDirectory(dir=store.root) as scratch:
        root = digests.root_of(order.task)
        task = order.task.moved(tree / root.relative_to(root.anchor)) if order.digests else order.task
        outcome, warned = _judge(order, task, Path(scratch))
        found = sorted(file for file in Path(scratch).rglob("*") if file.is_file())
        files = {str(file.relative_to(scratch)): file.read_bytes() for file in found}
    return Result(_without(str(tree), as_record(outcome)), files, _without(str(tree), warned))


def _judge(order: Order, task: Task, folder: Path) -> tuple[Outcome, list[str]]:
    """The outcome of a task and what was warned of, its files below a folder; tried once more where it costs its
    worker process.
    """
    idle = _idle.setdefault((os.getpid(), order.backend), deque())
    lost = Lost("")
    for _ in range(2):
        process = _waiting(idle) or WorkerProcess(order.backend, _ONE_THREAD, needs_evaluator(task))
        try:
            if not process.driver:
                process.driver = process.wait_for_answer()
            if digests.digest_of(digests.conditions(process.driver)) != order.conditions:
                reason = "this worker has other versions, another OpenGL or another source than the run"
                idle.append(process)
                return outcome_of(task, order.backend, "error", message=reason, fault="worker"), []
            process.give(task, folder, order.time_limit)
            outcome: Outcome
            outcome, warned, is_sound = process.wait_for_answer()
        except Lost as error:
            lost = error
        else:
            if is_sound:
                idle.append(process)
                return outcome, warned
            lost = Lost.by(outcome)
        process.stop()
        for left in folder.iterdir():
            shutil.rmtree(left) if left.is_dir() else left.unlink()
    return outcome_of(task, order.backend, "error", message=f"{lost}, twice", fault=lost.fault), []


def _waiting(idle: deque[WorkerProcess]) -> WorkerProcess | None:
    """A process that waits, if there is one that still lives and has the environment of this moment; others end.

    What ended while it waited cost no task, and what was started for another run knows that one's variables.
    """
    while True:
        try:
            process = idle.pop()
        except IndexError:
            return None
        if process.is_alive() and process.surroundings == dict(os.environ):
            return process
        process.stop()


def _without(root: str, value: Any) -> Any:
    """A record in which paths are those of the machine that asked."""
    if isinstance(value, dict):
        return {name: _without(root, each) for name, each in value.items()}
    if isinstance(value, list):
        return [_without(root, each) for each in value]
    return value.replace(root, "") if isinstance(value, str) else value
