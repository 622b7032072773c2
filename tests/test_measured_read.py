# ruff: noqa: E741  the field's own name
"""Readers of measured materials: each against files that are written here, from values that are known."""

from __future__ import annotations

import json
import math
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.measured import Measurement, read, write_xompt

Vector = tuple[float, float, float]


def unit(theta: float, phi: float) -> Vector:
    return math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)


def dot(a: Vector, b: Vector) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def known(v: Vector, l: Vector) -> float:
    """A reciprocal f of some peak about retroreflection."""
    return 0.1 + math.exp(-4.0 * (1.0 - dot(v, l))) * (v[2] * l[2]) ** 0.3


GRID = [
    (theta_l, theta_v, phi)
    for theta_l in (0.25, 0.5, 1.0)
    for theta_v in (0.05, 0.25, 0.3, 0.5, 0.8, 1.0, 1.3)
    for phi in (0.0, 0.4, 1.5, 2.5, 3.1, -1.0)
]
PAIRS = [(unit(theta_v, phi), unit(theta_l, 0.0)) for theta_l, theta_v, phi in GRID]


def angle(a: Vector, b: Vector) -> float:
    return math.acos(max(-1.0, min(1.0, dot(a, b))))


def about_light(v: Vector, l: Vector) -> tuple[float, float]:
    """θ_vl cos φ, θ_vl sin φ by the law of cosines, as ALTA's own from_cartesian has it."""
    between = angle(v, l)
    theta_l = math.acos(l[2])
    cosine = (v[2] - l[2] * math.cos(between)) / (math.sin(theta_l) * math.sin(between))
    sine = v[1] / math.sin(between)
    return between * cosine, between * sine


def about_back(v: Vector, l: Vector) -> tuple[float, float]:
    k = (v[0] - l[0], v[1] - l[1], v[2] + l[2])
    length = math.sqrt(dot(k, k))
    theta, phi = math.acos(k[2] / length), math.atan2(k[1], k[0])
    return theta * math.cos(phi), theta * math.sin(phi)


def half_difference(v: Vector, l: Vector) -> tuple[float, float, float, float]:
    h = (v[0] + l[0], v[1] + l[1], v[2] + l[2])
    length = math.sqrt(dot(h, h))
    theta_h, phi_h = math.acos(h[2] / length), math.atan2(h[1], h[0])
    # v turned by -phi_h about z, then by -theta_h about y.
    x = math.cos(phi_h) * v[0] + math.sin(phi_h) * v[1]
    y = math.cos(phi_h) * v[1] - math.sin(phi_h) * v[0]
    d = (
        math.cos(theta_h) * x - math.sin(theta_h) * v[2],
        y,
        math.sin(theta_h) * x + math.cos(theta_h) * v[2],
    )
    return theta_h, phi_h, math.acos(min(1.0, d[2])), math.atan2(d[1], d[0])


COORDINATES: dict[str, Callable[[Vector, Vector], tuple[float, ...]]] = {
    "ISOTROPIC_TL_TV_PROJ_DPHI": lambda v, l: (
        math.acos(l[2]),
        math.acos(v[2]) * math.cos(math.atan2(v[1], v[0])),
        math.acos(v[2]) * math.sin(math.atan2(v[1], v[0])),
    ),
    "ISOTROPIC_TV_TL_DPHI": lambda v, l: (math.acos(v[2]), math.acos(l[2]), -math.atan2(v[1], v[0])),
    "SPHERICAL_TL_PL_TV_PV": lambda v, l: (
        math.acos(l[2]),
        math.atan2(l[1], l[0]),
        math.acos(v[2]),
        math.atan2(v[1], v[0]),
    ),
    "RETRO_TL_TVL_PROJ_DPHI": lambda v, l: (math.acos(l[2]), *about_light(v, l)),
    "SCHLICK_TL_TK_PROJ_DPHI": lambda v, l: (math.acos(l[2]), *about_back(v, l)),
    "RUSIN_TH_PH_TD_PD": half_difference,
    "RUSIN_TH_TD_PD": lambda v, l: (half_difference(v, l)[0], *half_difference(v, l)[2:]),
    "CARTESIAN": lambda v, l: (*v, *l),
}


