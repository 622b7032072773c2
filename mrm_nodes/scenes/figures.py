"""The paper's Figures 3 and 5: GGX and MRM on a ball in a cup, or on a mesh of the user's."""

from __future__ import annotations

import math

import numpy as np

from mrm_nodes.render import Camera, CameraLight, Framing, Mesh, PointLight
from mrm_nodes.scenes import shapes
from mrm_nodes.scenes.compose import Lamp, Rows, Scene, Thing
from mrm_nodes.scenes.surface import open_pbr

Vec3 = tuple[float, float, float]


def ball() -> Mesh:
    """Return a ball in a cup."""
    cup = shapes.turned(
        "cup",
        [
            [(0.0001, -1.32), (0.72, -1.32)],
            [(0.72, -1.32), *shapes.arc((0.66, -1.22), 0.06, 0, 90, 8)],
            [(0.66, -1.16), (0.40, -1.12), *shapes.arc((0.40, -1.04), 0.08, -90, -180, 8)],
            [(0.32, -1.04), (0.44, -0.86), (0.50, -0.80), *shapes.arc((0.47, -0.80), 0.03, 0, 100, 6)],
        ],
    )
    return shapes.joined("ball", [shapes.patch("ball", shapes.unit_sphere, 256, 128), cup])


def around(center: Vec3, position: Vec3, degrees: float) -> Vec3:
    """Return a position turned about the vertical axis through a centre."""
    x, y, z = np.subtract(position, center)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (center[0] + c * x + s * z, center[1] + y, center[2] - s * x + c * z)


def grey(exposure: float) -> tuple[Vec3, Vec3]:
    """Return a background that is dark grey at this exposure: the unlit side stays visible against it."""
    value = 0.06 * 2.0**-exposure
    return (value, value, value), (value, value, value)


def figure3(solid: Mesh) -> Rows:
    """A dielectric of roughness 0.5: GGX and MRM, the light at the camera and 60 degrees from it."""
    camera = Framing((0.0, 0.22, 1.0), fov=24.0).camera(solid.center, 0.97 * solid.radius, 1.0)
    beside = PointLight(around(solid.center, camera.position, 60.0), decay_rate=0.0)
    row = []
    for weight in (0.0, 1.0):
        skin = open_pbr(base_color=(0.0, 0.0, 0.0), specular_roughness=0.5, specular_retroreflectivity=weight)
        for light in (CameraLight(), beside):
            row.append(
                (Scene([Thing(solid, skin, False)], camera, [Lamp(light)], grey(3.2), 3.2), (208, 208))
            )
    return [row]


def figure5(solid: Mesh) -> Rows:
    """A metal: GGX above, MRM below; the light stays, the camera turns 0, 45 and 90 degrees away from it."""
    front = Framing((0.0, 0.22, 1.0), fov=24.0).camera(solid.center, 0.97 * solid.radius, 1.0)
    light = PointLight(front.position, decay_rate=0.0)
    rows = []
    for weight in (0.0, 1.0):
        skin = open_pbr(
            base_color=(0.95, 0.64, 0.38),
            base_metalness=1.0,
            specular_roughness=0.4,
            specular_retroreflectivity=weight,
        )
        row = []
        for degrees in (0.0, 45.0, 90.0):
            camera = Camera(around(solid.center, front.position, degrees), solid.center, fov=24.0)
            row.append(
                (Scene([Thing(solid, skin, False)], camera, [Lamp(light)], grey(-1.3), -1.3), (208, 208))
            )
        rows.append(row)
    return rows
