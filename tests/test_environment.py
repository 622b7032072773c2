"""Environment maps: what is read, what is refused, and what is made of them."""

import math
import warnings
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.truth.environment_reference import radiance_from
from mrm_nodes.render import environment as env
from mrm_nodes.render.environment import Environment, load_environment
from mrm_nodes.render.images import write_exr

DATA = Path(__file__).parents[2] / "shared" / "data"


def write_map(path, pixels):
    pixels = np.asarray(pixels, np.float32)
    specification = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], oiio.FLOAT)
    target = oiio.ImageOutput.create(str(path))
    target.open(str(path), specification)
    target.write_image(np.ascontiguousarray(pixels))
    target.close()
    return path


def rng_map(height=16, channels=3):
    return np.random.default_rng(1).random((height, 2 * height, channels)).astype(np.float32)


@pytest.mark.parametrize("ending", ["exr", "hdr"])
def test_a_map_is_read_as_it_is(tmp_path, ending):
    pixels = rng_map()
    loaded = load_environment(write_map(tmp_path / f"map.{ending}", pixels), rotation=30.0, samples=7)
    assert (loaded.rotation, loaded.samples) == (30.0, 7)
    # .hdr has eight bits and a common exponent.
    np.testing.assert_allclose(loaded.radiance, pixels, atol=0.0 if ending == "exr" else 1 / 128)


def test_one_channel_is_grey_and_alpha_is_dropped(tmp_path):
    grey = load_environment(write_map(tmp_path / "grey.exr", rng_map(channels=1)))
    np.testing.assert_array_equal(grey.radiance, np.repeat(rng_map(channels=1), 3, axis=2))
    alpha = load_environment(write_map(tmp_path / "alpha.exr", rng_map(channels=4)))
    np.testing.assert_array_equal(alpha.radiance, rng_map(channels=4)[..., :3])


def test_maps_that_are_refused(tmp_path):
    with pytest.raises(MrmError, match="no such image"):
        load_environment(tmp_path / "missing.hdr")
    with pytest.raises(MrmError, match="24 × 16 texels; a latitude-longitude map is twice as wide"):
        load_environment(write_map(tmp_path / "narrow.exr", np.ones((16, 24, 3))))
    for bad in (np.inf, np.nan):
        pixels = rng_map()
        pixels[5, 7, 1] = bad
        with pytest.raises(MrmError, match="1 texels are infinite or NaN, the first in row 5, column 7"):
            load_environment(write_map(tmp_path / "bad.exr", pixels))
    (tmp_path / "cut.exr").write_bytes(write_map(tmp_path / "whole.exr", rng_map()).read_bytes()[:2000])
    with pytest.raises(MrmError, match="damaged or truncated"):
        load_environment(tmp_path / "cut.exr")
    (tmp_path / "text.hdr").write_text("no image")
    with pytest.raises(MrmError, match="not an image"):
        load_environment(tmp_path / "text.hdr")


def test_negative_texels_become_black_with_a_warning(tmp_path):
    pixels = rng_map()
    pixels[3, 4] = -0.5
    with pytest.warns(MrmWarning, match=r"1 texels are negative, down to -0.5"):
        loaded = load_environment(write_map(tmp_path / "negative.exr", pixels))
    np.testing.assert_array_equal(loaded.radiance, np.maximum(pixels, 0.0))


def test_a_map_that_is_too_wide_is_averaged_down(tmp_path, monkeypatch):
    monkeypatch.setattr(env, "MAX_WIDTH", 64)
    pixels = rng_map(128)
    with pytest.warns(
        MrmWarning, match="256 × 128 texels are more than this renders with; averaged to 64 × 32"
    ):
        loaded = load_environment(write_map(tmp_path / "wide.exr", pixels))
    np.testing.assert_allclose(loaded.radiance, env.shrink(pixels, 32, 64), rtol=1e-6)


def test_a_wide_map_is_checked_before_it_is_averaged(tmp_path, monkeypatch):
    monkeypatch.setattr(env, "MAX_WIDTH", 64)
    pixels = rng_map(128)
    pixels[100, 3] = np.inf
    with pytest.raises(MrmError, match="infinite"):
        load_environment(write_map(tmp_path / "wide.exr", pixels))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rotation": math.nan}, "rotation nan"),
        ({"intensity": -1.0}, "intensity -1 is negative"),
        ({"samples": 0}, "0 samples"),
        ({"radiance": np.ones((4, 8))}, "shape"),
        ({"radiance": -np.ones((4, 8, 3))}, "negative"),
    ],
)
def test_options_that_are_refused(options, message):
    with pytest.raises(MrmError, match=message):
        Environment(**{"radiance": np.ones((4, 8, 3)), **options})


