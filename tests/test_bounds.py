"""What a verdict by physics notices: planted faults, under a coat so smooth that float32 knows nothing of its peak."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_material_case import case_of, write

from mrm_nodes.regression.cases.material_case import EnvironmentMap
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.truth import closure, physics
from mrm_nodes.regression.truth.closure import LobeNode, Nothing, Port, Tree, lobes
from mrm_nodes.regression.truth.material import complete
from mrm_nodes.regression.truth.reference_image import light_at
from mrm_nodes.regression.verdict.compare import (
    HALF_VECTOR_MAX,
    VIEW_MAX,
    Bounds,
    compare,
    direction_bounds,
    lobe_bounds,
)
from mrm_nodes.regression.verdict.outcome import Outcome
from mrm_nodes.render import probe_backends

MATERIAL = """
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""


def surface(node: str, **values: str | float) -> str:
    inputs = "".join(
        f'<input name="{name}" type="{"color3" if isinstance(value, str) else "float"}" value="{value}" />'
        for name, value in values.items()
    )
    return f'<{node} name="s" type="surfaceshader">{inputs}</{node}>{MATERIAL}'


COATED = {
    "open_pbr": surface(
        "mrm_open_pbr_surface",
        base_color="0.8, 0.3, 0.1",
        specular_roughness=0.3,
        specular_retroreflectivity=0.7,
        coat_weight=1.0,
        coat_roughness=0.0,
    ),
    "gltf": surface(
        "mrm_gltf_pbr",
        base_color="0.8, 0.3, 0.1",
        metallic=0.5,
        roughness=0.4,
        retroreflection=0.7,
        clearcoat=1.0,
        clearcoat_roughness=0.0,
    ),
    "standard": surface(
        "mrm_standard_surface",
        base_color="0.8, 0.3, 0.1",
        specular_roughness=0.3,
        specular_retroreflectivity=0.7,
        coat=1.0,
        coat_roughness=0.0,
    ),
    "by hand": """
<dielectric_bsdf name="coat" type="BSDF"><input name="roughness" type="vector2" value="0.0, 0.0" /></dielectric_bsdf>
<mrm_conductor_bsdf name="metal" type="BSDF">
  <input name="roughness" type="vector2" value="0.2, 0.2" />
  <input name="retroreflectivity" type="float" value="0.7" />
</mrm_conductor_bsdf>
<layer name="both" type="BSDF">
  <input name="top" type="BSDF" nodename="coat" /><input name="base" type="BSDF" nodename="metal" />
</layer>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="both" /></surface>"""
    + MATERIAL,
}


@pytest.fixture(scope="module")
def worker(gl: None) -> Worker:
    return Worker(next(probe.backend for probe in probe_backends() if probe.works))


@dataclass
class Shaded:
    """A case's outcome, and what its reference was made of."""

    outcome: Outcome
    tree: Tree
    rest: tuple[Any, ...]
    resolve: Callable[[Port], Any]
    reference: Any
    bounds: Bounds

    def of(self, tree: Tree, resolve: Callable[[Port], Any] | None = None) -> Any:
        """Radiance of another tree at the same points."""
        return physics.shade_tree(tree, *self.rest, resolve or self.resolve)[0]

    def is_noticed(self, image: Any) -> bool:
        return compare(image, self.reference, self.bounds)[0] == "fail"


