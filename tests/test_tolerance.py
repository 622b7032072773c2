"""Thresholds of a user's own: each is kept or not, and noise in a reference is never taken for an error."""

import dataclasses

import numpy as np
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.verdict.tolerance import Comparison, Tolerance, compare_images

SIZE = (40, 50)
MASK = np.ones(SIZE, bool)


def scene(seed=0):
    """Smooth shading with a bright spot, above zero everywhere."""
    y, x = np.mgrid[0:1:40j, 0:1:50j]
    rng = np.random.default_rng(seed)
    base = (
        0.2
        + 0.5 * x[..., None] * rng.uniform(0.3, 1.0, 3)
        + 3.0 * np.exp(-80 * ((x - 0.5) ** 2 + (y - 0.4) ** 2))[..., None]
    )
    return base


def compared(image, tolerance, **others) -> Comparison:
    return compare_images(image, scene(), MASK, tolerance, **others)


THRESHOLDS = [
    Tolerance(max_rel=1e-3),
    Tolerance(p999_rel=1e-3),
    Tolerance(rmse=1e-3),
    Tolerance(flip=0.01),
    Tolerance(hdr_flip=0.01),
]


@pytest.mark.parametrize("tolerance", THRESHOLDS, ids=lambda each: next(iter(each.limits())))
def test_an_equal_image_passes_and_a_different_one_fails(tolerance):
    assert compared(scene(), tolerance).verdict == "pass"
    assert compared(scene(), tolerance).figures.used == 0
    worse = compared(scene() * 1.3, tolerance)
    assert worse.verdict == "fail"
    assert worse.figures.used > 1


@pytest.mark.parametrize("tolerance", THRESHOLDS, ids=lambda each: next(iter(each.limits())))
def test_the_figure_itself_is_the_threshold_that_is_just_kept(tolerance):
    (name,) = tolerance.limits()
    figure = getattr(compared(scene() * 1.07, tolerance).figures, name)
    assert compared(scene() * 1.07, Tolerance(**{name: figure})).verdict == "pass"
    assert compared(scene() * 1.07, Tolerance(**{name: np.nextafter(figure, 0.0)})).verdict == "fail"


def test_all_thresholds_count_and_the_most_used_is_told():
    image = scene() * (1 + 1e-4)
    both = compared(image, Tolerance(max_rel=1e-3, rmse=1e-6))
    assert both.verdict == "fail"
    assert both.figures.used == pytest.approx(both.figures.rmse / 1e-6)
    assert compared(image, Tolerance(max_rel=1e-3, rmse=1.0)).verdict == "pass"


def test_figures_are_what_their_names_say():
    image = scene()
    image[3, 4, 1] += 0.5
    figures = compared(image, Tolerance(max_rel=1.0)).figures
    assert figures.max_abs == pytest.approx(0.5)
    assert figures.max_rel == pytest.approx(0.5 / scene()[3, 4, 1])
    assert figures.p999_rel == 0
    assert figures.rmse == pytest.approx(0.5 / np.sqrt(scene().size))
    assert (figures.pixels, figures.lit) == (2000, 2000)
    assert (figures.flip, figures.hdr_flip) == (None, None)


def test_only_the_mask_counts():
    image, mask = scene(), MASK.copy()
    mask[:10] = False
    image[:10] = np.nan
    result = compare_images(image, scene(), mask, Tolerance(max_rel=0.0, flip=0.0, hdr_flip=0.0))
    assert result.verdict == "pass"
    assert result.figures.pixels == 1500
    assert result.flip[:10].max() == 0


@pytest.mark.parametrize("tolerance", THRESHOLDS, ids=lambda each: next(iter(each.limits())))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_one_value_that_is_not_finite_fails_whatever_is_asked(tolerance, value):
    image = scene()
    image[7, 9, 2] = value
    loose = Tolerance(**dict.fromkeys(tolerance.limits(), 1e6))
    found = compared(image, loose)
    assert found.verdict == "fail"
    assert found.flip is None or found.flip[7, 9] == 1
    assert found.used is None or found.used[7, 9] == np.inf


