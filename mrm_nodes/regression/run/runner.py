"""A regression run: which backends, which tasks are still to do, and where the results go.

What a run has come to is on disk at once: each case's files appear complete or not at all, and its outcome is a
line of the journal. A run that is ended in any way can go on from there.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import html
import os
import platform
import shutil
import signal
import tempfile
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import TemplateError

from mrm_nodes import jsontext
from mrm_nodes.cachefolder import choose_numbas
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import place_in, prepare_folder, read_bytes
from mrm_nodes.regression.cases.digests import Inputs, conditions, digest_of, key, source_digest, versions
from mrm_nodes.regression.report.page import write_records
from mrm_nodes.regression.run import journal
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.cluster import Cluster, run_on
from mrm_nodes.regression.run.pool import TIME_LIMIT, Judged, estimate, run_locally
from mrm_nodes.regression.verdict.outcome import Outcome, Task, outcome_of
from mrm_nodes.render.context import BACKENDS, BackendReport, probe_backends, unknown_backend

REQUIRE_VARIABLE = "MRM_REQUIRE_BACKENDS"
"""Names the backends, with commas, whose absence is an error and not skipped: for continuous integration."""

_SCRATCH = ".unfinished"
"""Below the report's folder: what workers write, until their case is done."""

_ROOM = 1 << 20
"""Bytes that a file system must have left after an error, or it is the disk that is full."""


@dataclass(frozen=True)
class Plan:
    """The backends to run, by name the driver of each, and the others with the reason."""

    drivers: Mapping[str, str]
    skipped: Mapping[str, str]


def check_backend(request: str) -> None:
    """Check the name of a backend, or of a choice of them.

    Raises:
        MrmError: there is none of that name.
    """
    if request not in ("auto", "all", *BACKENDS):
        raise MrmError(unknown_backend(request, ("auto", "all", *BACKENDS)))


def plan_backends(request: str, probes: Sequence[BackendReport], required: Sequence[str] = ()) -> Plan:
    """Which backends a request means here.

    `auto` is the first that works; `all` is each that works, the others being skipped with their reason.

    Raises:
        MrmError: an unknown backend; one asked for by name or required that does not work; none that works.
    """
    known = {probe.backend: probe for probe in probes}
    check_backend(request)
    for name in required:
        if name not in BACKENDS:
            raise MrmError(f"{REQUIRE_VARIABLE} names {name}; known: {', '.join(BACKENDS)}")
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


def shard_of(tasks: Sequence[Task], shard: tuple[int, int]) -> list[Task]:
    """Part i of n of a suite, i from 1 to n: the parts share no task, and together they are the suite."""
    number, count = shard
    # Neighbours in a suite are alike: dealt out in turn, they spread the work evenly.
    return list(tasks[number - 1 :: count])


class Report(dict[str, Any]):
    """What report.json holds, and where the report lies: `.folder`. A notebook shows a link to its page."""

    def __init__(self, folder: Path, contents: Mapping[str, Any]) -> None:
        super().__init__(contents)
        self.folder = folder

    def _repr_html_(self) -> str:
        page = (self.folder / "index.html").resolve()
        counts = f"{self['summary']['passed']} of {self['summary']['total']} passed"
        return (
            f'<a href="{html.escape(page.as_uri())}" target="_blank">{html.escape(str(page))}</a>: {counts}'
        )


