"""The reference image follows MaterialX's lights and frames, in float64."""

import math

import numpy as np
import pytest

from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.reference_image import evaluator, light_at, shade, shading_frame
from mrm_nodes.render.scene import Camera, CameraLight, DirectionalLight, PointLight, SpotLight

CAMERA = Camera(position=(0.0, 0.0, 2.0))
ORIGIN = np.zeros((1, 3))
VALUES = material.complete("mrm_conductor_bsdf", {"roughness": (0.3, 0.2), "retroreflectivity": 0.5})


def at(light, position=(0.0, 0.0, 0.0)):
    direction, intensity = light_at(light.data(CAMERA), np.array([position]))
    return direction[0], intensity[0]


def test_a_directional_light_comes_from_against_its_direction():
    direction, intensity = at(DirectionalLight((0.0, 0.0, -2.0), (1.0, 0.5, 0.25), 3.0))
    assert direction.tolist() == [0.0, 0.0, 1.0]
    assert intensity.tolist() == [3.0, 1.5, 0.75]


def test_a_point_light_decays_with_one_plus_its_distance():
    direction, intensity = at(PointLight((0.0, 3.0, 0.0), intensity=8.0, decay_rate=2.0))
    assert direction == pytest.approx([0.0, 1.0, 0.0])
    assert intensity == pytest.approx([0.5, 0.5, 0.5])


@pytest.mark.parametrize(("degrees", "share"), [(0.0, 1.0), (29.0, 1.0), (61.0, 0.0)])
def test_a_spot_light_fades_between_its_cones(degrees, share):
    inner, outer = math.cos(math.radians(30.0)), math.cos(math.radians(60.0))
    light = SpotLight((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), decay_rate=0.0, inner_angle=inner, outer_angle=outer)
    _, intensity = at(light, (math.tan(math.radians(degrees)), 0.0, 0.0))
    assert intensity == pytest.approx([share] * 3)


def test_a_spot_light_is_half_way_at_the_middle_of_its_cosines():
    light = SpotLight((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), decay_rate=0.0, inner_angle=0.9, outer_angle=0.7)
    _, intensity = at(light, (math.tan(math.acos(0.8)), 0.0, 0.0))
    assert intensity == pytest.approx([0.5] * 3, abs=1e-6)


def test_a_camera_light_is_seen_along_the_view():
    direction, intensity = at(CameraLight(intensity=2.0), (0.3, 0.1, 0.5))
    view, _ = shading_frame([[0.3, 0.1, 0.5]], [[0, 0, 1]], [[1, 0, 0]], CAMERA.position)
    assert direction == pytest.approx(view[0])
    assert intensity == pytest.approx([2.0] * 3)


def test_the_frame_is_orthonormal_and_faces_the_viewer():
    rng = np.random.default_rng(1)
    position, normal, tangent = rng.normal(size=(3, 500, 3))
    view, frame = shading_frame(position, normal, tangent, (0.5, -1.0, 3.0))
    assert frame @ np.swapaxes(frame, 1, 2) == pytest.approx(np.broadcast_to(np.eye(3), (500, 3, 3)))
    assert np.linalg.det(frame) == pytest.approx(np.ones(500))
    assert (np.sum(frame[:, 2] * view, -1) >= 0).all()


def test_radiance_is_the_sum_over_lights_of_intensity_bsdf_cosine_and_weight():
    bsdf = evaluator("mrm_conductor_bsdf", VALUES)
    view, frame = shading_frame(ORIGIN, [[0, 0, 1]], [[1, 0, 0]], (1.0, 0.0, 1.0))
    lights = [DirectionalLight((0.6, 0.0, -0.8), intensity=2.0), DirectionalLight((0.0, 0.0, -1.0))]
    total = shade(bsdf, 0.25, view, frame, ORIGIN, [light.data(CAMERA) for light in lights])
    v = np.array([math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    expected = 0.25 * (2.0 * 0.8 * bsdf.eval(v, [-0.6, 0.0, 0.8]) + bsdf.eval(v, [0.0, 0.0, 1.0]))
    assert total[0] == pytest.approx(expected, rel=1e-6)


def test_a_light_below_the_horizon_gives_exactly_nothing():
    bsdf = evaluator("mrm_dielectric_bsdf", material.complete("mrm_dielectric_bsdf", {"scatter_mode": "RT"}))
    view, frame = shading_frame(ORIGIN, [[0, 0, 1]], [[1, 0, 0]], (0.0, 0.0, 1.0))
    below = DirectionalLight((0.6, 0.0, 0.8)).data(CAMERA)
    total = shade(bsdf, 1.0, view, frame, ORIGIN, [below])
    assert not total.any()


def test_values_are_rounded_to_float32_as_the_shader_sees_them():
    assert material.as_float32(0.1) == np.float64(np.float32(0.1)) != 0.1
