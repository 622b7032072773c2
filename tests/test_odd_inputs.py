"""Inputs as documents have them: out of range, values that MaterialX passes over, normals that are not unit."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from test_material_case import case_of, write
from test_ordinary_lights import COLOUR, LOBE, number, of_node

from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.render import probe_backends
from mrm_nodes.shadergen import generate_shader

WIDE = '<input name="roughness" type="vector2" value="0.3, 0.3" />'
VECTOR = '<input name="{}" type="vector3" value="0.3, 0.3, 1" />'


@pytest.fixture(scope="module")
def worker(gl: None) -> Worker:
    return Worker([probe.backend for probe in probe_backends() if probe.works][-1])


def mixed(amount: float) -> str:
    """A metal mixed with a diffuse base."""
    parts = (
        f'<oren_nayar_diffuse_bsdf name="o" type="BSDF">{COLOUR}</oren_nayar_diffuse_bsdf>'
        f'<mrm_conductor_bsdf name="c" type="BSDF">{LOBE}</mrm_conductor_bsdf>'
    )
    inputs = '<input name="fg" type="BSDF" nodename="c" /><input name="bg" type="BSDF" nodename="o" />'
    return parts + of_node("mix", inputs + number("mix", amount))


@pytest.mark.parametrize(
    ("text", "verdict"),
    [
        (mixed(1.5), "pass"),
        (mixed(-0.5), "pass"),
        (of_node("mrm_conductor_bsdf", LOBE + number("weight", 1.5)), "pass"),
        (of_node("mrm_dielectric_bsdf", LOBE + number("thinfilm_thickness", -100.0)), "pass"),
        # Black, and a case that is black says nothing.
        (of_node("mrm_conductor_bsdf", LOBE + number("weight", -0.5)), "undecided"),
        (of_node("mrm_conductor_bsdf", LOBE + VECTOR.format("normal")), "pass"),
        (of_node("conductor_bsdf", WIDE + VECTOR.format("normal")), "pass"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore::mrm_nodes.MrmWarning")
def test_both_sides_take_what_is_out_of_range_as_materialx_does(text, verdict, worker, tmp_path: Path):
    outcome = worker.run(case_of(write(tmp_path, text)), tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", verdict), outcome.message


@pytest.mark.parametrize("length", [0.9, 0.999, 1.001, 1.1])
@pytest.mark.parametrize("node", ["mrm_conductor_bsdf", "oren_nayar_diffuse_bsdf"])
def test_a_connected_normal_that_is_not_unit_has_no_model(node, length, worker, tmp_path: Path):
    scaled = f"""<normal name="n" type="vector3" /><multiply name="scaled" type="vector3">
      <input name="in1" type="vector3" nodename="n" />{number("in2", length)}</multiply>"""
    text = scaled + of_node(node, '<input name="normal" type="vector3" nodename="scaled" />')
    outcome = worker.run(case_of(write(tmp_path, text)), tmp_path / "report")
    assert outcome.verdict == "error"
    assert re.search(rf"b/normal is {length:.3g} to {length:.3g} long.*put a normalize node", outcome.message)
    whole = text.replace('nodename="scaled"', 'nodename="unit"').replace(
        "</multiply>",
        '</multiply><normalize name="unit" type="vector3"><input name="in" type="vector3" nodename="scaled" />'
        "</normalize>",
    )
    outcome = worker.run(case_of(write(tmp_path, whole)), tmp_path / "report")
    assert (outcome.message, outcome.verdict) == ("", "pass")


def test_a_tangent_of_no_length_is_named(worker, tmp_path: Path):
    text = (
        '<constant name="t" type="vector3"><input name="value" type="vector3" value="0, 0, 0" /></constant>'
    )
    text += of_node("mrm_conductor_bsdf", '<input name="tangent" type="vector3" nodename="t" />')
    outcome = worker.run(case_of(write(tmp_path, text)), tmp_path / "report")
    assert outcome.verdict == "error" and outcome.message.startswith("b: its tangent is zero or along its")


@pytest.mark.parametrize("node", ["mrm_conductor_bsdf", "conductor_bsdf"])
@pytest.mark.parametrize(("name", "taken"), [("normal", "Nworld"), ("tangent", "Tworld")])
def test_a_value_where_the_geometry_s_is_taken_is_said_to_be_ignored(node, name, taken, tmp_path: Path):
    file = write(tmp_path, of_node(node, VECTOR.format(name)))
    with pytest.warns(MrmWarning, match=f"b/{name}: its value is ignored, MaterialX takes {taken}"):
        with_value = generate_shader(file)
    file.write_text(file.read_text().replace(VECTOR.format(name), ""))
    assert generate_shader(file).pixel == with_value.pixel


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (mixed(1.5), "b/mix: 1.5 is outside 0 to 1, and is taken as it is: energy is made or lost"),
        (
            of_node("conductor_bsdf", number("weight", 2)),
            "b/weight: 2 is outside 0 to 1, and is taken as it is",
        ),
        (of_node("conductor_bsdf", number("weight", -1)), "b/weight: -1 is outside 0 to 1, and counts as 0"),
    ],
)
def test_a_share_outside_of_0_to_1_is_named(text, told, tmp_path: Path):
    with pytest.warns(MrmWarning, match=told):
        generate_shader(write(tmp_path, text))