def run_suite(
    tasks: Sequence[Task],
    folder: Path,
    backend: str = "auto",
    jobs: int = 1,
    on_outcome: Callable[[Outcome, int, int], None] = lambda outcome, done, total: None,
    *,
    shard: tuple[int, int] = (1, 1),
    time_limit: float = TIME_LIMIT,
    cache: Cache | None = None,
    resume: bool = False,
    retry_errors: bool = False,
    cluster: Cluster | None = None,
    gallery: Callable[[Path], Sequence[Mapping[str, str]]] | None = None,
    on_partial: Callable[[Mapping[str, Any]], None] = lambda report: None,
    on_compiled: Callable[[int, int], None] = lambda done, total: None,
) -> Report:
    """Run tasks on backends, write the report into a folder, and return what report.json holds.

    Ended by Ctrl-C or SIGTERM it leaves the report of what it came to, which says that it is partial.

    Args:
        tasks: cases and clouds, each with a name of its own; see `suites`.
        folder: made where it does not exist; an earlier report's files in it are replaced.
        backend: `egl`, `osmesa`, `auto` or `all`.
        jobs: worker processes, each with a GL context of its own.
        on_outcome: called with each outcome as it comes, how many there are, and how many there will be.
        shard: run part i of n of the tasks only; see `merge`.
        time_limit: seconds a case.
        cache: results of earlier runs, whose cases are not rendered again; new ones are added.
        resume: go on from what an earlier run of the same suite left in the folder. Where the machine was at fault
            (`Outcome.fault`), the case is run again.
        retry_errors: the same, and run again what ended in any error.
        cluster: where to run instead of in processes of this machine; `jobs` is its own affair then.
        gallery: draws pictures into the folder, to be shown above the cases: title, caption and image of each.
        on_partial: called with what report.json holds where the run ends before its end.
        on_compiled: as in `run_locally`.

    Raises:
        MrmError: the folder cannot be written, is full, or is another run's; the backends are not there; there
            is nothing that `resume` could go on with.
        KeyboardInterrupt: the run was ended.
    """
    check_backend(backend)
    prepare_folder(folder)
    with ThreadPoolExecutor(1) as pool:
        probing = pool.submit(probe_backends, backend)
        # What is needed next is found out while the driver starts.
        source_digest()
        versions()
        choose_numbas()
        plan = plan_backends(backend, probing.result(), required_backends())
    with _ended_by_signals(), _writing(folder), journal.locked(folder), _scratch(folder) as scratch:
        run = _Run(tasks, folder, plan, shard, cache, on_outcome, elsewhere=cluster is not None)
        run.environment["jobs"] = jobs
        resume = resume or retry_errors
        past = _past(folder, resume)
        kept = run.still_holds(past, retry_errors) if resume and past.header else []
        seconds = {_name(each.record): sum(each.record["seconds"].values()) for each in past.entries}
        with run.recorded(kept, on_partial):
            run.take_from_cache()
            for name, driver in plan.drivers.items():
                start = time.perf_counter()
                place = scratch / name
                place.mkdir()
                waiting = run.waiting(name)

                def expected(task: Task, name: str = name) -> float:
                    return seconds.get(f"{name} {task.name}") or estimate(task)

                judged = (
                    run_on(
                        cluster, waiting, name, place, run.inputs, conditions(driver), time_limit, expected
                    )
                    if cluster
                    else run_locally(waiting, name, place, jobs, time_limit, expected, on_compiled)
                )
                with contextlib.closing(judged):
                    for each in judged:
                        run.accept(each)
                run.environment["backend_seconds"][name] = round(time.perf_counter() - start, 3)
            if gallery is not None:
                run.environment["gallery"] = [dict(picture) for picture in gallery(folder)]
            return run.report()


