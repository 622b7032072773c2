"""`mrm-nodes photometry` and `mrm-nodes material`: what they print and write, and how they end."""

from __future__ import annotations

import dataclasses
import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mrm_nodes import photometry
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.photometry import SheetPoints, material_for, read_sheet
from mrm_nodes.photometry.openmaterial import read_asset
from mrm_nodes.photometry.retroreflector import Retroreflector

pytestmark = pytest.mark.usefixtures("gl")

Run = Callable[..., tuple[int, str, str]]

MATT = """<?xml version="1.0"?>
<materialx version="1.39">
  <oren_nayar_diffuse_bsdf name="film" type="BSDF">
    <input name="color" type="color3" value="0.5, 0.5, 0.5" />
  </oren_nayar_diffuse_bsdf>
  <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="film" /></surface>
  <surfacematerial name="matt" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface" />
  </surfacematerial>
</materialx>
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def asset(folder: Path, coefficient: Any = 250, **more: Any) -> Path:
    file = folder / "asset.xomp"
    data = {"coefficientOfRetroreflection": coefficient, "sources": "a data sheet", **more}
    tree = {"metadata": {"name": "Sign"}, "materialProperties": {"retroreflectivityData": data}}
    file.write_text(json.dumps(tree))
    return file


def test_the_material_of_a_class_passes_its_own_check(run: Run, folder: Path):
    status, out, _ = run("material", "--class", "ra2", "--colour", "Yellow", "-o", "sign.mtlx")
    assert status == 0
    assert "0.2°, 5°" in out and "RA2, yellow: alpha 0.0064, F0 0.1712" in out.replace("0.006382", "0.0064")
    assert "excess: 0.177 rms" in out and "values of RA2 (law): Austria" in out
    valid, message = read_document("sign.mtlx").validate()
    assert valid, message
    status, out, _ = run("photometry", "sign.mtlx", "--class", "RA2", "--colour", "yellow")
    assert status == 0
    assert "below" not in out and "pass" in out and "half of R_A at 0.472°" in out
    status, out, _ = run("photometry", "sign.mtlx", "--class", "RA2", "--colour", "white")
    assert status == 1
    assert "below" in out
    assert "verdict" in out


def test_json_has_each_row_of_the_table(run: Run, folder: Path):
    design = material_for("D4956 III", "red")
    (folder / "sheet.mtlx").write_text(design.bsdf.markup("sheet"))
    arguments = (
        "photometry",
        "sheet.mtlx",
        "--class",
        "D4956 III",
        "--colour",
        "red",
        "--geometry",
        "0.5,-4,10",
    )
    status, out, _ = run(*arguments, "--json")
    tree = json.loads(out)
    assert status == 0 and tree["passes"] is True
    assert tree["class"]["standing"] == "secondary"
    for row, exact in zip(tree["rows"], design.rows, strict=True):
        assert row["value"] == pytest.approx(exact.value, rel=1e-5)
        assert (row["observation"], row["beta1"]) == (exact.requirement.observation, exact.requirement.beta1)
        assert (row["minimum"], row["passes"]) == (exact.requirement.minimum, True)
    (other,) = tree["geometries"]
    expected = photometry.retroreflection(design.bsdf, 0.5, -4.0, 10.0)
    assert other["rgb"] == pytest.approx(list(expected), rel=1e-5)
    assert tree["half_width"] == pytest.approx(photometry.half_width(design.bsdf), rel=1e-5)


def test_of_a_pattern_least_mean_and_most_are_told_or_one_point(run: Run, folder: Path):
    bands = (
        material_for("RA1", "white")
        .bsdf.markup("bands")
        .replace(
            'name="retroreflectivity" type="float" value="1"',
            'name="retroreflectivity" type="float" nodename="u"',
        )
    )
    pattern = """<texcoord name="uv" type="vector2" />
  <extract name="u" type="float"><input name="in" type="vector2" nodename="uv" /></extract>
  <nodegraph"""
    (folder / "bands.mtlx").write_text(bands.replace("<nodegraph", pattern, 1))

    def first_row(*options: str) -> tuple[int, dict[str, Any]]:
        status, out, _ = run(
            "photometry", "bands.mtlx", "--class", "RA1", "--colour", "white", "--json", *options
        )
        return status, json.loads(out)["rows"][0]

    status, whole = first_row("--over-uv")
    assert status == 1 and whole["least"] < 1.0 < whole["value"] < whole["most"]
    assert whole["value"] == pytest.approx(0.5 * whole["most"], rel=0.01)
    assert first_row() == (status, whole)
    status, end = first_row("--uv", "1,0.5")
    assert status == 0 and end["least"] == end["most"] >= 70.0
    status, half = first_row("--uv", "0.5,0:1,1")
    assert half["value"] == pytest.approx(0.75 * end["value"], rel=0.01)
    _, out, _ = run("photometry", "bands.mtlx", "--geometry", "0.2,5")
    assert "least" in out and "mean" in out and "most" in out


def test_roads_are_checked_without_a_retroreflective_lobe_by_day_only(run: Run, folder: Path):
    (folder / "matt.mtlx").write_text(MATT)
    status, out, _ = run("photometry", "matt.mtlx", "--class", "EN 1436 Q3")
    assert status == 0 and "159.2" in out
    status, _, err = run("photometry", "matt.mtlx", "--class", "EN 1436 dry", "--colour", "white")
    assert status == 2 and "matt.mtlx: no lobe of it is retroreflective" in err


@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="no Matplotlib")
def test_a_plot_has_a_curve_and_steps_for_each_angle(run: Run, folder: Path):
    run("material", "--class", "RA2", "--colour", "white", "-o", "sheet.mtlx")
    arguments = ("photometry", "sheet.mtlx", "--class", "RA2", "--colour", "white", "--plot")
    assert run(*arguments, "plots/a.svg")[0] == 0
    text = (folder / "plots" / "a.svg").read_text()
    for label in ("entrance 5°", "entrance 30°", "entrance 40°", "observation 0.2°", "minima of RA2"):
        assert f"<!-- {label}" in text or label in text, label
    run(*arguments, "plots/b.svg")
    assert (folder / "plots" / "b.svg").read_text() == text
    assert run(*arguments, "plots/c.png")[0] == 0
    assert (folder / "plots" / "c.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--class", "RA3"), "unknown class RA3; did you mean RA2 or RA1"),
        (("--class", "RA2"), "RA2 has several colours; name one: white, yellow"),
        (("--class", "RA2", "--colour", "wite"), "RA2: unknown colour wite; did you mean white"),
        (("--colour", "white"), "--colour is of a class"),
        (("--geometry", "0.2,95"), "the source does not see the front of the sheet"),
        (("--geometry", "0.2"), "--geometry 0.2: write two to four angles"),
        (("--geometry", "0.2,x"), "--geometry 0.2,x: write two to four angles"),
        (("--geometry", "0.2,nan"), "--geometry 0.2,nan: write two to four angles"),
        (("--uv", "0.5"), "--uv 0.5: write a point"),
        (("--uv", "0,0:1,1:2,2"), "write a point as 0.5,0.5 or the corners"),
        (("--uv", "0,0", "--over-uv"), "give one of them"),
        (("--element", "sheat"), "unknown element sheat; did you mean sheet"),
        (("--plot", "plot.gif"), "plot.gif: unknown ending .gif of a plot"),
    ],
)
def test_a_wrong_request_of_photometry_is_one_line(run: Run, folder: Path, arguments: Any, said: str):
    (folder / "sheet.mtlx").write_text(Retroreflector(0.005, 0.1, falloff=3.7).markup("sheet"))
    before = sorted(folder.iterdir())
    status, out, err = run("photometry", "sheet.mtlx", *arguments)
    assert (status, out) == (2, "")
    assert err.startswith("mrm-nodes: ") and err.count("\n") == 1 and said in err
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    "contents", [None, "", "<materialx", "not XML", '<?xml version="1.0"?><materialx version="1.39"/>']
)
def test_what_is_no_material_is_one_line(run: Run, folder: Path, contents: str | None):
    if contents is not None:
        (folder / "x.mtlx").write_text(contents)
    status, out, err = run("photometry", "x.mtlx", "--class", "RA1", "--colour", "white")
    assert (status, out) == (2, "") and err.count("\n") == 1 and "x.mtlx" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "name a class with --class, or an OpenMATERIAL file with --from"),
        (("--class", "RA2"), "RA2 has several colours"),
        (("--class", "RA2", "--colour", "pink"), "RA2: unknown colour pink"),
        (("--class", "RA2", "--colour", "white", "--margin", "nan"), "margin nan: a share of each minimum"),
        (
            ("--class", "number plate", "--colour", "white", "--margin", "4.5"),
            "no retroreflector of this kind",
        ),
        (("--class", "RA2", "--colour", "white", "--geometry", "0.2,5"), "--geometry is that of --from"),
    ],
)
def test_a_wrong_request_of_material_is_one_line_and_nothing_is_written(
    run: Run, folder: Path, arguments: Any, said: str
):
    status, out, err = run("material", *arguments, "-o", "out.mtlx")
    assert (status, out) == (2, "")
    assert err.startswith("mrm-nodes: ") and err.count("\n") == 1 and said in err
    assert list(folder.iterdir()) == []


def test_another_ending_is_refused(run: Run, folder: Path):
    status, _, err = run("material", "--class", "RA2", "--colour", "white", "-o", "x.txt")
    assert status == 2 and "x.txt: unknown ending .txt; use .mtlx or .xomp" in err


@pytest.mark.parametrize(("name", "colour"), [("RA2", "blue"), ("EN 1436 dry", "yellow")])
def test_as_an_OpenPBR_surface_it_is_in_the_class_and_what_is_lost_is_said(
    run: Run, folder: Path, name: str, colour: str
):
    status, out, _ = run(
        "material", "--class", name, "--colour", colour, "--as", "open_pbr", "-o", "surface.mtlx"
    )
    assert status == 0 and "not carried by OpenPBR" in out
    text = (folder / "surface.mtlx").read_text()
    assert "<mrm_open_pbr_surface" in text
    assert run("photometry", "surface.mtlx", "--class", name, "--colour", colour)[0] == 0
    valid, message = read_document("surface.mtlx").validate()
    assert valid, message


# OpenMATERIAL.


def test_a_coefficient_goes_there_and_back(run: Run, folder: Path):
    assert run("material", "--class", "RA2", "--colour", "yellow", "-o", "sign.xomp")[0] == 0
    written = read_asset(Path("sign.xomp"))
    exact = material_for("RA2", "yellow").bsdf
    value = photometry.luminance(photometry.retroreflection(exact, 0.2, -4.0))
    assert written.coefficient == pytest.approx(float(value), rel=1e-5)
    assert "observation 0.2 deg, entrance -4 deg, colour yellow" in written.sources
    status, out, _ = run("material", "--from", "sign.xomp", "-o", "sign.mtlx")
    assert status == 0 and "R_A 184" in out.replace(f"{written.coefficient:.6g}", "184")
    found = read_sheet("sign.mtlx").at()
    again = photometry.luminance(photometry.retroreflection(found, 0.2, -4.0))
    assert float(again) == pytest.approx(written.coefficient, rel=1e-5)


@pytest.mark.parametrize("coefficient", [1, 250, 4000])
def test_a_material_has_the_coefficient_at_the_angles_that_are_given(
    run: Run, folder: Path, coefficient: float
):
    file = asset(folder, coefficient)
    options = ("--geometry", "0.3333,5" if coefficient < 1000 else "0.1,5", "--colour", "white")
    status, _, err = run("material", "--from", file, *options, "-o", "sign.mtlx")
    assert status == 0, err
    angles = (0.3333 if coefficient < 1000 else 0.1, 5.0)
    value = photometry.luminance(photometry.retroreflection(read_sheet("sign.mtlx").at(), *angles))
    assert float(value) == pytest.approx(coefficient, rel=1e-4)


@pytest.mark.parametrize("options", [(), ("--geometry", "0.2,-4"), ("--colour", "white")])
def test_what_OpenMATERIAL_does_not_say_is_asked_for(run: Run, folder: Path, options: Any):
    status, out, err = run("material", "--from", asset(folder), *options, "-o", "sign.mtlx")
    assert (status, out) == (2, "")
    assert "OpenMATERIAL's coefficient has no angles and no colour: say what they are, as in --" in err
    assert not (folder / "sign.mtlx").exists()


@pytest.mark.parametrize(
    ("contents", "said"),
    [
        (None, "cannot be read: No such file"),
        ("", "not the JSON of a .xomp file"),
        ("{", "not the JSON of a .xomp file"),
        ("[" * 500, "not the JSON of a .xomp file"),
        ("\xff\xfe", "no materialProperties"),
        ("[]", "no materialProperties"),
        ("{}", "no materialProperties"),
        ('{"materialProperties": {"surfaceRoughness": {}}}', "no retroreflectivityData"),
        ('{"materialProperties": {"retroreflectivityData": []}}', "no coefficientOfRetroreflection"),
    ],
)
def test_what_is_no_asset_is_one_line(run: Run, folder: Path, contents: str | None, said: str):
    if contents is not None:
        (folder / "asset.xomp").write_bytes(
            b"\xef\xbb\xbf{}" if contents == "\xff\xfe" else contents.encode()
        )
    options = ("--geometry", "0.2,-4", "--colour", "white")
    status, out, err = run("material", "--from", "asset.xomp", *options, "-o", "sign.mtlx")
    assert (status, out) == (2, "") and err.count("\n") == 1 and said in err
    assert not (folder / "sign.mtlx").exists()


@pytest.mark.parametrize("value", [-1, 5001, "250", None, True, float("nan"), [250]])
def test_a_coefficient_that_is_none_is_one_line(run: Run, folder: Path, value: Any):
    options = ("--geometry", "0.2,-4", "--colour", "white")
    status, out, err = run("material", "--from", asset(folder, value), *options, "-o", "sign.mtlx")
    assert (status, out) == (2, "") and "no number from 0 to 5000" in err and err.count("\n") == 1


def test_a_coefficient_of_nothing_and_one_of_too_much_are_refused(run: Run, folder: Path):
    for value, geometry, said in (
        (0, "0.2,-4", "nothing comes back"),
        (5000, "2,-4", "more than any white sheet has there"),
        (0.05, "0.2,-4", "the white film alone has more"),
    ):
        options = ("--geometry", geometry, "--colour", "white")
        status, _, err = run("material", "--from", asset(folder, value), *options, "-o", "sign.mtlx")
        assert status == 2 and said in err
    assert not (folder / "sign.mtlx").exists()


def test_an_asset_keeps_all_that_is_not_its_coefficient(run: Run, folder: Path):
    file = asset(folder, 250, note="kept")
    tree = json.loads(file.read_text())
    tree["geometryProperties"] = {"normal": [0, 0, 1]}
    tree["materialProperties"]["surfaceRoughness"] = {"roughness": 0.3}
    file.write_text(json.dumps(tree))
    options = ("--geometry", "0.3333,5", "--colour", "White")
    for source in (options, ()):  # the second time it says itself what it is of
        status, _, err = run("material", "--from", file, *source, "-o", file)
        assert status == 0, err
        found = json.loads(file.read_text())
        data = found["materialProperties"]["retroreflectivityData"]
        assert data["coefficientOfRetroreflection"] > 250 and data["note"] == "kept"
        assert data["sources"].endswith("colour white; illuminant A; before: a data sheet")
        for each in (found, tree):
            del each["materialProperties"]["retroreflectivityData"]
        assert found == tree
        tree["materialProperties"]["retroreflectivityData"] = None


@pytest.mark.parametrize("colour", ["White", "silver", "WHITE"])
def test_an_asset_of_ours_is_read_again_however_its_colour_was_spelt(run: Run, folder: Path, colour: str):
    options = ("--geometry", "0.3333,5", "--colour", colour)
    assert run("material", "--from", asset(folder), *options, "-o", "ours.xomp")[0] == 0
    assert read_asset(Path("ours.xomp")).colour == "white"
    status, out, err = run("material", "--from", "ours.xomp", "-o", "sign.mtlx")
    assert status == 0 and "white, shaped as RA2" in out, err


@pytest.mark.parametrize(
    "sources", ["observation 0.2. deg, entrance -4 deg", "observation . deg, entrance 4 deg"]
)
def test_angles_that_are_none_are_asked_for(run: Run, folder: Path, sources: str):
    status, _, err = run("material", "--from", asset(folder, sources=sources), "-o", "sign.mtlx")
    assert status == 2 and "as in --geometry 0.2,-4" in err and err.count("\n") == 1


def test_json_has_the_colour_s_own_name(run: Run, folder: Path):
    (folder / "sheet.mtlx").write_text(Retroreflector(0.3, 0.1).markup("sheet"))
    for name, given, said in (
        ("RA1", "Gray", "grey"),
        ("MUTCD 35 mph", "AMBER", "orange"),
        ("MUTCD 35 mph", None, "any"),
    ):
        options = () if given is None else ("--colour", given)
        _, out, err = run("photometry", "sheet.mtlx", "--class", name, *options, "--json")
        assert json.loads(out)["class"]["colour"] == said, err


def test_what_depends_on_the_view_alone_is_evaluated_at_one_point(
    run: Run, folder: Path, monkeypatch: pytest.MonkeyPatch
):
    most: list[int] = []
    evaluate = SheetPoints.eval

    def counted(self: SheetPoints, v: Any, l: Any) -> Any:  # noqa: E741  the field's own name
        most.append(len(self.uv))
        return evaluate(self, v, l)

    monkeypatch.setattr(SheetPoints, "eval", counted)
    text = material_for("RA1", "white").bsdf.markup("sheet")
    (folder / "sheet.mtlx").write_text(text)
    options = ("--class", "RA1", "--colour", "white")
    assert run("photometry", "sheet.mtlx", *options)[0] == 0
    assert max(most) == 64 and most[-1] == 1
    most.clear()
    # A pattern that no one of a few points meets.
    corner = """<texcoord name="uv" type="vector2" />
  <extract name="u" type="float"><input name="in" type="vector2" nodename="uv" /></extract>
  <ifgreater name="inside" type="float">
    <input name="value1" type="float" nodename="u" /><input name="value2" type="float" value="0.999" />
    <input name="in1" type="float" value="0" /><input name="in2" type="float" value="1" />
  </ifgreater>
  <nodegraph"""
    pattern = text.replace("<nodegraph", corner, 1).replace(
        'name="retroreflectivity" type="float" value="1"',
        'name="retroreflectivity" type="float" nodename="inside"',
    )
    (folder / "sheet.mtlx").write_text(pattern)
    run("photometry", "sheet.mtlx", *options)
    assert max(most) == 2048


def test_an_OpenPBR_document_says_what_it_is(run: Run, folder: Path):
    for name, colour in (("EN 1436 Q1", "grey"), ("RA1", "white")):
        options = ("--class", name, "--colour", colour, "--as", "open_pbr")
        status, out, err = run("material", *options, "-o", "surface.mtlx")
        assert status == 0, err
        doc = read_document("surface.mtlx").getNode("surface").getDocString()
        assert doc.startswith(f"{name}, {colour}: ") and "Design help, no certification." in doc
        assert "of which a share is retroreflective" not in out


def test_an_OpenPBR_surface_keeps_the_margin_or_is_refused(monkeypatch: pytest.MonkeyPatch):
    """One that never comes nearer than its minimum is in the class, but not by its margin."""
    from mrm_nodes.photometry import openpbr

    design = material_for("RA1", "white", margin=0.1)
    short = [dataclasses.replace(row, value=1.05 * row.requirement.minimum) for row in design.rows]
    monkeypatch.setattr(openpbr, "check", lambda *_: short)
    monkeypatch.setattr(openpbr, "_HIGHEST", 1e9)
    monkeypatch.setattr(openpbr, "_markup", lambda *_: design.bsdf.markup("sheet"))
    with pytest.raises(MrmError, match=r"no OpenPBR surface .* RA1, white, with a margin of 0.1"):
        openpbr.open_pbr_surface(design, "sheet")
