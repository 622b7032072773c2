"""The comparison says what an image is worth, and can say no."""

import numpy as np
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.compare import (
    FILM_MAX,
    FLOOR,
    Bounds,
    bounds_for,
    compare,
    grazing_factor,
    quantile,
    relative_error,
)

LOOSE = Bounds(np.array(1e-4), np.array(1e-5))


def scene(n=4000, seed=0):
    return np.random.default_rng(seed).uniform(0.01, 10.0, (n, 3))


def bounds(alpha, distribution="ggx", reference=1.0, grazing=None, white=0.0, film=False):
    reference = np.full((1, 3), reference)
    grazing = reference if grazing is None else np.full((1, 3), grazing)
    made = bounds_for(alpha, distribution, reference, grazing, np.full((1, 3), white), film)
    return made.max_rel[0, 0], made.p999_rel[0, 0]


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


def test_many_small_errors_fail_by_the_percentile():
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
    assert bounds(alpha, distribution) == (pytest.approx(max_rel), pytest.approx(p999_rel))


def test_a_thin_film_allows_an_error_of_its_fresnel_factor():
    without, _ = bounds(0.5, reference=2.0)
    with_film, _ = bounds(0.5, reference=2.0, white=4.0, film=True)
    assert with_film - without == pytest.approx(FILM_MAX * 4.0 / 2.0)


def test_bounds_grow_with_the_grazing_part_of_the_light():
    def at(v, l):  # noqa: E741
        return float(grazing_factor(*(np.array([[np.sin(t), 0.0, np.cos(t)]]) for t in (v, l)))[0, 0])

    assert at(0.3, -0.9) == at(0.0, 1.5) == 1.0
    # Both at cosine 0.01: the half angle's cosine is 0.01 for the forward lobe, or for the retro lobe.
    grazing = np.arccos(0.01)
    assert at(grazing, -grazing) == at(grazing, grazing) == pytest.approx(6.0)
    # Only the light: its own cosine counts.
    assert at(0.0, np.arccos(0.001)) == pytest.approx(5.0)
    assert bounds(0.5, reference=2.0, grazing=6.0)[0] == pytest.approx(3 * bounds(0.5)[0])
    assert bounds(0.5, reference=1e-9, grazing=1e-8)[0] == pytest.approx(bounds(0.5)[0])


def test_the_percentile_is_numpy_s_own_whatever_the_values():
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
