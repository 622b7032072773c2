# ruff: noqa: E741  the field's own name
"""Fits: what was put in comes out, as surely as is said; and the tapes, where they lie beside the checkout."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_material_case import case_of, judged
from test_retroreflector import evaluated

from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.measured import MODELS, Measurement, fit, folds, leave_angles_out, read
from mrm_nodes.measured.fitting import usable, weights
from mrm_nodes.measured.models import PARAMETERS, find_model
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.render import probe_backends

Run = Callable[..., tuple[int, str, str]]

DATA = Path(__file__).parents[2] / "shared" / "data"
TRIALS = int(os.environ.get("MRM_FIT_TRIALS", "12"))
"""200 take two minutes: MRM_FIT_TRIALS=200 runs them."""

TRUE = {
    "alpha": 0.04,
    "f0": 0.25,
    "f82": 0.3,
    "exponent": 0.9,
    "falloff": 2.5,
    "widening": 0.8,
    "retroreflectivity": 0.8,
    "second_alpha": 0.15,
    "second_share": 0.3,
    "film": 0.35,
    "top_alpha": 0.12,
    "top_f0": 0.08,
    "top_f90": 0.6,
}


def places(lights: tuple[float, ...] = (10.0, 30.0, 50.0, 70.0), seed: int = 1) -> tuple[Any, Any]:
    """Viewers about the light, about the mirrored one, and elsewhere."""
    rng = np.random.default_rng(seed)
    views, many = [], []
    for angle in np.radians(lights):
        light = np.array([np.sin(angle), 0.0, np.cos(angle)])
        spread = [0.02] * 25 + [0.06] * 30 + [0.2] * 30 + [0.1, -0.1] * 40
        for each in spread:
            centre = light if each > 0 else light * [-1.0, 1.0, 1.0]
            views.append(centre + rng.normal(scale=abs(each), size=3))
        views += list(rng.normal(loc=(0.0, 0.0, 1.0), size=(60, 3)))
        many += [light] * (len(views) - len(many))
    v, l = np.array(views), np.array(many)
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    seen = v[:, 2] > 0.2
    return v[seen], l[seen]


def made(
    model: str, noise: float = 0.0, seed: int = 1, channels: tuple[str, ...] = ("luminance",)
) -> Measurement:
    """What a material of known parameters shows, with noise of the logarithm."""
    v, l = places()
    described = find_model(model)
    values = {name: np.asarray(true(name)) for name in described.names(channels)}
    f = described.bsdf(values, channels).eval(v, l)[:, : len(channels)]
    return Measurement(v, l, f * np.exp(noise * np.random.default_rng(seed).normal(size=f.shape)), channels)


def true(name: str) -> float:
    """A channel's share of a colour differs."""
    base, _, channel = name.partition(".")
    return TRUE[base] * {"": 1.0, "R": 1.0, "G": 0.6, "B": 0.2}[channel]


IDENTIFIED = {"layered", "beside", "exponent", "widening", "beckmann"}


@pytest.mark.parametrize("model", sorted(IDENTIFIED | {"blend", "plain"}))
def test_without_noise_the_parameters_come_back(model: str):
    found = fit(made(model), model)
    assert found.rmse < 1e-4
    for name, value in found.parameters.items():
        assert value == pytest.approx(true(name), rel=1e-2), name


def test_a_colour_has_three_of_each():
    found = fit(made("layered", channels=("R", "G", "B")), "layered")
    assert found.parameters["f0.B"] == pytest.approx(0.05, rel=1e-3)
    assert found.parameters["film.G"] == pytest.approx(0.21, rel=1e-3)
    assert found.bsdf.f0 == pytest.approx((0.25, 0.15, 0.05), rel=1e-3)


def test_deviations_are_what_they_say():
    """Each parameter is within twice its deviation in 90 to 99 % of trials; of few, as many as chance lets be."""
    names = find_model("layered").names(("luminance",))
    inside = dict.fromkeys(names, 0)
    for trial in range(TRIALS):
        found = fit(made("layered", 0.1, seed=trial), "layered", TRUE)
        for name in names:
            inside[name] += abs(found.parameters[name] - TRUE[name]) <= 2.0 * found.deviations[name]
    print({name: f"{count}/{TRIALS}" for name, count in inside.items()})
    if TRIALS >= 200:
        assert all(0.90 <= count / TRIALS <= 0.99 for count in inside.values()), inside
    else:
        # 12 of a chance of 0.9 are below 7 in one of 20,000 cases.
        assert all(count >= 0.55 * TRIALS for count in inside.values()), inside
        assert sum(inside.values()) < len(names) * TRIALS


