"""Environments on the command line, and the bench."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mrm_nodes.bench import shader as bench
from mrm_nodes.cli import cli, main
from mrm_nodes.library import materials_path
from mrm_nodes.regression.truth.material import NODES
from mrm_nodes.render.context import probe_backends
from mrm_nodes.render.images import read_image

MATERIAL = str(materials_path() / "traffic_cone.mtlx")

needs_gl = pytest.mark.skipif(not any(probe.works for probe in probe_backends()), reason="no backend works")


def render(folder: Path, *options: str) -> np.ndarray:
    output = folder / "out.exr"
    arguments = ["render", MATERIAL, "-o", str(output), "--size", "32x32", "--env-samples", "8", *options]
    result = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return read_image(output)


@needs_gl
def test_an_environment_lights_a_material_and_turns(tmp_path):
    sky = render(tmp_path, "--env", "sky")
    assert sky.mean() > 0.01
    turned = render(tmp_path, "--env", "sky", "--env-rotation", "180")
    assert np.abs(turned - sky).max() > 0.01
    # With an environment there is no light but those that are named.
    lit = render(tmp_path, "--env", "sky", "--light", "camera")
    assert (lit - sky).min() > -1e-4
    assert lit.mean() > sky.mean()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--env", "missing.hdr"], "missing.hdr: no such image"),
        (["--env-rotation", "30"], "name an environment"),
        (["--env", "sky", "--env-samples", "0"], "0 samples"),
    ],
)
def test_faults_are_one_line_and_status_2(tmp_path, capsys, options, message):
    output = tmp_path / "folder" / "out.exr"
    with pytest.raises(SystemExit) as stopped:
        main(["render", MATERIAL, "-o", str(output), *options])
    assert stopped.value.code == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert complaint.count("\n") == 1
    assert not output.parent.exists()


@needs_gl
def test_the_bench_measures_every_subject():
    (row,) = bench.bench_shaders(
        size=16,
        rounds=3,
        nodes=NODES[:1],
        lights=["fis"],
        interfaces=["reduced"],
        films=[False],
        instructions=True,
    )
    assert set(row.milliseconds) == set(bench.SUBJECTS)
    assert all(value > 0.0 for value in row.milliseconds.values())
    assert set(row.ratios) == {"mix / single", "0.5 / mix", "0 / single", "1 / single"}
    if row.instructions:
        # One loop for both lobes is smaller than two.
        assert row.instructions["single"] < row.instructions["ours 0.5"] < row.instructions["mix"]
    data = bench.as_json([row], bench.describe_machine())
    assert json.loads(json.dumps(data))["rows"][0]["ratios"]["mix / single"] > 0.0
