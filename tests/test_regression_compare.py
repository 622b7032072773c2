"""The comparison says what an image is worth, and can say no."""

import numpy as np
import pytest

from mrm_nodes import reference
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.verdict.compare import (
    BEYOND,
    BY_CHANCE,
    FLOOR,
    NEAR_COSINE_MAX,
    VIEW_MAX,
    Bounds,
    beyond_by_chance,
    compare,
    direction_bounds,
    lobe_bounds,
    quantile,
    relative_error,
)

LOOSE = Bounds(np.array(1e-4), np.array(1e-5))


def scene(n=4000, seed=0):
    return np.random.default_rng(seed).uniform(0.01, 10.0, (n, 3))


def test_an_image_equal_to_its_reference_passes_with_figures_of_zero():
    verdict, figures = compare(scene(), scene(), LOOSE)
    assert verdict == "pass"
    assert (figures.max_abs, figures.max_rel, figures.p999_rel, figures.rmse, figures.used) == (0, 0, 0, 0, 0)
    assert figures.pixels == figures.lit == 4000


def test_errors_are_relative_above_the_floor_and_absolute_below():
    assert relative_error(1.01, 1.0) == pytest.approx(0.01)
    assert relative_error(2e-6, 1e-6) == pytest.approx(1e-6 / FLOOR)
    assert relative_error(1e-6, 0.0) == pytest.approx(0.01)


@pytest.mark.parametrize("factor", [1.0 + 2e-4, 1.0 - 2e-4])
def test_one_value_over_the_largest_error_fails(factor):
    image = scene()
    image[1234, 1] *= factor
    verdict, figures = compare(image, scene(), LOOSE)
    assert verdict == "fail"
    assert figures.max_rel == pytest.approx(2e-4)
    assert figures.used == pytest.approx(2.0)


def test_many_small_errors_fail_by_the_second_bound():
    image = scene()
    image[:40] *= 1.0 + 3e-5
    verdict, figures = compare(image, scene(), LOOSE)
    assert verdict == "fail"
    assert figures.max_rel < 1e-4
    assert figures.used == pytest.approx(3.0)


def test_a_few_small_errors_pass():
    image = scene()
    image[:2] *= 1.0 + 3e-5
    assert compare(image, scene(), LOOSE)[0] == "pass"


@pytest.mark.parametrize(("points", "allowed"), [(0, 0), (10, 1), (188, 3), (1000, 6), (1_000_000, 1120)])
def test_as_many_values_as_chance_may_put_beyond_the_second_bound_are_allowed(points, allowed):
    from scipy.stats import binom

    assert beyond_by_chance(points) == allowed
    if points:
        # The smallest number that chance exceeds in fewer than one sound image of 10,000.
        assert binom.sf(allowed, points, BEYOND) <= BY_CHANCE < binom.sf(allowed - 1, points, BEYOND)


@pytest.mark.parametrize("points", [10, 188, 4000])
def test_one_point_more_than_chance_allows_fails(points):
    allowed, image = beyond_by_chance(points), scene(points)
    image[:allowed] *= 1.0 + 3e-5
    verdict, figures = compare(image, scene(points), LOOSE)
    assert (verdict, figures.used < 1) == ("pass", True)
    image[allowed, 0] *= 1.0 + 3e-5
    verdict, figures = compare(image, scene(points), LOOSE)
    assert verdict == "fail"
    assert figures.used == pytest.approx(3.0)


def test_points_of_which_float32_says_nothing_do_not_add_to_what_chance_allows():
    bound = np.full((4000, 3), 1e-5)
    bound[188:] = 10.0
    image = scene()
    image[:4] *= 1.0 + 3e-5
    bounds = Bounds(np.full((4000, 3), 1e-4), bound)
    assert compare(image, scene(), bounds)[0] == "fail"


def test_points_without_light_do_not_add_to_what_chance_allows():
    image, wanted = np.zeros((1_000_000, 3)), np.zeros((1_000_000, 3))
    wanted[:188] = scene(188)
    image[:188] = scene(188)
    image[:4] *= 1.0 + 3e-5
    assert compare(image, wanted, LOOSE)[0] == "fail"


