"""Meshes from the user's .obj, .gltf and .glb files, completed with what they lack."""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render.gltffile import buffer_files, read_gltf_mesh
from mrm_nodes.render.mesh import BUILT_IN, Mesh, Part, normalized
from mrm_nodes.render.objfile import read_obj_mesh

_READERS: dict[str, Callable[[Path], list[Part]]] = {
    ".obj": read_obj_mesh,
    ".gltf": read_gltf_mesh,
    ".glb": read_gltf_mesh,
}
MESH_SUFFIXES = tuple(_READERS)


def load_mesh(name_or_path: str | os.PathLike[str]) -> Mesh:
    """Return a built-in mesh (`sphere`, `plane`, `baluster`), or read an .obj, .gltf or .glb file as one mesh.

    Warns (MrmWarning) where the file has no normals or texture coordinates, which are made, and of what it has and
    is not read or drawn.

    Raises:
        MrmError: an unknown name or ending, a file that is missing or malformed, an empty mesh, NaN, or an
            index of a vertex that does not exist.
    """
    name = os.fspath(name_or_path)
    if name in BUILT_IN:
        return BUILT_IN[name]()
    file = Path(name)
    if file.suffix.lower() not in _READERS:
        close = difflib.get_close_matches(name[:100], BUILT_IN, n=1)
        hint = (
            f"did you mean {close[0]}?"
            if close
            else f"give an .obj, .gltf or .glb file, or one of {', '.join(BUILT_IN)}"
        )
        raise MrmError(f"{name}: unknown mesh; {hint}")
    if not file.is_file():
        raise MrmError(f"{file}: no such mesh file")
    parts = _READERS[file.suffix.lower()](file)
    if not parts:
        raise MrmError(f"{file}: the mesh is empty: it has no triangles")
    return _completed(_joined(parts, str(file)), str(file))


def mesh_files(file: Path) -> list[Path]:
    """Return the files that a mesh is read from: itself, and the buffers of a glTF file beside it."""
    return [file, *(buffer_files(file) if _READERS.get(file.suffix.lower()) is read_gltf_mesh else ())]


def _joined(parts: list[Part], where: str) -> Part:
    """Join parts; what some of them lack is 0 there, NaN for texture coordinates, white for colours."""
    widths: dict[str, int] = {}
    for part in parts:
        for name, data in part.streams.items():
            widths[name] = max(widths.get(name, 0), data.shape[1])
    counts = [len(part.streams["position"]) for part in parts]
    streams = {}
    for name, width in widths.items():
        lacking = np.nan if name == "texcoord_0" else 1.0 if name.startswith("color") else 0.0
        pieces = [np.full((count, width), lacking) for count in counts]
        for part, piece in zip(parts, pieces, strict=True):
            if name in part.streams:
                piece[:, : part.streams[name].shape[1]] = part.streams[name]
        further = name.startswith(("geomprop", "texcoord")) and name != "texcoord_0"
        if further and any(name not in part.streams for part in parts):
            _warn(f"{where}: part of the mesh has no {name}; it is 0 there")
        streams[name] = np.concatenate(pieces)
    offsets = np.cumsum([0, *counts[:-1]])
    triangles = [part.triangles + offset for part, offset in zip(parts, offsets, strict=True)]
    return Part(streams, np.concatenate(triangles))


def _completed(part: Part, name: str) -> Mesh:
    """Make normals, texture coordinates and tangents for the vertices that have none, or none that is a number."""
    # Vertices that no triangle has are left out.
    part = _split(part, np.zeros_like(part.triangles))
    streams = dict(part.streams)
    count = len(streams["position"])
    streams["normal"], lacks_normals = _directions(streams.get("normal"), count)
    texcoords = streams.get("texcoord_0", np.full((count, 2), np.nan))
    lacks_texcoords = ~np.isfinite(texcoords).all(axis=1)
    made = {"normals": lacks_normals, "texture coordinates": lacks_texcoords}
    for some, which in (
        ("the mesh", np.all),
        ("part of the mesh", lambda each: each.any() and not each.all()),
    ):
        named = [what for what, lacking in made.items() if which(lacking)]
        if named:
            _warn(f"{name}: {some} has no {' and no '.join(named)}; made some")
    if "tangent" in streams and not np.isfinite(streams["tangent"]).all():
        _warn(f"{name}: some tangents are NaN or infinite; made others")
    streams["texcoord_0"] = np.where(lacks_texcoords[:, None], _around(streams["position"]), texcoords)
    streams["made_texcoord"] = lacks_texcoords[:, None]
    part = _with_tangents(_with_normals(Part(streams, part.triangles)))
    streams = part.streams
    signs = streams["bitangent_sign"]
    return Mesh(
        name,
        streams["position"],
        streams["normal"],
        streams["tangent"],
        streams["texcoord_0"],
        part.triangles,
        streams.get("color_0"),
        {key.removeprefix("geomprop_"): data for key, data in streams.items() if key.startswith("geomprop_")},
        signs if (signs < 0.0).any() else None,
        {
            key: data
            for key, data in streams.items()
            if key.startswith(("texcoord_", "color_")) and not key.endswith("_0")
        },
    )


