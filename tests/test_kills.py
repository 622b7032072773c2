"""Runs that are killed, stopped and crashed at any moment: --resume makes the report of one that was left alone.

MRM_FAULTS=200 harms so many; MRM_FAULTS_SEED chooses other moments.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest
from faulty_disk import contents, without_time

from mrm_nodes.regression.run.runner import required_backends
from mrm_nodes.render.context import probe_backends

COUNT = int(os.environ.get("MRM_FAULTS", "1"))
IN_ONE = 2
"""Harms to a run, one after another, each to the resumption of what the one before left."""
SEED = int(os.environ.get("MRM_FAULTS_SEED", "1"))

TAPE = """<materialx version="1.39">
  <mrm_conductor_bsdf name="tape" type="BSDF"/>
  <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="tape"/></surface>
  <surfacematerial name="material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface"/></surfacematerial>
</materialx>
"""
SUITE = """
[[case]]
material = "tape.mtlx"
size = 16
[case.matrix]
"input:tape/retroreflectivity" = [0, 0.25, 0.5]
mesh = ["sphere", "plane"]
"""


@pytest.fixture(scope="module")
def backend() -> str:
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working and required_backends():
        pytest.fail("no backend works")
    return working[0] if working else pytest.skip("no backend works")


def command(folder: Path, backend: str, *more: str) -> list[str]:
    return [
        sys.executable, "-m", "mrm_nodes", "regress", "--suite", str(folder / "suite.toml"), "--jobs", "2",
        "--backend", backend, "-o", str(folder / "report"), "--cache", str(folder / "cache"), *more
    ]  # fmt: skip


def write_suite(folder: Path) -> None:
    folder.mkdir()
    (folder / "suite.toml").write_text(SUITE)
    (folder / "tape.mtlx").write_text(TAPE)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, backend: str) -> tuple[object, float]:
    """The report of a run that was left alone, and how long it took."""
    folder = tmp_path_factory.mktemp("whole") / "run"
    write_suite(folder)
    start = time.monotonic()
    subprocess.run(command(folder, backend), check=True, capture_output=True)
    return results(folder / "report"), time.monotonic() - start


def results(report: Path) -> object:
    pictures = {name: data for name, data in contents(report).items() if name.startswith("cases/")}
    assert pictures
    return without_time(report / "report.json"), pictures


MARK = "MRM_TEST_RUN"
"""An environment variable that every process of a run inherits, by which orphans are found."""


def processes(mark: str) -> list[int]:
    """The processes of a run that live, the run itself first."""
    found = []
    for place in Path("/proc").iterdir():
        if place.name.isdigit():
            with contextlib.suppress(OSError):
                state = (place / "stat").read_text().rpartition(")")[2].split()[0]
                if state != "Z" and f"{MARK}={mark}".encode() in (place / "environ").read_bytes().split(
                    b"\0"
                ):
                    found.append(int(place.name))
    return sorted(found)


def is_worker(process: int) -> bool:
    with contextlib.suppress(OSError):
        return b"regression.worker" in Path(f"/proc/{process}/cmdline").read_bytes()
    return False


@contextlib.contextmanager
def running(folder: Path, backend: str, *more: str) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    mark = str(folder)
    run = subprocess.Popen(
        command(folder, backend, *more),
        env={**os.environ, MARK: mark},
        stdout=subprocess.DEVNULL,
        stderr=(folder / "stderr").open("wb"),
    )
    try:
        yield run, mark
    finally:
        run.kill()
        run.wait()
        for each in processes(mark):
            with contextlib.suppress(OSError):
                os.kill(each, signal.SIGKILL)


def send(process: int, number: int) -> None:
    with contextlib.suppress(OSError):
        os.kill(process, number)


def harm_parent(random: Random, run: int, workers: list[int]) -> bool:
    send(run, signal.SIGKILL)
    return True


def end_parent(random: Random, run: int, workers: list[int]) -> bool:
    send(run, random.choice([signal.SIGTERM, signal.SIGINT, signal.SIGHUP]))
    return True


def kill_everything(random: Random, run: int, workers: list[int]) -> bool:
    for each in random.sample([run, *workers], 1 + len(workers)):
        send(each, signal.SIGKILL)
    return True


def kill_a_worker(random: Random, run: int, workers: list[int]) -> bool:
    if workers:
        send(random.choice(workers), signal.SIGKILL)
    return False


def crash_a_thread(random: Random, run: int, workers: list[int]) -> bool:
    """A fault of OpenGL's in one of its threads."""
    if workers:
        worker = random.choice(workers)
        with contextlib.suppress(OSError):
            thread = int(random.choice([each.name for each in Path(f"/proc/{worker}/task").iterdir()]))
            send(thread, random.choice([signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGFPE]))
    return False


