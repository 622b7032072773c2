"""Meshes from the user's .obj and .glb files, through MaterialX's own loaders.

Those loaders read past the end of their buffers where a file refers to data that it lacks, and crash or go on
with garbage: the files are checked here before a loader sees them.
"""

from __future__ import annotations

import json
import os
import struct
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXRender as mx_render
import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render.mesh import BUILT_IN, Mesh, merge, normalized


def load_mesh(name_or_path: str | os.PathLike[str]) -> Mesh:
    """Return a built-in mesh (`sphere`, `plane`, `baluster`), or read an .obj or .glb file as one mesh.

    Warns (MrmWarning) where the file has no normals or texture coordinates: they are generated.

    Raises:
        MrmError: an unknown name or ending, a file that is missing or malformed, an empty mesh, NaN, or an
            index of a vertex that does not exist.
    """
    name = os.fspath(name_or_path)
    if name in BUILT_IN:
        return BUILT_IN[name]()
    file = Path(name)
    loaders = {".obj": (mx_render.TinyObjLoader, _check_obj), ".glb": (mx_render.CgltfLoader, _check_glb)}
    if file.suffix.lower() not in loaders:
        raise MrmError(f"{name}: unknown mesh; give an .obj or .glb file, or one of {', '.join(BUILT_IN)}")
    if not file.is_file():
        raise MrmError(f"{file}: no such mesh file")
    loader, check = loaders[file.suffix.lower()]
    try:
        lacks_normals, lacks_texcoords = check(file)
    except OSError as error:
        raise MrmError(f"{file}: cannot be read: {error.strerror}") from None
    handler = mx_render.GeometryHandler.create()
    handler.addLoader(loader.create())
    # MaterialX's v grows upwards and glTF's downwards: not asking for a flip keeps MaterialX's.
    if not handler.loadGeometry(mx.FilePath(str(file)), False):
        raise MrmError(f"{file}: MaterialX cannot read this mesh")
    parts = [part for mesh in handler.getMeshes() for part in _parts(mesh)]
    if not parts:
        raise MrmError(f"{file}: the mesh is empty: it has no triangles")
    made = [
        what
        for what, missing in (("normals", lacks_normals), ("texture coordinates", lacks_texcoords))
        if missing
    ]
    if made:
        warnings.warn(f"{file}: the mesh has no {' and no '.join(made)}; made some", MrmWarning, stacklevel=2)
    return _completed(merge(str(file), parts))


def _parts(mesh: Any) -> Iterator[dict[str, NDArray[Any]]]:
    indices = [np.array(mesh.getPartition(i).getIndices(), np.int64) for i in range(mesh.getPartitionCount())]
    triangles = np.concatenate([*indices, np.empty(0, np.int64)]).reshape(-1, 3)
    if not len(triangles):
        return
    count = len(_stream(mesh, "i_position", 3))
    part = {"positions": _stream(mesh, "i_position", 3), "indices": triangles}
    for name, stream, width in (
        ("normals", "i_normal", 3),
        ("tangents", "i_tangent", 3),
        ("texcoords", "i_texcoord_0", 2),
    ):
        data = _stream(mesh, stream, width)
        part[name] = data if len(data) == count else np.zeros((count, width))
    yield part


def _stream(mesh: Any, name: str, width: int) -> NDArray[np.float32]:
    stream = mesh.getStream(name)
    if stream is None:
        return np.zeros((0, width), np.float32)
    return np.array(stream.getData(), np.float32).reshape(-1, stream.getStride())[:, :width]