@pytest.fixture(scope="module", params=COATED)
def shaded(
    request: pytest.FixtureRequest, worker: Worker, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Shaded]:
    kept: list[Any] = []
    own = physics.shade_tree

    def spy(tree: Tree, points: Any, lights: Any, resolve: Any, around: Any = None) -> Any:
        found = own(tree, points, lights, resolve, around)
        kept.append((tree, (points, lights), resolve, *found))
        return found

    folder = tmp_path_factory.mktemp("coated")
    case = case_of(write(folder, COATED[request.param]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(physics, "shade_tree", spy)
        outcome = worker.run(case, folder / "report")
    yield Shaded(outcome, *kept[0])


def with_lobes(tree: Tree, change: Callable[[LobeNode], Tree]) -> Tree:
    """A tree with other lobes."""
    match tree:
        case LobeNode():
            return change(tree)
        case Nothing():
            return tree
        case closure.MixNode(fg, bg, amount):
            return closure.MixNode(with_lobes(fg, change), with_lobes(bg, change), amount)
        case closure.AddNode(in1, in2):
            return closure.AddNode(with_lobes(in1, change), with_lobes(in2, change))
        case closure.MultiplyNode(in1, in2):
            return closure.MultiplyNode(with_lobes(in1, change), in2)
        case closure.LayerNode(top, base):
            return closure.LayerNode(with_lobes(top, change), with_lobes(base, change))


def test_what_is_sound_passes_and_says_how_little_it_would_have_noticed(shaded: Shaded):
    assert (shaded.outcome.message, shaded.outcome.truth, shaded.outcome.verdict) == ("", "physics", "pass")
    figures = shaded.outcome.figures
    assert figures is not None and figures.notices is not None and figures.notices < 1e-3
    # As it says, and no less: of a fault of that size a hundredth of the lit values is beyond its bound.
    assert shaded.is_noticed(shaded.reference * (1 + 1.01 * figures.notices))
    assert not shaded.is_noticed(shaded.reference)


def test_the_reference_is_the_trees_own_response(shaded: Shaded):
    """By the evaluator's own `mix`, `add` and `layer`, which know of no bounds."""
    points, lights = shaded.rest
    expected = np.zeros_like(shaded.reference)
    for light in lights:
        direction, intensity = light_at(light, points.position)
        expected += physics.respond(shaded.tree, points, direction, shaded.resolve) * intensity
    np.testing.assert_allclose(shaded.reference, expected, rtol=1e-12)


@pytest.mark.parametrize("factor", [0.0, 0.9, 0.99, 0.999, 1.001, 1.01, 1.1])
def test_a_whole_image_that_is_darker_or_brighter_is_noticed(shaded: Shaded, factor: float):
    assert shaded.is_noticed(shaded.reference * factor)


def test_channels_in_another_order_are_noticed(shaded: Shaded):
    assert shaded.is_noticed(shaded.reference[:, [1, 0, 2]])


def test_a_coat_that_returns_black_is_noticed(shaded: Shaded):
    coat = next(lobe for lobe in lobes(shaded.tree) if "coat" in lobe.path)
    gone = with_lobes(shaded.tree, lambda each: Nothing(False) if each is coat else each)
    dark = with_lobes(shaded.tree, lambda each: Nothing(True) if each is coat else each)
    for fault in (gone, dark):
        assert shaded.is_noticed(shaded.of(fault))


def test_the_retro_lobe_forward_is_noticed(shaded: Shaded):
    def forward(lobe: LobeNode) -> LobeNode:
        if "retroreflectivity" not in lobe.inputs:
            return lobe
        return replace(lobe, inputs={**lobe.inputs, "retroreflectivity": 0.0})

    assert shaded.is_noticed(shaded.of(with_lobes(shaded.tree, forward)))


def test_each_lobe_that_is_missing_and_was_a_tenth_of_the_light_is_noticed(shaded: Shaded):
    counted = 0
    for lobe in lobes(shaded.tree):
        image = shaded.of(with_lobes(shaded.tree, lambda each: Nothing(False) if each is lobe else each))  # noqa: B023
        lit = shaded.reference > 0
        share = np.abs(image - shaded.reference)[lit] / shaded.reference[lit]
        if np.mean(share > 0.1) >= 0.01:
            counted += 1
            assert shaded.is_noticed(image), lobe.path
    assert counted


@dataclass(frozen=True)
class Squared:
    port: Port


def test_a_roughness_that_is_squared_twice_is_noticed(shaded: Shaded):
    def resolve(port: Any) -> Any:
        return np.square(shaded.resolve(port.port)) if isinstance(port, Squared) else shaded.resolve(port)

    def squared(lobe: LobeNode) -> LobeNode:
        return replace(lobe, inputs={**lobe.inputs, "roughness": Squared(lobe.inputs["roughness"])})  # type: ignore[dict-item]

    assert shaded.is_noticed(shaded.of(with_lobes(shaded.tree, squared), resolve))


def test_a_material_too_narrow_for_float32_is_undecided_and_says_why(worker: Worker, tmp_path: Path):
    mirror = surface("mrm_open_pbr_surface", base_metalness=1.0, specular_roughness=0.0)
    path = write(tmp_path, mirror.replace("<surfacematerial", "<!-- a mirror --><surfacematerial"))
    outcome = worker.run(case_of(path), tmp_path / "report")
    assert outcome.verdict == "undecided"
    assert "narrow" in outcome.message or "nothing is lit" in outcome.message


@pytest.mark.parametrize("around", [None, EnvironmentMap("sky", (("samples", 16),))])
def test_a_film_of_a_colours_own_index_is_undecided_and_says_why(
    around: EnvironmentMap | None, worker: Worker, tmp_path: Path
):
    """Rounding decides about half a turn of phase, which an image may show or not."""
    rng = np.random.default_rng(1)
    for number in range(3):
        root = np.sqrt(np.float32(rng.uniform(0.02, 0.3)))
        index, color = np.float32((1 + root) / (1 - root)), np.float32(root * root)
        text = f"""<mrm_generalized_schlick_bsdf name="b" type="BSDF">
<input name="color0" type="color3" value="0.3, {color:.9g}, 0.1" />
<input name="roughness" type="vector2" value="0.3, 0.3" />
<input name="thinfilm_thickness" type="float" value="400" />
<input name="thinfilm_ior" type="float" value="{index:.9g}" /></mrm_generalized_schlick_bsdf>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>"""
        folder = tmp_path / str(number)
        folder.mkdir()
        case = case_of(write(folder, text + MATERIAL), environment=around)
        lights = case.lights if around is None else ()
        outcome = worker.run(replace(case, size=(12, 12), lights=lights), tmp_path / "report")
        assert outcome.verdict == "undecided" and "a film of a colour's own index" in outcome.message


def test_an_image_of_which_nothing_is_lit_is_undecided():
    dark = np.zeros((50, 3))
    bounds = Bounds(np.array(1e-5), np.array(1e-5))
    verdict, figures = compare(dark, dark, bounds)
    assert (verdict, figures.notices) == ("undecided", np.inf)
    assert compare(dark + 1e-3, dark, bounds)[0] == "fail"


def test_a_tint_multiplies_a_lobe_and_what_its_fresnel_factor_may_be_off():
    node = "mrm_dielectric_bsdf"
    rng = np.random.default_rng(0)
    light = rng.normal(size=(500, 3))
    light[:, 2] = np.abs(light[:, 2]) + 0.05
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    view = light[::-1]
    frame = np.broadcast_to(np.eye(3), (500, 3, 3))

    def judged(tint: float) -> Any:
        values = complete(node, {"ior": 1.2, "roughness": (0.5, 0.5), "tint": (tint, tint, tint)})
        return physics._Judged(node, {**values, "normal": None, "tangent": None}, frame).judge(
            view, light, 0.0
        )

    plain, tinted = judged(1.0), judged(8.0)
    for name in ("value", "most", "usual"):
        np.testing.assert_allclose(getattr(tinted, name), 8.0 * getattr(plain, name), rtol=1e-12)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [1e-8, 1e-6, 1e-4])
def test_a_narrow_lobe_may_be_what_it_is_for_a_half_vector_that_is_rounded(alpha: float, distribution: str):
    """The distributions from their definitions, for slopes that float32 cannot tell apart."""
    rng = np.random.default_rng(0)
    v = np.array([0.3, -0.2, 0.0]) + np.zeros((4000, 3))
    v[:, 2] = np.sqrt(1 - (v**2).sum(axis=-1))
    slope = alpha * 10 ** rng.uniform(-2, 4 if distribution == "ggx" else 1, 4000)
    turned = rng.uniform(0, 2 * np.pi, 4000)
    half = np.stack([slope * np.cos(turned), slope * np.sin(turned), np.ones(4000)], axis=-1)
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    light = 2 * (v * half).sum(axis=-1, keepdims=True) * half - v

    def density(slope: Any) -> Any:
        if distribution == "ggx":
            return alpha**2 / (np.pi * (slope**2 + alpha**2) ** 2)
        return np.exp(-((slope / alpha) ** 2)) / (np.pi * alpha**2)

    shifted = np.maximum(slope + rng.uniform(-1, 1, 4000) * 2.5e-6, 0.0)
    roughness = np.full((4000, 2), alpha)
    allowed = direction_bounds(roughness, distribution, "smith", v, light).max_rel[:, 0]
    beyond = allowed - lobe_bounds(alpha, distribution).max_rel[0]
    error = np.abs(density(shifted) - density(slope)) / density(slope)
    # The directions of this test lose a part of a slope of 1e-10: what is left of it is no less than their rounding.
    # Exponentials end at e^80: beyond that the bound is as good as none, and black has always kept it.
    assert (error <= 1.001 * allowed + 1e-6)[allowed < 1e30].all()
    # And no more than that where the lobe is far away: the bound is its own error there, not a licence.
    far = (slope > 0.05) & (light[:, 2] > 0.5)
    of_view = 2 * lobe_bounds(alpha, "ggx").max_rel[0] * VIEW_MAX / HALF_VECTOR_MAX
    assert not far.any() or beyond[far].max() < 1e-3 + of_view
