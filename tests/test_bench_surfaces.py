"""What `bench shader --surfaces` compares is the same picture, made in two ways."""

from __future__ import annotations

import json
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest
from click.testing import CliRunner

from mrm_nodes.bench import surfaces as bench_surfaces
from mrm_nodes.cli import cli
from mrm_nodes.library import load_library
from mrm_nodes.render import CameraLight, probe_backends, render
from mrm_nodes.surfaces import known_surfaces

pytestmark = [
    pytest.mark.skipif(
        not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
    ),
    pytest.mark.skipif(
        mx.getVersionIntegers() < (1, 39, 5), reason="this MaterialX has no retroreflective BSDFs"
    ),
]


def test_the_mix_of_two_surfaces_is_ours_at_one_half() -> None:
    surface = known_surfaces()["standard_surface"]
    library = load_library()
    bench_surfaces._add_retroreflective(library, surface)
    values = bench_surfaces.LOBES["every"][surface.node]
    mix, half, own = (
        render(
            bench_surfaces._shader(library, surface, values, subject, "direct", "reduced"),
            lights=[CameraLight()],
            size=(32, 32),
        ).image
        for subject in ("mix", "ours 0.5", "own")
    )
    assert np.allclose(mix, half, rtol=1e-4, atol=1e-5)
    assert not np.allclose(mix, own, rtol=0.1)


def test_the_command_prints_a_line_for_each_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    row = bench_surfaces.SurfaceRow(
        "gltf_pbr",
        "default",
        "fis",
        "reduced",
        dict(zip(bench_surfaces.SUBJECTS, (1, 2, 1, 1.5, 1), strict=True)),
    )
    monkeypatch.setattr(bench_surfaces, "bench_surfaces", lambda *arguments: [row])
    path = tmp_path / "bench.json"
    result = CliRunner().invoke(cli, ["bench", "shader", "--surfaces", "-o", str(path)])
    assert result.exit_code == 0, result.output
    assert (
        "gltf_pbr          default fis    reduced       1.00    0.75    1.00    1.50    1.00" in result.output
    )
    (written,) = json.loads(path.read_text())["rows"]
    assert written["ratios"]["0.5 / mix"] == 0.75