def test_the_map_is_the_share_of_the_bound_and_marks_the_worst_pixel():
    image = scene()
    image[5, 6, 0] *= 1.004
    used = compared(image, Tolerance(max_rel=2e-3)).used
    assert np.unravel_index(np.argmax(used), SIZE) == (5, 6)
    assert used.max() == pytest.approx(2.0)
    assert compared(image, Tolerance(flip=0.1)).used is None


def test_a_pixel_uses_of_a_root_mean_square_what_it_would_use_alone():
    image = scene()
    image[5, 6, 0] += 0.1
    alone = compared(image, Tolerance(rmse=1e-3))
    assert alone.used.max() == pytest.approx(alone.figures.used)
    image[9, 9] += 0.2
    both = compared(image, Tolerance(rmse=1e-3))
    assert np.sqrt(np.sum(both.used**2)) == pytest.approx(both.figures.used)


def test_flip_lies_where_the_difference_is():
    image = scene()
    image[20:24, 30:34] *= 3.0
    for tolerance in (Tolerance(flip=0.1), Tolerance(hdr_flip=0.1)):
        seen = compared(image, tolerance).flip
        row, column = np.unravel_index(np.argmax(seen), SIZE)
        assert (18 <= row <= 25) and (28 <= column <= 35)
        assert seen[:8].max() < 0.05 * seen.max()


def test_flip_sees_what_a_person_sees():
    """One value of a thousand is invisible, and a change of hue at equal luminance is not."""
    image = scene()
    image[::20, ::20] *= 1.02
    assert compared(image, Tolerance(flip=1.0)).figures.flip < 0.01
    turned = scene() + 0.2 * np.array([0.7152, -0.2126, 0.0])
    assert compared(turned, Tolerance(flip=1.0)).figures.flip > 0.1


def test_hdr_flip_sees_what_one_exposure_leaves_in_the_dark():
    reference = np.where(scene() > 2.0, 400.0, scene())
    image = np.where(scene() > 2.0, 400.0, scene() * 1.5)
    figures = compare_images(image, reference, MASK, Tolerance(flip=1.0, hdr_flip=1.0)).figures
    assert figures.hdr_flip > 5 * figures.flip


@pytest.mark.parametrize("brightness", [0.0, 1e-12, 1e-7, 1e8])
def test_flip_of_references_that_are_black_dim_or_bright(brightness):
    """The library ends the process where the reference is black."""
    reference = scene() * brightness
    tolerance = Tolerance(flip=0.01, hdr_flip=0.01)
    assert compare_images(reference, reference, MASK, tolerance).verdict == "pass"
    assert compare_images(reference + max(brightness, 1.0), reference, MASK, tolerance).verdict == "fail"


# What is refused


def test_a_tolerance_that_asks_for_nothing_is_refused():
    with pytest.raises(MrmError, match="asks for nothing"):
        compared(scene(), Tolerance())


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, "0.1", True])
def test_a_threshold_is_a_number(value):
    with pytest.raises(MrmError, match="tolerance rmse is"):
        Tolerance(rmse=value)


def test_what_cannot_be_compared_is_refused():
    tolerance = Tolerance(max_rel=1.0)
    broken = scene()
    broken[2, 3] = np.nan
    with pytest.raises(MrmError, match="not two images of one size"):
        compare_images(scene()[:5], scene(), MASK, tolerance)
    with pytest.raises(MrmError, match="no pixel shows the mesh"):
        compare_images(scene(), scene(), ~MASK, tolerance)
    with pytest.raises(
        MrmError, match="reference is not finite at 1 of 2000 pixels, first at column 3, row 2"
    ):
        compare_images(scene(), broken, MASK, tolerance)
    with pytest.raises(MrmError, match="does not fit"):
        compare_images(scene(), scene(), MASK[:4], tolerance)


def test_a_tolerance_is_a_value():
    assert Tolerance(rmse=1) == Tolerance(rmse=1.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        Tolerance().rmse = 2.0
