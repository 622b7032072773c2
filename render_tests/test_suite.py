"""A few cases of the default suite on every backend, of several structures, and a small cloud of each node.

`make regress` draws all of them.
"""

import dataclasses
import json
import re

import pytest

from mrm_nodes.regression.cases import workshop
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.truth import material
from mrm_nodes.render.images import read_image
from mrm_nodes.shadergen import generate_shader

FIRST = default_suite()[0]
CHOSEN = (
    "conductor-noise",
    "dielectric-over-diffuse-retro0.5",
    "schlick-checker",
    "conductor-in-sky-retro0.5",
    "conductor-in-sky-prefilter-retro0.5",
    "schlick-in-sky-and-lights",
    "dielectric-over-diffuse-in",
    "schlick-mirror",
)
CASES = [case for case in default_suite() if case.name.startswith(CHOSEN)]
CLOUDS = [Cloud(node, "ggx", "smith", configurations=60_000) for node in material.NODES]


@pytest.mark.parametrize("task", [*CASES, *CLOUDS], ids=lambda task: task.name)
def test_the_nodes_agree_with_the_evaluator(worker, task, tmp_path):
    outcome = worker.run(task, tmp_path)
    assert outcome.verdict == "pass", f"{outcome.message} {outcome.figures} {outcome.details.get('worst')}"
    assert outcome.figures.lit > 0


def test_a_case_leaves_its_pictures_and_data(worker, tmp_path):
    case = FIRST
    files = worker.run(case, tmp_path).files
    width, height = case.size
    for name in ("render", "reference", "error", "render_data", "reference_data"):
        assert read_image(tmp_path / files[name]).shape[:2] == (height, width)


def test_an_exception_in_a_case_is_its_verdict(worker, tmp_path):
    broken = dataclasses.replace(FIRST, name="broken", mesh="teapot")
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


def test_shaders_are_shared_by_cases_of_one_structure(working_backend, tmp_path, monkeypatch):
    worker, generated = Worker(working_backend), []

    def generate(document, **options):
        generated.append(options["element"])
        return generate_shader(document, **options)

    monkeypatch.setattr(workshop, "generate_shader", generate)
    same = [case for case in default_suite() if case.structure == FIRST.structure][:3]
    seconds = [worker.run(case, tmp_path).seconds for case in same]
    assert generated == ["mrm_conductor_bsdf"]
    assert all(later["compile"] == 0 for later in seconds[1:])


FAULTS = {
    "black": (r"response = Li \* compensation", "response = vec3(0.0)", "conductor-in-sky-retro0.5"),
    "a thousandth brighter": (
        r"response = Li \* compensation",
        "response = Li * compensation * 1.001",
        "schlick-in-sky-retro1",
    ),
    "no compensation": (r"Li \* compensation", "Li", "conductor-in-white-retro0.5"),
    "one sample fewer": (r"int count = (\w+);", r"int count = \1 - 1;", "dielectric-in-sky-retro0.5"),
    "a tenth of a mip level": (
        "MIP_LEVEL_OFFSET = 1.5",
        "MIP_LEVEL_OFFSET = 1.6",
        "conductor-in-studio-retro0.5",
    ),
    "the level of another density": (
        r"sampled \* perNormal",
        "sampled * perNormal / G1",
        "schlick-in-studio-retro0",
    ),
    "the map mirrored": (
        r"mx_atan\(dir.x, -dir.z\)",
        "mx_atan(-dir.x, -dir.z)",
        "conductor-in-sky-prefilter-retro0.5",
    ),
    "the lobes' shares exchanged": (
        r"float retro = clamp\(retroreflectivity, 0.0, 1.0\)",
        "float retro = 1.0 - clamp(retroreflectivity, 0.0, 1.0)",
        "dielectric-in-sky-retro0",
    ),
    "the retro look-up on the forward side": ("up - across", "up + across", "conductor-mirror-in-sky"),
    "samples weighed without their masking": (
        r"G1 \* float\(count\)",
        "float(count)",
        "dielectric-in-white-retro0",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_image_light_fails(working_backend, tmp_path, fault):
    pattern, replacement, name = FAULTS[fault]

    def edit(shader):
        text, count = re.subn(pattern, replacement, shader.pixel)
        assert count, f"the generated GLSL no longer has {pattern}: plant {fault} anew"
        return dataclasses.replace(shader, pixel=text)

    (case,) = (case for case in default_suite() if case.name == name)
    outcome = Worker(working_backend, edit).run(dataclasses.replace(case, size=(24, 24)), tmp_path)
    assert outcome.verdict == "fail", outcome