class _Run:
    """A run's tasks, fixed with all that they depend on, and what came of them so far."""

    def __init__(
        self,
        tasks: Sequence[Task],
        folder: Path,
        plan: Plan,
        shard: tuple[int, int],
        cache: Cache | None,
        on_outcome: Callable[[Outcome, int, int], None],
        elsewhere: bool = False,
    ) -> None:
        self._start = time.perf_counter()
        self._elsewhere = elsewhere
        self._folder, self._plan, self._cache, self._on_outcome = folder, plan, cache, on_outcome
        self.inputs = Inputs()
        self._tasks = shard_of(tasks, shard)
        self._conditions = {name: conditions(driver) for name, driver in plan.drivers.items()}
        arounds = {name: digest_of(each) for name, each in self._conditions.items()}
        setups = {task.name: task.describe() for task in tasks}
        self._keys = {
            f"{name} {task.name}": key(task, name, self.inputs, around, setups[task.name])
            for name, around in arounds.items()
            for task in self._tasks
        }
        self._suite = digest_of([[task.name, task.kind, setups[task.name]] for task in tasks])
        self._shard = shard
        self._records: dict[str, Mapping[str, Any]] = {}
        self._journal: journal.Journal | None = None
        self.environment = {**describe_environment(plan), "backend_seconds": {}}
        if shard != (1, 1):
            self.environment["shard"] = f"{shard[0]}/{shard[1]}"
        if len({task.name for task in tasks}) < len(tasks):
            name, _ = Counter(task.name for task in tasks).most_common(1)[0]
            raise MrmError(f"two cases are called {name}; give each a name of its own")

    def still_holds(self, past: journal.Past, retry_errors: bool = False) -> list[journal.Entry]:
        """The outcomes of an earlier run that this one need not come to again: verdicts, no faults of the machine.

        Warns (MrmWarning) of cases whose files were changed since; they are run again.

        Raises:
            MrmError: it was a run of something else.
        """
        then, now = past.header["conditions"], self._conditions
        for name in now:
            for what, value in now[name].items():
                if then.get(name, {}).get(what) != value:
                    raise MrmError(self._cannot_resume(f"{what} of the {name} backend changed since"))
        keys = past.header["keys"]
        for name in {**self._keys, **keys}:
            if keys.get(name) != self._keys.get(name):
                how = "is new" if name not in keys else "changed" if name in self._keys else "is gone"
                raise MrmError(self._cannot_resume(f"the suite changed since: {name} {how}"))
        known = {_name(each.record): each for each in past.entries if _name(each.record) in self._keys}
        final = [entry for entry in known.values() if not _is_tried_again(entry.record, retry_errors)]
        intact = [entry for entry in final if entry.is_intact(self._folder)]
        if len(intact) < len(final):
            warnings.warn(
                f"{self._folder}: the files of {len(final) - len(intact)} cases were changed or removed; "
                "they are run again",
                MrmWarning,
                stacklevel=2,
            )
        return intact

    def _cannot_resume(self, reason: str) -> str:
        return f"{self._folder}: --resume: {reason}; run without it"

    @contextlib.contextmanager
    def recorded(
        self, kept: Sequence[journal.Entry], on_partial: Callable[[Mapping[str, Any]], None]
    ) -> Iterator[None]:
        """Keep a journal for as long as the block lasts; where it ends in an exception, write a partial report.

        kept: outcomes of an earlier run.
        """
        for name in ("report.json", "index.html"):
            # After a kill, an earlier report would be taken for this run's.
            (self._folder / name).unlink(missing_ok=True)
        header = {
            "suite": self._suite,
            "shard": list(self._shard),
            "conditions": self._conditions,
            "keys": self._keys,
            "environment": self.environment,
        }
        with journal.Journal(self._folder, header, kept) as self._journal:
            try:
                for name, reason in self._plan.skipped.items():
                    for task in self._tasks:
                        skipped = outcome_of(task, name, "skipped", message=reason)
                        self._note(journal.entry_for(skipped, {}))
                for entry in kept:
                    self._show(entry)
                if kept:
                    self.environment["resumed"] = len(kept)
                yield
            except BaseException as error:
                self.environment["partial"] = (
                    "it was interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
                )
                for name in self._plan.drivers:
                    for task in self.waiting(name):
                        outcome = outcome_of(task, name, "skipped", message="not run")
                        self._show(journal.entry_for(outcome, {}), quietly=True)
                with contextlib.suppress(MrmError):
                    on_partial(self.report())
                raise

    def waiting(self, backend: str) -> list[Task]:
        """The tasks that have no outcome on a backend yet."""
        return [task for task in self._tasks if f"{backend} {task.name}" not in self._records]

    def take_from_cache(self) -> None:
        """Note the outcomes that are known from other runs, and write their files."""
        if self._cache is None or self._journal is None:
            return
        found = 0
        for backend in self._plan.drivers:
            for task in self.waiting(backend):
                key = self._keys[f"{backend} {task.name}"]
                known = self._cache.get(key, self._folder, task, backend)
                if known is not None:
                    found += 1
                    entry, line = known
                    self._journal.add_line(line)
                    self._show(entry)
        self.environment["cached"] = found

    def accept(self, judged: Judged) -> None:
        """Take over what a worker came to: its files into the report's folder, its outcome into the journal."""
        outcome = judged.outcome
        changed = self.inputs.changed(judged.task.files())
        if changed:
            outcome = outcome_of(
                judged.task,
                outcome.backend,
                "error",
                message=f"{changed[0]}: changed during the run",
                fault="change",
            )
        elif outcome.fault == "disk" and not self._elsewhere:
            # What failed was removed, and left room for the next to fail.
            raise MrmError(f"{outcome.name}: {outcome.message}; what is done is kept: go on with --resume")
        elif outcome.verdict == "error":
            self._check_room()
        sums = {} if changed else _publish(judged.folder, self._folder)
        if changed:
            shutil.rmtree(judged.folder, ignore_errors=True)
        for text in judged.warnings:
            warnings.warn(text, MrmWarning, stacklevel=2)
        entry = journal.entry_for(outcome, sums)
        self._note(entry)
        if self._cache is not None:
            self._cache.put(self._keys[_name(entry.record)], entry, self._folder)

    def _check_room(self) -> None:
        """See whether a full disk may be at fault, which is no case's error."""
        with tempfile.TemporaryFile(dir=self._folder) as file:
            file.write(bytes(_ROOM))

    def _note(self, entry: journal.Entry) -> None:
        assert self._journal is not None
        self._journal.add_line(entry.line)
        self._show(entry)

    def _show(self, entry: journal.Entry, quietly: bool = False) -> None:
        self._records[_name(entry.record)] = entry.record
        if not quietly:
            total = len(self._tasks) * (len(self._plan.drivers) + len(self._plan.skipped))
            self._on_outcome(entry.outcome, len(self._records), total)

    def report(self) -> Report:
        """Write the report of what there is, and return what report.json holds."""
        if self._cache is not None:
            self._cache.prune()
        seconds = time.perf_counter() - self._start
        return Report(
            self._folder, write_records(self._folder, self.environment, [*self._records.values()], seconds)
        )