def alta(
    path: Path,
    name: str = "ISOTROPIC_TL_TV_PROJ_DPHI",
    factor: Callable[[Vector, Vector], float] = lambda v, l: 1.0,
    output: str | None = "INV_STERADIAN",
    number: str = "{:.17g}",
    extra: str = "",
    newline: str = "\n",
    separator: str = "  ",
    pairs: list[tuple[Vector, Vector]] = PAIRS,
) -> Path:
    """An ALTA file of `known`."""
    coordinates = [COORDINATES[name](v, l) for v, l in pairs if angle(v, l) > 1e-6]
    values = [known(v, l) * factor(v, l) for v, l in pairs if angle(v, l) > 1e-6]
    lines = ['#SAMPLE "A tape"', f"#DIM {len(coordinates[0])} 1", "#VS 0", f"#PARAM_IN {name}"]
    lines += [f"#PARAM_OUT {output}"] if output else []
    lines += [extra] if extra else []
    for place, value in zip(coordinates, values, strict=True):
        lines.append(separator.join(number.format(each) for each in (*place, value)))
    path.write_bytes((newline.join(lines) + newline).encode())
    return path


def check(found: Measurement, rel: float = 1e-9, turned: bool = False) -> None:
    """Every sample has the value that belongs to its directions."""
    assert len(found) >= 100
    for v, l, value in zip(found.v, found.l, found.value, strict=True):
        assert value[0] == pytest.approx(known(tuple(v), tuple(l)), rel=rel)
    expected = sorted(round(angle(v, l), 5) for v, l in PAIRS if angle(v, l) > 1e-6)
    assert sorted(np.round(found.from_retro, 5)) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("name", COORDINATES)
def test_each_of_altas_coordinates(name: str, tmp_path: Path):
    found = read(alta(tmp_path / "a.dat", name))
    check(found, rel=1e-6)
    assert found.sample == "A tape" and found.channels == ("luminance",)


@pytest.mark.parametrize("name", [name for name in COORDINATES if not name.startswith("RUSIN_TH_")])
def test_the_viewer_is_the_viewer(name: str, tmp_path: Path):
    """A reciprocal f does not tell the two directions apart; the angles of the light do."""
    found = read(alta(tmp_path / "a.dat", name))
    assert set(np.round(found.theta_l, 6)) == {0.25, 0.5, 1.0}


def test_the_light_along_the_normal(tmp_path: Path):
    path = tmp_path / "a.dat"
    path.write_text(
        "#DIM 2 1\n#PARAM_IN ISOTROPIC_TV_PROJ_DPHI\n#PARAM_OUT INV_STERADIAN\n0.3 0.4 2.0\n0 0 3\n"
    )
    found = read(path)
    assert found.l == pytest.approx(np.array([[0, 0, 1.0], [0, 0, 1.0]]))
    assert found.v[0] == pytest.approx([0.6 * math.sin(0.5), 0.8 * math.sin(0.5), math.cos(0.5)])
    assert found.v[1] == pytest.approx([0, 0, 1])


ODD: dict[str, dict[str, Any]] = {
    "Windows": {"newline": "\r\n"},
    "old Macintosh": {"newline": "\r"},
    "tabs": {"separator": "\t"},
    "commas": {"separator": ", "},
    "scientific": {"number": "{:.12e}"},
    "capital exponents": {"number": "{:.12E}"},
    "comments": {"extra": "# measured in May\n#\n#CMPL 1\n#URL http://example.org/a#b"},
    "blank lines": {"extra": "\n   \n"},
    "small letters": {"extra": "#param_out INV_STERADIAN", "output": None},
    "a colon": {"extra": "# PARAM_OUT: INV_STERADIAN", "output": None},
    "an unknown output": {"output": "UNKNOWN_OUTPUT"},
    "a mark": {"extra": "\ufeff"},
}


