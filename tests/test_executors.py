"""Who does which task, and when."""

import multiprocessing
import os
from types import SimpleNamespace

from mrm_nodes.regression import cluster
from mrm_nodes.regression.cases import default_suite
from mrm_nodes.regression.cloud import Cloud
from mrm_nodes.regression.executors import Queue, estimate, threads
from mrm_nodes.regression.inputs import conditions, digest_of
from mrm_nodes.regression.outcome import outcome_of


def task(name, structure, seconds):
    return SimpleNamespace(name=name, structure=structure, seconds=seconds)


def taken(queue, own, others):
    return queue.take(own, others).name


def test_the_longest_comes_first_and_structures_stay_together():
    tasks = [
        task("b1", "b", 2),
        task("a1", "a", 1),
        task("a2", "a", 3),
        task("b2", "b", 2),
        task("c1", "c", 2),
    ]
    queue = Queue(tasks, lambda each: each.seconds)
    mine, other = set(), set()
    assert taken(queue, mine, other) == "a2"
    assert taken(queue, other, mine) == "b1"
    assert mine == {"a"}
    # b2 is as long as c1, but another worker has its shader.
    assert taken(queue, mine, other) == "c1"
    assert taken(queue, mine, other) == "a1"
    # Nothing else is left.
    assert taken(queue, mine, other) == "b2"
    assert not queue


def test_a_worker_stays_with_its_structure_among_equals():
    tasks = [task("a1", "a", 1), task("b1", "b", 1), task("a2", "a", 1), task("b2", "b", 1)]
    queue = Queue(tasks, lambda each: each.seconds)
    own = {"b"}
    assert [taken(queue, own, set()) for _ in tasks] == ["b1", "b2", "a1", "a2"]


def test_many_tasks_are_handed_out_quickly():
    """Each hand-out looks at the structures, not at all tasks: 50,000 would take minutes otherwise."""
    tasks = [task(str(number), number % 10, number % 7) for number in range(50_000)]
    queue = Queue(tasks, lambda each: each.seconds)
    own = set()
    assert sorted(taken(queue, own, set()) for _ in tasks) == sorted(each.name for each in tasks)


def test_more_points_and_lights_are_expected_to_take_longer():
    image = default_suite()[0]
    larger = type(image)("larger", image.node, size=(256, 256))
    assert estimate(larger) == 4 * estimate(image)
    assert estimate(Cloud(image.node, configurations=10_000_000)) > estimate(larger)


def test_processes_share_the_processors(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda process: set(range(8)))
    assert threads(2)["NUMBA_NUM_THREADS"] == "4"
    assert threads(16)["LP_NUM_THREADS"] == "1"


class Started:
    """In place of a worker process: its outcome says which process started it."""

    def __init__(self, backend, variables, evaluates):
        self.driver, self.starter = "some OpenGL", os.getpid()

    def give(self, task, folder, time_limit):
        self.task = task

    def wait_for_answer(self):
        return outcome_of(self.task, "egl", "pass", message=str(self.starter)), [], True


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
