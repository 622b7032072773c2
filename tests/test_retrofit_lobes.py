"""What retrofitted surfaces render: MaterialX's own at weight 0, the model at weight 1, nothing else changed."""

from __future__ import annotations

from collections.abc import Callable

import MaterialX as mx
import numpy as np
import pytest
from surface_lobes import (
    EVERYTHING,
    Points,
    base_specular,
    draw,
    has_film,
    only_base_specular,
    opposite_points,
    random_points,
    random_values,
    roughness_of,
    shader_of,
    with_our_departures,
)

from mrm_nodes.regression.verdict.compare import FLOOR, direction_bounds, fresnel_bounds
from mrm_nodes.render.context import probe_backends
from mrm_nodes.surfaces import Surface, known_surfaces

SETS = 200 if EVERYTHING else 16
POINTS = 96

pytestmark = pytest.mark.skipif(
    not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)
by_surface = pytest.mark.parametrize("surface", list(known_surfaces().values()), ids=lambda s: s.node)


def relative(image: np.ndarray, reference: np.ndarray) -> np.ndarray:
    return (np.abs(image - reference) / np.maximum(np.abs(reference), FLOOR)).max(axis=-1)


def bound(values: dict) -> float:
    """At every alpha: the 82 degree tint subtracts, and a film's Fresnel sum cancels in float32."""
    earlier = 1.0 if mx.getVersionIntegers() >= (1, 39, 5) else 2.0
    return earlier * (1e-5 if has_film(values) else 2e-6)


@by_surface
@pytest.mark.parametrize("anisotropic", [False, True] if EVERYTHING else [False])
@pytest.mark.parametrize("points_of", [random_points, opposite_points], ids=["random", "opposite"])
def test_weight_zero_is_materialx_own_surface_but_for_our_departures(
    surface: Surface, points_of: Callable[..., Points], anisotropic: bool
) -> None:
    rng = np.random.default_rng(5)
    # In ours too: its coat and transmission are MaterialX's.
    own, ours = (with_our_departures(shader_of(node), anisotropic) for node in (surface.node, surface.name))
    compared = 0
    for _ in range(SETS):
        values = random_values(surface.node, rng, anisotropic)
        points = points_of(rng, POINTS, roughness_of(values) ** 2)
        image = draw(ours, points, values | {surface.input: 0.0})[points.lit]
        expected = draw(own, points, values)[points.lit]
        # Masking written in another form rounds in another way.
        assert relative(image, expected).max() <= bound(values) * (2.0 if anisotropic else 1.0), values
        compared += len(image)
    assert compared > 0.3 * SETS * POINTS


@by_surface
@pytest.mark.parametrize("film", [False, True], ids=["bare", "film"])
@pytest.mark.parametrize("points_of", [random_points, opposite_points], ids=["random", "opposite"])
@pytest.mark.parametrize("metal", [False, True], ids=["dielectric", "metal"])
def test_weight_zero_is_nearer_to_the_evaluator_than_materialx_own(
    surface: Surface, metal: bool, points_of: Callable[..., Points], film: bool
) -> None:
    """In the mean and, but for rounding, at most; they differ by no more than these errors, as if independent.

    A film's phase makes more of the half angle's rounding than there is left of it: of the worst value chance decides.
    """
    rng = np.random.default_rng(3)
    own, ours = shader_of(surface.node), shader_of(surface.name)
    errors = []
    for _ in range(6):
        values = only_base_specular(surface, random_values(surface.node, rng), metal, film)
        points = points_of(rng, 512, roughness_of(values) ** 2)
        v, l = points.v[points.lit], points.l[points.lit]  # noqa: E741  the field's own name
        expected = base_specular(surface, values, 0.0).bsdf.eval(v, l) * l[:, 2:]
        # A tint at 82 degrees can make MaterialX's Fresnel factor negative; ours is clamped.
        theirs = np.maximum(draw(own, points, values)[points.lit], 0.0)
        mine = draw(ours, points, values | {surface.input: 0.0})[points.lit]
        size = np.maximum(expected, FLOOR)
        errors.append([np.abs(each) / size for each in (mine - expected, theirs - expected, mine - theirs)])
    mine, theirs, difference = (np.concatenate([each[i] for each in errors]) for i in range(3))
    assert mine.mean() < theirs.mean()
    assert film or mine.max() <= theirs.max() + 1e-6
    assert difference.mean() <= np.hypot(theirs.mean(), mine.mean())
    assert difference.max() <= theirs.max() + mine.max()


