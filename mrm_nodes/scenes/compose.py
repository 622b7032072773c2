"""Several meshes under several lights, with shadows: each mesh and light is drawn alone and put together here."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import MaterialX as mx
import numba
import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render import Camera, DirectionalLight, Light, Mesh, PointLight, SpotLight, shared_renderer
from mrm_nodes.scenes.shapes import joined
from mrm_nodes.shadergen import Shader, generate_shader

Array = NDArray[Any]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Thing:
    """A mesh and what it is made of."""

    mesh: Mesh
    shader: Shader
    casts_shadow: bool = True


@dataclass(frozen=True)
class Lamp:
    """A light whose shadows have soft edges: its shading comes from the middle, its shadow from all of `size`."""

    light: Light
    size: float = 0.0
    """Radius of a light that has a place; the sine of the angular radius of a directional one."""
    shadow_samples: int = 1
    resolution: int = 1024
    strength: Callable[[Array], Array] | None = None
    """What its light is multiplied by at points (n, 3), such as a lamp's illuminance there: (n,)."""


@dataclass(frozen=True)
class Room:
    """Shadows are found inside this sphere."""

    center: Vec3 = (0.0, 0.0, 0.0)
    radius: float = 4.0


@dataclass(frozen=True, eq=False)
class Scene:
    """What is seen, from where, by which light."""

    things: Sequence[Thing]
    camera: Camera
    lamps: Sequence[Lamp]
    background: tuple[Vec3, Vec3] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    """Radiance at the lower and the upper edge of the picture, where nothing is."""
    exposure: float = 0.0
    room: Room = Room()


Rows = list[list[tuple[Scene, tuple[int, int]]]]
"""Pictures beside and above each other: what each shows, and its width and height."""


def reduced(picture: Array, samples: int) -> Array:
    """Return the means of samples × samples pixels, (h, w, 3).

    picture: (samples h, samples w, 3), as `sampled` has it.

    Raises:
        ValueError: its sides are no multiples of `samples`.
    """
    height, width = picture.shape[0] // samples, picture.shape[1] // samples
    mean: Array = picture.reshape(height, samples, width, samples, 3).mean(axis=(1, 3))
    return mean


def steps(scene: Scene) -> int:
    """How often `sampled` calls back."""
    return (len(_merged(scene.things)) + 1) * len(scene.lamps)


def sampled(
    scene: Scene,
    size: tuple[int, int],
    samples: int = 2,
    shadows: float = 1.0,
    drawn: Callable[[], object] = lambda: None,
) -> Array:
    """Return every sample of the linear picture, (samples h, samples w, 3).

    Args:
        shadows: share of their resolution and of their samples that is used, above 0.
        drawn: called after each of the `steps`.
    """
    renderer = shared_renderer()
    width, height = size[0] * samples, size[1] * samples
    reach = [
        np.linalg.norm(thing.mesh.positions - np.array(scene.camera.position), axis=1)
        for thing in scene.things
    ]
    near, far = max(0.02, 0.5 * min(r.min() for r in reach)), 1.01 * max(r.max() for r in reach)
    camera = replace(scene.camera, near=near, far=far)

    depth = np.full((height, width), np.inf)
    position, normal = np.zeros((2, height, width, 3), np.float32)
    radiance = np.zeros((len(scene.lamps), height, width, 3), np.float32)
    for thing in _merged(scene.things):
        nearer = None
        for index, lamp in enumerate(scene.lamps):
            image = renderer.render(thing.shader, thing.mesh, camera, [lamp.light], (width, height))
            if nearer is None:
                distance = np.linalg.norm(image.position - np.array(camera.position), axis=-1)
                nearer = image.mask & (distance < depth)
                depth[nearer], position[nearer] = distance[nearer], image.position[nearer]
                normal[nearer] = image.normal[nearer]
            radiance[index][nearer] = image.image[nearer]
            drawn()

    seen = np.isfinite(depth)
    casting = [thing.mesh for thing in scene.things if thing.casts_shadow]
    casters = joined("casters", casting) if casting else None
    low, high = (np.array(color) for color in scene.background)
    share = np.linspace(1.0, 0.0, height)[:, None, None]
    picture = np.broadcast_to(low + (high - low) * share, (height, width, 3)).copy()
    total = np.zeros((int(seen.sum()), 3), np.float32)
    for index, lamp in enumerate(scene.lamps):
        coarse = replace(
            lamp,
            shadow_samples=max(1, round(shadows * lamp.shadow_samples)),
            resolution=max(1, round(shadows * lamp.resolution)),
        )
        lit = _visibility(scene, casters, coarse, position[seen], normal[seen])
        if lamp.strength is not None:
            lit = lit * lamp.strength(position[seen]).astype(np.float32)
        total += radiance[index][seen] * lit[:, None]
        drawn()
    picture[seen] = total
    return picture


