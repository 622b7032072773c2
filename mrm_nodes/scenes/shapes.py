"""Geometry of the scenes, all of it computed: turned solids, plates, ground, a torso. Metres, y up."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.render import Mesh

Array = NDArray[np.float64]
Vec3 = tuple[float, float, float]

#: A surface: positions (..., 3) for s and t from 0 to 1, both (...); s × t points outwards.
Surface = Callable[[Array, Array], Array]


def patch(name: str, surface: Surface, columns: int, rows: int) -> Mesh:
    """Return a surface as a mesh whose texture coordinates are s and t."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    step = 1e-4
    along_s = surface(s + step, t) - surface(s - step, t)
    along_t = surface(s, np.minimum(t + step, 1.0)) - surface(s, np.maximum(t - step, 0.0))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = np.stack([first, first + 1, first + columns + 2], axis=1)
    upper = np.stack([first, first + columns + 2, first + columns + 1], axis=1)
    positions, normals, tangents = (
        array.reshape(-1, 3) for array in (surface(s, t), _unit(np.cross(along_s, along_t)), _unit(along_s))
    )
    texcoords = np.stack([s, t], -1).reshape(-1, 2)
    return Mesh(name, positions, normals, tangents, texcoords, np.concatenate([lower, upper]))


def turned(name: str, pieces: Sequence[Sequence[tuple[float, float]]], sides: int = 96) -> Mesh:
    """Return profiles (radius, height), from bottom to top, turned about the y axis; edges between pieces are sharp.

    v runs with the height from 0 to 1 over the whole.
    """
    heights = [y for piece in pieces for _, y in piece]
    low, high = min(heights), max(heights)
    parts = []
    for piece in pieces:
        points = np.array(piece, float)
        along = np.linspace(0.0, 1.0, len(points))

        def surface(s: Array, t: Array, points: Array = points, along: Array = along) -> Array:
            radius = np.maximum(np.interp(t, along, points[:, 0]), 1e-4)
            height = np.interp(t, along, points[:, 1])
            angle = 2.0 * np.pi * (s - 0.5)
            return np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], -1)

        part = patch(name, surface, sides, len(points) - 1)
        texcoords = np.stack([part.texcoords[:, 0], (part.positions[:, 1] - low) / max(high - low, 1e-9)], -1)
        parts.append(Mesh(name, part.positions, part.normals, part.tangents, texcoords, part.indices))
    return joined(name, parts)


def arc(
    center: tuple[float, float], radius: float, first: float, last: float, count: int = 10
) -> list[tuple[float, float]]:
    """Return points of a profile on an arc, angles in degrees above the horizontal."""
    angles = np.radians(np.linspace(first, last, count))
    return [(center[0] + radius * math.cos(a), center[1] + radius * math.sin(a)) for a in angles]


def slab(name: str, width: float, height: float, corner: float, bevel: float) -> Mesh:
    """Return a square slab that lies on the ground, its corners round and its upper edge bevelled."""

    def outline(s: Array, inset: Array) -> tuple[Array, Array]:
        angle = 2.0 * np.pi * (s - 0.5)
        half, c, w = width / 2.0 - inset, np.cos(angle), np.sin(angle)
        power = 2.0 + 10.0 * (1.0 - corner / (width / 2.0))
        radius = half / (np.abs(c) ** power + np.abs(w) ** power) ** (1.0 / power)
        return radius * w, radius * c

    profile = np.array(
        [
            (0.0, 0.0),
            (0.0, height - bevel),
            *[
                (bevel * (1.0 - math.cos(a)), height - bevel * (1.0 - math.sin(a)))
                for a in np.linspace(0.1, math.pi / 2, 8)
            ],
        ]
    )
    along = np.linspace(0.0, 1.0, len(profile))

    def side(s: Array, t: Array) -> Array:
        x, z = outline(s, np.interp(t, along, profile[:, 0]))
        return np.stack([x, np.interp(t, along, profile[:, 1]), z], -1)

    def top(s: Array, t: Array) -> Array:
        x, z = outline(s, np.full_like(s, bevel))
        return np.stack([x * (1.0 - t), np.full_like(s, height), z * (1.0 - t)], -1)

    return joined(name, [patch(name, side, 160, 40), patch(name, top, 160, 2)])


