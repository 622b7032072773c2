"""What the evaluator draws and how it is run: figures, threads, and memory."""

import math

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.bench import reference as bench
from mrm_nodes.reference import compiled, figures


def test_figure_2_has_its_features():
    """Both lobes have one shape, peaks mirror each other, and Lambert is 1/π (001, "BRDF comparison")."""
    for panel in figures.figure_2():
        curves = {curve.label: curve for curve in panel.curves}
        x = curves["Lambert"].x
        # Where the sine is not 0 at the horizon: the view is above the surface.
        assert curves["Lambert"].y[len(x) // 2] == pytest.approx(1.0 / math.pi)
        if "φ = 0°" in panel.title:
            retro, forward = (curves[f"{name}, roughness 0.1"].y for name in ("MRM", "GGX"))
            np.testing.assert_allclose(retro, forward[::-1], rtol=1e-9)
            theta_i = float(panel.title.split("= ")[1].split("°")[0])
            assert x[np.argmax(retro)] == pytest.approx(theta_i, abs=1.0)


def test_heitzs_table_3_is_reproduced():
    assert [physical for _, _, physical in figures.heitz_table_3()] == [True, True, False, False, False]


def test_figures_are_drawn(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(figures, "FIGURES", {"heitz_figure_12": figures.heitz_figure_12})
    names = {path.name for path in figures.write_figures(tmp_path)}
    assert names == {
        f"heitz_{what}.{kind}" for what in ("figure_12", "table_3") for kind in ("png", "svg", "csv")
    }
    assert all((tmp_path / name).stat().st_size > 0 for name in names)


def test_the_bench_measures_every_question():
    rows = list(bench.measure(count=1 << 9, repeats=1))
    assert {row.question for row in rows} == {"eval", "pdf", "sample", "albedo", "table"}
    assert all(row.rate > 0.0 for row in rows)
    assert any(row.subject.startswith("NumPy") for row in rows)


def test_the_first_draft_in_numpy_agrees():
    rng = np.random.default_rng(2)
    v, l = bench._directions(rng, 200), bench._directions(rng, 200)  # noqa: E741
    lobe = ref.Conductor(bench.IOR, bench.EXTINCTION, 0.3, correlation="separable")
    np.testing.assert_allclose(bench.numpy_conductor(v, l, 0.3), lobe.eval(v, l), rtol=1e-11)


def test_results_do_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(3)
    v, l = bench._directions(rng, 50_001), bench._directions(rng, 50_001)  # noqa: E741
    lobe = ref.Conductor(0.2, 3.9, 0.3, 0.5)
    whole = lobe.eval(v, l)
    compiled.set_thread_count(1)
    try:
        np.testing.assert_array_equal(lobe.eval(v, l), whole)
    finally:
        compiled.set_thread_count(None)
    # Lanes that pad a block change nothing either.
    np.testing.assert_array_equal(lobe.eval(v[7:20], l[7:20]), whole[7:20])


def test_inputs_are_neither_copied_nor_changed():
    """A view with any strides is read as it lies, and float32 is only widened."""
    rng = np.random.default_rng(4)
    planes = np.ascontiguousarray(bench._directions(rng, 4096).T)
    v = planes.T
    v.flags.writeable = False
    before = planes.copy()
    lobe = ref.Dielectric(1.5, 0.3, retroreflectivity=0.5)
    strided = lobe.eval(v, v[::-1])
    np.testing.assert_array_equal(planes, before)
    np.testing.assert_array_equal(strided, lobe.eval(np.ascontiguousarray(v), np.ascontiguousarray(v[::-1])))
