"""kill -9, of the run and of its workers, at random moments: in the end all is as an undisturbed run leaves it.

No baseline is touched by any of it. MRM_FAULTS, of `make faults`, has more kills.
"""

import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from mrm_nodes import cli
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.run import journal
from mrm_nodes.regression.run import runner as run
from mrm_nodes.regression.run.pool import WorkerProcess
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.render.context import probe_backends

KILLS = 25 if os.environ.get("MRM_FAULTS") else 8
"""Of each kind."""
CASES = [
    replace(case, size=(40, 40))
    for case in default_suite()
    if case.environment is None and "-" not in case.material
]


@pytest.fixture(scope="module")
def probes(working_backend):
    """What works here, found out once."""
    return probe_backends()


VELVET = """<materialx version="1.39">
<sheen_bsdf name="b" type="BSDF" />
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="velvet" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""
SUITE = """
[[case]]
material = "velvet.mtlx"
size = 24
[case.matrix]
"input:b/roughness" = [0.2, 0.4, 0.6, 0.8]
"""


@pytest.fixture(scope="module")
def studio(working_backend, tmp_path_factory):
    """A suite whose cases have baselines."""
    folder = tmp_path_factory.mktemp("studio")
    (folder / "velvet.mtlx").write_text(VELVET)
    (folder / "suite.toml").write_text(SUITE)
    names = ["--suite", str(folder / "suite.toml"), "--report", str(folder / "report")]
    run_suite(suites.suite(names[1]), folder / "report", working_backend)
    with pytest.raises(SystemExit, match="0"):
        cli.main(["baseline", "accept", "*", "--reason", "seen", *names])
    return folder


@pytest.fixture(scope="module")
def tasks(studio):
    """Some are compared with physics and some with baselines."""
    return [*suites.suite(str(studio / "suite.toml")), *CASES]


@pytest.fixture(autouse=True)
def no_baseline_is_touched(studio):
    """Neither its contents nor its file."""

    def look():
        files = sorted((studio / "baselines").iterdir())
        return {file.name: (file.read_bytes(), file.stat().st_mtime_ns, file.stat().st_ino) for file in files}

    before = look()
    assert len(before) == 2 * 4 + 1
    yield
    assert look() == before


@pytest.fixture(scope="module")
def undisturbed(working_backend, tasks, tmp_path_factory):
    """The report of a run that nothing happens to."""
    folder = tmp_path_factory.mktemp("undisturbed")
    report = run_suite(tasks, folder, working_backend)
    assert [case["verdict"] for case in report["cases"] if case["truth"] == "baseline"] == ["pass"] * 4
    return report, folder


def is_the_same(report, folder, undisturbed):
    """Every figure and every byte of every file, but for the seconds."""
    expected, there = undisturbed
    by_name = {case["name"]: {**case, "seconds": None} for case in report["cases"]}
    assert by_name == {case["name"]: {**case, "seconds": None} for case in expected["cases"]}
    files = {file.relative_to(there) for file in (there / "cases").rglob("*") if file.is_file()}
    assert files == {file.relative_to(folder) for file in (folder / "cases").rglob("*") if file.is_file()}
    for file in files:
        assert (folder / file).read_bytes() == (there / file).read_bytes(), file
    assert not list(folder.glob(".unfinished"))


def workers_of(process):
    """The worker processes that a process has now."""
    try:
        return [int(child) for child in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
    except OSError:
        return []


def opened(folder):
    """Which file the journal of a run is, and how many lines it has."""
    try:
        with (folder / journal.NAME).open("rb") as file:
            return os.fstat(file.fileno()).st_ino, file.read().count(b"\n")
    except OSError:
        return None, 0


def wait_for_results(process, folder, earlier, more):
    """Wait until a run has opened its journal in place of an earlier one and added so many lines, or has ended."""
    at_first = None
    while process.is_alive():
        file, lines = opened(folder)
        if file != earlier and file is not None:
            at_first = lines if at_first is None else at_first
            if lines >= at_first + more:
                return
        time.sleep(0.005)


def test_a_run_that_is_killed_goes_on_where_it_was(
    working_backend, probes, tasks, undisturbed, tmp_path, monkeypatch
):
    monkeypatch.setattr(run, "probe_backends", lambda *_: probes)
    rng = random.Random(6)
    # Forked, so that the time goes into runs and not into imports; workers are programs of their own.
    fork = multiprocessing.get_context("fork")
    folder = tmp_path / "0"
    done, finished = 0, 0
    for number in range(KILLS):
        arguments = {"jobs": 1 + number % 2, "resume": True}
        process = fork.Process(target=run_suite, args=(tasks, folder, working_backend), kwargs=arguments)
        earlier, _ = opened(folder)
        process.start()
        if number % 4 == 3:
            process.join(rng.uniform(0.0, 3.0))
        else:
            # What a run has, it writes anew as it begins: it is killed then, or soon after.
            wait_for_results(process, folder, earlier, (0, 1, 3)[number % 4])
            process.join(rng.uniform(0.0, 0.3))
        process.kill()
        process.join()
        if process.exitcode == 0:
            # It was too quick: the next one starts anew.
            is_the_same(json.loads((folder / "report.json").read_text()), folder, undisturbed)
            finished += 1
            folder, done = tmp_path / str(finished), 0
            continue
        past = journal.read(folder)
        count = len(past.entries) if past else 0
        assert count >= done, "a result was lost"
        done = count
    report = run_suite(tasks, folder, working_backend, 2, resume=True)
    is_the_same(report, folder, undisturbed)


def test_a_run_whose_workers_are_killed_ends_as_if_nothing_was(
    working_backend, probes, tasks, undisturbed, tmp_path, monkeypatch
):
    monkeypatch.setattr(run, "probe_backends", lambda *_: probes)
    rng = random.Random(7)
    over, lock = threading.Event(), threading.Lock()
    at, hit, dead, rounds = {}, set(), [], 0
    give = WorkerProcess.give

    def give_and_note(worker, task, *others):
        with lock:
            at[worker.pid] = task.name
            if worker.pid in dead:
                hit.add(task.name)
            give(worker, task, *others)

    def kill_now_and_then():
        while not over.wait(rng.uniform(0.1, 1.0)):
            with lock:
                # A case that loses two workers is an error, as it should be; so is a run whose workers never start.
                allowed = [
                    worker
                    for worker in workers_of(os.getpid())
                    if worker not in dead
                    and (at[worker] not in hit if worker in at else dead and dead[-1] in at)
                ]
                if allowed and len(dead) < KILLS:
                    dead.append(rng.choice(allowed))
                    hit.add(at.get(dead[-1]))
                    os.kill(dead[-1], signal.SIGKILL)

    monkeypatch.setattr(WorkerProcess, "give", give_and_note)
    killer = threading.Thread(target=kill_now_and_then)
    killer.start()
    try:
        while len(dead) < KILLS:
            rounds += 1
            report = run_suite(tasks, tmp_path / str(rounds), working_backend, 2)
            is_the_same(report, tmp_path / str(rounds), undisturbed)
    finally:
        over.set()
        killer.join()


@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_command_that_is_ended_leaves_what_it_came_to(working_backend, tmp_path, signal_):
    """With Ctrl-C or SIGTERM as a partial report in every form; after kill -9 as what --resume goes on from."""
    folder, junit, copy = tmp_path / "report", tmp_path / "junit.xml", tmp_path / "copy.json"
    folder.mkdir()
    for earlier in (folder / "report.json", junit, copy):
        earlier.write_text("of an earlier run")
    command = [sys.executable, "-m", "mrm_nodes", "regress", "-o", folder, "--junit", junit, "--json", copy]
    command += ["--no-cache", "--backend", working_backend, "--filter", "conductor-ggx"]
    path = os.pathsep.join(path for path in sys.path if path)
    with subprocess.Popen(command, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path}) as process:
        while not (past := journal.read(folder)) or not past.entries:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal_)
        _, complaint = process.communicate()
    done = journal.read(folder).entries
    assert done and all(entry.is_intact(folder) for entry in done)
    if signal_ == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert not [file for file in (folder / "report.json", junit, copy) if file.exists()]
        return
    assert process.returncode == 130
    assert b"interrupted; what was done is in" in complaint
    assert b"Traceback" not in complaint
    report = json.loads((folder / "report.json").read_text())
    assert json.loads(copy.read_text()) == report
    assert report["environment"]["partial"] == "it was interrupted"
    summary = report["summary"]
    assert summary["passed"] == len(done)
    assert summary["passed"] + summary["skipped"] == summary["total"]
    assert (folder / "index.html").exists()
    (suite,) = ET.parse(junit).getroot()
    assert {name: int(suite.get(name)) for name in ("tests", "skipped", "failures", "errors")} == {
        "tests": summary["total"],
        "skipped": summary["skipped"],
        "failures": 0,
        "errors": 0,
    }
    assert suite.find("properties/property[@name='partial']").get("value") == "it was interrupted"
