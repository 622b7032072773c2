"""Triangle meshes, and the shapes that need no file: a sphere, a plane and a baluster."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.scene import Vec3

Floats = NDArray[np.float32]


class Part(NamedTuple):
    """A part of a file's mesh as it was read."""

    streams: dict[str, NDArray[Any]]
    """Vertex data (n, k) by MaterialX's names (`position`, `normal`, `tangent`, `texcoord_0`, `color_0`, …,
    `geomprop_NAME`), and `bitangent_sign`."""
    triangles: NDArray[np.int64]
    """(m, 3)."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh in world space; its arrays are copied to float32 (uint32) and made read-only.

    Args:
        name: what errors call it.
        positions: (n, 3), in scene units.
        normals: (n, 3), unit vectors.
        tangents: (n, 3), unit vectors along u.
        texcoords: (n, 2); v grows upwards, as MaterialX has it.
        indices: (m, 3), counter-clockwise seen from outside.
        colors: (n, 4), or None for white.
        geomprops: further vertex data by the name that a `geompropvalue` node gives, (n,) or (n, k).
        bitangent_signs: (n, 1), 1 or -1: the bitangent is this times normal × tangent; None for 1.
        sets: further sets by MaterialX's names, `texcoord_1` (n, 2) or `color_1` (n, 4) and so on.

    Raises:
        MrmError: an empty mesh, a wrong shape, NaN, or an index of a vertex that does not exist.
    """

    name: str
    positions: NDArray[Any]
    normals: NDArray[Any]
    tangents: NDArray[Any]
    texcoords: NDArray[Any]
    indices: NDArray[Any]
    colors: NDArray[Any] | None = None
    geomprops: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    bitangent_signs: NDArray[Any] | None = None
    sets: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"<Mesh {self.name!r}: {len(self.positions)} vertices, {len(self.indices)} triangles>"

    def __post_init__(self) -> None:
        indices = np.asarray(self.indices).reshape(-1, 3)
        count = len(self.positions)
        if count == 0 or len(indices) == 0:
            raise MrmError(f"mesh {self.name}: it is empty: {count} vertices, {len(indices)} triangles")
        if indices.min() < 0 or indices.max() >= count:
            wrong = int(indices.min() if indices.min() < 0 else indices.max())
            raise MrmError(f"mesh {self.name}: a triangle refers to vertex {wrong}, but there are {count}")
        self._keep("indices", indices.astype(np.uint32))
        for name, width in (("positions", 3), ("normals", 3), ("tangents", 3), ("texcoords", 2)):
            self._keep(name, self._vertex_data(name, getattr(self, name), width))
        if self.colors is not None:
            self._keep("colors", self._vertex_data("colors", self.colors, 4))
        if self.bitangent_signs is not None:
            self._keep("bitangent_signs", self._vertex_data("bitangent_signs", self.bitangent_signs, 1))
        sets = {
            name: self._vertex_data(name, data, 4 if name.startswith("color") else 2)
            for name, data in self.sets.items()
        }
        geomprops = {name: self._vertex_data(name, data, None) for name, data in self.geomprops.items()}
        object.__setattr__(self, "sets", sets)
        object.__setattr__(self, "geomprops", geomprops)

    def _keep(self, name: str, array: NDArray[Any]) -> None:
        array.flags.writeable = False
        object.__setattr__(self, name, array)

    def _vertex_data(self, name: str, data: Any, width: int | None) -> Floats:
        array = np.array(data, dtype=np.float32, order="C")
        if array.ndim == 1 and width is None:
            array = array[:, None]
        if array.ndim != 2 or len(array) != len(self.positions) or width not in (None, array.shape[1]):
            expected = f"({len(self.positions)}, {width or 'k'})"
            raise MrmError(f"mesh {self.name}: {name} have shape {array.shape}, not {expected}")
        if not np.isfinite(array).all():
            vertex = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise MrmError(f"mesh {self.name}: {name} of vertex {vertex} are NaN or infinite")
        return array

    @functools.cached_property
    def center(self) -> Vec3:
        """Centre of the bounding box."""
        x, y, z = (self.positions.max(axis=0).astype(float) + self.positions.min(axis=0)) / 2.0
        return (float(x), float(y), float(z))

    @functools.cached_property
    def radius(self) -> float:
        """Radius, in scene units, of the sphere about `center` that holds every vertex."""
        return float(np.linalg.norm(self.positions - np.array(self.center), axis=1).max())

    @functools.cached_property
    def tiles(self) -> Mapping[tuple[int, int], Mesh]:
        """The triangles of each tile of texture coordinates, by column and row, as MaterialX's `Mesh.splitByUdims`.

        A triangle is of the tile in which its smallest u and v lie.
        """
        corners = self.texcoords[self.indices].min(axis=1)
        columns_and_rows, numbers = np.unique(np.floor(corners).astype(int), axis=0, return_inverse=True)
        return {
            (int(column), int(row)): self._part(self.indices[numbers.ravel() == number])
            for number, (column, row) in enumerate(columns_and_rows)
        }

    def _part(self, triangles: NDArray[Any]) -> Mesh:
        used, indices = np.unique(triangles, return_inverse=True)

        def picked(data: Any) -> Any:
            return None if data is None else data[used]

        return replace(
            self,
            indices=indices.reshape(-1, 3),
            **{
                name: picked(getattr(self, name))
                for name in ("positions", "normals", "tangents", "texcoords", "colors", "bitangent_signs")
            },
            geomprops={name: data[used] for name, data in self.geomprops.items()},
            sets={name: data[used] for name, data in self.sets.items()},
        )


