"""A wrong shader makes the suite fail: faults are planted in the generated GLSL."""

import dataclasses
import json
import re

import pytest

from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.run.pool import Judged
from mrm_nodes.regression.run.worker import Worker

FAULTS = {
    "a sign flipped in the back-vector": (r"vec3 D = L - V;", "vec3 D = L + V;"),
    "alpha squared once too often": (
        r"clamp\(roughness, M_FLOAT_EPS",
        "clamp(roughness * roughness, M_FLOAT_EPS",
    ),
    "a forgotten 1/4": (r"4\.0 \* NdotV", "NdotV"),
}
NAMES = ("ggx-smith-a0.25-retro", "beckmann-vcavity-a0.05", "figure5", "camera-light")
CASES = [case for case in default_suite() if any(name in case.name for name in NAMES)]


def planted(fault):
    pattern, replacement = FAULTS[fault]

    def edit(shader):
        if "mrm_reflection" not in shader.pixel:
            return shader  # of a pattern, without our node
        text, count = re.subn(pattern, replacement, shader.pixel)
        assert count, f"the generated GLSL no longer has {pattern}: plant {fault} anew"
        return dataclasses.replace(shader, pixel=text)

    return edit


@pytest.fixture(scope="module", params=FAULTS)
def outcomes(request, working_backend, tmp_path_factory):
    """The cases with one fault planted."""
    worker = Worker(working_backend, planted(request.param))
    folder = tmp_path_factory.mktemp("faults")
    cloud = Cloud("mrm_conductor_bsdf", configurations=4000)
    return request.param, {task.name: worker.run(task, folder) for task in [*CASES, cloud]}


def test_the_suite_fails(outcomes):
    fault, found = outcomes
    assert not [outcome.message for outcome in found.values() if outcome.verdict == "error"]
    failed = [name for name, outcome in found.items() if outcome.verdict == "fail"]
    assert len(failed) >= len(CASES) / 3, f"{fault}: only {failed}"
    assert any(name.startswith("cloud-") for name in failed)


def test_every_node_is_caught(outcomes):
    _, found = outcomes
    assert {outcome.node for outcome in found.values() if outcome.verdict == "fail"} == {
        c.node for c in CASES
    }


def test_the_command_line_says_so_with_its_status(working_backend, tmp_path, monkeypatch, capsys):
    """End to end: the command ends with status 1, and the report names the case."""
    from mrm_nodes import cli
    from mrm_nodes.regression.run import runner as run

    fault = planted("a forgotten 1/4")
    monkeypatch.setattr(run, "run_locally", lambda tasks, backend, scratch, *others: (
        Judged(task, Worker(backend, fault).run(task, scratch), scratch) for task in tasks))  # fmt: skip
    arguments = [
        "regress",
        "-o",
        str(tmp_path),
        "--backend",
        working_backend,
        "--filter",
        "figure5-0deg-retro1",
        "--no-cache",
    ]
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 1
    case = json.loads((tmp_path / "report.json").read_text())["cases"][0]
    assert case["verdict"] == "fail"
    assert case["max_rel"] == pytest.approx(3.0, rel=1e-3)
    assert "1 failed" in capsys.readouterr().out