def merge(
    parts: Sequence[Path],
    folder: Path,
    partial: bool = False,
    merged: Callable[[], object] = lambda: None,
) -> Report:
    """Make one report of the shards of a run, copying their files, and return what report.json holds.

    Its seconds are those of the shard that took longest. Where shards are missing, it says that it is partial, and
    its environment names them as `missing`.

    Args:
        parts: folders of the shards.
        folder: made where it does not exist.
        partial: whether shards may be missing: the report is then as good as those that are there.
        merged: called after each shard.

    Raises:
        MrmError: a folder has no journal, or they are not shards of one run.
    """
    if folder.resolve() in [part.resolve() for part in parts]:
        raise MrmError(f"{folder}: that is a shard's own folder; choose another with -o")
    for number, part in enumerate(parts):
        if part.resolve() in [other.resolve() for other in parts[:number]]:
            past = journal.read(part)
            shard = (
                ""
                if past is None
                else f"shard {'/'.join(map(str, past.header['shard']))} does not go together with "
            )
            raise MrmError(
                f"{part}: {shard and f'{shard}itself: '}named twice; name the folder of each shard once"
            )
    prepare_folder(folder)
    records: dict[str, Mapping[str, Any]] = {}
    shards: dict[int, Path] = {}
    first: Mapping[str, Any] = {}
    seconds = 0.0
    with _writing(folder), journal.locked(folder):
        for part in parts:
            past = journal.read(part)
            if past is None:
                raise MrmError(f"{part}: no run's journal is there; name the folder of a shard's report")
            number, count = past.header["shard"]
            first = first or past.header
            for what in ("suite", "conditions"):
                if past.header[what] != first[what]:
                    raise MrmError(f"{part}: not a part of the same run as {parts[0]}: its {what} differs")
            if count != first["shard"][1] or number in shards:
                other = shards.get(number, parts[0])
                raise MrmError(f"{part}: shard {number}/{count} does not go together with {other}")
            shards[number] = part
            for entry in past.entries:
                if not entry.is_intact(part):
                    raise MrmError(
                        f"{part}: files of {entry.record['name']} were changed or removed; run it with --resume"
                    )
                for name in entry.sums:
                    # Its names are sound; its folders may be links.
                    if not (part / name).resolve().is_relative_to(part.resolve()):
                        raise MrmError(
                            f"{part}: {name} leads outside of the shard's folder; run the shard again"
                        )
                    target = place_in(folder, name)
                    target.unlink(missing_ok=True)
                    shutil.copyfile(part / name, target)
                records[_name(entry.record)] = entry.record
            undone = {*past.header["keys"]} - {_name(entry.record) for entry in past.entries}
            if undone:
                raise MrmError(f"{part}: {len(undone)} cases are not done; finish it with --resume")
            seconds = max(seconds, _seconds_of(part / "report.json"))
            merged()
        environment = {name: value for name, value in first["environment"].items() if name != "shard"}
        count = first["shard"][1]
        missing = [f"{number}/{count}" for number in range(1, count + 1) if number not in shards]
        if missing:
            environment["partial"] = f"shards are missing: {', '.join(missing)}"
            if not partial:
                environment["missing"] = missing
        try:
            return Report(folder, write_records(folder, environment, [*records.values()], seconds))
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, TemplateError) as error:
            what = f"{type(error).__name__}: {error}"
            raise MrmError(
                f"{folder}: a shard's journal holds what no run writes ({what}); run the shards again"
            ) from None


