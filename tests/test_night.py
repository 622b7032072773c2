"""The road of classes by night: its luminances are what photometry says, and a headlamp is what its table says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mrm_nodes.cli import cli
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.photometry import luminance, luminance_coefficient, material_for, retroreflection
from mrm_nodes.render import Camera, probe_backends
from mrm_nodes.scenes import shapes
from mrm_nodes.scenes.compose import Room, Scene, Thing
from mrm_nodes.scenes.headlamp import Headlamp, dipped, find_headlamp
from mrm_nodes.scenes.night import (
    CLASSES,
    LEGEND,
    NightPicture,
    class_shader,
    false_colours,
    headlights,
    parse_classes,
    seen_of,
    with_legend,
)

needs_gl = pytest.mark.skipif(
    not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)
EVEN = Headlamp(np.array([-90.0, 90.0]), np.array([-90.0, 90.0]), np.full((2, 2), 12_000.0))


def middle(thing: Thing, camera: Camera) -> float:
    """The luminance of what the camera looks at, in the light of one lamp."""
    black = (0.0, 0.0, 0.0)
    lamps = headlights(EVEN, [(0.0, 0.65, 0.0)], size=0.0)
    scene = Scene([thing], camera, lamps, (black, black), room=Room((0.0, 1.0, -30.0), 20.0))
    seen = seen_of(scene, 0.05, 1, shadows=0.02)
    height, width = seen.luminance.shape
    return float(seen.luminance[height // 2, width // 2])


@needs_gl
@pytest.mark.parametrize(("name", "colour"), [("RA2", "red"), ("ISO 20471", "white")])
def test_a_sign_is_as_bright_as_its_coefficient_says(name: str, colour: str) -> None:
    """L = R_A E / cos β_v, for a sign 40 m ahead and 2 m high, a lamp at 0.65 m and an eye at 1.2 m."""
    sign = shapes.moved(shapes.plate("sign", 0.9, 0.9, 0.05), (0.0, 2.0, -40.0))
    camera = Camera((0.0, 1.2, 0.0), (0.0, 2.0, -40.0), fov=0.5)
    beta_l, beta_v = np.degrees(np.arctan([1.35 / 40.0, 0.8 / 40.0]))
    illuminance = 12_000.0 / (1.35**2 + 40.0**2)
    r_a = luminance(retroreflection(material_for(name, colour).bsdf, beta_l - beta_v, beta_l))
    expected = r_a * illuminance / np.cos(np.radians(beta_v))
    assert middle(Thing(sign, class_shader(name, colour), False), camera) == pytest.approx(
        float(expected), rel=0.01
    )


@needs_gl
def test_paint_is_as_bright_as_its_coefficient_says() -> None:
    """L = R_L E in the 30 m geometry: the lamp at 0.65 m, the eye at 1.2 m, the paint seen at 2.29° above it."""
    distance = 30.0
    line = shapes.ground("line", (-1.0, 1.0), (-45.0, -15.0))
    camera = Camera((0.0, 1.2, 0.0), (0.0, 0.0, -distance), fov=0.2)
    r_l = luminance(luminance_coefficient(material_for("EN 1436 dry", "white").bsdf))
    assert 1000 * r_l == pytest.approx(150.0, rel=0.01), "what the class asks for"
    expected = r_l * 12_000.0 / (0.65**2 + distance**2)
    seen = middle(Thing(line, class_shader("EN 1436 dry", "white"), False), camera)
    assert seen == pytest.approx(float(expected), rel=0.03)


def test_a_headlamp_is_linear_between_its_angles_and_dark_beyond() -> None:
    lamp = Headlamp(np.array([-10.0, 0.0, 20.0]), np.array([-4.0, 0.0]), np.array([[0, 10, 4], [2, 20, 8.0]]))

    def at(across: float, upwards: float) -> float:
        h, v = np.radians([across, upwards])
        return float(
            lamp.intensity(3.0 * np.array([np.sin(h) * np.cos(v), np.sin(v), -np.cos(h) * np.cos(v)]))
        )

    assert at(0, 0) == pytest.approx(20) and at(-10, 0) == pytest.approx(2) and at(20, -4) == pytest.approx(4)
    assert at(0, -1) == pytest.approx(17.5) and at(10, -2) == pytest.approx(10.5)
    assert at(21, -1) == at(0, 0.1) == at(180, -1) == 0.0
    assert dipped().intensity(np.array([0.0, -np.tan(np.radians(0.8)), -1.0])) == pytest.approx(20_000)
    assert find_headlamp("5000").candela.max() == pytest.approx(5000)
    points = np.array([[0.0, 0.65, -10.0], [0.0, 0.65, -20.0]])
    assert EVEN.illuminance((0.0, 0.65, 0.0), points) == pytest.approx([120.0, 30.0])


def test_a_table_of_a_headlamp_is_read_in_any_order(tmp_path: Path) -> None:
    table = tmp_path / "lamp.csv"
    table.write_text(
        "\ufeffVertical, Candela ,horizontal\n0,4,5\n-2,1,-5\n0,3,-5\n-2,2,5\n", encoding="utf-8"
    )
    lamp = find_headlamp(str(table))
    assert lamp.candela.tolist() == [[1.0, 2.0], [3.0, 4.0]] and lamp.horizontal.tolist() == [-5.0, 5.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the first line names the columns horizontal, vertical, candela"),
        ("horizontal,vertical\n1,2\n", "the first line names"),
        ("horizontal,vertical,candela\n0,0,x\n", "line 2: three numbers are wanted"),
        ("horizontal,vertical,candela\n0,0\n", "line 2: three numbers are wanted"),
        ("horizontal,vertical,candela\n0,0,nan\n", "line 2: angles are in degrees"),
        ("horizontal,vertical,candela\n0,0,-1\n", "line 2: angles are in degrees"),
        ("horizontal,vertical,candela\n0,0,1.1e7\n", "line 2: .* from 0 to 1e\\+07 cd"),
        ("horizontal,vertical,candela\n0,0,1\n0,1," + "1" * 200_000, "line 3: field larger than field limit"),
        ("x" * 200_000, "line 1: field larger than field limit"),
        ("horizontal,vertical,candela\n0,0,1\n0,0,1\n", "line 3: this direction is there already"),
        ("horizontal,vertical,candela\n0,0,1\n1,0,1\n0,1,1\n", "no grid"),
        ("horizontal,vertical,candela\n0,0,0\n1,0,0\n0,1,0\n1,1,0\n", "gives no light"),
    ],
)
def test_a_table_that_is_none_is_said(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "lamp.csv").write_text(text)
    with pytest.raises(MrmError, match=message):
        find_headlamp(str(tmp_path / "lamp.csv"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["road", "--class", "RA9"], "unknown class RA9"),
        (["road", "--class", "sing=RA2"], "unknown kind sing; did you mean sign?"),
        (["road", "--class", "paint=RA2"], "paint of RA2: a class with R_L is wanted, and it has R_A"),
        (["road", "--class", "EN 1436 dry"], "sign of EN 1436 dry: a class with R_A is wanted, and it has R_L"),
        (["road", "--class", "sign=ISO 20471"], "red"),
        (["cone", "--class", "RA2"], "--class is for the road"),
        (["raod", "--class", "RA2"], "unknown scene raod; did you mean road?"),
        (["road", "--class", "RA2", "--mesh", "sphere"], "--class is for the road"),
        (["road", "--class", "RA2", "--headlamp", "0"], "headlamp 0: the largest intensity is above 0"),
        (["road", "--class", "RA2", "--headlamp", "nan"], "headlamp nan: the largest"),
        (["road", "--class", "RA2", "--headlamp", "1.1e7"], "above 0 and at most 1e+07 cd"),
        (["road", "--class", "RA2", "--headlamp", "lamp.ies"], "headlamp lamp.ies: cannot be read"),
        (["road", "--headlamp", "100"], "name some with --class"),
    ],
)  # fmt: skip
def test_a_bad_request_is_said_and_nothing_is_written(
    arguments: list[str], message: str, tmp_path: Path
) -> None:
    output = tmp_path / "folder" / "a.png"
    result = CliRunner().invoke(cli, ["scene", *arguments, "-o", str(output)])
    assert isinstance(result.exception, MrmError) and message in str(result.exception), result.exception
    assert not output.parent.exists()


def test_a_class_without_a_kind_is_of_signs_cones_and_posts() -> None:
    assert parse_classes([]) == CLASSES
    chosen = parse_classes(["ra 1", "vest = ISO 20471", "cone=D4956 III"])
    assert (chosen["sign"], chosen["post"], chosen["cone"]) == ("RA1", "RA1", "D4956 III")


def test_false_colours_get_brighter_by_decades() -> None:
    shown = false_colours(np.array([0.0, 0.01, 0.1, 1.0, 10.0, 100.0, 1e4])) @ [0.2126, 0.7152, 0.0722]
    assert shown[0] == shown[1] and shown[-1] == shown[-2] and (np.diff(shown[1:-1]) > 0.01).all()


@needs_gl
def test_the_legend_lies_below_both_pictures() -> None:
    plate = Thing(
        shapes.moved(shapes.plate("sign", 3.0, 2.0, 0.05), (0.0, 1.2, -20.0)), class_shader("RA2", "red")
    )
    black = (0.0, 0.0, 0.0)
    camera = Camera((0.0, 1.2, 0.0), (0.0, 1.2, -20.0), fov=10.0)
    lamps = headlights(EVEN, [(0.0, 0.65, 0.0)], size=0.0)
    seen = seen_of(Scene([plate], camera, lamps, (black, black), room=Room((0, 1, -15), 10)), 0.3, 2, 0.1)
    sheet = with_legend(seen)
    height, width = seen.luminance.shape
    assert sheet.shape[1] == width and sheet.shape[0] > 2 * height
    assert np.array_equal(sheet[:height], seen.picture) and seen.picture.max() > 0.5
    assert sheet[2 * height :].max() > 0.5


def test_a_narrow_picture_has_its_legend_too() -> None:
    """The narrowest that the command draws."""
    sheet = with_legend(NightPicture(np.ones((16, 42)), np.ones((16, 42, 3), np.float32), 0.0))
    assert sheet.shape[1] == LEGEND and sheet[33 + 8 :].max() > 0.5
    left = (LEGEND - 42) // 2
    assert (sheet[:16, left : left + 42] == 1.0).all() and sheet[:16, :left].max() < 0.1


def test_what_an_exr_of_the_road_does_not_take_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = NightPicture(np.ones((8, 8)), np.ones((8, 8, 3), np.float32), -1.2345)
    black = (0.0, 0.0, 0.0)
    monkeypatch.setattr(
        "mrm_nodes.scenes.night.night_road", lambda *_: Scene([], Camera(), [], (black, black))
    )
    monkeypatch.setattr("mrm_nodes.scenes.night.seen_of", lambda *_, **__: seen)
    arguments = ["scene", "road", "--class", "RA2", "--exposure", "-1.2345", "--tonemap", "neutral"]
    with pytest.warns(MrmWarning, match="--exposure and --tonemap: an .exr has linear light"):
        result = CliRunner().invoke(cli, [*arguments, "-o", str(tmp_path / "a.exr")])
    assert result.exit_code == 0 and "exposure -1.2345 stops" in result.output