def test_noise_is_found_and_not_fitted():
    data = made("layered", 0.1)
    found = fit(data, "layered")
    assert found.rmse == pytest.approx(0.1, rel=0.1)
    assert folds(data, found) == pytest.approx(found.rmse, abs=0.005)
    left = leave_angles_out(data, found)
    assert sorted(left) == [10.0, 30.0, 50.0, 70.0]
    assert all(error < 0.2 for error in left.values())
    assert list(leave_angles_out(data, found, (30.4,))) == [30.0]


def test_what_the_data_do_not_show_is_not_identified():
    data = made("layered", 0.05)
    straight = data.where(np.degrees(data.theta_l) < 15.0)
    found = fit(straight, "layered")
    # One light near the normal: neither a fall with the angle nor a grazing reflectance is seen.
    assert {"top_f90"} <= set(found.unidentified)
    assert leave_angles_out(straight, found) == {}


def test_a_model_in_a_model_is_no_worse():
    data = made("widening", 0.05)
    worse, better = fit(data, "beside"), fit(data, "widening")
    assert better.rmse < 0.8 * worse.rmse


def test_a_fit_is_the_same_again():
    data = made("layered", 0.1)
    first, second = fit(data, "layered"), fit(data, "layered")
    assert first.parameters == second.parameters and first.deviations == second.deviations


def test_samples_near_retroreflection_weigh_half_of_their_light():
    data = usable(made("layered"))
    weight = weights(data)
    near = data.from_retro < np.radians(8.0)
    for angle in data.light_angles():
        here = data.at_light(angle)
        expected = max(0.5 * here.sum(), float((here & near).sum()))
        assert weight[here & near].sum() == pytest.approx(expected)
        assert (weight[here & ~near] == 1.0).all()