def _on_grid(columns: int, rows: int) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return s and t on a grid over the unit square, of shape (rows + 1, columns + 1), and its triangles."""
    s, t = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    lower = np.stack([first, first + 1, first + columns + 2], axis=1)
    upper = np.stack([first, first + columns + 2, first + columns + 1], axis=1)
    return s, t, np.concatenate([lower, upper])


@functools.cache
def sphere() -> Mesh:
    """Return the unit sphere about the origin: u runs eastwards around +y, v from the south pole up.

    The middle of a texture faces +z; tangents point east.
    """
    u, v, indices = _on_grid(72, 36)
    longitude, latitude = 2.0 * np.pi * (u - 0.5), np.pi * (v - 0.5)
    zero = np.zeros_like(u)
    normals = _joined(
        np.cos(latitude) * np.sin(longitude), np.sin(latitude), np.cos(latitude) * np.cos(longitude)
    )
    tangents = _joined(np.cos(longitude), zero, -np.sin(longitude))
    # At the poles one of the two triangles of a grid cell has no area.
    a, b, c = np.moveaxis(normals[indices], 1, 0)
    indices = indices[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
    return Mesh("sphere", normals, normals, tangents, _joined(u, v), indices)


@functools.cache
def plane() -> Mesh:
    """Return the square from (-1, -1, 0) to (1, 1, 0) that faces +z; u runs along x, v along y."""
    u, v, indices = _on_grid(1, 1)
    zero, one = np.zeros_like(u), np.ones_like(u)
    return Mesh(
        "plane",
        _joined(2.0 * u - 1.0, 2.0 * v - 1.0, zero),
        _joined(zero, zero, one),
        _joined(one, zero, zero),
        _joined(u, v),
        indices,
    )


def _joined(*components: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack(components, axis=-1).reshape(-1, len(components))


Profile = Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], NDArray[np.float64]]]


def _line(start: tuple[float, float], end: tuple[float, float]) -> Profile:
    return lambda t: (start[0] + t * (end[0] - start[0]), start[1] + t * (end[1] - start[1]))


def _arc(center: tuple[float, float], radius: float, first: float, last: float) -> Profile:
    """Return the arc from angle `first` to `last` (radians above the horizontal)."""

    def profile(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        angle = first + t * (last - first)
        return center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)

    return profile


def _shaft(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a shaft that swells a little, as the columns of temples do."""
    return 0.33 - 0.05 * t - 0.05 * t**2 + 0.03 * np.sin(np.pi * t), 0.36 + 0.89 * t