SKY = (0.62, 0.74, 0.95)


def dome(strength: float, count: int = 7, color: Vec3 = SKY) -> list[Lamp]:
    """Return a sky as directional lights, each with its shadow: where they crowd out, it is dark."""
    lamps = []
    for k in range(count):
        up = 0.18 + 0.8 * (k + 0.5) / count
        around = k * math.pi * (3.0 - math.sqrt(5.0))
        across = math.sqrt(1.0 - up * up)
        direction = (-across * math.cos(around), -up, -across * math.sin(around))
        light = DirectionalLight(direction, color, math.pi * strength / count)
        lamps.append(Lamp(light, 0.2, 3, 512))
    return lamps


def _merged(things: Sequence[Thing]) -> list[Thing]:
    """Return the things with those of one shader joined: fewer draws."""
    by_shader: dict[int, list[Thing]] = {}
    for thing in things:
        by_shader.setdefault(id(thing.shader), []).append(thing)
    groups = by_shader.values()
    return [Thing(joined("group", [thing.mesh for thing in group]), group[0].shader) for group in groups]


def _visibility(scene: Scene, casters: Mesh | None, lamp: Lamp, position: Array, normal: Array) -> Array:
    """Return the share of a lamp that each point sees, (n,)."""
    total = np.zeros(len(position), np.float32)
    if casters is None:
        return total + 1.0
    spots = _disk(lamp.shadow_samples) if lamp.size > 0.0 else np.zeros((1, 2))
    size = (lamp.resolution, lamp.resolution)
    texel = 2.0 * scene.room.radius / lamp.resolution
    for spot in spots:
        camera = _shadow_camera(scene, lamp, spot * lamp.size)
        drawn = shared_renderer().render(_plain(), casters, camera, [], size)
        depth = _depth(camera, drawn.position.reshape(-1, 3)).reshape(size)
        depth = np.where(drawn.mask, depth, np.inf).astype(np.float32)
        matrix = camera.projection_matrix(1.0, camera.near or 0.1, camera.far or 1.0) @ camera.view_matrix()
        axis = np.subtract(camera.target, camera.position)
        axis = axis / np.linalg.norm(axis) if camera.width is not None else np.zeros(3)
        _add_lit(total, position, normal, matrix, np.array(camera.position), axis, depth, texel)
    return total / len(spots)


