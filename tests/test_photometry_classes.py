"""The classes: their values are those that were read, and a slip of the pen in any of them would be seen."""

from __future__ import annotations

import dataclasses
import itertools
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes import photometry
from mrm_nodes import reference as ref
from mrm_nodes.errors import MrmError
from mrm_nodes.photometry import RetroClass

SHARED = Path(__file__).parents[2] / "shared" / "data" / "retroreflection_classes.toml"

# Added up from the notes that were taken when the sources were read, by colour and by geometry.
SUMS = {
    "ISO 20471": (
        {"white": 1633},
        {
            "0.2/5": 330,
            "0.2/20": 290,
            "0.2/30": 180,
            "0.2/40": 65,
            "0.3333/5": 250,
            "0.3333/20": 200,
            "0.3333/30": 170,
            "0.3333/40": 60,
            "1/5": 25,
            "1/20": 15,
            "1/30": 12,
            "1/40": 10,
            "1.5/5": 10,
            "1.5/20": 7,
            "1.5/30": 5,
            "1.5/40": 4,
        },
    ),
    "RA1": (
        {
            "white": 202,
            "yellow": 141.5,
            "orange": 69.2,
            "red": 40.3,
            "green": 26.2,
            "blue": 9.6,
            "brown": 2.6,
            "grey": 121.2,
        },
        {
            "0.2/5": 215.5,
            "0.2/30": 91.5,
            "0.2/40": 29.3,
            "0.3333/5": 154.6,
            "0.3333/30": 70.6,
            "0.3333/40": 25.8,
            "2/5": 13.9,
            "2/30": 7,
            "2/40": 4.4,
        },
    ),
    "RA2": (
        {
            "white": 894,
            "yellow": 595.5,
            "orange": 317.5,
            "red": 138.7,
            "green": 127,
            "blue": 68.4,
            "brown": 41.9,
            "grey": 446.4,
        },
        {
            "0.2/5": 767,
            "0.2/30": 454.5,
            "0.2/40": 304,
            "0.3333/5": 523,
            "0.3333/30": 299,
            "0.3333/40": 256,
            "2/5": 13.9,
            "2/30": 7.1,
            "2/40": 4.9,
        },
    ),
    "D4956 I": (
        {"white": 145, "yellow": 110, "orange": 49, "red": 30.5, "green": 19.2, "blue": 8.5, "brown": 1.8},
        {"0.2/-4": 173, "0.2/30": 70.5, "0.5/-4": 82.3, "0.5/30": 38.2},
    ),
    "D4956 II": (
        {"white": 278, "yellow": 189, "orange": 114, "red": 58, "green": 55, "blue": 19, "brown": 10},
        {"0.2/-4": 375, "0.2/30": 146, "0.5/-4": 127, "0.5/30": 75},
    ),
    "D4956 III": (
        {"white": 880, "yellow": 590, "orange": 352, "red": 156, "green": 156, "blue": 69, "brown": 44.5},
        {"0.1/-4": 766, "0.1/30": 460, "0.2/-4": 642, "0.2/30": 379.5},
    ),
    "number plate": (
        {"white": 92, "yellow": 62.5, "blue": 3.8},
        {"0.3333/5": 87, "0.3333/30": 41, "0.3333/40": 15.4, "1.5/5": 8.2, "1.5/30": 4.1, "1.5/40": 2.6},
    ),
    "SMV emblem": (
        {"red": 33},
        {"0.2/0": 10, "0.2/15": 7, "0.2/30": 5, "0.5/0": 5, "0.5/15": 4, "0.5/30": 2},
    ),
}
ROADS = {
    ("EN 1436 dry", "white"): 150,
    ("EN 1436 dry", "yellow"): 200,
    ("EN 1436 RW2", "any"): 35,
    ("EN 1436 RR2", "any"): 35,
    ("EN 1436 Q1", "any"): 80,
    ("EN 1436 Q2", "any"): 100,
    ("EN 1436 Q3", "any"): 130,
    ("MUTCD 35 mph", "any"): 50,
    ("MUTCD 70 mph", "any"): 100,
}

Table = Mapping[tuple[str, float, float], float]
"""Minima by colour, observation and entrance angle."""


def table_of(found: RetroClass) -> Table:
    return {
        (colour, each.observation or 0.0, each.beta1 or 0.0): each.minimum
        for colour, rows in found.requirements.items()
        for each in rows
    }


def rises(table: Table) -> list[str]:
    """Where a value is above that of a smaller entrance or observation angle."""
    return [
        f"{a} < {b}"
        for a, b in itertools.permutations(table, 2)
        if a[0] == b[0] and a[1] <= b[1] and abs(a[2]) <= abs(b[2]) and table[a] < table[b]
    ]


