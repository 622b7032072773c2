"""What MaterialX's rule of layering costs: the albedo of many points, and both rules over the trees of a material."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes import cli
from mrm_nodes import reference as ref
from mrm_nodes.library import host
from mrm_nodes.reference.albedo_points import ALBEDO_ERROR, EDGE_ERROR, albedo_of_points
from mrm_nodes.reference.checks import PAIRS
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SuiteError
from mrm_nodes.regression.truth import closure, material, physics
from mrm_nodes.regression.verdict.compare import FLOOR
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS

RNG = np.random.default_rng(5)


def views(count: int) -> np.ndarray:
    """Half of them evenly over the cosine, half over its logarithm."""
    cosine = np.concatenate([RNG.random(count // 2), 10.0 ** RNG.uniform(-5.0, 0.0, count - count // 2)])
    azimuth, sine = 2.0 * np.pi * RNG.random(count), np.sqrt(1.0 - cosine**2)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)


@pytest.mark.parametrize("pair", PAIRS, ids="-".join)
def test_albedo_at_many_points_is_albedo(pair: tuple[str, str]):
    common = {"distribution": pair[0], "masking": pair[1], "energy_compensation": "materialx-1.39.5"}
    film = {"thinfilm_thickness": 600.0, "thinfilm_ior": 1.8}
    v = views(70)
    for alpha in (1e-3, 0.4):
        for lobe, error in (
            (ref.Dielectric(0.8, alpha, **common), EDGE_ERROR),
            (ref.Dielectric(1.5, alpha, scatter_mode="RT", **common), EDGE_ERROR),
            (
                ref.GeneralizedSchlick((0.19, 0.5, 1.0), 0.0, alpha=alpha, retroreflectivity=0.5, **common),
                ALBEDO_ERROR,
            ),
            (ref.GeneralizedSchlick(0.1, 0.3, exponent=0.2, alpha=alpha, **film, **common), ALBEDO_ERROR),
        ):
            # By a curve, and each for itself.
            expected = lobe.albedo(v[::10])
            np.testing.assert_allclose(albedo_of_points(lobe, v)[::10], expected, atol=error)
            np.testing.assert_allclose(albedo_of_points(lobe, v[::10]), expected, atol=error)


def test_albedo_at_many_points_where_a_texture_makes_each_another_lobe():
    v = views(131)
    # Two lobes, whose curves are shared by what has them.
    steps = ref.Dielectric(1.5, RNG.integers(1, 3, 131)[:, None] * 0.2, tint=(1.0, 0.5, 0.2))
    np.testing.assert_allclose(albedo_of_points(steps, v), steps.albedo(v), atol=ALBEDO_ERROR)
    v, each, colour = v[:24], RNG.uniform(0.05, 1.0, 24), RNG.random((24, 3))
    for lobe in (
        ref.Dielectric(
            1.3 + 0.4 * each, each[:, None], retroreflectivity=each, thinfilm_thickness=900.0 * each
        ),
        ref.GeneralizedSchlick(colour, 1.0 - colour, alpha=np.stack([each, each[::-1]], axis=-1)),
        ref.GeneralizedSchlick(0.2, 0.5, alpha=(0.6, 0.1), slope_correlation=0.5),
    ):
        np.testing.assert_allclose(albedo_of_points(lobe, v), lobe.albedo(v), atol=ALBEDO_ERROR)
    below = v * (1.0, 1.0, -1.0)
    glass = ref.Dielectric(1.5, 0.3)
    np.testing.assert_allclose(albedo_of_points(glass, below), glass.albedo(below), atol=EDGE_ERROR)


def lobe(node: str, **values) -> closure.LobeNode:
    return closure.LobeNode(node, node, {**material.complete(node, values), "normal": None, "tangent": None})


GLASS = lobe("mrm_dielectric_bsdf", roughness=(0.4, 0.2), ior=1.6, thinfilm_thickness=350.0, weight=0.8)
TAPE = lobe(
    "mrm_generalized_schlick_bsdf", color0=(0.19, 0.1, 0.02), color82=(0.0, 0.0, 0.0), roughness=(0.3, 0.3)
)
METAL = lobe("mrm_conductor_bsdf", roughness=(0.3, 0.3))
PAPER = closure.LobeNode(
    "oren_nayar_diffuse_bsdf",
    "paper",
    {"weight": 1.0, "color": (0.8, 0.6, 0.3), "roughness": 0.0, "energy_compensation": False, "normal": None},
)
FACTOR = (0.9, 0.5, 0.2)
TREES = {
    "layer": closure.LayerNode(TAPE, PAPER),
    "layers": closure.LayerNode(GLASS, closure.LayerNode(TAPE, PAPER)),
    "mix over": closure.LayerNode(closure.MixNode(METAL, TAPE, 0.25), PAPER),
    "add over": closure.LayerNode(closure.AddNode(GLASS, TAPE), PAPER),
    "multiply over": closure.LayerNode(
        closure.MultiplyNode(closure.MixNode(METAL, closure.AddNode(GLASS, TAPE), 0.25), FACTOR), PAPER
    ),
    "nothing over": closure.LayerNode(closure.Nothing(opaque=False), closure.LayerNode(TAPE, PAPER)),
}
DIRECTIONS = ((0.0, 0.0, -1.0), (-0.6, 0.0, -0.8))
COLOUR = (2.0, 1.6, 1.2)
LIGHTS = [{"type": 1, "direction": d, "color": COLOUR, "intensity": 1.0} for d in DIRECTIONS]


def by_hand(tree: closure.Tree, layering: str) -> ref.Closure:
    """The same tree of the evaluator's own closures and lobes."""
    match tree:
        case closure.LobeNode(node="oren_nayar_diffuse_bsdf", inputs=given):
            return ref.Leaf(ref.Lambert(given["color"]))
        case closure.LobeNode(node=node, inputs=given):
            common = {"alpha": given["roughness"], "energy_compensation": host().compensation}
            common["thinfilm_thickness"], common["thinfilm_ior"] = (
                given["thinfilm_thickness"],
                given["thinfilm_ior"],
            )
            if "dielectric" in node:
                made: ref.Lobe = ref.Dielectric(given["ior"], **common)
            elif "conductor" in node:
                made = ref.Conductor(given["ior"], given["extinction"], **common)
            else:
                made = ref.GeneralizedSchlick(given["color0"], given["color82"], given["color90"], **common)
            return ref.Leaf(made, given["weight"])
        case closure.Nothing():
            return ref.Leaf(ref.Dielectric(1.5, 0.3), 0.0)
        case closure.MixNode(fg, bg, amount):
            return ref.Mix(by_hand(fg, layering), by_hand(bg, layering), amount)
        case closure.AddNode(one, other):
            return ref.Add(by_hand(one, layering), by_hand(other, layering))
        case closure.MultiplyNode(inner, factor):
            return ref.Multiply(by_hand(inner, layering), factor)
        case closure.LayerNode(top, base):
            return ref.Layer(by_hand(top, layering), by_hand(base, layering), layering)


