"""kill -9, of the run and of its workers, at random moments: in the end all is as an undisturbed run leaves it."""

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

import pytest

from mrm_nodes.regression import journal, run
from mrm_nodes.regression.cases import default_suite
from mrm_nodes.regression.executors import WorkerProcess
from mrm_nodes.regression.run import run_suite
from mrm_nodes.render.context import probe_backends

KILLS = 25
"""Of each kind."""
CASES = [
    replace(case, size=(40, 40))
    for case in default_suite()
    if case.environment is None and not case.patterns and not case.base
]


@pytest.fixture(scope="module")
def probes(working_backend):
    """What works here, found out once."""
    return probe_backends()


@pytest.fixture(scope="module")
def undisturbed(working_backend, tmp_path_factory):
    """The report of a run that nothing happens to."""
    folder = tmp_path_factory.mktemp("undisturbed")
    return run_suite(CASES, folder, working_backend), folder


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


def test_a_run_that_is_killed_goes_on_where_it_was(
    working_backend, probes, undisturbed, tmp_path, monkeypatch
):
    monkeypatch.setattr(run, "probe_backends", lambda *_: probes)
    rng = random.Random(6)
    # Forked, so that the time goes into runs and not into imports; workers are programs of their own.
    fork = multiprocessing.get_context("fork")
    folder = tmp_path / "0"
    done, finished = 0, 0
    for number in range(KILLS):
        arguments = {"jobs": 1 + number % 2, "resume": True}
        process = fork.Process(target=run_suite, args=(CASES, folder, working_backend), kwargs=arguments)
        process.start()
        process.join(rng.uniform(0.0, 5.0))
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
    report = run_suite(CASES, folder, working_backend, 2, resume=True)
    is_the_same(report, folder, undisturbed)


def test_a_run_whose_workers_are_killed_ends_as_if_nothing_was(
    working_backend, probes, undisturbed, tmp_path, monkeypatch
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
            report = run_suite(CASES, tmp_path / str(rounds), working_backend, 2)
            is_the_same(report, tmp_path / str(rounds), undisturbed)
    finally:
        over.set()
        killer.join()


@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM])
def test_the_command_ends_with_130_and_a_partial_report(working_backend, tmp_path, signal_):
    command = [sys.executable, "-m", "mrm_nodes", "regress", "-o", tmp_path / "report", "--no-cache"]
    command += ["--backend", working_backend, "--filter", "conductor-ggx"]
    path = os.pathsep.join(path for path in sys.path if path)
    with subprocess.Popen(command, stderr=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path}) as process:
        while not (past := journal.read(tmp_path / "report")) or not past.entries:
            assert process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal_)
        _, complaint = process.communicate()
    assert process.returncode == 130
    assert b"interrupted; what was done is in" in complaint
    assert b"Traceback" not in complaint
    report = json.loads((tmp_path / "report" / "report.json").read_text())
    assert report["environment"]["partial"] == "it was interrupted"
    assert report["summary"]["passed"] >= 1
    assert report["summary"]["passed"] + report["summary"]["skipped"] == report["summary"]["total"]
    assert (tmp_path / "report" / "index.html").exists()