def wrong_sums(name: str, table: Table) -> list[str]:
    """The colours and geometries whose values do not add up to those that were read."""
    colours, geometries = SUMS[name]
    found: dict[str, float] = {}
    for (colour, observation, beta1), value in table.items():
        for key in (colour, f"{observation:g}/{beta1:g}"):
            found[key] = found.get(key, 0.0) + value
    expected: dict[str, float] = {**colours, **geometries}
    assert found.keys() == expected.keys()
    return [key for key, value in expected.items() if abs(found[key] - value) > 1e-6]


def slips(table: Table) -> Iterator[tuple[str, Table]]:
    """The table with one slip of the pen: a digit off, a point moved, two digits or two values exchanged."""
    for key, value in table.items():
        text = f"{value:g}"
        step = 10.0 ** -len(text.partition(".")[2])
        changed = {value + step, value - step, value * 10.0, value / 10.0}
        changed |= {
            float(text[:i] + text[i + 1] + text[i] + text[i + 2 :])
            for i in range(len(text) - 1)
            if "." not in text[i : i + 2]
        }
        for other in changed - {value}:
            yield f"{key}: {other:g} for {value:g}", {**table, key: other}
    for a, b in itertools.combinations(table, 2):
        if table[a] != table[b] and (a[0] == b[0] or a[1:] == b[1:]):
            yield f"{a} and {b} exchanged", {**table, a: table[b], b: table[a]}


@pytest.mark.parametrize("name", SUMS)
def test_a_table_adds_up_and_falls_with_both_angles(name: str):
    table = table_of(photometry.classes()[name])
    assert wrong_sums(name, table) == []
    assert rises(table) == []


@pytest.mark.parametrize("name", SUMS)
def test_each_slip_of_the_pen_would_be_seen(name: str):
    table = table_of(photometry.classes()[name])
    tried = seen_by_order = 0
    for slip, changed in slips(table):
        assert wrong_sums(name, changed), slip
        tried += 1
        seen_by_order += bool(rises(changed))
    assert tried > len(table)
    assert seen_by_order > 0.5 * tried  # which needs no sums


def test_roads_have_what_was_read():
    found = {
        (each.name, colour): rows[0].minimum
        for each in photometry.classes().values()
        if each.name not in SUMS
        for colour, rows in each.requirements.items()
    }
    assert found == ROADS


def test_sources_that_have_nothing_to_do_with_each_other_agree():
    """American type III has the European RA2's values, French plates have RA1's, and grey is a share of white."""
    known = {name: table_of(found) for name, found in photometry.classes().items()}
    for colour in ("white", "yellow", "orange", "red", "green", "blue", "brown"):
        for american, european in ((-4.0, 5.0), (30.0, 30.0)):
            assert known["D4956 III"][colour, 0.2, american] == known["RA2"][colour, 0.2, european]
    for colour, beta1 in itertools.product(("white", "yellow"), (5.0, 30.0, 40.0)):
        assert known["number plate"][colour, 0.3333, beta1] == known["RA1"][colour, 0.3333, beta1]
        assert known["number plate"][colour, 1.5, beta1] == known["RA1"][colour, 2.0, beta1]
    for name, share, rounding in (("RA1", 0.6, 1e-9), ("RA2", 0.5, 0.51)):
        for (colour, observation, beta1), value in known[name].items():
            if colour == "grey":
                assert value == pytest.approx(share * known[name]["white", observation, beta1], abs=rounding)


def test_the_values_are_those_of_the_notes():
    if not SHARED.is_file():
        pytest.skip(f"no {SHARED}")
    notes = tomllib.loads(SHARED.read_text())["class"]
    tables = [
        sorted(
            (colour, float(observation), float(beta1), float(value))
            for colour, rows in each.items()
            for observation, line in rows.items()
            if observation not in ("verified", "maximum")
            for beta1, value in line
        )
        for each in notes.values()
    ]
    ours = [
        sorted((*key, value) for key, value in table_of(each).items())
        for each in photometry.classes().values()
        if each.name in SUMS
    ]
    assert sorted(ours) == sorted(tables)
    largest = {colour: each["maximum"] for colour, each in notes["fr_number_plate"].items()}
    plate = photometry.find_class("plate")
    assert {colour: rows[0].maximum for colour, rows in plate.requirements.items()} == largest


def test_each_class_says_where_it_was_read():
    for found in photometry.classes().values():
        assert found.source and found.title
        assert found.standing in ("law", "secondary")


