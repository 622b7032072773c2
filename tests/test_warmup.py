"""The evaluator is compiled before anybody waits for it, once, and no case pays for it."""

import importlib
import os
import pkgutil
import sys
import time

import pytest
from numba import config

from mrm_nodes import cli, compiling, reference
from mrm_nodes.reference import compiled, warmup
from mrm_nodes.reference.compiled import Kernel
from mrm_nodes.regression.run import pool as executors
from mrm_nodes.regression.run.pool import Lost, WorkerProcess, run_locally
from mrm_nodes.regression.verdict.outcome import Outcome, needs_evaluator, timed


def double(start, stop, inputs, dense, modes, outputs):
    for i in range(start, stop):
        outputs[0][i] = 2.0 * inputs[0][i, 0]
    return 0


def triple(start, stop, inputs, dense, modes, outputs):
    for i in range(start, stop):
        outputs[0][i] = 3.0 * inputs[0][i, 0]
    return 0


@pytest.fixture
def kernels(monkeypatch, tmp_path):
    """Two small loops in place of the evaluator's, and a cache that is empty."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    made = []
    monkeypatch.setattr(compiled, "KERNELS", made)
    monkeypatch.setattr(warmup, "KERNELS", made)
    for function in (double, triple):
        Kernel(function, 1, 1)
    return made


def kept():
    """What another process would find: which of the two loops."""
    known = list(compiled.KERNELS)
    try:
        return [each.name.split(".")[1] for each in known if Kernel(each._function, 1, 1).is_kept()]
    finally:
        compiled.KERNELS[:] = known


def test_every_loop_of_the_evaluator_is_registered_by_its_import():
    known = list(compiled.KERNELS)
    for module in pkgutil.iter_modules(reference.__path__):
        importlib.import_module(f"mrm_nodes.reference.{module.name}")
    assert known == compiled.KERNELS
    assert len({kernel.name for kernel in known}) == len(known) >= 10


def test_what_is_missing_is_compiled_and_kept_at_once(kernels):
    told = []
    assert kept() == []
    assert warmup.warm_up(lambda name, done, total: told.append((name, done, total, kept())), 1) == 2
    assert told == [
        ("", 0, 2, []),
        ("test_warmup.double", 1, 2, ["double"]),
        ("test_warmup.triple", 2, 2, ["double", "triple"]),
    ]
    assert warmup.warm_up(lambda *_: pytest.fail("nothing is missing")) == 0


def test_what_another_process_compiles_is_left_to_it_and_waited_for_at_the_end(kernels):
    with kernels[0]._dispatcher()[2].alone(wait=True):
        assert not kernels[0].prepare(wait=False)
        told = []

        def note(name, done, total):
            told.append(name)
            if name == "test_warmup.triple":
                raise InterruptedError  # what follows would wait

        with pytest.raises(InterruptedError):
            warmup.warm_up(note, 1)
    assert told == ["", "test_warmup.triple"]
    assert warmup.warm_up(processes=1) == 1


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("damage", [b"", b"no pickle", None])
def test_a_cache_that_is_damaged_is_compiled_anew(kernels, tmp_path, ending, damage):
    warmup.warm_up(processes=1)
    for file in tmp_path.rglob(f"*.{ending}"):
        file.write_bytes(file.read_bytes()[:-100] if damage is None else damage)
    fresh = Kernel(double, 1, 1)
    assert fresh.prepare()
    for file in tmp_path.rglob("*.nbc"):
        file.unlink()
    assert kept() == []


def test_a_cache_that_cannot_be_written_costs_no_result(kernels, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile.save", full)
    assert kernels[0].prepare()
    assert kept() == []


def test_the_command_compiles_and_says_where_it_is_kept(kernels, capsys, monkeypatch):
    monkeypatch.setattr(warmup, "thread_count", lambda: 1)
    for words in ("2 loops compiled", "nothing to compile"):
        with pytest.raises(SystemExit) as ended:
            cli.main(["warmup"])
        said = capsys.readouterr()
        assert not ended.value.code
        assert said.out.startswith(f"{words}: they are kept in {config.CACHE_DIR}")
        assert ("compiling the evaluator" in said.err) == (words == "2 loops compiled")


def test_no_stage_of_a_case_is_charged_with_compiling(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    outcome = Outcome("a", "none", "egl", "pass")
    with timed(outcome, "reference"):
        now[0] += 1.0
        compiling.begin()
        compiling.begin()
        now[0] += 80.0
        compiling.end()
        compiling.end()
        now[0] += 0.5
    assert outcome.seconds["reference"] == 1.5


def test_everything_that_numba_compiles_is_counted():
    """A formula that is called from Python too, which no loop registers."""
    before = compiling.seconds()
    compiled.formula(lambda x: x + 1.0)(2.0)
    assert compiling.seconds() > before


SPEECH = """
import sys, time
from multiprocessing.connection import Connection
from mrm_nodes.regression.run.pool import Compiled, Compiling
connection = Connection(int(sys.argv[1]))
{start}
connection.send("some OpenGL")
while True:
    task, folder = connection.recv()
    {answer}