@pytest.mark.parametrize("model", MODELS)
def test_the_document_is_the_fit(model: str, tmp_path: Path):
    found = fit(made(model, 0.05), model, TRUE)
    path = tmp_path / "a.mtlx"
    path.write_text(found.markup("tape"))
    document = read_document(path)
    assert document.validate()[0]
    assert "RMSE" in document.getNode("tape").getDocString()
    v, l = places(seed=3)
    # The evaluator of documents has the lights' directions in float32.
    l = l.astype(np.float32).astype(np.float64)
    l /= np.linalg.norm(l, axis=1, keepdims=True)
    expected = found.bsdf.eval(v, l)
    np.testing.assert_allclose(evaluated(document, "tape", v, l), expected, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("model", ["layered", "full"])
def test_glsl_shows_the_fit(model: str, tmp_path: Path):
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working:
        pytest.skip("no backend works")
    (tmp_path / "a.mtlx").write_text(fit(made(model, 0.05), model, TRUE).markup("tape"))
    outcome = judged(Worker(working[0]), case_of(tmp_path / "a.mtlx"), tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")
    assert outcome.figures is not None and outcome.figures.lit > 2000


def test_too_little_is_said():
    data = made("layered")
    with pytest.raises(MrmError, match="5 values below 80°, but 7 parameters of layered"):
        fit(data.where(np.arange(5)), "layered")
    with pytest.raises(MrmError, match="did you mean layered"):
        fit(data, "layred")
    with pytest.raises(MrmError, match="no light at 45°"):
        leave_angles_out(data, fit(data, "layered", TRUE), (45.0,))
    dark = Measurement(data.v, data.l, 0.0 * data.value)
    with pytest.raises(MrmError, match="nothing to fit"):
        fit(dark, "layered")
    two = Measurement(data.v, data.l, np.repeat(data.value, 2, axis=1), ("a", "b"))
    with pytest.raises(MrmError, match="2 channels"):
        fit(two, "layered")


def test_every_parameter_has_a_start_inside_of_its_bounds():
    for name, parameter in PARAMETERS.items():
        assert parameter.low < parameter.start < parameter.high, name
        assert float(parameter.from_free(np.array(parameter.to_free(0.3)))) == pytest.approx(0.3)


TAPES = {"retro-3M-jaune": 0.37, "retro-gray-tape": 0.28}


@pytest.mark.parametrize("tape", TAPES)
def test_the_tapes_are_fitted_as_they_were_before(tape: str):
    path = DATA / f"{tape}.dat"
    if not path.is_file():
        pytest.skip(f"{path.name} does not lie beside the checkout")
    if tape == "retro-gray-tape":
        with pytest.warns(
            MrmWarning, match="says nothing of a cosine; by reciprocity its values are f cos θ_v"
        ):
            data = read(path)
    else:
        data = read(path)
    found = fit(data, "layered")
    assert found.rmse <= TAPES[tape]
    assert folds(data, found) == pytest.approx(found.rmse, abs=0.005)
    wider = fit(data, "widening", found.parameters)
    assert wider.rmse <= {"retro-3M-jaune": 0.37, "retro-gray-tape": 0.25}[tape]
    peaks = wider.peaks()
    assert sorted(peaks) == [15.0, 30.0, 60.0] and all(0.5 < each < 2.0 for each in peaks.values())


def test_figure_4_shows_what_the_wrong_cosine_does(tmp_path: Path):
    pytest.importorskip("matplotlib")
    from mrm_nodes.measured.figures import pairs, write_figure_4
    from mrm_nodes.render.images import read_image

    rng = np.random.default_rng(5)
    polar, turn = rng.uniform(0.0, 1.2, 4000), rng.uniform(-np.pi, np.pi, 4000)
    theta_l = np.radians(np.repeat([15.0, 30.0, 60.0, 45.0], 1000))
    polar[::3] = np.radians(rng.choice([15.0, 30.0, 60.0, 45.0], len(polar[::3])))
    v = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], axis=-1)
    l = np.stack([np.sin(theta_l), 0.0 * polar, np.cos(theta_l)], axis=-1)
    f = (
        find_model("exponent")
        .bsdf({name: np.asarray(TRUE[name]) for name in TRUE}, ("luminance",))
        .eval(v, l)
    )
    tape = Measurement(v, l, f[:, :1])
    there, back = pairs(tape)
    assert len(there) > 50 and np.median(there / back) == pytest.approx(1.0, abs=0.1)
    wrong = Measurement(v, l, f[:, :1] * v[:, 2:] / l[:, 2:])
    there, back = pairs(wrong)
    assert np.median(there / back) < 0.9
    for path in write_figure_4(tape, tmp_path):
        assert path.stat().st_size > 1000
    picture = read_image(tmp_path / "mrm_figure_4.png")
    assert picture.std() > 0.05
    again = tmp_path / "again"
    (again / "mrm_figure_4.csv").mkdir(parents=True)
    with pytest.raises(MrmError, match=r"mrm_figure_4.csv: cannot be written"):
        write_figure_4(tape, again)
    for name in ("mrm_figure_4.png", "mrm_figure_4.svg"):
        assert (again / name).read_bytes() == (tmp_path / name).read_bytes()
    assert not list(again.glob(".mrm-*"))
    with pytest.raises(MrmError, match="Figure 4 needs samples whose directions are exchanged"):
        write_figure_4(made("layered"), again)
    with pytest.raises(MrmError, match="one channel"):
        write_figure_4(Measurement(v, l, f, ("R", "G", "B")), tmp_path)


def test_of_many_samples_the_error_is_that_of_all(monkeypatch: pytest.MonkeyPatch):
    """Near the light the noise is five times that of the rest: samples that are drawn must have as many of either."""
    from mrm_nodes.measured import fitting

    v, l = (np.concatenate(each) for each in zip(*(places(seed=seed) for seed in range(12)), strict=True))
    values = {name: np.asarray(true(name)) for name in find_model("layered").names(("luminance",))}
    data = Measurement(v, l, find_model("layered").bsdf(values, ("luminance",)).eval(v, l)[:, :1])
    data = data.where((data.from_retro >= np.radians(8.0)) | (np.arange(len(data)) % 4 == 0))
    noise = np.where(data.from_retro < np.radians(8.0), 0.5, 0.1)[:, None]
    data = replace(
        data,
        value=data.value * np.exp(noise * np.random.default_rng(2).choice([-1.0, 1.0], data.value.shape)),
    )
    monkeypatch.setattr(fitting, "MOST", 1200)
    found = fit(data, "layered", TRUE)
    known = usable(data)
    assert len(found.measurement) == 1200 < len(known) == found.drawn_from
    model = found.bsdf.eval(known.v, known.l)[:, :1]
    over_all = np.sqrt(np.mean(np.log((model + 1e-3) / (known.value + 1e-3)) ** 2))
    assert found.rmse == pytest.approx(over_all, rel=0.1)
    assert f"over 1200 samples below 80 degrees, drawn from {len(known)}." in found.markup()