@pytest.mark.parametrize("name", TREES)
def test_both_rules_are_the_evaluators(name: str):
    v = np.array([[0.3, 0.1, 0.0], [0.8, 0.0, 0.0], [0.0, -0.97, 0.0]])
    v[:, 2] = np.sqrt(1.0 - np.sum(v**2, axis=1))
    rest = (
        np.broadcast_to(np.array([0.0, 0.0, 1.0]), v.shape),
        np.broadcast_to(np.array([1.0, 0.0, 0.0]), v.shape),
    )
    points = physics.Points(-5.0 * v, *rest, (0.0, 0.0, 0.0))
    reference, bounds, exact = physics.shade_both(TREES[name], points, LIGHTS, lambda port: port)
    alone = physics.shade_tree(TREES[name], points, LIGHTS, lambda port: port)
    assert np.array_equal(reference, alone[0]) and np.array_equal(bounds.max_rel, alone[1].max_rel)
    for found, layering in ((reference, "materialx"), (exact, "exact")):
        tree = by_hand(TREES[name], layering)
        expected = sum(tree.eval(v, -np.array(d)) * -d[2] * COLOUR for d in DIRECTIONS)
        np.testing.assert_allclose(found, expected, atol=2.0 * ALBEDO_ERROR * 0.8 / np.pi + 1e-6)
    assert np.abs(reference - exact).max() > 0.01
    told = physics.beside_exact(reference, exact)
    assert told["max_rel"] == (np.abs(reference - exact) / np.maximum(np.abs(exact), FLOOR)).max()