@by_surface
@pytest.mark.parametrize("film", [False, True], ids=["bare", "film"])
@pytest.mark.parametrize("metal", [False, True], ids=["dielectric", "metal"])
def test_the_base_specular_is_the_model(surface: Surface, metal: bool, film: bool) -> None:
    rng = np.random.default_rng(7)
    shader = shader_of(surface.name)
    for count in range(12):
        weight = (0.0, 1.0, rng.uniform())[count % 3]
        values = random_values(surface.name, rng, anisotropic=count >= 6)
        values = only_base_specular(surface, values | {surface.input: weight}, metal, film)
        points = random_points(rng, 256, roughness_of(values) ** 2)
        image = draw(shader, points, values)[points.lit]
        specular = base_specular(surface, values, weight)
        v, l = points.v[points.lit], points.l[points.lit]  # noqa: E741  the field's own name
        expected = specular.bsdf.eval(v, l) * l[:, 2:]
        white = specular.white.eval(v, l) * l[:, 2:]
        roughness = np.broadcast_to(specular.alpha, (len(v), 2))
        # Errors are relative to at least the floor: before 1.39.5 other lobes at weight 0 leave 1e-8 behind.
        size = np.maximum(np.abs(expected), FLOOR)
        allowed = direction_bounds(roughness, "ggx", "smith", v, l).max_rel * size
        allowed = allowed + fresnel_bounds(film, 1.3).max_rel * white
        worst = (np.abs(image - expected) / allowed).max()
        assert worst <= 1.0, (worst, weight, values)


@by_surface
def test_lobes_that_are_not_base_specular_do_not_change(surface: Surface) -> None:
    """Without base specular, the weight does nothing, whatever else is on."""
    rng = np.random.default_rng(11)
    own, ours = shader_of(surface.node), shader_of(surface.name)
    off = {
        "open_pbr_surface": {"specular_weight": 0.0, "base_metalness": 0.0, "thin_film_weight": 0.0},
        "gltf_pbr": {"specular": 0.0, "metallic": 0.0, "iridescence": 0.0},
        "standard_surface": {"specular": 0.0, "metalness": 0.0},
    }[surface.node]
    for _ in range(12):
        values = random_values(surface.node, rng, anisotropic=True) | off
        points = random_points(rng, POINTS, roughness_of(values) ** 2)
        retro = draw(ours, points, values | {surface.input: 1.0})[points.lit]
        assert relative(retro, draw(ours, points, values | {surface.input: 0.0})[points.lit]).max() <= 1e-6
        if EVERYTHING:
            assert relative(retro, draw(own, points, values)[points.lit]).max() <= 1e-5


@by_surface
def test_the_weight_blends_linearly_under_every_other_lobe(surface: Surface) -> None:
    rng = np.random.default_rng(13)
    ours = shader_of(surface.name)
    # The OpenPBR graph of earlier releases showed 3e-5.
    bound = 2e-6 if mx.getVersionIntegers() >= (1, 39, 5) else 1e-4
    for _ in range(12):
        values = random_values(surface.node, rng, anisotropic=True)
        points = random_points(rng, POINTS, roughness_of(values) ** 2)
        weight = rng.uniform()
        forward, retro, blend = (
            draw(ours, points, values | {surface.input: w})[points.lit] for w in (0.0, 1.0, weight)
        )
        size = np.maximum(np.abs(forward) + np.abs(retro), FLOOR)
        assert (np.abs(blend - forward - weight * (retro - forward)) / size).max() <= bound
