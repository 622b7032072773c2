"""A part of the default suite on every backend: cases of several structures, small clouds of each node."""

import itertools
import json

import pytest

from mrm_nodes.regression import material
from mrm_nodes.regression.cases import default_suite
from mrm_nodes.regression.cloud import Cloud
from mrm_nodes.regression.run import run_suite
from mrm_nodes.regression.worker import Worker
from mrm_nodes.render.images import read_image

ONE_OF_EACH = list({case.structure: case for case in default_suite()}.values())
PATTERNS = ("conductor-noise", "dielectric-over", "schlick-checker")
CASES = [case for case in ONE_OF_EACH if not case.patterns or case.name.startswith(PATTERNS)]
CLOUDS = [
    Cloud(node, *pair, configurations=60_000)
    for node, pair in itertools.product(material.NODES, (("ggx", "smith"), ("beckmann", "vcavity")))
]


@pytest.mark.parametrize("task", [*CASES, *CLOUDS], ids=lambda task: task.name)
def test_the_nodes_agree_with_the_evaluator(worker, task, tmp_path):
    outcome = worker.run(task, tmp_path)
    assert outcome.verdict == "pass", f"{outcome.message} {outcome.figures} {outcome.details.get('worst')}"
    assert outcome.figures.lit > 0


def test_a_case_leaves_its_pictures_and_data(worker, tmp_path):
    case = ONE_OF_EACH[0]
    files = worker.run(case, tmp_path).files
    width, height = case.size
    for name in ("render", "reference", "error", "render_data", "reference_data"):
        assert read_image(tmp_path / files[name]).shape[:2] == (height, width)


def test_an_exception_in_a_case_is_its_verdict(worker, tmp_path):
    broken = ONE_OF_EACH[0].__class__("broken", "mrm_conductor_bsdf", mesh="teapot")
    outcome = worker.run(broken, tmp_path)
    assert outcome.verdict == "error"
    assert "teapot" in outcome.message


def test_a_run_in_two_processes_writes_one_report(working_backend, tmp_path):
    tasks = [case for case in default_suite() if case.name.startswith("conductor-figure5")]
    seen = []
    report = run_suite(tasks, tmp_path, working_backend, jobs=2, on_outcome=lambda *each: seen.append(each))
    assert report["summary"]["passed"] == len(tasks) == len(seen)
    assert seen[-1][1:] == (len(tasks), len(tasks))
    assert json.loads((tmp_path / "report.json").read_text()) == report
    page = (tmp_path / "index.html").read_text()
    for case in report["cases"]:
        assert case["files"]["render"] in page
        assert (tmp_path / case["files"]["error"]).is_file()


class Deadly(type(ONE_OF_EACH[0])):
    """A case that kills the process that runs it."""

    @property
    def patterns(self):
        import multiprocessing
        import os

        if multiprocessing.parent_process() is not None:
            os._exit(9)
        return {}

    @patterns.setter
    def patterns(self, value):
        pass


def test_a_worker_that_dies_costs_its_case_only(working_backend, tmp_path):
    good = [case for case in default_suite() if case.name.startswith("conductor-figure5-0")]
    report = run_suite([good[0], Deadly("deadly", "mrm_conductor_bsdf"), good[1]], tmp_path, working_backend)
    assert {case["name"]: case["verdict"] for case in report["cases"]} == {
        "deadly": "error",
        good[0].name: "pass",
        good[1].name: "pass",
    }
    assert report["cases"][0]["message"] == "the worker process died"


def test_shaders_are_shared_by_cases_of_one_structure(working_backend, tmp_path):
    worker = Worker(working_backend)
    same = [case for case in default_suite() if case.structure == ONE_OF_EACH[0].structure][:3]
    seconds = [worker.run(case, tmp_path).seconds for case in same]
    assert seconds[0]["generate"] > 0.001
    assert all(later["generate"] < 0.001 and later["compile"] == 0 for later in seconds[1:])