@functools.cache
def baluster() -> Mesh:
    """Return a turned baluster, 1.9 high, about the origin: foot, moulding, fluted shaft, collar and ball.

    It has what a picture of a material needs: flat, round (one and two ways) and hollow surfaces, sharp
    edges, undersides. u runs eastwards around +y, v along the profile from foot to top; tangents point east.
    """
    ball, neck = 0.32, 0.2
    ball_center = (0.0, 1.33 + float(np.sqrt(ball**2 - neck**2)))
    ball_start = -float(np.arccos(neck / ball))
    # The moulding meets the foot at an angle: surfaces that touch tangentially flicker.
    bed = -1.2
    # The axis itself has no tangent: leave out a hole too small to see.
    hole = 1e-5
    pieces: list[tuple[Profile, int, int]] = [  # profile (radius, height), rows, flutes
        (_line((hole, 0.0), (0.56, 0.0)), 1, 0),
        (_line((0.56, 0.0), (0.56, 0.17)), 1, 0),
        (_line((0.56, 0.17), (0.40 + 0.10 * np.cos(bed), 0.17)), 1, 0),
        (_arc((0.40, 0.17 - 0.10 * np.sin(bed)), 0.10, bed, np.pi / 2.0), 24, 0),
        (_line((0.40, 0.27 - 0.10 * np.sin(bed)), (0.24, 0.27 - 0.10 * np.sin(bed))), 1, 0),
        (_shaft, 24, 16),
        (_line((0.20, 1.25), (0.36, 1.25)), 1, 0),
        (_line((0.36, 1.25), (0.36, 1.33)), 1, 0),
        (_line((0.36, 1.33), (neck, 1.33)), 1, 0),
        (_arc(ball_center, ball, ball_start, np.pi / 2.0 - hole), 32, 0),
    ]
    grid = np.linspace(0.0, 1.0, 65)
    lengths = [float(np.hypot(*np.diff(profile(grid))).sum()) for profile, _, _ in pieces]
    ends = np.concatenate([[0.0], np.cumsum(lengths)]) / sum(lengths)
    middle = (ball_center[1] + ball) / 2.0
    parts = []
    for (profile, rows, flutes), v0, v1 in zip(pieces, ends[:-1], ends[1:], strict=True):
        sides = max(flutes, 1)
        for side in range(sides):
            surface = _turned(profile, middle, side, sides, 0.14 if flutes else 0.0)
            part = _patch(surface, 10 if flutes else 128, rows)
            s, t = part["texcoords"].T
            part["texcoords"] = _joined((side + s) / sides, v0 + t * (v1 - v0))
            parts.append(part)
    return merge("baluster", parts)


Surface = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def _turned(profile: Profile, middle: float, side: int, sides: int, hollow: float) -> Surface:
    """Return one of the equal sides of a profile turned about +y, hollowed between its edges."""

    def surface(s: NDArray[np.float64], t: NDArray[np.float64]) -> NDArray[np.float64]:
        longitude = 2.0 * np.pi * ((side + s) / sides - 0.5)
        radius, height = profile(t)
        radius = radius * (1.0 - hollow * 4.0 * s * (1.0 - s))
        return np.stack([radius * np.sin(longitude), height - middle, radius * np.cos(longitude)], axis=-1)

    return surface


def _patch(surface: Surface, columns: int, rows: int) -> dict[str, NDArray[Any]]:
    """Sample P(s, t) on a grid; P_s × P_t points outwards.

    P is smooth a little beyond the unit square, so that central differences are good at its edges too.
    """
    s, t, indices = _on_grid(columns, rows)
    step = 1e-5
    along_s = (surface(s + step, t) - surface(s - step, t)).reshape(-1, 3)
    along_t = (surface(s, t + step) - surface(s, t - step)).reshape(-1, 3)
    return {
        "positions": surface(s, t).reshape(-1, 3),
        "normals": normalized(np.cross(normalized(along_s), normalized(along_t))),
        "tangents": normalized(along_s),
        "texcoords": _joined(s, t),
        "indices": indices,
    }


def normalized(vectors: NDArray[Any]) -> NDArray[np.float64]:
    """Return vectors of shape (..., 3) at unit length; zero stays zero."""
    wide = np.asarray(vectors, dtype=np.float64)
    lengths = np.linalg.norm(wide, axis=-1, keepdims=True)
    return wide / np.where(lengths > 0.0, lengths, 1.0)


def merge(name: str, parts: list[dict[str, NDArray[Any]]]) -> Mesh:
    """Join parts, each with the five arrays of a Mesh by their names, into one mesh."""
    offsets = np.cumsum([0] + [len(part["positions"]) for part in parts[:-1]])
    indices = [part["indices"].astype(np.int64) + offset for part, offset in zip(parts, offsets, strict=True)]
    positions, normals, tangents, texcoords = (
        np.concatenate([part[key] for part in parts])
        for key in ("positions", "normals", "tangents", "texcoords")
    )
    return Mesh(name, positions, normals, tangents, texcoords, np.concatenate(indices))


#: The shapes that need no file, by the name that the command line uses.
BUILT_IN: dict[str, Callable[[], Mesh]] = {"sphere": sphere, "plane": plane, "baluster": baluster}
