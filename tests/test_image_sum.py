"""Image light summed as a shader sums it: its samples, its texels, and what a driver makes of them."""

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference import image_light
from mrm_nodes.reference.image_light import EXACT, Driver
from mrm_nodes.regression.truth.environment_reference import Estimate, beside_integral, radiance_from, some_of
from mrm_nodes.regression.truth.image_sum import Surroundings, _joined, diffuse_sum
from mrm_nodes.regression.verdict.compare import lobe_bounds
from mrm_nodes.render import probe_backends
from mrm_nodes.render.arithmetic import ALLOWED, Arithmetic, measure
from mrm_nodes.render.environment import Environment, sky

RNG = np.random.default_rng(5)
NOISE = Environment(RNG.random((16, 32, 3)))
STEPS = Driver(np.zeros((2, 2)), 0.0, 0.0, 1 / 256, 1 / 256)
LOBE = ref.Conductor((0.2, 0.9, 1.1), (3.9, 2.4, 2.2), (0.4, 0.2), 0.4)


def anywhere(n):
    found = RNG.normal(size=(n, 3))
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def views(n):
    found = anywhere(n)
    found[:, 2] = np.abs(found[:, 2]) + 0.1
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def frames(n):
    normal = anywhere(n)
    tangent = np.cross(normal, anywhere(n))
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=1)


def summed(lobe, v, axes, environment, samples, driver=EXACT):
    around = _joined(environment.levels)
    return image_light.filtered_samples(lobe, v, axes, around, samples, len(environment.levels), driver)


def test_points_are_those_that_float32_makes():
    exact = np.modf(np.arange(1, 2001) * (1 + 5**0.5) / 2)[0]
    points = image_light.spherical_fibonacci(2000)
    np.testing.assert_allclose(points[:10, 1], exact[:10], atol=2e-6)
    assert 2e-5 < np.abs(points[:, 1] - exact).max() < 3e-4


def test_level_0_is_read_as_the_map_is():
    toward = anywhere(500)
    found = image_light.look_up(_joined(NOISE.levels), toward, 0.0, np.zeros(1), 0.0, EXACT)
    np.testing.assert_allclose(found.value, radiance_from(NOISE, toward), atol=1e-12)


def test_between_two_levels_both_are_read():
    toward, around = anywhere(100), _joined(NOISE.levels)
    low, middle, high = (
        image_light.look_up(around, toward, 0.0, np.array([level]), 0.0, EXACT).value
        for level in (1.0, 1.25, 2.0)
    )
    np.testing.assert_allclose(middle, 0.75 * low + 0.25 * high, atol=1e-12)
    last = len(NOISE.levels) - 1.0
    beyond = image_light.look_up(around, toward, 0.0, np.array([last + 3.0]), 0.0, EXACT).value
    np.testing.assert_allclose(beyond, NOISE.levels[-1][0, 0] + 0.0 * beyond, atol=1e-12)


@pytest.mark.parametrize("level", [0.0, 1.0, 1.6])
def test_a_texture_unit_of_256_steps_stays_within_the_bound(level):
    """A unit that rounds to a step is imitated by directions that are moved by as much, in each way."""
    around = _joined(NOISE.levels)
    u, v = RNG.random(400), RNG.uniform(0.1, 0.9, 400)

    def read(u, v, level, driver):
        latitude, longitude = np.pi * (0.5 - v), 2 * np.pi * (u - 0.5)
        toward = np.stack(
            [np.cos(latitude) * np.sin(longitude), np.sin(latitude), -np.cos(latitude) * np.cos(longitude)],
            axis=-1,
        )
        return image_light.look_up(around, toward, 0.0, np.array([level]), 0.0, driver)

    bound = read(u, v, level, STEPS)
    step = 1 / 256 / (NOISE.radiance.shape[0] >> int(level))
    worst = np.zeros_like(bound.value)
    for across, down, along in np.ndindex(3, 3, 3):
        moved = read(u + (across - 1) * step / 2, v + (down - 1) * step, level + (along - 1) / 256, EXACT)
        worst = np.maximum(worst, np.abs(moved.value - bound.value))
    inside = bound.most > 0
    assert inside.all()
    assert (worst <= 2.0 * bound.most).all()
    assert worst.max() > 0.2 * bound.most.max()


def test_the_error_of_a_driver_moves_the_look_up():
    tilted = Driver(np.array([[0.01, 0.0], [0.01, 0.0]]), 0.0, 0.0, 0.0, 0.0)
    around = _joined(NOISE.levels)
    level = np.zeros(1)
    latitude = RNG.uniform(-1.2, 1.2, 50)

    def toward(latitude):
        return np.stack([np.cos(latitude), np.sin(latitude), 0.0 * latitude], axis=-1)

    np.testing.assert_allclose(
        image_light.look_up(around, toward(latitude), 0.0, level, 0.0, tilted).value,
        image_light.look_up(around, toward(latitude + 0.01), 0.0, level, 0.0, EXACT).value,
        atol=1e-12,
    )