@pytest.mark.parametrize("how", ODD)
def test_files_as_others_write_them(how: str, tmp_path: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check(read(alta(tmp_path / "a.dat", **ODD[how])), rel=1e-6)


def test_errors_of_values_may_follow_them(tmp_path: Path):
    path = tmp_path / "a.dat"
    path.write_text(
        "#DIM 3 1\n#VS 2\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n0.3 0.4 0.1 2.0 1.9 2.1\n", "latin-1"
    )
    assert read(path, "none").value == pytest.approx(np.array([[2.0]]))


def test_a_name_in_an_old_encoding(tmp_path: Path):
    path = tmp_path / "a.dat"
    path.write_bytes(
        '#SAMPLE "réflecteur"\n#DIM 3 3\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n0.3 0.4 0.1 1 2 3\n'.encode(
            "latin-1"
        )
    )
    found = read(path, "none")
    assert found.sample == "réflecteur" and found.channels == ("R", "G", "B")
    assert found.value == pytest.approx(np.array([[1.0, 2.0, 3.0]]))


FACTORS: dict[str, Callable[[Vector, Vector], float]] = {
    "none": lambda v, l: 1.0,
    "view": lambda v, l: v[2],
    "light": lambda v, l: l[2],
}


@pytest.mark.parametrize("claim", ["INV_STERADIAN", "INV_STERADIAN_COSINE_FACTOR", None])
@pytest.mark.parametrize("factor", FACTORS)
def test_reciprocity_says_which_cosine_it_is(factor: str, claim: str | None, tmp_path: Path):
    path = alta(tmp_path / "a.dat", factor=FACTORS[factor], output=claim)
    right = {"none": ("INV_STERADIAN", None), "view": ("INV_STERADIAN_COSINE_FACTOR",), "light": ()}[factor]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        check(read(path))
    assert [each.category for each in told] == ([] if claim in right else [MrmWarning])
    if told:
        assert "by reciprocity its values are" in str(told[0].message)


def test_without_pairs_the_header_is_believed(tmp_path: Path):
    one = [(v, l) for v, l in PAIRS if math.acos(l[2]) < 0.3]
    path = alta(tmp_path / "a.dat", factor=FACTORS["view"], output="INV_STERADIAN_COSINE_FACTOR", pairs=one)
    found = read(path)
    assert found.value[0, 0] == pytest.approx(known(tuple(found.v[0]), tuple(found.l[0])))
    path = alta(tmp_path / "b.dat", output=None, pairs=one)
    with pytest.warns(MrmWarning, match="neither its header nor reciprocity"):
        read(path)


def test_what_is_asked_for_is_done(tmp_path: Path):
    path = alta(tmp_path / "a.dat")
    with pytest.warns(MrmWarning, match="as asked; by reciprocity its values are plain f"):
        found = read(path, "view")
    v, l, value = found.v[5], found.l[5], found.value[5, 0]
    assert value == pytest.approx(known(tuple(v), tuple(l)) / v[2])
    with pytest.raises(MrmError, match="did you mean view"):
        read(path, "veiw")


def merl(path: Path, shape: tuple[int, int, int] = (90, 90, 180)) -> Path:
    """Red is 1 + θ_d's cell, green 2, blue 3 times that, in MERL's units; below the horizon -1."""
    values = []
    for channel, scale in enumerate((1500.0, 1500.0 / 1.15, 1500.0 / 1.66)):
        for i in range(shape[0]):
            for j in range(shape[1]):
                value = (1.0 + j) * (channel + 1) * scale
                row = [value if i < 60 else -1.0] * shape[2]
                values.append(struct.pack(f"<{shape[2]}d", *row))
    path.write_bytes(struct.pack("<3i", *shape) + b"".join(values))
    return path


def test_merl(tmp_path: Path):
    found = read(merl(tmp_path / "tape.binary"))
    assert found.channels == ("R", "G", "B") and found.sample == "tape"
    some = np.random.default_rng(1).integers(0, len(found), 300)
    for v, l, value in zip(found.v[some], found.l[some], found.value[some], strict=True):
        theta_h, _, theta_d, _ = half_difference(tuple(v), tuple(l))
        cell = math.floor(math.degrees(theta_d))
        assert value == pytest.approx([(1.0 + cell) * (channel + 1) for channel in range(3)])
        assert theta_h < 0.5 * math.pi * (60 / 90) ** 2
        assert v[2] > 0 and l[2] > 0


def tensor_file(path: Path, fields: dict[str, np.ndarray[Any, Any]]) -> Path:
    """RGL's container: a table of names, shapes, types and places, then the arrays."""
    kinds = {"uint8": 1, "float32": 10}
    size = 12 + 2 + 4 + sum(2 + len(name) + 2 + 1 + 8 + 8 * array.ndim for name, array in fields.items())
    head = b"tensor_file\0" + bytes((1, 0)) + struct.pack("<I", len(fields))
    body = b""
    for name, array in fields.items():
        head += (
            struct.pack("<H", len(name))
            + name.encode()
            + struct.pack("<HB", array.ndim, kinds[array.dtype.name])
        )
        head += struct.pack("<Q", size + len(body)) + struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    path.write_bytes(head + body)
    return path


def rgl(path: Path) -> Path:
    """A table whose spectrum is 1, 2 and 3 everywhere, of an even distribution of normals and area 0.5."""
    theta = np.array([0.0, 0.8, 1.6], np.float32)
    phi = np.array([0.0], np.float32)
    even = np.ones((4, 4), np.float32)
    rgb = np.ones((1, 3, 3, 4, 4), np.float32) * np.array([1, 2, 3], np.float32)[None, None, :, None, None]
    return tensor_file(
        path,
        {
            "description": np.frombuffer(b"made up", np.uint8),
            "phi_i": phi,
            "theta_i": theta,
            "ndf": even,
            "sigma": 0.5 * even,
            "vndf": np.ones((1, 3, 4, 4), np.float32),
            "luminance": np.ones((1, 3, 4, 4), np.float32),
            "rgb": rgb,
            "jacobian": np.array([1], np.uint8),
        },
    )


def test_rgl(tmp_path: Path):
    pytest.importorskip("mitsuba")
    found = read(rgl(tmp_path / "tape_rgb.bsdf"))
    # The format's own equation: spectrum D / (4 σ), which holds the cosine.
    expected = np.array([1.0, 2.0, 3.0]) * 1.0 / (4.0 * 0.5) / found.v[:, 2:]
    np.testing.assert_allclose(found.value, expected, rtol=1e-4)
    assert found.from_retro.min() < 1e-6 and found.channels == ("R", "G", "B")


def test_rgl_leaves_mitsuba_as_it_was(tmp_path: Path):
    mitsuba = pytest.importorskip("mitsuba")
    before = mitsuba.variant()
    path = rgl(tmp_path / "a.bsdf")
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(MrmError, match="Mitsuba does not read it"):
        read(path)
    assert mitsuba.variant() == before


def astm(path: Path, names: str = "value", stated: int | None = None, newline: str = "\n") -> Path:
    lines = ["SOURCE made up", f"NUM_POINTS {len(GRID) if stated is None else stated}"]
    lines.append(f"VARS=theta_i,phi_i,theta_s,phi_s,{names}")
    for theta_l, theta_v, phi in GRID:
        value = known(unit(theta_v, phi + 0.2), unit(theta_l, 0.2))
        values = [value * (k + 1) for k in range(names.count(",") + 1)]
        lines.append(",".join(repr(each) for each in (theta_l, 0.2, theta_v, phi + 0.2, *values)))
    path.write_bytes(newline.join(lines).encode())
    return path


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_astm(newline: str, tmp_path: Path):
    found = read(astm(tmp_path / "a.astm", newline=newline))
    for v, l, value in zip(found.v, found.l, found.value, strict=True):
        assert value[0] == pytest.approx(known(tuple(v), tuple(l)))
    assert sorted(np.round(found.from_retro, 6)) == sorted(round(angle(v, l), 6) for v, l in PAIRS)
    coloured = read(astm(tmp_path / "b.astm", "R,G,B"))
    assert coloured.channels == ("R", "G", "B")
    assert coloured.value[:, 2] == pytest.approx(3.0 * coloured.value[:, 0])


def xompt(path: Path, rows: list[list[float | None]]) -> Path:
    path.write_text(
        json.dumps({"metadata": {"name": "a tape"}, "brdf": {"wavelengths": [], "lookupTable": rows}})
    )
    return path


def test_openmaterial(tmp_path: Path):
    rows: list[list[float | None]] = [
        [
            wavelength,
            theta_l,
            theta_v,
            phi % (2.0 * math.pi),
            known(unit(theta_v, phi), unit(theta_l, 0.0)) * factor,
        ]
        for wavelength, factor in ((4.5e-7, 1.0), (5.55e-7, 2.0))
        for theta_l, theta_v, phi in GRID
    ]
    found = read(xompt(tmp_path / "a.xompt", rows))
    check_all = [known(tuple(v), tuple(l)) for v, l in zip(found.v, found.l, strict=True)]
    assert found.channels == ("450 nm", "555 nm") and found.sample == "a tape"
    assert found.value[:, 0] == pytest.approx(check_all) and found.value[:, 1] == pytest.approx(
        2 * np.array(check_all)
    )
    assert found.pick(["555 nm"]).value[:, 0] == pytest.approx(found.value[:, 1])
    with pytest.raises(MrmError, match="did you mean 555 nm"):
        found.pick(["556 nm"])
    with (
        pytest.warns(MrmWarning, match="1 rows have no value"),
        pytest.warns(MrmWarning, match="1 directions lack one of the 2 wavelengths"),
    ):
        assert len(read(xompt(tmp_path / "b.xompt", [[*rows[0][:4], None], *rows[1:]]))) == len(GRID) - 1


@pytest.mark.parametrize("channels", [("luminance",), ("R", "G", "B"), ("450 nm", "620 nm")])
def test_openmaterial_is_read_as_it_was_written(channels: tuple[str, ...], tmp_path: Path):
    v, l = (np.array(each) for each in zip(*PAIRS, strict=True))
    value = np.array([[known(*pair) * (k + 1) for k in range(len(channels))] for pair in PAIRS])
    write_xompt(tmp_path / "a.xompt", Measurement(v, l, value, channels, "tape"))
    found = read(tmp_path / "a.xompt")
    assert found.channels == channels and found.sample == "tape"
    order = lambda m: np.lexsort(np.round([m.theta_l, m.theta_v, m.v[:, 1]], 5))  # noqa: E731
    before = Measurement(v, l, value, channels)
    for name in ("v", "l", "value"):
        np.testing.assert_allclose(
            getattr(found, name)[order(found)], getattr(before, name)[order(before)], atol=2e-6
        )
    table = json.loads((tmp_path / "a.xompt").read_text())
    rows = table["brdf"]["lookupTable"]
    assert rows == sorted(rows) and all(0 <= row[3] <= 6.283185 and row[1] <= 1.570796 for row in rows)
    assert {
        "name",
        "uuid",
        "materialVersion",
        "openMaterial3dVersion",
        "copyrights",
        "license",
        "authors",
        "sources",
    } <= set(table["metadata"])


CSV = {
    "radians": ("theta_l,theta_v,dphi,f", lambda t, v, p, f: (t, v, p, f), ","),
    "degrees": (
        "theta_v_deg;theta_l_deg;phi_v_deg;phi_l_deg;value",
        lambda t, v, p, f: (math.degrees(v), math.degrees(t), math.degrees(p) + 10.0, 10.0, f),
        ";",
    ),
    "units in brackets": (
        "Theta_L (deg)\tTheta_V [deg]\tdphi [deg]\tBRDF",
        lambda t, v, p, f: (math.degrees(t), math.degrees(v), math.degrees(p), f),
        "\t",
    ),
    "vectors": (
        "vx vy vz lx ly lz f",
        lambda t, v, p, f: (*unit(v, p), *unit(t, 0.0), f),
        " ",
    ),
    "colours": ("theta_l,theta_v,dphi,R,G,B", lambda t, v, p, f: (t, v, p, f, 2 * f, 3 * f), ","),
}


@pytest.mark.parametrize("kind", CSV)
def test_csv(kind: str, tmp_path: Path):
    header, row, separator = CSV[kind]
    lines = ["# made up", header]
    for theta_l, theta_v, phi in GRID:
        f = known(unit(theta_v, phi), unit(theta_l, 0.0))
        lines.append(separator.join(repr(each) for each in row(theta_l, theta_v, phi, f)))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(lines))
    found = read(path)
    for v, l, value in zip(found.v, found.l, found.value, strict=True):
        assert value[0] == pytest.approx(known(tuple(v), tuple(l)))
    assert sorted(np.round(found.from_retro, 6)) == sorted(round(angle(v, l), 6) for v, l in PAIRS)
    assert sorted(np.round(found.theta_l, 6)) == sorted(round(t, 6) for t, _, _ in GRID)


