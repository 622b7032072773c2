"""What a notebook shows of a render, a lobe and a report."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mrm_nodes
from mrm_nodes import reference as ref
from mrm_nodes.library import materials_path
from mrm_nodes.reference.polar import profile
from mrm_nodes.regression.run.runner import Report
from mrm_nodes.render import probe_backends, read_image

TAPE = ref.GeneralizedSchlick(0.04, alpha=0.006, retroreflectivity=1.0)


def shown(png: bytes | None, folder: Path) -> np.ndarray:
    assert png is not None
    (folder / "shown.png").write_bytes(png)
    return read_image(folder / "shown.png")


@pytest.mark.skipif(not any(probe.works for probe in probe_backends()), reason="no backend works")
def test_a_render_shows_its_picture(tmp_path: Path) -> None:
    material = next(materials_path().glob("*.mtlx"))
    rendered = mrm_nodes.render(material, lights="camera", size=(24, 16))
    image = shown(rendered._repr_png_(), tmp_path)
    assert image.shape == (16, 24, 4)
    rendered.save(tmp_path / "saved.png")
    assert np.array_equal(read_image(tmp_path / "saved.png"), image)


def test_a_lobe_shows_its_polar_plot(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for lobe in (TAPE, ref.Layer(ref.Leaf(TAPE), ref.Leaf(ref.Lambert(0.5)))):
        assert np.ptp(shown(lobe._repr_png_(), tmp_path)) == 1.0
    assert ref.Conductor((0.2, 0.9, 1.1), (3.9, 2.4, 2.1), np.full((7, 1), 0.1))._repr_png_() is None


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0])
def test_the_plot_has_the_peak_of_a_narrow_lobe_where_it_is(degrees: float) -> None:
    angles, values = profile(TAPE, degrees)
    assert np.degrees(angles[values.argmax()]) == pytest.approx(degrees, abs=0.02)
    v = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    assert values.max() == pytest.approx(TAPE.eval(v, v).mean() * v[2], rel=1e-3)


def test_a_plot_without_matplotlib_is_none() -> None:
    code = (
        "import sys; sys.modules['matplotlib'] = None; from mrm_nodes import reference as ref; "
        "sys.exit(ref.Conductor(0.2, 3.0, 0.1)._repr_png_() is not None)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_report_shows_its_link(tmp_path: Path) -> None:
    folder = tmp_path / 'a "b" & c'
    contents = {"summary": {"passed": 2, "total": 3}, "cases": []}
    report = Report(folder, contents)
    assert report == contents and json.loads(json.dumps(report)) == contents
    link = report._repr_html_()
    assert "a%20%22b%22%20%26%20c/index.html" in link and "2 of 3 passed" in link
    assert "<" not in link.split(">", 1)[1].split("</a>")[0]