@pytest.mark.parametrize(
    ("asked", "name"),
    [
        ("ra2", "RA2"),
        ("EN 12899-1 RA2", "RA2"),
        ("en12899_1_ra2", "RA2"),
        ("iso20471", "ISO 20471"),
        ("d4956-iii", "D4956 III"),
        ("Plate", "number plate"),
        ("en1436 dry", "EN 1436 dry"),
        ("q2", "EN 1436 Q2"),
    ],
)
def test_names_are_known_however_they_are_written(asked: str, name: str):
    assert photometry.find_class(asked).name == name


@pytest.mark.parametrize(
    ("name", "colour", "said"),
    [
        ("RA3", "white", "unknown class RA3; did you mean RA2 or RA1"),
        ("D4956 IV", "white", "unknown class D4956 IV; did you mean"),
        ("RA2", "yelow", "RA2: unknown colour yelow; did you mean yellow"),
        ("RA2", None, "RA2 has several colours; name one: white, yellow"),
        ("ISO 20471", "red", "unknown colour red; known: white"),
    ],
)
def test_what_there_is_not_is_named_with_what_is_like_it(name: str, colour: str | None, said: str):
    with pytest.raises(MrmError, match=said):
        photometry.check(ref.Lambert(0.5), name, colour)


def test_a_check_has_a_row_a_geometry_with_value_minimum_and_margin():
    sheet = ref.GeneralizedSchlick(0.2, color90=0.2, alpha=0.0064, retroreflectivity=1.0)
    rows = photometry.check(sheet, "RA2", "white")
    assert [row.requirement.geometry for row in rows[:4]] == [
        "0.2°, 5°",
        "0.2°, 30°",
        "0.2°, 40°",
        "0.3333°, 5°",
    ]
    for row in rows:
        asked = row.requirement
        value = photometry.luminance(photometry.retroreflection(sheet, asked.observation, asked.beta1))
        assert row.value == row.least == row.most == pytest.approx(float(value), rel=1e-14)
        assert row.margin == pytest.approx(value / asked.minimum - 1.0)
    assert all(row.passes for row in rows)


def test_black_fails_every_class():
    for name, found in photometry.classes().items():
        for colour in found.requirements:
            assert not any(row.passes for row in photometry.check(ref.Lambert(0.0), name, colour)), name


def test_a_plate_may_not_be_too_bright():
    bright = ref.GeneralizedSchlick(0.3, color90=0.3, alpha=0.0064, retroreflectivity=1.0)
    rows = photometry.check(bright, "number plate", "white")
    assert rows[0].value > 250.0 and not rows[0].passes
    assert not dataclasses.replace(rows[0], value=49.9).passes
    assert dataclasses.replace(rows[0], value=250.0).passes


def test_roads_are_checked_by_day_and_by_night():
    paint = ref.GeneralizedSchlick(0.1, color90=0.1, alpha=0.3, retroreflectivity=1.0)
    (night,) = photometry.check(paint, "EN 1436 dry", "white")
    assert night.value == pytest.approx(205.8, rel=0.01)
    (day,) = photometry.check(ref.Lambert(0.4), "Q2")
    assert day.value == pytest.approx(400.0 / np.pi, rel=1e-6)


def test_of_a_pattern_the_mean_counts():
    class Striped:
        """Two points: one as bright as the other is dark."""

        def eval(self, v: Any, l: Any) -> Any:  # noqa: E741  the field's own name
            one = ref.Lambert(1.0).eval(v, l)
            return np.concatenate([0.0 * one, one], axis=-2)

    (row,) = photometry.check(Striped(), "Q1")
    assert (row.least, row.most) == (0.0, pytest.approx(1000.0 / np.pi))
    assert row.value == pytest.approx(500.0 / np.pi)
    assert photometry.check(Striped(), "RA1", "blue")[0].most > 0.0


@pytest.mark.parametrize("name", ["RA2", "EN 1436 Q2", "MUTCD 35 mph"])
def test_a_colour_is_resolved_alike_by_all(name: str):
    found = photometry.find_class(name)
    for given, resolved in (("Gray", "grey"), ("silver", "white"), (" AMBER ", "orange"), ("white", "white")):
        assert found.resolve(given) == resolved
        assert photometry.material_for(name, given).colour == resolved
    for ask in (found.resolve, found.of, lambda colour: photometry.material_for(name, colour)):
        with pytest.raises(MrmError, match=f"{name}: unknown colour yelow; did you mean yellow"):
            ask("yelow")
    with pytest.raises(MrmError, match="did you mean yellow"):
        photometry.check(ref.Lambert(0.5), name, "yelow")
