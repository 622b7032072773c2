"""Cameras and lights: what they mean, and how they are written."""

import math

import numpy as np
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.render import (
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    PointLight,
    SpotLight,
    baluster,
    parse_camera,
    parse_light,
)

NAN = float("nan")


def project(camera, points, aspect=1.0):
    """Normalised device coordinates (n, 3) of points (n, 3)."""
    matrix = camera.projection_matrix(aspect, 0.5, 20.0) @ camera.view_matrix()
    clip = np.c_[points, np.ones(len(points))] @ matrix.T
    return clip[:, :3] / clip[:, 3:]


def test_the_target_is_in_the_middle_and_up_is_up():
    camera = Camera((3, 2, 5), (1, 1, 0))
    middle, above, right = project(camera, [(1, 1, 0), (1, 1.1, 0), (1 + 0.5, 1, -0.2)])
    assert np.abs(middle[:2]).max() < 1e-12
    assert above[1] > 0.01 and abs(above[0]) < 1e-9
    assert right[0] > 0.01


def test_the_field_of_view_is_vertical():
    camera = Camera((0, 0, 2), fov=90.0)
    edge = project(camera, [(4, 2, 0)], aspect=2.0)[0]
    assert edge[:2] == pytest.approx((1.0, 1.0))


def test_near_and_far_span_the_depth_range():
    camera = Camera((0, 0, 0), (0, 0, -1))
    depths = project(camera, [(0, 0, -0.5), (0, 0, -20.0)])[:, 2]
    assert depths == pytest.approx((-1.0, 1.0))


def test_an_orthographic_camera_is_as_wide_as_told():
    camera = Camera((0, 0, 5), width=4.0)
    near, far = project(camera, [(2, 1, 0), (2, 1, -9)], aspect=2.0)
    assert near[:2] == pytest.approx((1, 1)) and far[:2] == pytest.approx((1, 1))


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, 1, 1), (0, 1, 0), (0, -1, 0), (-1, 0.2, -3)])
@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("orthographic", [False, True])
def test_framing_just_shows_the_whole_mesh(direction, aspect, orthographic):
    mesh = baluster()
    framing = Framing(direction, orthographic=orthographic)
    for points in (None, mesh.positions):
        camera = framing.camera(mesh.center, mesh.radius, aspect, points)
        toward = np.subtract(camera.position, mesh.center)
        np.testing.assert_allclose(
            toward / np.linalg.norm(toward), np.divide(direction, np.linalg.norm(direction))
        )
        reach = np.abs(project(camera, mesh.positions, aspect)[:, :2]).max()
        assert reach < 1.0 and (points is None or reach > 0.9)


def test_clip_distances_enclose_the_mesh():
    assert Camera((0, 0, 5)).clip_distances((0, 0, 0), 1.0) == pytest.approx((3.99, 6.01))
    near, far = Camera((0, 0, 0.5), (0, 0, -1)).clip_distances((0, 0, 0), 1.0)
    assert 0 < near < 0.01 and far > 1.5
    assert Camera((0, 0, 5), near=1.0, far=9.0).clip_distances((0, 0, 0), 1.0) == (1.0, 9.0)
    near, far = Camera((0, 0, 5), (0, 0, 9)).clip_distances((0, 0, 0), 1.0)
    assert 0 < near < far


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Camera((NAN, 0, 0)), "camera: position: .*nan.* is not three finite numbers"),
        (lambda: Camera((0, 0, 0), (0, 0, 0)), "from position to target: a direction cannot be zero"),
        (lambda: Camera((0, 5, 0)), "up must not point along the view"),
        (lambda: Camera(fov=180.0), "fov 180 is not between 0 and 180"),
        (lambda: Camera(fov=NAN), "fov: nan is not a finite number"),
        (lambda: Camera(width=0.0), "width 0 is not positive"),
        (lambda: Camera(near=-1.0), "near -1 is not positive"),
        (lambda: Camera(near=2.0, far=1.0), "near 2 is not below far 1"),
        (lambda: Framing((0, 0, 0)), "direction: a direction cannot be zero"),
        (lambda: DirectionalLight((0, 0, 0)), "directional light: direction: a direction cannot be zero"),
        (lambda: DirectionalLight((0, NAN, 1)), "directional light: direction: .*nan"),
        (lambda: DirectionalLight((0, 0)), "directional light: direction: .* is not three finite numbers"),
        (lambda: DirectionalLight((0, 0, 1), color=(1, 1, NAN)), "directional light: color"),
        (lambda: DirectionalLight((0, 0, 1), intensity=math.inf), "directional light: intensity: inf"),
        (lambda: PointLight((0, 0, NAN)), "point light: position"),
        (lambda: PointLight((0, 0, 0), decay_rate=NAN), "point light: decay_rate"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 0)), "spot light: direction: a direction cannot be zero"),
        (lambda: SpotLight((0, 0, 0), (0, 0, 1), inner_angle=NAN), "spot light: inner_angle"),
        (lambda: CameraLight((1, NAN, 1)), "camera light: color"),
    ],
)
def test_nonsense_is_refused(make, message):
    with pytest.raises(MrmError, match=message):
        make()