def _completed(mesh: Mesh) -> Mesh:
    """Give normals, texture coordinates and tangents to the vertices that have none."""
    positions, indices = mesh.positions.astype(np.float64), mesh.indices
    normals, texcoords = normalized(mesh.normals), mesh.texcoords.astype(np.float64)
    lacking = ~normals.any(axis=1)
    if lacking.any():
        corners = positions[indices]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sums = np.zeros_like(positions)
        for corner in range(3):
            np.add.at(sums, indices[:, corner], face)
        normals[lacking] = normalized(sums)[lacking]
        normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    tangents = mesh.tangents.astype(np.float64)
    if not texcoords.any():
        # Latitude and longitude about the middle of the mesh.
        x, y, z = normalized(positions - mesh.center).T
        texcoords = np.stack([np.arctan2(x, z) / (2.0 * np.pi) + 0.5, np.arcsin(y) / np.pi + 0.5], axis=1)
        tangents = np.cross((0.0, 1.0, 0.0), normals)
    tangents = normalized(tangents - np.sum(tangents * normals, axis=1, keepdims=True) * normals)
    lacking = ~tangents.any(axis=1) | ~np.isfinite(tangents).all(axis=1)
    if lacking.any():
        n = normals[lacking]
        axis = np.where(np.abs(n[:, :1]) < 0.9, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        tangents[lacking] = normalized(axis - np.sum(axis * n, axis=1, keepdims=True) * n)
    return Mesh(mesh.name, positions, normals, tangents, texcoords, indices)


def _check_obj(file: Path) -> tuple[bool, bool]:
    """Return whether a face lacks normals, and whether one lacks texture coordinates.

    Raises:
        MrmError: a face refers to what the file lacks, a number is none, or there is no face.
    """
    counts = {"v": 0, "vt": 0, "vn": 0}
    lacks_texcoords = lacks_normals = False
    faces = 0
    with file.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines, start=1):
            words = line.split("#", 1)[0].split()
            if not words:
                continue
            where = f"{file}, line {number}"
            if words[0] in counts:
                counts[words[0]] += 1
                _check_obj_numbers(words, where)
            elif words[0] == "f":
                faces += 1
                if len(words) < 4:
                    raise MrmError(f"{where}: a face needs three vertices or more")
                for corner in words[1:]:
                    has_texcoord, has_normal = _check_obj_corner(corner, counts, where)
                    lacks_texcoords |= not has_texcoord
                    lacks_normals |= not has_normal
    if faces == 0 or counts["v"] == 0:
        raise MrmError(f"{file}: the mesh is empty: {counts['v']} vertices, {faces} faces")
    return lacks_normals, lacks_texcoords


def _check_obj_numbers(words: list[str], where: str) -> None:
    needed = {"v": 3, "vt": 1, "vn": 3}[words[0]]
    try:
        numbers = [float(word) for word in words[1:]]
    except ValueError:
        raise MrmError(f"{where}: not numbers: {' '.join(words)[:80]}") from None
    if len(numbers) < needed:
        raise MrmError(f"{where}: {words[0]} needs {needed} numbers: {' '.join(words)[:80]}")
    if not np.isfinite(numbers).all():
        raise MrmError(f"{where}: NaN or infinite: {' '.join(words)[:80]}")


def _check_obj_corner(corner: str, counts: dict[str, int], where: str) -> tuple[bool, bool]:
    """Return whether the corner of a face (`v`, `v/vt`, `v//vn` or `v/vt/vn`) has a texcoord and a normal."""
    fields = corner.split("/")
    present = [False, False, False]
    for place, (kind, text) in enumerate(zip(("v", "vt", "vn"), fields, strict=False)):
        if not text and kind != "v":
            continue
        try:
            index = int(text)
        except ValueError:
            raise MrmError(f"{where}: not a vertex of a face: {corner}") from None
        # Indices count from 1, or backwards from the last one read.
        if index == 0 or index > counts[kind] or -index > counts[kind]:
            raise MrmError(f"{where}: the face refers to {kind} {index}, but {counts[kind]} are there so far")
        present[place] = True
    if len(fields) > 3:
        raise MrmError(f"{where}: not a vertex of a face: {corner}")
    return present[1], present[2]


# glTF 2.0, section 3.6.2.2 and 4.4
_GLB_MAGIC = b"glTF"
_COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES = 4


