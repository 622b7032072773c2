"""Documents on a goniometer, and the materials that are made for classes."""

from __future__ import annotations

import functools
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes import photometry
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.photometry import classes, material_for, read_sheet, retroreflection
from mrm_nodes.photometry.design import COLOURS, Design
from mrm_nodes.photometry.retroreflector import ClearTop, Retroreflector
from mrm_nodes.render import get_context

ALL = [(name, colour) for name, found in classes().items() for colour in found.requirements]
SHEETS = [(name, colour) for name, colour in ALL if classes()[name].of(colour)[0].quantity == "R_A"]
each_class = pytest.mark.parametrize(("name", "colour"), ALL, ids="-".join)


@functools.cache
def designed(name: str, colour: str) -> Design:
    return material_for(name, None if colour == "any" else colour)


@pytest.fixture
def gl() -> None:
    """Skip where there is no OpenGL, unless this machine must have it."""
    try:
        get_context("auto")
    except MrmError as error:
        if os.environ.get("MRM_REQUIRE_BACKENDS"):
            raise
        pytest.skip(str(error))


@each_class
def test_the_material_of_a_class_is_in_it_with_the_excess_that_it_says(name: str, colour: str):
    design = designed(name, colour)
    rows = photometry.check(design.bsdf, name, None if colour == "any" else colour)
    assert len(rows) == len(classes()[name].requirements[colour])
    assert all(row.passes for row in rows)
    assert rows == design.rows
    assert design.rms == pytest.approx(math.sqrt(np.mean([math.log1p(row.margin) ** 2 for row in rows])))
    assert min(row.margin for row in rows) < 5e-6


@pytest.mark.parametrize(
    ("name", "colour"),
    [("ISO 20471", "white"), ("RA1", "blue"), ("RA2", "white"), ("number plate", "yellow")],
)
def test_no_other_width_and_falloff_has_a_smaller_excess(name: str, colour: str):
    design = designed(name, colour)
    goal = np.log([row.requirement.minimum for row in design.rows])
    found = design.bsdf
    for alpha in np.geomspace(0.002, 0.03, 15):
        for falloff in np.linspace(0.0, 12.0, 15):
            tried = Retroreflector(alpha, found.f0, falloff=falloff, film=found.film, top=found.top)
            rows = photometry.check(tried, name, colour)
            excess = np.log([row.value for row in rows]) - goal
            # Brighter or darker by one factor, until one value is its minimum: the film is small beside it.
            assert np.sqrt(np.mean((excess - excess.min()) ** 2)) > design.rms - 0.005


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(
    ("name", "colour"), [("RA2", "yellow"), ("number plate", "blue"), ("EN 1436 dry", "white")]
)
def test_its_document_is_in_the_class_too(tmp_path: Path, name: str, colour: str):
    design = designed(name, colour)
    file = tmp_path / "sheet.mtlx"
    file.write_text(design.bsdf.markup("sheet"))
    rows = photometry.check(read_sheet(file).at(), name, colour)
    for row, exact in zip(rows, design.rows, strict=True):
        assert row.passes
        assert row.value == pytest.approx(exact.value, rel=1e-5)


def test_a_margin_is_kept():
    for name, colour in (("RA2", "red"), ("EN 1436 dry", "yellow"), ("number plate", "white")):
        rows = material_for(name, colour, margin=0.25).rows
        assert all(row.margin >= 0.25 for row in rows)
        assert min(row.margin for row in rows) < 0.25 + 1e-5


def test_a_margin_that_the_maximum_of_a_class_forbids_is_refused():
    with pytest.raises(
        MrmError, match=r"no retroreflector of this kind is number plate, white, with a margin of 4.5"
    ):
        material_for("number plate", "white", margin=4.5)


def test_a_start_that_ends_where_no_sheet_is_in_the_class_does_not_count(monkeypatch: pytest.MonkeyPatch):
    """However small its excess: here 0, of a first one that is far too dark."""
    import scipy.optimize

    expected, search, calls = material_for("RA1", "red"), scipy.optimize.minimize, []

    def first_fails(*given: Any, **options: Any) -> Any:
        found = search(*given, **options)
        if not calls:
            found.x, found.fun = np.array([math.log(0.1), math.log(1e-5), 0.0]), 0.0
        calls.append(found)
        return found

    monkeypatch.setattr(scipy.optimize, "minimize", first_fails)
    assert material_for("RA1", "red").rms == pytest.approx(expected.rms, abs=1e-3)
    assert len(calls) == 2