"""


def speaking(monkeypatch, start="", answer="pass"):
    """Worker processes that say what they are told to."""
    monkeypatch.setattr(WorkerProcess, "_PROGRAM", SPEECH.format(start=start, answer=answer))


class Task:
    name, kind, node, target, structure = "a", "image", "none", "glsl", "none"

    def describe(self):
        return {}


def test_a_clock_stands_still_while_its_worker_compiles(monkeypatch, tmp_path):
    began = "connection.send(Compiling(True, time.monotonic()))"
    ended = "connection.send(Compiling(False, time.monotonic() + 1000.0))"
    speaking(monkeypatch, answer=f"{began}; {ended}; connection.send('done')")
    worker = WorkerProcess("egl", {})
    try:
        worker.driver = worker.wait_for_answer()
        worker.give(None, tmp_path, 60.0)
        assert isinstance(worker.next_message(), executors.Compiling)
        assert worker.seconds_left > 60.0
        assert worker.wait_for_answer() == "done"
        assert 1000.0 < worker.seconds_left < 1060.0
    finally:
        worker.stop()


def test_what_never_ends_compiling_is_given_up(monkeypatch, tmp_path):
    speaking(monkeypatch, answer="connection.send(Compiling(True, time.monotonic() - 1e6))")
    worker = WorkerProcess("egl", {})
    try:
        worker.driver = worker.wait_for_answer()
        worker.give(None, tmp_path, 60.0)
        with pytest.raises(Lost, match="numba has compiled for 1800 s without an end"):
            worker.wait_for_answer()
    finally:
        worker.stop()


def test_the_start_is_announced_as_one_however_many_workers_share_it(monkeypatch, tmp_path):
    say = "[connection.send(Compiled(*each)) for each in [('', 0, 3), ('a', 1, 3), ('b', 2, 3), ('c', 3, 3)]]"
    outcome = (
        "from mrm_nodes.regression.verdict.outcome import Outcome; o = Outcome('a', 'none', 'egl', 'pass')"
    )
    speaking(monkeypatch, say, f"{outcome}; connection.send((o, [], True))")
    # The workers unpickle the task.
    monkeypatch.setattr(sys, "path", [os.path.dirname(__file__), *sys.path])  # noqa: PTH120
    told = []
    judged = list(run_locally([Task()] * 2, "egl", tmp_path, 2, on_compiled=lambda *each: told.append(each)))
    assert len(judged) == 2
    assert {total for _, total in told} == {3}
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1] == (3, 3)


def test_a_run_that_only_compares_images_compiles_no_evaluator(monkeypatch, tmp_path):
    class Stored(Task):
        truth = "baseline"

    assert needs_evaluator(Task())
    assert not needs_evaluator(Stored())
    asked = []

    class Refused(Exception):
        pass

    def refuse(*arguments):
        asked.append(arguments[-1])
        raise Refused

    monkeypatch.setattr(executors, "WorkerProcess", refuse)
    for tasks in ([Stored()], [Stored(), Task()]):
        with pytest.raises(Refused):
            list(run_locally(tasks, "egl", tmp_path))
    assert asked == [False, True]