@pytest.mark.parametrize(
    "text",
    [
        '"theta_v_deg","theta_l_deg","dphi_deg","f"\n"10.5","20","0","1.5"\n"10","30","0","2"\n',
        "theta_v_deg,theta_l_deg,dphi_deg,f,\n10.5,20,0,1.5,\n10,30,0,2,\n",
        "theta_v_deg,theta_l_deg,dphi_deg,f\n10.5,20,0,1.5,,\n10,30,0,2\n",
        "theta_v_deg;theta_l_deg;dphi_deg;f\r\n10,5;20;0;1,5\r\n10;30;0;2\r\n",
        "\ufefftheta_v_deg;theta_l_deg;dphi_deg;f\n10,5;20;0;1,5E+00\n10;30;0;2;\n",
        "sep=;\ntheta_v_deg;theta_l_deg;dphi_deg;f\n10.5;20;0;1.5\n10;30;0;2\n",
        '"theta_v (deg)";"theta_l (deg)";"dphi (deg)";"f"\n"10,5";"20";"0";"1,5"\n10;30;0;2\n',
        "theta_v_deg\ttheta_l_deg\tdphi_deg\tf\n10,5\t20\t0\t1,5\n10\t30\t0\t2\n",
        "theta_v_deg, theta_l_deg, dphi_deg, f\n10.5, 20, 0, 1.5\n# a note\n\n10, 30, 0, 2\n",
        "theta_v_deg theta_l_deg dphi_deg f\n10,5 20 0 1,5\n10 30 0 2\n",
    ],
)
def test_csv_as_spreadsheets_write_it(text: str, tmp_path: Path):
    path = tmp_path / "a.csv"
    path.write_text(text, encoding="utf-8", newline="")
    found = read(path)
    assert found.value[:, 0].tolist() == [1.5, 2.0]
    assert np.degrees(found.theta_v) == pytest.approx([10.5, 10.0])
    assert np.degrees(found.theta_l) == pytest.approx([20.0, 30.0])