@pytest.mark.parametrize("margin", [-0.1, math.nan, math.inf, 11.0])
def test_a_margin_that_is_none_is_refused(margin: float):
    with pytest.raises(MrmError, match="margin"):
        material_for("RA2", "white", margin)


def test_each_colour_of_a_class_can_be_made():
    for found in classes().values():
        assert set(found.requirements) <= {*COLOURS, "any"}
    with pytest.raises(MrmError, match="unknown colour yelow; did you mean yellow"):
        material_for("EN 1436 Q2", "yelow")


def test_white_and_yellow_are_that_by_night():
    """The boxes of French plates (arrete du 15 avril 1996, appendice 1), and the red of UN R3's reflectors."""
    boxes = {
        "white": [(0.548, 0.404), (0.417, 0.359), (0.372, 0.405), (0.450, 0.513)],
        "yellow": [(0.610, 0.390), (0.585, 0.385), (0.505, 0.465), (0.520, 0.480)],
    }
    for colour, corners in boxes.items():
        x, y = photometry.night_chromaticity(COLOURS[colour][1])
        turns = [
            (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
            for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
        ]
        assert all(turn > 0.0 for turn in turns) or all(turn < 0.0 for turn in turns), (colour, x, y)


# Sheets of documents.

SHEET = Retroreflector(
    0.0064, (0.2, 0.12, 0.01), falloff=3.5, widening=0.4, film=0.5, top=ClearTop(0.02, 0.04)
)


@pytest.fixture
def sheet_file(tmp_path: Path) -> Path:
    file = tmp_path / "sheet.mtlx"
    file.write_text(SHEET.markup("sheet"))
    return file


@pytest.mark.usefixtures("gl")
def test_a_document_has_the_coefficients_of_what_it_says(sheet_file: Path):
    """Also where its graph asks for the view, at all angles; what GLSL works out comes in float32."""
    sheet = read_sheet(sheet_file).at()
    angles = np.meshgrid([0.0, 0.2, 1.0, 5.0], [-40.0, 0.0, 30.0, 60.0], [0.0, 20.0], [0.0, 70.0])
    found, expected = (retroreflection(each, *angles) for each in (sheet, SHEET))
    np.testing.assert_allclose(found, expected, rtol=3e-6)
    for quantity in (photometry.luminance_coefficient, photometry.total_retroreflectance):
        np.testing.assert_allclose(quantity(sheet), quantity(SHEET), rtol=2e-5)
    assert photometry.half_width(sheet) == pytest.approx(photometry.half_width(SHEET), rel=1e-5)


@pytest.mark.usefixtures("gl")
def test_both_backends_and_a_second_look_give_the_same(sheet_file: Path):
    sheet = read_sheet(sheet_file)
    first = retroreflection(sheet.at(), 0.2, [5.0, 30.0])
    assert (retroreflection(sheet.at(), 0.2, [5.0, 30.0]) == first).all()
    for backend in ("egl", "osmesa"):
        try:
            other = read_sheet(sheet_file, backend=backend)
            np.testing.assert_allclose(retroreflection(other.at(), 0.2, [5.0, 30.0]), first, rtol=1e-6)
        except MrmError as error:
            if os.environ.get("MRM_REQUIRE_BACKENDS"):
                raise
            pytest.skip(str(error))


SPLIT = """<?xml version="1.0"?>
<materialx version="1.39">
  <texcoord name="uv" type="vector2" />
  <extract name="u" type="float"><input name="in" type="vector2" nodename="uv" /></extract>
  {nodes}
  <mrm_generalized_schlick_bsdf name="beads" type="BSDF">
    <input name="color0" type="color3" value="0.1, 0.1, 0.1" />
    <input name="color90" type="color3" value="0.1, 0.1, 0.1" />
    <input name="roughness" type="vector2" value="0.01, 0.01" />
    <input name="retroreflectivity" type="float" nodename="u" />
    {inputs}
  </mrm_generalized_schlick_bsdf>
  <surface name="surface" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="beads" />
    {surface}
  </surface>
  <surfacematerial name="sheet" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface" />
  </surfacematerial>
</materialx>
"""


def written(folder: Path, nodes: str = "", inputs: str = "", surface: str = "") -> Path:
    file = folder / "split.mtlx"
    file.write_text(SPLIT.format(nodes=nodes, inputs=inputs, surface=surface))
    return file


@pytest.mark.usefixtures("gl")
def test_a_pattern_is_measured_point_by_point(tmp_path: Path):
    uv = np.stack([np.linspace(0.0, 1.0, 5), np.full(5, 0.3)], axis=-1)
    value = retroreflection(read_sheet(written(tmp_path)).at(uv), [[0.2], [0.5]], 20.0)[..., 1]
    assert value.shape == (2, 5)
    whole = retroreflection(Retroreflector(0.01, 0.1), [[0.2], [0.5]], 20.0)[..., 1]
    np.testing.assert_allclose(value, whole * uv[:, 0], rtol=1e-5, atol=1e-4)
    rows = photometry.check(read_sheet(written(tmp_path)).at(uv), "RA1", "red")
    assert rows[0].least < 0.1 < rows[0].value == pytest.approx(0.5 * rows[0].most, rel=1e-3)


@pytest.mark.usefixtures("gl")
def test_a_normal_map_tilts_the_sheet(tmp_path: Path):
    """A tilt of the normal about +x by 10 degrees, in place of beta1."""
    tilt = math.radians(10.0)
    colour = f"0.5, {0.5 + 0.5 * math.sin(tilt):.9f}, {0.5 + 0.5 * math.cos(tilt):.9f}"
    nodes = f"""<normalmap name="tilted" type="vector3">
      <input name="in" type="vector3" value="{colour}" />
    </normalmap>"""
    inputs = '<input name="normal" type="vector3" nodename="tilted" />'
    tilted = read_sheet(written(tmp_path, nodes, inputs)).at((1.0, 0.5))
    flat = Retroreflector(0.01, 0.1)
    found = retroreflection(tilted, 0.3, [10.0, 20.0, 40.0])[:, 1]
    # A lobe has R_A without its own cosine at l, and the sheet's at v.
    v, l = photometry.directions(0.3, [10.0, 20.0, 40.0])  # noqa: E741
    turn = np.array(
        [[1.0, 0.0, 0.0], [0.0, math.cos(tilt), -math.sin(tilt)], [0.0, math.sin(tilt), math.cos(tilt)]]
    )
    own_v, own_l = v @ turn.T, l @ turn.T
    expected = flat.eval(own_v, own_l)[:, 1] * own_l[:, 2] * v[:, 2]
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert not np.allclose(found, flat.eval(v, l)[:, 1] * l[:, 2] * v[:, 2], rtol=1e-3)


@pytest.mark.usefixtures("gl")
def test_what_shines_through_is_refused_and_what_shines_is_said(tmp_path: Path):
    half = '<input name="opacity" type="float" nodename="u" />'
    with pytest.raises(MrmError, match=r"split.mtlx: its opacity is not 1 everywhere"):
        read_sheet(written(tmp_path, surface=half)).at()
    lamp = '<uniform_edf name="lamp" type="EDF"><input name="color" type="color3" value="1, 1, 1" /></uniform_edf>'
    glows = '<input name="edf" type="EDF" nodename="lamp" />'
    with pytest.warns(MrmWarning, match="it emits light, which is no part of what it sends back"):
        read_sheet(written(tmp_path, lamp, surface=glows)).at()


@pytest.mark.usefixtures("gl")
def test_a_graph_that_gives_no_number_is_named(tmp_path: Path):
    nodes = """<divide name="nothing" type="float">
      <input name="in1" type="float" nodename="u" /><input name="in2" type="float" value="0.0" />
    </divide>"""
    file = written(tmp_path, nodes, '<input name="weight" type="float" nodename="nothing" />')
    with pytest.raises(MrmError, match=r"split.mtlx: .* is NaN or infinite"):
        retroreflection(read_sheet(file).at(), 0.2, 5.0)


def test_a_lobe_that_the_evaluator_does_not_know_is_named(tmp_path: Path):
    file = tmp_path / "velvet.mtlx"
    file.write_text(
        SPLIT.format(nodes="", inputs="", surface="").replace("mrm_generalized_schlick", "chiang_hair")
    )
    with pytest.raises(MrmError, match=r"velvet.mtlx: .*chiang_hair_bsdf"):
        read_sheet(file)