def test_a_mix_beyond_0_to_1_has_both_rules_and_an_integral():
    """MaterialX does not clamp it."""
    points = physics.Points(np.zeros((1, 3)), np.eye(3)[2:], np.eye(3)[:1], (0.0, 0.6, 0.8))
    mixed = closure.LayerNode(closure.MixNode(TAPE, METAL, 1.5), PAPER)
    reference, _, exact = physics.shade_both(mixed, points, LIGHTS, lambda port: port)
    assert np.isfinite(reference).all() and np.isfinite(exact).all()
    around = BUILT_IN_ENVIRONMENTS["white"]()
    fg, bg, both = (
        physics.light_tree(tree, points, around, lambda port: port).mean for tree in (TAPE, METAL, mixed.top)
    )
    np.testing.assert_allclose(both, 1.5 * fg - 0.5 * bg, rtol=1e-12)


def test_a_tree_has_layers_where_something_lies_on_something():
    nothing = closure.Nothing(opaque=False)
    assert all(map(closure.has_layers, TREES.values()))
    for tree in (
        TAPE,
        closure.MixNode(TAPE, GLASS, 0.5),
        closure.LayerNode(nothing, TAPE),
        closure.LayerNode(TAPE, nothing),
    ):
        assert not closure.has_layers(tree)


COATED = """<materialx version="1.39">
  <mrm_dielectric_bsdf name="coat" type="BSDF" />
  <oren_nayar_diffuse_bsdf name="paper" type="BSDF" />
  <layer name="coated" type="BSDF">
    <input name="top" type="BSDF" nodename="coat" />
    <input name="base" type="BSDF" nodename="paper" />
  </layer>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="coated" /></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" />
  </surfacematerial>
</materialx>"""


def test_a_suite_says_it_itself_and_the_command_line_has_the_last_word(tmp_path: Path):
    (tmp_path / "coated.mtlx").write_text(COATED)
    (tmp_path / "paper.mtlx").write_text(
        COATED.replace('nodename="coated" /></surface>', 'nodename="paper" /></surface>')
    )
    path = tmp_path / "own.toml"
    path.write_text('[defaults]\nlayering = "exact"\n[[case]]\nmaterial = ["coated.mtlx", "paper.mtlx"]\n')
    rules = {case.name: case.layering for case in load(path).cases}
    assert rules == {"coated": "exact", "paper": "materialx"}
    assert {case.layering for case in load(path, layering="materialx").cases} == {"materialx"}
    built_in = suites.suite("default", 0, layering="exact")
    asked = {case.name: case.layering == "exact" for case in built_in}
    assert any(asked.values()) and not all(asked.values())
    assert all(case.layering == "materialx" for case in suites.suite("default", 0))
    coat = next(case for case in built_in if case.layering == "exact")
    assert "layering" in coat.describe() and "layering" not in replace(coat, layering="materialx").describe()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ("exakt", "unknown --layering exakt; did you mean exact?"),
        ("", "unknown --layering ; known: exact, materialx"),
    ],
)
def test_a_rule_that_is_none_is_one_line(wrong: str, said: str, tmp_path: Path, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main(["regress", "-o", str(tmp_path / "report"), "--layering", wrong])
    assert ended.value.code == 2 and capsys.readouterr().err == f"mrm-nodes: {said}\n"
    assert not (tmp_path / "report").exists()


def test_a_suite_with_a_rule_that_is_none_is_one_line(tmp_path: Path):
    (tmp_path / "coated.mtlx").write_text(COATED)
    path = tmp_path / "wrong.toml"
    path.write_text('[defaults]\nlayering = "precise"\n[[case]]\nmaterial = "coated.mtlx"\n')
    with pytest.raises(SuiteError, match=r"wrong.toml:2: defaults.layering: .*'exact'"):
        load(path)