def test_csv_of_coefficients(tmp_path: Path):
    """R_A at 0.2° and -4°, which is f cos cos: photometry's own worked example."""
    path = tmp_path / "a.csv"
    path.write_text("observation,beta1,R_A\n0.2,-4,101.17\n0.2,30,80\n")
    found = read(path)
    assert found.value[0, 0] == pytest.approx(101.69, rel=1e-4)
    assert np.degrees(found.from_retro) == pytest.approx([0.2, 0.2], rel=1e-3)


GOOD = "#DIM 3 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n"
BAD = {
    "no rows": (GOOD, "no sample in it"),
    "truncated": (GOOD + "0.3 0.4 0.1 2\n0.3 0.", "line 4 has 2 numbers, the first row 4: is the file whole"),
    "words": (GOOD + "0.3 0.4 0.1 x2\n", "line 3: .* is no row of numbers"),
    "another dimension": (
        "#DIM 4 1\n#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI\n1 1 1 1 1\n",
        "DIM says 4 coordinates",
    ),
    "too many columns": (GOOD + "0.3 0.4 0.1 2 3\n", "a row has 5 numbers, but 3 coordinates and 1 values"),
    "DIM of words": ("#DIM three 1\n#PARAM_IN CARTESIAN\n1 1 1 1 1\n", "DIM three 1"),
    "NaN": (GOOD + "0.3 0.4 0.1 nan\n", "the value of sample 1 is no finite number"),
    "infinite": (GOOD + "0.3 0.4 0.1 1\n0.3 0.4 0.1 inf\n", "the value of sample 2 is no finite number"),
    "negative": (GOOD + "0.3 0.4 0.1 1\n0.3 0.4 0.1 -2\n", "the value of sample 2 is negative"),
    "degrees": (GOOD + "15 30 5 1\n", "30.* looks like degrees|15.* looks like degrees"),
    "degrees of the light": (GOOD + "60 0.1 0.1 1\n", "60, beyond .* degrees"),
    "no PARAM_IN": ("#DIM 3 1\n0.3 0.4 0.1 1\n", "no PARAM_IN"),
    "unknown PARAM_IN": (
        "#PARAM_IN ISOTROPIC_TL_TV\n0.3 0.4 1\n",
        "unknown PARAM_IN ISOTROPIC_TL_TV; did you mean",
    ),
    "unknown PARAM_OUT": (GOOD + "#PARAM_OUT STERADIAN\n0.3 0.4 0.1 1\n", "unknown PARAM_OUT STERADIAN"),
    "no unit": ("#PARAM_IN CARTESIAN\n1 1 1 0 0 1 1\n", "sample 1: a direction is not of unit length"),
    "NaN angle": (GOOD + "nan 0.4 0.1 1\n", "no finite number|NaN"),
    "empty": ("  \n", "is empty"),
    "below the horizon": ("#PARAM_IN CARTESIAN\n0 0 -1 0 0 1 1\n", "it has no sample"),
    "json": ("{", "no JSON"),
    "other json": ('{"brdf": {}}', "no brdf.lookupTable"),
    "short row": (
        '{"brdf": {"lookupTable": [[5e-7, 0.1, 0.1, 0.1]]}}',
        "row 1 of lookupTable is not five numbers",
    ),
    "xompt degrees": ('{"brdf": {"lookupTable": [[5e-7, 10, 10, 0, 1]]}}', "looks like degrees"),
    "xompt nanometres": ('{"brdf": {"lookupTable": [[555, 0.1, 0.1, 0, 1]]}}', "metres are meant"),
    "xompt negative": (
        '{"brdf": {"lookupTable": [[5e-7, 0.1, 0.1, 0, -1]]}}',
        "row 1: the value is negative",
    ),
    "xompt huge": (
        '{"brdf": {"lookupTable": [[5e-7, 0.1, 0.1, 0, 1], [5e-7, 0.1, 0.1, 0, 1' + "0" * 400 + "]]}}",
        "row 2 of lookupTable is not five numbers",
    ),
    "xompt beyond all": ('{"brdf": 1' + "0" * 5000 + "}", "no JSON"),
    "xompt deep": ('{"a":' + "[" * 500 + "]" * 500 + "}", "no JSON: more than 100"),
    "xompt true": ('{"brdf": {"lookupTable": [[5e-7, 0.1, 0.1, 0, true]]}}', "row 1 of lookupTable"),
    "no header": ("0.1,0.2,0.3,1\n", "its first line names no columns"),
    "no values": ("theta_v,theta_l,dphi\n0,0,0\n", "no column of values"),
    "no light": ("theta_v,dphi,f\n0,0,0\n", "no column theta_l"),
    "no azimuth": ("theta_v,theta_l,f\n0,0,0\n", "no column dphi"),
    "csv degrees": ("theta_v,theta_l,dphi,f\n30,15,0,1\n", "name the column theta_v_deg"),
    "csv truncated": ("theta_v,theta_l,dphi,f\n0.1,0.2,0,1\n0.1,0", "line 3 has 2 numbers, not 4"),
    "csv twice": ("theta_v,theta_v,theta_l,f\n0.1,0.2,0,1\n", "named twice"),
    "csv negative": ("theta_v,theta_l,dphi,f\n0.1,0.2,0,-1\n", "negative"),
    "csv NaN": (
        "vx,vy,vz,lx,ly,lz,f\n0,0,1,0,0,1,1\n0,0,1,0,nan,1,1\n",
        "sample 2: a direction is not of unit length",
    ),
    "csv NaN of a goniometer": (
        "observation,beta1,R_A\n0.2,5,1\n0.2,nan,1\n",
        "beta1 of sample 2 is no finite number",
    ),
    "csv two commas": ("theta_v;theta_l;dphi;f\n0,1;0,2;0;1,2,3\n", "line 2: .* is no row of numbers"),
    "csv thousands": ('theta_v,theta_l,dphi,f\n0.1,0.2,0,"1,234"\n', "line 2: .* is no row of numbers"),
    "csv open quote": (
        'theta_v,theta_l,dphi,f\n0.1,0.2,0,"1\n0.1,0.2,0,x"\n',
        "line 3: .* is no row of numbers",
    ),
    "csv names of a data sheet": (
        "Observation Angle,Entrance Angle,R_A\n0.2,5,1\n",
        "observation_angle, entrance_angle: name the observation angle's column observation, .* beta1",
    ),
    "goniometer": ("observation,beta1,R_A\n0.2,100,1\n", "beyond 90°"),
    "astm short": ("NUM_POINTS 1\nVARS=a,b,c\n", "VARS names 3 columns"),
    "binary": ("\x00\x01\x02\x00", "none of the formats"),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_files_are_one_line(kind: str, tmp_path: Path):
    text, message = BAD[kind]
    path = tmp_path / "a.dat"
    path.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        warnings.simplefilter("ignore", MrmWarning)
        with pytest.raises(MrmError, match=message) as caught:
            read(path)
    assert "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_other_bad_files(tmp_path: Path):
    whole = merl(tmp_path / "a.binary").read_bytes()
    (tmp_path / "b.binary").write_bytes(whole[:-8])
    (tmp_path / "c.binary").write_bytes(struct.pack("<3i", 45, 90, 180) + whole[12:])
    (tmp_path / "d.binary").write_bytes(b"short")
    (tmp_path / "e.binary").write_bytes(whole[:12] + struct.pack("<d", math.nan) + whole[20:])
    for name, message in {
        "b": "is the file whole",
        "c": r"dimensions \(45, 90, 180\)",
        "d": "5 bytes",
        "e": "value 1 is no finite number",
    }.items():
        with pytest.raises(MrmError, match=message):
            read(tmp_path / f"{name}.binary")
    with pytest.raises(MrmError, match="NUM_POINTS says 7"):
        read(astm(tmp_path / "a.astm", stated=7))
    with pytest.raises(MrmError, match="no such file"):
        read(tmp_path / "missing.dat")
    with pytest.raises(MrmError, match="cannot be read"):
        read(tmp_path)
    with pytest.raises(MrmError, match="its format has plain f"):
        read(tmp_path / "a.binary", "view")


def test_between_samples(tmp_path: Path):
    """A sample comes back as itself, a mirrored or turned one too, and one between lies between."""
    found = read(alta(tmp_path / "a.dat"))
    again = found.resampled(found.v, found.l)
    np.testing.assert_allclose(again.value, found.value, rtol=1e-6)
    mirrored = found.resampled(found.v * [1, -1, 1], found.l)
    np.testing.assert_allclose(mirrored.value, found.value, rtol=1e-6)
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(found.eval(found.v @ turn, found.l @ turn)[:, 1], found.value[:, 0], rtol=1e-6)
    between = found.eval(unit(0.28, 0.1), unit(0.25, 0.0))
    assert between.shape == (3,) and found.value.min() < between[0] < found.value.max()


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "mrm_nodes", *arguments], capture_output=True, text=True, check=False
    )