def ground(
    name: str, x: tuple[float, float], z: tuple[float, float], y: float = 0.0, turn: float = 1.0
) -> Mesh:
    """Return a rectangle that faces up; u runs with x, v away from the viewer, one unit a metre times `turn`."""

    def surface(s: Array, t: Array) -> Array:
        return np.stack([x[0] + s * (x[1] - x[0]), np.full_like(s, y), z[1] + t * (z[0] - z[1])], -1)

    mesh = patch(name, surface, 8, 64)
    texcoords = np.stack([mesh.positions[:, 0], -mesh.positions[:, 2]], -1) * turn
    return Mesh(name, mesh.positions, mesh.normals, mesh.tangents, texcoords, mesh.indices)


def plate(name: str, width: float, height: float, corner: float) -> Mesh:
    """Return a plate in the x-y plane that faces +z, about the origin, its corners round."""
    corners = [(1, 1), (-1, 1), (-1, -1), (1, -1)]
    outline = [
        (sx * (width / 2 - corner) + corner * math.cos(a), sy * (height / 2 - corner) + corner * math.sin(a))
        for k, (sx, sy) in enumerate(corners)
        for a in np.linspace(k * math.pi / 2, (k + 1) * math.pi / 2, 12)
    ]
    points = np.array([(0.0, 0.0), *outline])
    count = len(outline)
    indices = [(0, 1 + k, 1 + (k + 1) % count) for k in range(count)]
    positions = np.concatenate([points, np.zeros((count + 1, 1))], -1)
    texcoords = points / np.array([width, height]) + 0.5
    return Mesh(
        name,
        positions,
        np.tile([0.0, 0.0, 1.0], (count + 1, 1)),
        np.tile([1.0, 0.0, 0.0], (count + 1, 1)),
        texcoords,
        np.array(indices),
    )


def moved(
    mesh: Mesh, to: Vec3 = (0.0, 0.0, 0.0), turn: float = 0.0, tilt: float = 0.0, scale: float = 1.0
) -> Mesh:
    """Return a mesh scaled, tilted about z, turned about y (degrees), then moved."""
    a, b = math.radians(tilt), math.radians(turn)
    about_z = np.array([[math.cos(a), -math.sin(a), 0.0], [math.sin(a), math.cos(a), 0.0], [0.0, 0.0, 1.0]])
    about_y = np.array([[math.cos(b), 0.0, math.sin(b)], [0.0, 1.0, 0.0], [-math.sin(b), 0.0, math.cos(b)]])
    rotation = about_y @ about_z
    positions = scale * mesh.positions @ rotation.T + np.array(to)
    return Mesh(
        mesh.name,
        positions,
        mesh.normals @ rotation.T,
        mesh.tangents @ rotation.T,
        mesh.texcoords,
        mesh.indices,
    )


