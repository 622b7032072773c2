"""Who does which task, and when."""

import multiprocessing
import os
from concurrent.futures import Future
from dataclasses import replace
from random import Random
from types import SimpleNamespace

import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.cases.digests import Inputs, conditions, digest_of
from mrm_nodes.regression.run import cluster
from mrm_nodes.regression.run.pool import Queue, estimate, threads
from mrm_nodes.regression.verdict.outcome import as_record, outcome_of


def task(name, structure, seconds):
    return SimpleNamespace(name=name, structure=structure, seconds=seconds)


def queue_of(tasks):
    return Queue(tasks, lambda each: each.seconds)


def taken(queue, worker, workers=("first", "second")):
    return queue.take(worker, workers).name


def test_the_longest_comes_first_and_structures_stay_together():
    tasks = [
        task("b1", "b", 2),
        task("a1", "a", 1),
        task("a2", "a", 3),
        task("b2", "b", 2),
        task("c1", "c", 2),
    ]
    queue = queue_of(tasks)
    assert taken(queue, "first") == "a2"
    assert taken(queue, "second") == "b1"
    # b2 is as long as c1, but another worker has its shader.
    assert taken(queue, "first") == "c1"
    assert taken(queue, "first") == "a1"
    # Nothing else is left.
    assert taken(queue, "first") == "b2"
    assert not queue


def test_a_worker_stays_with_its_structure_among_equals():
    tasks = [
        task("a1", "a", 1),
        task("b0", "b", 2),
        task("b1", "b", 1),
        task("a2", "a", 1),
        task("b2", "b", 1),
    ]
    queue = queue_of(tasks)
    assert [taken(queue, "first") for _ in tasks] == ["b0", "b1", "b2", "a1", "a2"]


def test_what_a_worker_had_that_is_gone_is_anyone_s():
    queue = queue_of([task("a1", "a", 2), task("b1", "b", 1), task("a2", "a", 2)])
    assert taken(queue, "first") == "a1"
    assert taken(queue, "second", ["second", "third"]) == "a2"


class Plainly:
    """The rule of `Queue.take` as it reads: every structure is looked at for each task."""

    def __init__(self, tasks):
        self.waiting, self.had = {}, {}
        for each in sorted(tasks, key=lambda each: -each.seconds):
            self.waiting.setdefault(each.structure, []).append(each)

    def take(self, worker, workers):
        self.had = {each: structures for each, structures in self.had.items() if each in workers}
        own = self.had.setdefault(worker, set())
        others = {each for other in self.had if other != worker for each in self.had[other]}

        def rank(structure):
            is_own = structure in own
            return is_own or structure not in others, self.waiting[structure][0].seconds, is_own

        structure = max(self.waiting, key=rank)
        found = self.waiting[structure].pop(0)
        if not self.waiting[structure]:
            del self.waiting[structure]
        own.add(structure)
        return found


@pytest.mark.parametrize("seed", range(40))
def test_the_order_is_that_of_the_rule_with_any_workers_also_as_some_are_lost(seed):
    random = Random(seed)
    lengths = random.choice((2, 5, 30))
    tasks = [task(str(number), random.randrange(4), random.randrange(lengths)) for number in range(120)]
    workers = list(range(random.randrange(1, 6)))
    queue, plainly = queue_of(tasks), Plainly(tasks)
    for number in range(len(tasks)):
        if random.random() < 0.1:
            workers[random.randrange(len(workers))] = f"instead {number}"
        worker = random.choice(workers)
        assert queue.take(worker, workers) is plainly.take(worker, workers)
    assert not queue


class Seconds(float):
    """Counts how often two are compared: a heap does nothing else."""

    compared = 0

    def __lt__(self, other):
        Seconds.compared += 1
        return float(self) < float(other)

    def __gt__(self, other):
        Seconds.compared += 1
        return float(self) > float(other)

    def __neg__(self):
        return Seconds(-float(self))


class Structure(int):
    """Counts how often one is looked up."""

    looked_up = 0

    def __hash__(self):
        Structure.looked_up += 1
        return int(self)