@pytest.mark.parametrize(
    "lobe",
    [
        LOBE,
        ref.GeneralizedSchlick(0.5, alpha=0.3, distribution="beckmann"),
        ref.Dielectric(1.5, alpha=(0.3, 0.1), distribution="phong", masking="vcavity", retroreflectivity=1.0),
        ref.GeneralizedSchlick(0.5, alpha=0.2, masking="vcavity", retroreflectivity=0.5),
    ],
)
def test_many_samples_of_a_white_map_come_to_the_albedo(lobe):
    v = views(20)
    white = Environment(np.ones((4, 8, 3)))
    albedo = lobe.albedo(v)
    # Beyond some thousands float32 has lost so many digits of the points that they are less even again.
    errors = [np.abs(summed(lobe, v, frames(20), white, n).value / albedo - 1).max() for n in (200, 2000)]
    assert errors[1] < 1.5e-3
    assert errors[1] < 0.3 * errors[0]


def test_the_bounds_hold_for_a_view_a_frame_and_a_driver_in_float32():
    v, axes = views(200), frames(200)
    rounded = summed(
        LOBE, v.astype(np.float32).astype(float), axes.astype(np.float32).astype(float), sky(), 32
    )
    found = summed(LOBE, v, axes, sky(), 32)
    error = np.abs(rounded.value - found.value)
    assert (error <= found.most).all()
    assert np.quantile(error / found.usual, 0.999) <= 1
    # And an image a ten-thousandth brighter is noticed.
    assert np.median(found.most / found.value) < 1e-4


def test_a_constant_map_has_no_difference_of_texels():
    found = summed(LOBE, views(50), frames(50), Environment(np.ones((8, 16, 3))), 64, STEPS)
    assert (found.most / found.value).max() < 1e-3
    assert np.median(found.most / found.value) < 2e-5


def test_oren_nayar_in_an_environment_keeps_what_it_has_as_light_from_all_around():
    cosine = np.array([[0.2], [0.7], [1.0]])
    roughness = np.full((3, 1), 0.6)
    color = np.array([[0.8, 0.3, 0.1]])
    compensated = image_light.oren_nayar_albedo(color, roughness, cosine, True)
    l = views(200_000)  # noqa: E741  the field's own name
    l[:, 2] = np.sqrt(RNG.random(len(l)))
    l[:, :2] *= (np.sqrt(1 - l[:, 2] ** 2) / np.linalg.norm(l[:, :2], axis=1))[:, None]
    for k, mu in enumerate(cosine[:, 0]):
        v = np.array([np.sqrt(1 - mu * mu), 0.0, mu])
        integral = np.pi * ref.eon(color[0], 0.6, v, l).mean(axis=0)
        np.testing.assert_allclose(compensated[k], integral, atol=4e-3)


def test_points_that_share_a_normal_may_all_have_the_largest_error_of_one_look_up():
    around = Surroundings(NOISE, Arithmetic(np.full(2, 1e-4), np.full(2, 1e-4), 0.0, 0.0, 0.0, 0.0))
    values = {"color": 0.8, "roughness": np.zeros(100), "energy_compensation": False}
    differ = diffuse_sum(values, views(100), frames(100), around, 0.0)
    share = diffuse_sum(values, views(100), frames(1).repeat(100, axis=0), around, 0.0)
    arithmetic = lobe_bounds(1.0, "ggx")
    differ, share = (  # what is left are the products of look-up and albedo
        each.most - each.usual - (arithmetic.max_rel - arithmetic.p999_rel) * each.value
        for each in (differ, share)
    )
    assert (differ > 1e-9).mean() > 0.9
    np.testing.assert_allclose(share, 0.0, atol=1e-15)


def test_what_a_sum_is_beside_the_integral():
    truth = Estimate(np.ones((100, 3)), np.full((100, 3), 0.01))
    noisy = 1.0 + 0.01 * np.repeat(RNG.normal(size=(100, 1)), 3, axis=1)
    same = beside_integral(noisy, truth, 64)
    assert abs(same["mean"]) < 4 * same["mean_error"] == pytest.approx(4e-3, rel=0.2)
    assert same["rms"] < 4 * same["rms_error"]
    brighter = beside_integral(noisy + 0.1, truth, 64)
    assert brighter["mean"] == pytest.approx(0.1, abs=5e-3)
    assert brighter["rms"] == pytest.approx(0.1, abs=5e-3)
    assert "mean" not in beside_integral(noisy, Estimate(0.0 * noisy, 0.0 * noisy), 64)
    assert len(set(some_of(1000))) == 64
    assert list(some_of(3)) == [0, 1, 2]
    assert len(some_of(0)) == 0


def test_a_driver_is_measured():
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working:
        pytest.skip("no backend works")
    for backend in working:
        found = measure(backend)
        assert found is measure(backend)
        angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, len(found.arc_sine))
        assert (np.abs(found.arc_sine) <= ALLOWED * np.maximum(np.abs(angles), 1e-3)).all()
        assert found.sine < 1e-5
        assert found.logarithm < 1e-5
        assert 0 <= found.texel <= 1 / 16
        assert 0 <= found.level <= 1 / 16