# The command.


def table(data: Measurement, path: Path, rows: slice = slice(None)) -> Path:
    """A CSV file of samples."""
    lines = [",".join(f"{each:.9g}" for each in row) for row in np.hstack([data.v, data.l, data.value])[rows]]
    path.write_text("\n".join(["vx,vy,vz,lx,ly,lz,f", *lines]))
    return path


def test_what_cannot_be_fitted_again_is_a_question_mark_and_the_document_is_written(run: Run, tmp_path: Path):
    """Nine samples for seven parameters: enough for one fit, but for none without a fifth of them."""
    file = table(made("layered", 0.05), tmp_path / "few.csv", slice(0, 400, 50))
    status, out, err = run("fit", file, "-o", tmp_path / "out" / "a.mtlx", "--no-compare")
    assert status == 0, err
    assert "? in five folds (" in out and "too few to fit" in out
    assert (tmp_path / "out" / "a.mtlx").is_file()


def test_an_angle_without_which_nothing_can_be_fitted_is_a_question_mark(run: Run, tmp_path: Path):
    data = made("layered", 0.05)
    some = np.flatnonzero(data.at_light(30.0))[:5]
    shared = np.flatnonzero(data.at_light(10.0))[:60]
    file = table(data.where(np.concatenate([shared, np.resize(some, 10)])), tmp_path / "two.csv")
    status, out, err = run("fit", file, "-o", tmp_path / "a.mtlx", "--no-compare", "--model", "full")
    assert status == 0, err
    assert "? where it is left out (10 values below 80°" in out
    assert (tmp_path / "a.mtlx").is_file()


@pytest.mark.parametrize("angle", ["45", "nan", "inf"])
def test_an_angle_that_is_not_there_is_said_before_anything_is_fitted(
    run: Run, tmp_path: Path, angle: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("mrm_nodes.measured.fit", lambda *_: pytest.fail("it was fitted"))
    file = table(made("layered"), tmp_path / "a.csv")
    status, _, err = run("fit", file, "-o", tmp_path / "out" / "a.mtlx", "--hold-out", angle)
    assert status == 2 and f"no light at {angle}°: the samples have it at 10, 30, 50, 70" in err
    assert not (tmp_path / "out").exists()


def test_the_only_angle_cannot_be_held_out(run: Run, tmp_path: Path):
    data = made("layered")
    file = table(data.where(data.at_light(30.0)), tmp_path / "a.csv")
    status, _, err = run("fit", file, "-o", tmp_path / "out" / "a.mtlx", "--hold-out", "30")
    assert status == 2 and "all samples have the light at 30°: none is left" in err
    assert not (tmp_path / "out").exists()


def test_without_matplotlib_a_plot_is_refused_before_anything_is_fitted(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    file = table(made("layered"), tmp_path / "a.csv")
    monkeypatch.setattr("mrm_nodes.measured.fit", lambda *_: pytest.fail("it was fitted"))
    status, _, err = run("fit", file, "-o", tmp_path / "out" / "a.mtlx", "--plot")
    assert status == 2 and "a plot needs Matplotlib" in err and err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("ending", ["svg", "pdf", "png"])
def test_a_plot_is_the_same_file_again(
    run: Run, tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("matplotlib")
    file = table(made("layered"), tmp_path / "a.csv", slice(0, 400, 5))
    plots = []
    for folder in (tmp_path / "first", tmp_path / "second"):
        # What Matplotlib takes for the time of writing.
        monkeypatch.setenv("SOURCE_DATE_EPOCH", "1000000000" if plots else "1500000000")
        plot = folder / f"a.{ending}"
        status, _, err = run("fit", file, "-o", folder / "a.mtlx", "--no-compare", "--plot", plot)
        assert status == 0, err
        plots.append(plot.read_bytes())
    assert plots[0] == plots[1]