def joined(name: str, parts: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    offsets = np.cumsum([0] + [len(part.positions) for part in parts[:-1]])
    positions, normals, tangents, texcoords = (
        np.concatenate([getattr(part, key) for part in parts])
        for key in ("positions", "normals", "tangents", "texcoords")
    )
    indices = np.concatenate(
        [part.indices.astype(np.int64) + o for part, o in zip(parts, offsets, strict=True)]
    )
    return Mesh(name, positions, normals, tangents, texcoords, indices)


def cone_body() -> Mesh:
    """Return the body of a traffic cone 0.72 high, without its foot; v is the height over 0.72."""

    def slope(y: float) -> float:
        return 0.152 - (y - 0.035) * 0.178

    return turned(
        "cone",
        [
            [(0.175, 0.0), (0.175, 0.02), *arc((0.165, 0.02), 0.010, 0, 80, 6)],
            [
                (0.1667, 0.0298),
                (0.158, 0.034),
                (0.152, 0.045),
                *[(slope(y), y) for y in np.linspace(0.06, 0.70, 40)],
            ],
            arc((slope(0.70) - 0.008, 0.70), 0.008, 0, 90, 8),
            [(slope(0.70) - 0.008, 0.708), (slope(0.70) - 0.014, 0.704), (slope(0.7) - 0.015, 0.60)],
        ],
        128,
    )


def unit_sphere(s: Array, t: Array) -> Array:
    """Return points of the unit sphere: s runs around, t from pole to pole."""
    longitude, latitude = 2.0 * np.pi * (s - 0.5), np.pi * (np.clip(t, 1e-3, 1.0 - 1e-3) - 0.5)
    across = np.cos(latitude)
    return np.stack([across * np.sin(longitude), np.sin(latitude), across * np.cos(longitude)], -1)


#: Height, half width and half depth of the torso, from the hem up to the neck.
_TORSO = np.array([
    (-0.470, 0.196, 0.142), (-0.380, 0.190, 0.140), (-0.270, 0.178, 0.130), (-0.160, 0.168, 0.121),
    (-0.040, 0.176, 0.126), (0.070, 0.193, 0.136), (0.160, 0.204, 0.134), (0.225, 0.207, 0.121),
    (0.270, 0.198, 0.104), (0.305, 0.172, 0.089), (0.330, 0.134, 0.078), (0.348, 0.096, 0.070),
    (0.368, 0.071, 0.064), (0.400, 0.061, 0.060), (0.450, 0.058, 0.058),
])  # fmt: skip


def torso(s: Array, t: Array) -> Array:
    """Return points of a tailor's dummy in a vest: s runs around from the back, t from the hem to the neck."""
    y, a, b = (np.interp(t, np.linspace(0.0, 1.0, 240), column) for column in _torso_curves())
    angle = 2.0 * np.pi * (s - 0.5)
    c, w = np.cos(angle), np.sin(angle)
    power = 2.35
    radius = 1.0 / (np.abs(c) ** power + np.abs(w) ** power) ** (1.0 / power)
    low = np.clip((0.02 - y) / 0.49, 0.0, 1.0)
    folds = 1.0 + low**1.5 * (
        0.035 * np.sin(9.0 * angle + 3.0 * y) + 0.02 * np.sin(17.0 * angle - 5.0 * y + 1.0)
    )
    folds = folds + 0.012 * low * np.sin(26.0 * y + 2.0 * np.sin(2.0 * angle))
    chest = 0.012 * np.exp(-(((y - 0.10) / 0.09) ** 2)) * np.clip(c, 0.0, 1.0) ** 2
    return np.stack([a * radius * w * folds, y, b * radius * c * folds + chest], -1)


def _torso_curves() -> Array:
    """Return the table above as smooth curves with even steps along the outline."""
    table = _TORSO
    knots = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(table[:, 0]), np.diff(table[:, 1])))])
    fine = np.linspace(0.0, knots[-1], 240)
    curves = []
    for column in table.T:
        slopes = np.gradient(column, knots)
        k = np.clip(np.searchsorted(knots, fine, side="right") - 1, 0, len(knots) - 2)
        h = knots[k + 1] - knots[k]
        u = (fine - knots[k]) / h
        curves.append(
            (1 + 2 * u) * (1 - u) ** 2 * column[k]
            + u * (1 - u) ** 2 * h * slopes[k]
            + u**2 * (3 - 2 * u) * column[k + 1]
            + u**2 * (u - 1) * h * slopes[k + 1]
        )
    return np.array(curves)


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(lengths > 1e-12, lengths, 1.0)