def test_a_point_whose_bound_black_would_keep_says_nothing_but_that_it_is_finite():
    """Where float32 alone makes a value what it is, an error of a million is as good as none."""
    bound = np.full((4000, 3), 1e-4)
    bound[7] = 1e7
    bounds, image = Bounds(bound, bound), scene()
    image[7] *= 1e6
    verdict, figures = compare(image, scene(), bounds)
    assert (verdict, figures.max_rel, figures.used) == ("pass", 0.0, 0.0)
    bound[7] = 0.99
    assert compare(image, scene(), bounds)[0] == "fail"
    bound[7] = 1e7
    image[7, 2] = np.nan
    assert compare(image, scene(), bounds)[0] == "fail"
    assert compare(np.zeros((4000, 3)), scene(), Bounds(np.full((4000, 3), 2.0), bound))[0] == "fail"
    assert (
        compare(scene(), scene(), Bounds(np.full((4000, 3), 2.0), np.full((4000, 3), 2.0)))[0] == "undecided"
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_fails(value):
    image = scene()
    image[7, 2] = value
    verdict, figures = compare(image, scene(), LOOSE)
    assert verdict == "fail"
    assert figures.max_rel == np.inf
    assert figures.as_dict()["max_rel"] is None


def test_a_black_image_of_a_lit_reference_fails():
    assert compare(np.zeros((10, 3)), scene(10), LOOSE)[0] == "fail"


def test_nothing_to_compare_is_an_error():
    with pytest.raises(MrmError, match="no pixel"):
        compare(np.zeros((0, 3)), np.zeros((0, 3)), LOOSE)


def test_a_reference_that_is_not_finite_is_an_error():
    reference = scene()
    reference[5] = np.nan
    with pytest.raises(MrmError, match="first at 5"):
        compare(scene(), reference, LOOSE)


@pytest.mark.parametrize(
    ("alpha", "distribution", "max_rel", "p999_rel"),
    [
        (0.001, "ggx", 5e-3, 2e-3),
        (0.05, "ggx", 1e-4, 4e-5),
        (1.0, "ggx", 2e-5, 5e-6),
        (0.05, "beckmann", 5e-4, 2e-4),
        (1.0, "phong", 1e-4, 2.5e-5),
    ],
)
def test_bounds_follow_alpha_and_distribution(alpha, distribution, max_rel, p999_rel):
    found = lobe_bounds(alpha, distribution)
    assert (found.max_rel[0], found.p999_rel[0]) == (pytest.approx(max_rel), pytest.approx(p999_rel))


def at(v, l, alpha=0.01, masking="smith", **others):  # noqa: E741
    """The bound for a view and a light at angles in one plane."""
    directions = (np.array([[np.sin(t), 0.0, np.cos(t)]]) for t in (v, l))
    return float(direction_bounds((alpha, alpha), "ggx", masking, *directions, **others).max_rel[0, 0])


def test_bounds_grow_as_the_half_angles_cosine_falls_and_more_for_materialx():
    own = lobe_bounds(0.01, "ggx").max_rel[0]
    assert own < at(0.3, -0.9) < 1.1 * own
    grazing = np.arccos(0.01)
    # Both at cosine 0.01: the half angle's cosine is 0.01 for the forward lobe, or for the retro lobe.
    for light in (grazing, -grazing):
        of_view = 2 / 0.01 * VIEW_MAX / 0.02
        assert own + of_view < at(grazing, light) < 2 * (own + of_view)
        assert at(grazing, light, materialx=True) > 1.5 * at(grazing, light)


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("alpha", [0.003, 0.05, 1.0])
@pytest.mark.parametrize(("v", "l"), [(0.2, 1.57), (1.57, 0.2), (1.5, 1.55), (-1.55, 1.5), (0.4, 0.3)])
def test_bounds_allow_what_an_error_of_both_cosines_does_to_the_masking(v, l, alpha, masking):  # noqa: E741
    """By differences of the evaluator's own masking, for errors of a millionth of each cosine."""
    ggx = reference.GGX(alpha, alpha)

    def log_response(near_v, near_l):
        view, light = (
            np.array([np.sign(t) * np.sqrt(1 - c * c), 0.0, c]) for t, c in ((v, near_v), (l, near_l))
        )
        half = (view + light) / np.linalg.norm(view + light)
        return np.log(float(ggx.G2(view, light, half, masking=masking)) / near_v)

    near_v, near_l = np.cos(v), np.cos(l)
    slopes = [
        abs(log_response(near_v * (1 + 1e-6 * i), near_l * (1 + 1e-6 * j)) - log_response(near_v, near_l))
        / (1e-6 * (near_v if i else near_l))
        for i, j in ((1, 0), (0, 1))
    ]
    needed = NEAR_COSINE_MAX * slopes[1] + (NEAR_COSINE_MAX + VIEW_MAX) * slopes[0]
    assert at(v, l, alpha, masking) >= needed + lobe_bounds(alpha, "ggx").max_rel[0]


def test_the_quantile_is_numpy_s_own_whatever_the_values():
    """The largest values are sorted out first: ties, infinities and few values must not matter."""
    rng = np.random.default_rng(4)
    for count in (1, 2, 999, 1001, 30_000):
        spread = rng.lognormal(size=(count, 3))
        misleading = spread.copy()
        misleading.ravel()[:: misleading.size // 4096 + 1] += 100.0  # all of the sample is among the largest
        for values in (spread, misleading, np.round(spread), np.zeros((count, 3))):
            values[rng.random((count, 3)) < 0.002] = np.inf
            for share in (0.0, 0.5, 0.999, 1.0):
                assert quantile(values, share) == np.quantile(values, share, method="higher")