def _split(part: Part, labels: NDArray[Any]) -> Part:
    """Give each vertex as many copies as its corners have labels (m, 3), which are whole numbers from 0."""
    kinds = int(labels.max()) + 1
    keys, triangles = np.unique(part.triangles * kinds + labels, return_inverse=True)
    taken = keys // kinds
    return Part({name: data[taken] for name, data in part.streams.items()}, triangles.reshape(-1, 3))


def _directions(vectors: NDArray[Any] | None, count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return unit vectors, 0 where there is none, and where that is."""
    if vectors is None:
        return np.zeros((count, 3)), np.ones(count, bool)
    units = normalized(np.where(np.isfinite(vectors).all(axis=1, keepdims=True), vectors, 0.0))
    return units, _none(units)


def _none(vectors: NDArray[Any]) -> NDArray[np.bool_]:
    return np.asarray((vectors == 0.0).all(axis=1))


def _around(positions: NDArray[Any]) -> NDArray[np.float64]:
    """Return latitude and longitude about the middle of the mesh as texture coordinates."""
    middle = (positions.max(axis=0) + positions.min(axis=0)) / 2.0
    x, y, z = normalized(positions - middle).T
    return np.stack([np.arctan2(x, z) / (2.0 * np.pi) + 0.5, np.arcsin(y) / np.pi + 0.5], axis=1)


def _edges(part: Part, stream: str) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return what grows along two edges of each triangle, (m, k) each."""
    corners = part.streams[stream][part.triangles]
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _with_normals(part: Part) -> Part:
    """Make vertices that lack a normal flat ones: glTF 2.0, section 3.7.2.1, and MaterialX's loaders."""
    lacking = _none(part.streams["normal"])
    if not lacking.any():
        return part
    faces = np.arange(len(part.triangles))[:, None]
    part = _split(part, np.where(lacking[part.triangles], faces + 1, 0))
    flat = normalized(np.cross(*_edges(part, "position")))
    flat[_none(flat)] = (0.0, 0.0, 1.0)
    normals = part.streams["normal"].copy()
    face, corner = np.nonzero(_none(normals)[part.triangles])
    normals[part.triangles[face, corner]] = flat[face]
    return Part({**part.streams, "normal": normals}, part.triangles)


def _with_tangents(part: Part) -> Part:
    """Make tangents along u where there are none, and bitangents that follow v.

    A vertex between a texture and its mirror image becomes two, as one tangent cannot follow both.
    """
    streams = dict(part.streams)
    count = len(streams["position"])
    lacking = _directions(streams.get("tangent"), count)[1]
    signs = streams.get("bitangent_sign", np.ones((count, 1)))
    streams["tangent"] = np.where(lacking[:, None], 0.0, streams.get("tangent", np.zeros((count, 3))))
    # 0: to be made by the texture.
    by_texture = lacking[:, None] & ~streams["made_texcoord"]
    streams["bitangent_sign"] = np.where(by_texture, 0.0, np.where(signs < 0.0, -1.0, 1.0))
    along_u, mirrored = _along_u(part)
    labels = by_texture.ravel()[part.triangles] & mirrored[:, None]
    part = _split(Part(streams, part.triangles), labels.astype(np.int64))

    tangents, signs, normals = (part.streams[name] for name in ("tangent", "bitangent_sign", "normal"))
    by_texture = signs == 0.0
    sums = np.zeros_like(tangents)
    np.add.at(sums, part.triangles, along_u[:, None])
    signs[part.triangles[labels]] = -1.0
    signs = np.where(signs == 0.0, 1.0, signs)
    east = np.where(_none(tangents)[:, None], np.cross((0.0, 1.0, 0.0), normals), tangents)
    tangents = _perpendicular(np.where(by_texture, sums, east), normals)
    axes = np.where(np.abs(normals[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    tangents = np.where(_none(tangents)[:, None], _perpendicular(axes, normals), tangents)
    return Part({**part.streams, "tangent": tangents, "bitangent_sign": signs}, part.triangles)


def _along_u(part: Part) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return how each triangle's position grows with u (m, 3) (Lengyel 2001, as MaterialX), 0 where u does not.

    And whether the texture lies there mirrored, as the normals see it.
    """
    first, second = _edges(part, "position")
    (u1, v1), (u2, v2) = (edges.T for edges in _edges(part, "texcoord_0"))
    area = u1 * v2 - u2 * v1
    seen = area != 0.0
    along_u = (first.T * v2 - second.T * v1) / np.where(seen, area, 1.0) * seen
    normals = part.streams["normal"][part.triangles].sum(axis=1)
    inside_out = np.sum(np.cross(first, second) * normals, axis=1) < 0.0
    return along_u.T, seen & ((area < 0.0) != inside_out)


def _perpendicular(vectors: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    return normalized(vectors - np.sum(vectors * normals, axis=1, keepdims=True) * normals)


def _warn(text: str) -> None:
    warnings.warn(text, MrmWarning, stacklevel=4)