def _seconds_of(report: Path) -> float:
    """What a run took, by its report.json."""
    try:
        return float(jsontext.loads(read_bytes(report))["summary"]["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        raise MrmError(f"{report}: cannot be read; write it anew with --resume") from None


def describe_environment(plan: Plan) -> dict[str, Any]:
    """Where and with what a run took place."""
    return {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "platform": platform.platform(),
        "processors": os.cpu_count(),
        "backends": dict(plan.drivers),
        "versions": versions(),
    }


def _name(record: Mapping[str, Any]) -> str:
    """What tells an outcome from the others of a run."""
    return f"{record['backend']} {record['name']}"


def _is_tried_again(record: Mapping[str, Any], retry_errors: bool) -> bool:
    """Whether an outcome is none to keep."""
    return record["verdict"] == "error" and bool(retry_errors or record.get("fault"))


def _past(folder: Path, resume: bool) -> journal.Past:
    """What an earlier run left in a folder; damage matters only to one that goes on from there."""
    with warnings.catch_warnings():
        if not resume:
            warnings.simplefilter("ignore", MrmWarning)
        return journal.read(folder) or journal.Past({}, [])


def _publish(source: Path, folder: Path) -> journal.Sums:
    """Move a case's files to their place in the report, and return their checksums.

    Each appears at once, and all of a new folder together. Folders above the files stay, for the next case: file
    systems take their time to remove one.
    """
    sums: journal.Sums = {}
    for place, _, names in os.walk(source, topdown=False):
        if names:
            below = Path(place).relative_to(source).as_posix()
            beside = "" if below == "." else f"{below}/"
            sums |= {f"{beside}{name}": journal.checksum(f"{place}/{name}") for name in sorted(names)}
            _move(Path(place), place_in(folder, below))
    return sums


def _move(source: Path, target: Path) -> None:
    """Put a folder in a place where there may be one already, whose files of the same names it replaces."""
    try:
        source.rename(target)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        for file in source.iterdir():
            file.replace(target / file.name)
        source.rmdir()


@contextlib.contextmanager
def _scratch(folder: Path) -> Iterator[Path]:
    """An empty folder on the report's own file system, for as long as the block lasts."""
    place = folder / _SCRATCH
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turn what a folder or its file system does not allow into one line."""
    try:
        yield
    except OSError as error:
        raise MrmError(
            f"{folder}: cannot be written: {error.strerror or error}; what is done is kept: go on with --resume"
        ) from None


@contextlib.contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Have SIGTERM and SIGHUP end the block as Ctrl-C does."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, end) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