def _check_glb(file: Path) -> tuple[bool, bool]:
    """Return whether a primitive lacks normals, and whether one lacks texture coordinates.

    Raises:
        MrmError: a truncated file, or one that refers to data or vertices that it lacks.
    """
    content = file.read_bytes()
    try:
        gltf, binary = _glb_chunks(content, file)
        required = set(gltf.get("extensionsRequired", ())) - {
            "KHR_mesh_quantization",
            "KHR_texture_transform",
        }
        compressed = sorted(name for name in required if "compression" in name)
        if compressed:
            raise MrmError(
                f"{file}: uses {', '.join(compressed)}, which MaterialX cannot read; save it uncompressed"
            )
        for number, buffer in enumerate(gltf.get("buffers", ())):
            if "uri" in buffer or number > 0:
                raise MrmError(f"{file}: its data lies outside the file; save it as one self-contained .glb")
            if buffer["byteLength"] > len(binary):
                raise MrmError(
                    f"{file}: truncated: {len(binary)} of {buffer['byteLength']} bytes of data are there"
                )
        lacks = [False, False]
        drawn = 0
        for mesh in gltf.get("meshes", ()):
            for primitive in mesh["primitives"]:
                if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
                    continue
                drawn += 1
                _check_primitive(gltf, primitive, binary, file)
                lacks[0] |= "NORMAL" not in primitive["attributes"]
                lacks[1] |= "TEXCOORD_0" not in primitive["attributes"]
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise MrmError(f"{file}: not a well-formed .glb: {type(error).__name__}: {error}") from None
    if not drawn:
        raise MrmError(f"{file}: the mesh is empty: it has no triangles")
    return lacks[0], lacks[1]


def _glb_chunks(content: bytes, file: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk."""
    if len(content) < 20 or content[:4] != _GLB_MAGIC:
        raise MrmError(f"{file}: not a .glb file")
    version, length, json_length = struct.unpack_from("<III", content, 4)
    if version != 2:
        raise MrmError(f"{file}: glTF version {version}; only version 2 is read")
    if length > len(content):
        raise MrmError(f"{file}: truncated: {len(content)} of {length} bytes are there")
    gltf = json.loads(content[20 : 20 + json_length])
    start = 20 + json_length
    if start + 8 > len(content):
        return gltf, b""
    (binary_length,) = struct.unpack_from("<I", content, start)
    return gltf, content[start + 8 : start + 8 + binary_length]


def _check_primitive(gltf: dict[str, Any], primitive: dict[str, Any], binary: bytes, file: Path) -> None:
    count = gltf["accessors"][primitive["attributes"]["POSITION"]]["count"]
    for name, accessor in primitive["attributes"].items():
        data = _accessor_data(gltf, accessor, binary, file)
        if len(data) != count:
            raise MrmError(f"{file}: {name} has {len(data)} values for {count} vertices")
        if name == "POSITION" and not np.isfinite(data).all():
            raise MrmError(f"{file}: a position is NaN or infinite")
    if "indices" not in primitive:
        return
    indices = _accessor_data(gltf, primitive["indices"], binary, file)
    if len(indices) and int(indices.max()) >= count:
        raise MrmError(f"{file}: a triangle refers to vertex {int(indices.max())}, but there are {count}")


def _accessor_data(gltf: dict[str, Any], index: int, binary: bytes, file: Path) -> NDArray[Any]:
    """Return an accessor's values, shape (count, components)."""
    if index < 0:
        raise IndexError(f"accessor {index}")
    accessor = gltf["accessors"][index]
    if "sparse" in accessor or "bufferView" not in accessor:
        raise MrmError(f"{file}: uses sparse accessors, which are not supported; save it without")
    view = gltf["bufferViews"][accessor["bufferView"]]
    kind, components = np.dtype(_COMPONENT_TYPES[accessor["componentType"]]), _COMPONENTS[accessor["type"]]
    size = kind.itemsize * components
    stride, count = view.get("byteStride", size), accessor["count"]
    offset = accessor.get("byteOffset", 0)
    needed = offset + stride * (count - 1) + size if count else offset
    start = view.get("byteOffset", 0)
    if min(offset, start, count, stride) < 0 or needed > view["byteLength"] or start + needed > len(binary):
        raise MrmError(f"{file}: accessor {index} refers to data outside its buffer")
    return np.ndarray((count, components), kind, binary, start + offset, (stride, kind.itemsize))