def test_the_command_writes_a_fit(tmp_path: Path):
    path = alta(tmp_path / "a.dat", newline="\r\n")
    done = run(
        "fit",
        str(path),
        "-o",
        str(tmp_path / "out" / "tape.mtlx"),
        "--plot",
        "--no-compare",
        "--hold-out",
        "28.6",
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "tape.mtlx").is_file() and (tmp_path / "out" / "tape.svg").is_file()
    assert "RMSE of ln(f + 0.001)" in done.stdout and "five folds" in done.stdout
    assert "where it is left out" in done.stdout and "deviation" in done.stdout
    assert 'name="tape" type="material"' in (tmp_path / "out" / "tape.mtlx").read_text()


def test_the_command_says_what_is_best(tmp_path: Path):
    from test_measured_fit import made

    data = made("widening", 0.02)
    write_xompt(tmp_path / "a.xompt", data)
    done = run("fit", str(tmp_path / "a.xompt"), "-o", str(tmp_path / "a.mtlx"))
    assert done.returncode == 0, done.stderr
    assert "models, best first:" in done.stdout and "comes nearer: --model" in done.stdout
    table = done.stdout.split("models, best first:")[1]
    assert "* layered" in table and table.index("widening") < table.index("layered")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{good}", "-o", "{folder}/a.xml"], "unknown document ending .xml"),
        (["{good}", "-o", "{folder}/a.mtlx", "--model", "layred"], "did you mean layered"),
        (["{good}", "-o", "{folder}/a.mtlx", "--plot", "{folder}/a.bmp"], "unknown ending .bmp of a plot"),
        (["{good}", "-o", "{folder}/a.mtlx", "--hold-out", "45"], "no light at 45°"),
        (["{good}", "-o", "{folder}/a.mtlx", "--channel", "R"], "unknown channel R"),
        (["{bad}", "-o", "{folder}/a.mtlx"], "looks like degrees"),
        (["{few}", "-o", "{folder}/a.mtlx"], "too few to fit"),
    ],
)
def test_bad_requests_write_nothing(arguments: list[str], message: str, tmp_path: Path):
    alta(tmp_path / "good.dat")
    (tmp_path / "bad.dat").write_text(BAD["degrees"][0])
    (tmp_path / "few.dat").write_text(GOOD + "#PARAM_OUT INV_STERADIAN\n0.3 0.4 0.1 2\n0.3 0.3 0.1 2\n")
    folder = tmp_path / "out"
    places = {
        "good": tmp_path / "good.dat",
        "bad": tmp_path / "bad.dat",
        "few": tmp_path / "few.dat",
        "folder": folder,
    }
    done = run("fit", *(each.format(**places) for each in arguments))
    assert done.returncode == 2
    assert message in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert not folder.exists()
