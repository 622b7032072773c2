"""Frames in which something moves: the mesh turns, or the light leaves the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.scene import (
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    Light,
    PointLight,
    parse_camera,
    parse_light,
    vector,
)

Vec3 = tuple[float, float, float]

MOST_FRAMES = 360
FARTHEST = 60.0
"""Degrees between light and camera at the end of a light sweep."""


@dataclass(frozen=True, eq=False)
class Frame:
    """What of a render changes from frame to frame, and what to write below it."""

    label: str
    camera: Camera
    lights: tuple[Light, ...]
    environment: Environment | None


def frames_of(
    kind: str,
    count: int,
    mesh: Mesh,
    camera: str | None,
    lights: Sequence[str],
    environment: Environment | None,
    aspect: float,
) -> list[Frame]:
    """The frames of a `light sweep` or a `turntable`; camera and lights are texts as the command line has them.

    Raises:
        MrmError: a text that is none; fewer than 2 frames or more than `MOST_FRAMES`.
    """
    check_count(count, kind)
    placed = Framing() if camera is None else parse_camera(camera)
    if isinstance(placed, Framing):
        if kind == "turntable":
            placed = framed(placed, mesh, aspect)
        else:
            placed = placed.camera(mesh.center, mesh.radius, aspect, mesh.positions)
    if kind == "turntable":
        return turntable(count, placed, [parse_light(light) for light in lights], mesh.center, environment)
    return light_sweep(count, placed, mesh.center, environment)


def light_sweep(count: int, camera: Camera, center: Vec3, environment: Environment | None) -> list[Frame]:
    """The light starts at the camera and goes round the mesh's middle to its right, as far away all the time.

    The angle grows with the square of the frame: what a retroreflector does, it does near the camera.

    Raises:
        MrmError: fewer than 2 frames or more than `MOST_FRAMES`.
    """
    check_count(count, "light sweep")
    frames = []
    for angle in FARTHEST * np.linspace(0.0, 1.0, count) ** 2:
        light = PointLight(
            _about(camera.view_matrix()[1, :3], camera.position, center, angle), decay_rate=0.0
        )
        frames.append(Frame(f"{angle:.3g}°", camera, (light,), environment))
    return frames


def turntable(
    count: int, camera: Camera, lights: Sequence[Light], center: Vec3, environment: Environment | None
) -> list[Frame]:
    """The mesh turns once about the vertical through its middle; camera, lights and environment stay as they are.

    What is drawn is the same seen from the mesh: they turn about it, and its own coordinates stay.

    Raises:
        MrmError: fewer than 2 frames or more than `MOST_FRAMES`.
    """
    check_count(count, "turntable")
    frames = []
    for angle in 360.0 * np.arange(count) / count:

        def turned(vector_: Vec3, about: Vec3 = center, degrees: float = -angle) -> Vec3:
            return _about(np.array([0.0, 1.0, 0.0]), vector_, about, degrees)

        def turned_direction(direction: Vec3, degrees: float = -angle) -> Vec3:
            return _about(np.array([0.0, 1.0, 0.0]), direction, (0.0, 0.0, 0.0), degrees)

        moved = replace(
            camera,
            position=turned(camera.position),
            target=turned(camera.target),
            up=turned_direction(camera.up),
        )
        lit = tuple(_moved(light, turned, turned_direction) for light in lights)
        around = None if environment is None else environment.turned(-angle)
        frames.append(Frame(f"{angle:.3g}°", moved, lit, around))
    return frames


def _moved(light: Light, place: Any, direction: Any) -> Light:
    if isinstance(light, CameraLight):
        return light
    if isinstance(light, DirectionalLight):
        return replace(light, direction=direction(light.direction))
    if isinstance(light, PointLight):
        return replace(light, position=place(light.position))
    return replace(light, position=place(light.position), direction=direction(light.direction))


def framed(framing: Framing, mesh: Mesh, aspect: float) -> Camera:
    """The camera that has the mesh in the picture however it turns about its vertical."""
    offset = mesh.positions - np.asarray(mesh.center, np.float32)
    radius = np.hypot(offset[:, 0], offset[:, 2])
    # The widest of each height, all around.
    low, high = float(offset[:, 1].min()), float(offset[:, 1].max())
    band = ((offset[:, 1] - low) / max(high - low, 1e-9) * 63.0).round().astype(int)
    widest = np.zeros(64)
    np.maximum.at(widest, band, radius)
    angle = np.linspace(0.0, 2.0 * math.pi, 48, endpoint=False)
    x, z = widest[:, None] * np.cos(angle), widest[:, None] * np.sin(angle)
    y = np.broadcast_to(np.linspace(low, high, 64)[:, None], x.shape)
    points = np.stack([x, y, z], axis=-1).reshape(-1, 3) + mesh.center
    return framing.camera(mesh.center, mesh.radius, aspect, points)


def _about(axis: NDArray[np.float64], point: Vec3, center: Vec3, degrees: float) -> Vec3:
    """A point turned about an axis of unit length through a centre: +z goes to +x about +y."""
    angle = math.radians(degrees)
    offset = np.subtract(point, center)
    # Rodrigues' formula
    turned = (
        offset * math.cos(angle)
        + np.cross(axis, offset) * math.sin(angle)
        + axis * np.dot(axis, offset) * (1.0 - math.cos(angle))
    )
    return vector(np.add(center, turned), "sweep")


def check_count(count: int, what: str) -> None:
    """Check how many frames there are to be.

    Raises:
        MrmError: fewer than 2 or more than `MOST_FRAMES`.
    """
    if not 2 <= count <= MOST_FRAMES:
        raise MrmError(f"{what}: {count} frames; it takes 2 to {MOST_FRAMES}")