def _shadow_camera(scene: Scene, lamp: Lamp, offset: Array) -> Camera:
    """Return the camera that sees the sphere of shadows from a point of the lamp."""
    light, center, radius = lamp.light, np.array(scene.room.center), scene.room.radius
    if isinstance(light, DirectionalLight):
        axis = np.array(light.direction)
        right, up = _across(axis)
        axis = axis + offset[0] * right + offset[1] * up
        axis /= np.linalg.norm(axis)
        place, far = center - 2.0 * radius * axis, 4.0 * radius
        return Camera(_vec(place), _vec(center), _vec(up), width=2.0 * radius, near=0.02, far=far)
    if not isinstance(light, PointLight | SpotLight):
        raise MrmError(f"{type(light).__name__} casts no shadow")
    place = np.array(light.position)
    right, up = _across(center - place)
    place = place + offset[0] * right + offset[1] * up
    distance = float(np.linalg.norm(center - place))
    fov = min(2.0 * math.degrees(math.asin(min(radius / distance, 0.99))), 150.0)
    near, far = 0.02 * distance, distance + 2.0 * radius
    return Camera(_vec(place), _vec(center), _vec(up), fov=fov, near=near, far=far)


@numba.njit(parallel=True, fastmath=True, cache=True)
def _add_lit(total, position, normal, matrix, eye, axis, depth, texel):  # type: ignore[no-untyped-def]
    """Add to `total` 1 for each point that the depth map's camera sees, 0 for one behind another, or between."""
    count = depth.shape[0]
    for i in numba.prange(len(total)):
        toward = 0.0
        for k in range(3):
            toward += normal[i, k] * (eye[k] - position[i, k])
        side = 2.5 * texel if toward > 0.0 else -2.5 * texel
        x, y, z = (
            position[i, 0] + side * normal[i, 0],
            position[i, 1] + side * normal[i, 1],
            position[i, 2] + side * normal[i, 2],
        )
        w = matrix[3, 0] * x + matrix[3, 1] * y + matrix[3, 2] * z + matrix[3, 3]
        u = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z + matrix[0, 3]) / w
        v = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z + matrix[1, 3]) / w
        if not (w > 0.0 and abs(u) < 0.999 and abs(v) < 0.999):
            total[i] += 1.0
            continue
        x, y, z = x - eye[0], y - eye[1], z - eye[2]
        along = x * axis[0] + y * axis[1] + z * axis[2]
        here = (along if along != 0.0 else math.sqrt(x * x + y * y + z * z)) - 1.5 * texel
        column, row = (u * 0.5 + 0.5) * count - 0.5, (0.5 - v * 0.5) * count - 0.5
        c0, r0 = math.floor(column), math.floor(row)
        for c in range(c0, c0 + 2):
            for r in range(r0, r0 + 2):
                weight = (1.0 - abs(column - c)) * (1.0 - abs(row - r))
                if here <= depth[min(max(r, 0), count - 1), min(max(c, 0), count - 1)]:
                    total[i] += weight


def _depth(camera: Camera, position: Array) -> Array:
    distance: Array = np.linalg.norm(position - np.array(camera.position), axis=-1)
    if camera.width is None:
        return distance
    axis = np.subtract(camera.target, camera.position)
    distance = (position - np.array(camera.position)) @ (axis / np.linalg.norm(axis))
    return distance


def _across(axis: Array) -> tuple[Array, Array]:
    helper = (
        np.array([0.0, 1.0, 0.0]) if abs(axis[1]) < 0.9 * np.linalg.norm(axis) else np.array([1.0, 0.0, 0.0])
    )
    right = np.cross(axis, helper)
    right /= np.linalg.norm(right)
    up = np.cross(right, axis)
    return right, up / np.linalg.norm(up)


def _disk(count: int) -> Array:
    """Return points spread evenly over the unit disk: Vogel's spiral."""
    index = np.arange(count) + 0.5
    angle = index * math.pi * (3.0 - math.sqrt(5.0))
    points: Array = np.sqrt(index / count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    return points


def _vec(array: Array) -> Vec3:
    x, y, z = (float(value) for value in array)
    return (x, y, z)


@functools.cache
def _plain() -> Shader:
    """Return the cheapest shader there is: only the geometry that comes with it is wanted."""
    document = mx.createDocument()
    shader = document.addNode("surface_unlit", "plain", "surfaceshader")
    document.addMaterialNode("plain_material", shader)
    return generate_shader(document, max_lights=1)