def test_handing_out_many_tasks_of_many_structures_looks_at_few_for_each():
    count = 4000
    tasks = [task(str(n), Structure(n % (count // 5)), Seconds(n % 7)) for n in range(count)]
    queue = queue_of(tasks)
    Seconds.compared = Structure.looked_up = 0
    for number in range(count):
        queue.take(number % 2, range(2))
    # A heap's height, a few times over.
    assert Seconds.compared < 100 * count
    assert Structure.looked_up < 5 * count


def test_more_points_and_lights_are_expected_to_take_longer():
    image = default_suite()[0]
    larger = replace(image, name="larger", size=(256, 256))
    assert estimate(larger) == 4 * estimate(image)
    assert estimate(Cloud(image.node, configurations=10_000_000)) > estimate(larger)


def test_processes_share_the_processors(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda process: set(range(8)))
    assert threads(2)["NUMBA_NUM_THREADS"] == "4"
    assert threads(16)["LP_NUM_THREADS"] == "1"


class Started:
    """In place of a worker process: its outcome says which process started it."""

    def __init__(self, backend, variables, evaluates):
        self.driver, self.starter, self.alive = "some OpenGL", os.getpid(), True
        self.surroundings = dict(os.environ)

    def is_alive(self):
        return self.alive

    def stop(self):
        self.alive = False

    def give(self, task, folder, time_limit):
        self.task = task

    def wait_for_answer(self):
        return outcome_of(self.task, "egl", "pass", message=str(self.starter)), [], True


@pytest.mark.parametrize("change", ["it ended", "a variable"])
def test_a_process_that_waited_is_used_again_unless_it_ended_or_the_environment_is_another(
    change, monkeypatch, tmp_path
):
    idle = {}
    monkeypatch.setattr(cluster, "WorkerProcess", Started)
    monkeypatch.setattr(cluster, "_idle", idle)
    case = default_suite()[0]

    def used():
        order = cluster.Order(case, "egl", {}, digest_of(conditions("some OpenGL")), 60.0)
        outcome, _ = cluster._judge(order, case, tmp_path)
        assert outcome.verdict == "pass", outcome
        (process,) = idle[os.getpid(), "egl"]
        return process

    first = used()
    assert used() is first
    if change == "it ended":
        first.alive = False
    else:
        monkeypatch.setenv("MATERIALX_SEARCH_PATH", "elsewhere")
    assert used() is not first
    assert not first.alive


def test_a_fork_has_worker_processes_of_its_own(monkeypatch, tmp_path):
    """Those that its parent left waiting answer the parent too: two processes would read one pipe."""
    monkeypatch.setattr(cluster, "WorkerProcess", Started)
    monkeypatch.setattr(cluster, "_idle", {})
    case = default_suite()[0]
    order = cluster.Order(case, "egl", {}, digest_of(conditions("some OpenGL")), 60.0)

    def starter():
        outcome, _ = cluster._judge(order, case, tmp_path)
        return int(outcome.message)

    def tell(pipe):
        pipe.send((os.getpid(), starter()))

    assert starter() == starter() == os.getpid()
    near, far = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=tell, args=(far,))
    child.start()
    itself, its_starter = near.recv()
    child.join()
    assert its_starter == itself != os.getpid()
    assert starter() == os.getpid()


@pytest.mark.parametrize(
    "name", ["../secret", "/tmp/secret", "cases/../../secret", "cases//secret", "cases\\secret", "", "a\0b"]
)
@pytest.mark.parametrize("of", ["a file", "a picture"])
def test_no_file_that_a_worker_sends_leads_outside_of_the_report(name, of, tmp_path):
    """Whoever answers for a cluster's worker chooses the names."""
    case = default_suite()[0]
    answer = Future()
    record = as_record(outcome_of(case, "egl", "pass", files={"render": name} if of == "a picture" else {}))
    harm = {name: b"harm"} if of == "a file" else {}
    answer.set_result(cluster.Result(record, {"cases/render.exr": b"sound", **harm}))
    executor = SimpleNamespace(submit=lambda *arguments: answer)
    scratch = tmp_path / "report" / "scratch"
    scratch.mkdir(parents=True)
    judged = cluster.run_on(cluster.Cluster(executor), [case], "egl", scratch, Inputs(), {}, 60.0)
    with pytest.raises(MrmError, match=r"a worker sent a file .*, which leads outside"):
        next(judged)
    assert {each.name for each in tmp_path.rglob("*")} <= {
        "report",
        "scratch",
        "arrived",
        "cases",
        "render.exr",
    }