@pytest.mark.parametrize("size", [(16, 32), (15, 30), (9, 18)])
def test_every_level_has_the_mean_of_the_sphere(size):
    pixels = np.random.default_rng(2).random((*size, 3))
    environment = Environment(pixels)
    angles = env.solid_angles(*size)[:, None, None]
    mean = (environment.radiance * angles).sum(axis=(0, 1)) / (4.0 * math.pi)
    assert environment.levels[-1].shape == (1, 1, 3)
    for level in environment.levels:
        weights = env.solid_angles(*level.shape[:2])[:, None, None]
        np.testing.assert_allclose((level * weights).sum(axis=(0, 1)) / (4.0 * math.pi), mean, rtol=2e-3)
    assert [len(level) for level in Environment(rng_map(16)).levels] == [16, 8, 4, 2, 1, 1]


def test_solid_angles_fill_the_sphere():
    assert env.solid_angles(17, 34).sum() * 34 == pytest.approx(4.0 * math.pi)


def test_irradiance_of_a_constant_map_is_the_constant():
    irradiance = Environment(np.full((16, 32, 3), 0.7)).irradiance
    np.testing.assert_allclose(irradiance, 0.7, rtol=1e-6)


def test_irradiance_of_a_half_lit_sphere_follows_the_cosine():
    up = env.directions(64, 128)[..., 1:2] > 0.0
    irradiance = Environment(np.repeat(up, 3, axis=2).astype(float)).irradiance
    # A hemisphere of radiance 1 about +y gives (1 + n.y) / 2.
    expected = (1.0 + env.directions(*irradiance.shape[:2])[..., 1]) / 2.0
    np.testing.assert_allclose(irradiance[..., 0], expected, atol=5e-3)


def test_a_map_turns_from_z_towards_x():
    pixels = np.zeros((32, 64, 3))
    pixels[:, 0] = pixels[:, -1] = 1.0  # the edge columns look along +z
    facing = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    for rotation, seen in ((0.0, (1, 0, 0)), (90.0, (0, 1, 0)), (180.0, (0, 0, 1)), (450.0, (0, 1, 0))):
        turned = Environment(pixels, rotation=rotation)
        np.testing.assert_allclose(radiance_from(turned, facing)[:, 0], seen, atol=1e-12)


def test_texels_lie_where_their_directions_say():
    environment = Environment(rng_map(), rotation=37.0)
    world = env.directions(16, 32) @ environment.matrix[:3, :3]
    np.testing.assert_allclose(radiance_from(environment, world), environment.radiance, atol=1e-6)


def test_built_in_environments_are_valid_and_small():
    for name, make in env.BUILT_IN_ENVIRONMENTS.items():
        built = make()
        assert built.radiance.nbytes < 1 << 20, name
        assert env.find_environment(name, samples=3).samples == 3
    for make in (env.sky, env.studio):
        assert make().radiance.max() > 4.0 * make().radiance.mean()
    assert np.ptp(env.white().radiance) == 0.0


def test_a_map_that_is_turned_shares_what_was_made_of_it():
    given = env.Environment(rng_map(), rotation=20.0)
    turned = given.turned(15.0)
    assert turned.radiance is given.radiance
    assert (turned.rotation, given.rotation) == (35.0, 20.0)
    assert turned.levels is given.levels
    assert turned.irradiance is given.irradiance


@pytest.mark.parametrize("name", ["san_giuseppe_bridge.hdr", "goegap.hdr"])
def test_measured_maps_are_read(name):
    if not (DATA / name).is_file():
        pytest.skip(f"{DATA / name} is not here")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = load_environment(DATA / name)
    assert loaded.radiance.shape == (128, 256, 3)
    assert loaded.radiance.max() > 1.0


def test_an_exr_written_here_is_read_back(tmp_path):
    write_exr(tmp_path / "map.exr", rng_map())
    np.testing.assert_array_equal(load_environment(tmp_path / "map.exr").radiance, rng_map())