def stop_a_worker(random: Random, run: int, workers: list[int]) -> bool:
    """It stays stopped: the time limit has to end it."""
    if workers:
        send(random.choice(workers), signal.SIGSTOP)
    return False


def stop_for_a_while(random: Random, run: int, workers: list[int]) -> bool:
    """The parent alone, or the whole machine as it sleeps, for longer than a case may take."""
    stopped = random.choice([[run], [run, *workers], workers])
    for each in stopped:
        send(each, signal.SIGSTOP)
    time.sleep(random.choice([0.5, LIMIT + 1]))
    for each in stopped:
        send(each, signal.SIGCONT)
    return False


LIMIT = 4
HARM = [
    harm_parent, end_parent, kill_everything, kill_a_worker, crash_a_thread, stop_a_worker, stop_for_a_while
]  # fmt: skip


def wait_for_orphans(mark: str) -> None:
    end = time.monotonic() + 20
    while left := processes(mark):
        assert time.monotonic() < end, [Path(f"/proc/{each}/cmdline").read_bytes() for each in left]
        time.sleep(0.02)


@pytest.fixture(scope="module")
def earlier(tmp_path_factory: pytest.TempPathFactory, backend: str) -> Path:
    """The report of an earlier run, of some of the cases."""
    folder = tmp_path_factory.mktemp("earlier") / "run"
    write_suite(folder)
    (folder / "suite.toml").write_text(SUITE.replace(", 0.25", ""))
    subprocess.run(command(folder, backend), check=True, capture_output=True)
    return folder / "report"


@pytest.mark.parametrize("number", range(-(-COUNT // IN_ONE)))
def test_a_run_that_was_harmed_is_whole_after_resume(
    tmp_path: Path,
    backend: str,
    whole: tuple[object, float],
    number: int,
    request: pytest.FixtureRequest,
):
    random = Random(f"{SEED} {number}")
    expected, seconds = whole
    folder = tmp_path / "run"
    write_suite(folder)
    if number % 3 == 1:
        shutil.copytree(request.getfixturevalue("earlier"), folder / "report")
    harms = []
    resume: list[str] = []
    for _ in range(min(IN_ONE, COUNT)):
        harm = random.choice(HARM)
        at = random.uniform(0.0, 1.2 * seconds)
        harms.append(f"{harm.__name__} at {at:.2f} s of {seconds:.2f}")
        with running(folder, backend, "--time-limit", str(LIMIT), *resume) as (run, mark):
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.wait(at)
            ends = harm(random, run.pid, [each for each in processes(mark) if is_worker(each)])
            status = run.wait(120)
            wait_for_orphans(mark)
            told = (folder / "stderr").read_text()
            assert "Traceback" not in told, (harms, told)
            assert ends or status in (0, 1, 2), (harms, told)
        if (folder / "report" / "journal").exists():
            resume = ["--resume"]
    ended = subprocess.run(command(folder, backend, "--resume"), capture_output=True, text=True)
    if "run without it" in ended.stderr:  # it was ended before the earlier run's journal was replaced
        ended = subprocess.run(command(folder, backend), capture_output=True, text=True)
    assert ended.returncode == 0, (harms, ended.stderr)
    assert results(folder / "report") == expected, harms
    assert {name.name for name in (folder / "report").iterdir()} == {
        ".lock", "cases", "index.html", "journal", "report.json"
    }  # fmt: skip
    if number % 3 == 2:  # what the cache was left with is sound too
        shutil.rmtree(folder / "report")
        subprocess.run(command(folder, backend), check=True, capture_output=True)
        assert results(folder / "report") == expected, harms
