"""A task that kills, hangs or spoils its worker costs itself and nothing else."""

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import pytest
from nasty import DEEDS, Nasty

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.run.cluster import Cluster
from mrm_nodes.regression.run.pool import WorkerProcess
from mrm_nodes.regression.run.runner import run_suite

LIMIT = 6.0
FAULTS = {"die": "worker", "hang": "time", "exhaust memory": "memory", "lose context": "opengl"}
"""What of the machine is at fault."""
GOOD = [Nasty(f"good-{number}") for number in range(4)]
REASONS = {
    "die": "the worker process died (signal 9), twice",
    "hang": f"no result within the time limit of {LIMIT:g} s, twice",
    "exhaust memory": "needs more memory than the",
    "lose context": "the context is lost, twice",
    "raise": "RuntimeError: a fault of the case's own",
}


def verdicts(report):
    return {case["name"]: case["verdict"] for case in report["cases"]}


def test_what_harms_a_worker_costs_its_case_and_no_other(working_backend, tmp_path):
    bad = [Nasty(deed, deed) for deed in DEEDS]
    tasks = [*GOOD[:2], *bad, *GOOD[2:]]
    report = run_suite(tasks, tmp_path, working_backend, 2, time_limit=LIMIT)
    found = {case["name"]: case for case in report["cases"]}
    assert {name: case["verdict"] for name, case in found.items()} == {
        **{task.name: "pass" for task in GOOD},
        **{task.name: "error" for task in bad},
    }
    for deed, reason in REASONS.items():
        assert reason in found[deed]["message"]
        assert found[deed].get("fault") == FAULTS.get(deed)
    assert json.loads((tmp_path / "report.json").read_text()) == report


@pytest.mark.parametrize("place", ["workers of its own", "an executor's workers"])
def test_a_case_is_not_charged_with_what_numba_compiles_in_it(working_backend, tmp_path, place):
    with ThreadPoolExecutor(1) as executor:
        cluster = Cluster(executor) if place == "an executor's workers" else None
        report = run_suite(
            [Nasty("first", "compile")], tmp_path, working_backend, time_limit=LIMIT, cluster=cluster
        )
    assert verdicts(report) == {"first": "pass"}


def test_what_harms_a_worker_once_is_tried_again_elsewhere(working_backend, tmp_path):
    tasks = [Nasty(deed, deed, tmp_path / f"done {deed}") for deed in DEEDS if deed != "raise"]
    report = run_suite([*tasks, *GOOD], tmp_path / "report", working_backend, 2, time_limit=LIMIT)
    assert set(verdicts(report).values()) == {"pass"}
    for task in tasks:
        assert task.marker.exists()
        assert (tmp_path / "report" / "cases" / task.name / "read.txt").read_text() == task.name


def test_an_executors_workers_survive_the_same(working_backend, tmp_path):
    """Any executor of concurrent.futures: its workers keep processes of their own."""
    bad = [Nasty("die", "die"), Nasty("once", "die", tmp_path / "done")]
    with ProcessPoolExecutor(2) as executor:
        report = run_suite(
            [*bad, *GOOD], tmp_path / "report", working_backend, time_limit=60.0, cluster=Cluster(executor)
        )
    assert verdicts(report) == {"die": "error", "once": "pass", **{task.name: "pass" for task in GOOD}}
    assert "signal 9" in report["cases"][0]["message"]
    assert report["cases"][0]["fault"] == "worker"


@pytest.mark.parametrize("place", ["workers of its own", "an executor's workers"])
def test_what_workers_warn_of_is_said_here_and_once(working_backend, tmp_path, capfd, place):
    text = f"{tmp_path}: the mesh has no normals; made some"
    tasks = [Nasty(f"{number}", warning=text) for number in range(4)]
    with ThreadPoolExecutor(2) as executor, warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("once", MrmWarning)
        cluster = Cluster(executor) if place == "an executor's workers" else None
        run_suite(tasks, tmp_path / "report", working_backend, 2, cluster=cluster)
    assert [(str(each.message), each.category) for each in heard] == [(text, MrmWarning)]
    assert "Warning" not in capfd.readouterr().err


def test_a_worker_process_ends_with_the_one_that_started_it(working_backend):
    """Even in the midst of a draw that never ends."""
    program = (
        "import pathlib, sys, time; from nasty import Nasty;"
        "from mrm_nodes.regression.run.pool import WorkerProcess;"
        f"worker = WorkerProcess({working_backend!r}, {{}}); worker.wait_for_answer();"
        "worker.give(Nasty('hang', 'hang'), pathlib.Path(), 100.0); time.sleep(0.5);"
        "print(worker.pid, flush=True); time.sleep(100)"
    )
    path = os.pathsep.join(path for path in sys.path if path)
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path}
    ) as parent:
        child = int(parent.stdout.readline())
        os.kill(child, 0)
        parent.kill()
    for _ in range(100):
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            return
        time.sleep(0.05)
    os.kill(child, signal.SIGKILL)
    pytest.fail("the worker process outlived its parent")


def test_a_backend_that_is_not_there_is_said_once(tmp_path, monkeypatch):
    """Worker processes that cannot start end the run with one line."""
    monkeypatch.setattr(WorkerProcess, "_PROGRAM", "raise SystemExit(3)")
    with pytest.raises(MrmError, match=r"do not start.*exit status 3.*doctor"):
        run_suite(GOOD, tmp_path)


def test_a_file_that_is_edited_during_the_run_is_an_error_of_its_cases(working_backend, tmp_path):
    edited, kept = tmp_path / "edited.mtlx", tmp_path / "kept.mtlx"
    edited.write_text("before ")
    kept.write_text("kept ")
    tasks = [
        Nasty("editor", file=edited, edits=True),
        Nasty("later", file=edited),
        Nasty("other", file=kept),
    ]
    report = run_suite(tasks, tmp_path / "report", working_backend)
    assert verdicts(report) == {"editor": "error", "later": "error", "other": "pass"}
    assert report["cases"][0]["message"] == f"{edited}: changed during the run"
    assert (tmp_path / "report" / "cases" / "other" / "read.txt").read_text() == "kept other"