def test_directions_are_stored_at_unit_length():
    assert DirectionalLight((0, 3, -4)).direction == (0.0, 0.6, -0.8)
    assert SpotLight((0, 0, 0), (0, 0, 7)).direction == (0.0, 0.0, 1.0)


def test_light_data_is_what_materialx_declares():
    camera = Camera((1, 2, 3))
    assert CameraLight((1, 0, 0), 2.0).data(camera) == {
        "type": 2,
        "position": (1.0, 2.0, 3.0),
        "decay_rate": 0.0,
        "color": (1.0, 0.0, 0.0),
        "intensity": 2.0,
    }
    spot = SpotLight((0, 0, 1), (0, 0, -1)).data(camera)
    assert set(spot) == {
        *("type", "position", "direction", "color", "intensity", "decay_rate", "inner_angle", "outer_angle")
    }


@pytest.mark.parametrize(
    ("text", "light"),
    [
        ("camera", CameraLight()),
        ("camera:1,0.5,0", CameraLight((1, 0.5, 0))),
        ("directional:0,-1,0", DirectionalLight((0, -1, 0))),
        ("directional:0,-1,0:2,2,2", DirectionalLight((0, -1, 0), (2, 2, 2))),
        (" point:1,2,3:1,0,0 ", PointLight((1, 2, 3), (1, 0, 0), decay_rate=0.0)),
        ("spot:0,0,3:0,0,-1", SpotLight((0, 0, 3), (0, 0, -1), decay_rate=0.0)),
        ("spot:0,0,3:0,0,-1:1,1,0", SpotLight((0, 0, 3), (0, 0, -1), (1, 1, 0), decay_rate=0.0)),
    ],
)
def test_lights_are_read(text, light):
    assert parse_light(text) == light


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sun", "unknown light sun; write camera"),
        ("", "unknown light ''; write camera"),
        ("point", "light point: 0 parts after point; write"),
        ("camera:1,1,1:2,2,2", "2 parts after camera; write"),
        ("point:1,2", r"light point:1,2: \[1.0, 2.0\] is not three finite numbers"),
        ("point:1,2,x", "'x' is not a number"),
        ("point:1,2,nan", "is not three finite numbers"),
        ("directional:0,0,0", "a direction cannot be zero"),
        ("spot:0,0,3", "1 parts after spot"),
    ],
)
def test_a_wrong_light_is_explained(text, message):
    with pytest.raises(MrmError, match=message):
        parse_light(text)


@pytest.mark.parametrize(
    ("text", "camera"),
    [
        ("0,0,3", Camera((0, 0, 3))),
        ("0,1,3:0,1,0", Camera((0, 1, 3), (0, 1, 0))),
        ("0,0,3:fov=30", Camera((0, 0, 3), fov=30)),
        ("0,0,3:0,0,1:width=2:up=1,0,0", Camera((0, 0, 3), (0, 0, 1), (1, 0, 0), width=2)),
        ("frame", Framing()),
        ("frame:1,0,0:fov=20", Framing((1, 0, 0), fov=20)),
    ],
)
def test_cameras_are_read(text, camera):
    assert parse_camera(text) == camera


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "write X,Y,Z|is not a number"),
        ("0,0,3:1,1,1:2,2,2", "write X,Y,Z"),
        ("0,0", "is not three finite numbers"),
        ("0,0,3:lens=50", "unknown option lens; write"),
        ("0,0,3:fov=wide", "'wide' is not a number"),
        ("frame:0,0,0", "a direction cannot be zero"),
        ("frame:1,0,0:width=2", "write X,Y,Z"),
        ("0,0,3:frame:1,0,0", "write X,Y,Z"),
    ],
)
def test_a_wrong_camera_is_explained(text, message):
    with pytest.raises(MrmError, match=message):
        parse_camera(text)
