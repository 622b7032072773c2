"""The triangles of a glTF 2.0 file, .glb or .gltf, with everything that its vertices carry.

MaterialX's own loader reads past the end of its buffers where a file refers to data that it lacks, and drops
colours, further sets of texture coordinates, the sign of the bitangent, strips and fans; readers for Python drop
some of these too. So accessors are read here, as NumPy arrays, and checked.
"""

from __future__ import annotations

import base64
import binascii
import os
import struct
import urllib.parse
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes import jsontext
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render.mesh import Part

Json = dict[str, Any]
Streams = dict[str, NDArray[Any]]

# glTF 2.0, section 3.6.2.2 and 4.4
_GLB_MAGIC = b"glTF"
_COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
_TRIANGLES, _TRIANGLE_STRIP, _TRIANGLE_FAN = 4, 5, 6

#: How many numbers a vertex has of an attribute: glTF 2.0, section 3.7.2.1.
_WIDTHS = {"POSITION": (3,), "NORMAL": (3,), "TANGENT": (4,), "TEXCOORD": (2,), "COLOR": (3, 4)}

#: Values of all vertices, each mesh as often as it is placed; an accessor without a buffer may claim any number.
_MOST_VALUES = 1 << 27

#: Extensions that change no geometry start like this; others are named.
_HARMLESS = (
    "KHR_materials",
    "KHR_texture",
    "KHR_lights",
    "EXT_texture",
    "EXT_lights",
    "KHR_mesh_quantization",
)
_INSTANCING = "EXT_mesh_gpu_instancing"


def read_gltf_mesh(file: Path) -> list[Part]:
    """Read the triangles of a file's scene, each where its node stands.

    Warns (MrmWarning) of what is there and is not drawn: other scenes, points, lines, skins, morph targets, further
    attributes.

    Raises:
        MrmError: a truncated file, one that refers to data or vertices that it lacks, that reads a file outside
            of its folder, or that is compressed.
    """
    try:
        return _Reader(file).parts()
    except OSError as error:
        raise MrmError(f"{file}: cannot be read: {error.strerror}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise MrmError(
            f"{file}: not a well-formed {file.suffix.lower()}: {type(error).__name__}: {error}"
        ) from None


def buffer_files(file: Path) -> list[Path]:
    """Return the files beside a .gltf that hold its vertices; none where it cannot be read."""
    try:
        gltf = _glb_json(file) if file.suffix.lower() == ".glb" else _content(file)[0]
        uris = [buffer["uri"] for buffer in gltf.get("buffers", ()) if "uri" in buffer]
        return [_buffer_file(file, uri) for uri in uris if not uri.startswith("data:")]
    except (MrmError, OSError, LookupError, TypeError, ValueError, AttributeError, struct.error):
        return []


def _content(file: Path) -> tuple[Json, bytes]:
    """Return the JSON, and the binary chunk of a .glb."""
    content = file.read_bytes()
    if content[:4] == _GLB_MAGIC:
        return _glb_chunks(content, file)
    if file.suffix.lower() == ".glb":
        raise MrmError(f"{file}: not a .glb file")
    try:
        gltf = jsontext.loads(content)
    except ValueError as error:
        raise MrmError(f"{file}: not a .gltf file: {error}") from None
    if not isinstance(gltf, dict):
        raise MrmError(f"{file}: not a .gltf file")
    return gltf, b""


def _glb_chunks(content: bytes, file: Path) -> tuple[Json, bytes]:
    if len(content) < 20:
        raise MrmError(f"{file}: not a .glb file")
    version, length, json_length = struct.unpack_from("<III", content, 4)
    if version != 2:
        raise MrmError(f"{file}: glTF version {version}; only version 2 is read")
    if length > len(content):
        raise MrmError(f"{file}: truncated: {len(content)} of {length} bytes are there")
    gltf = jsontext.loads(content[20 : 20 + json_length])
    start = 20 + json_length
    if start + 8 > len(content):
        return gltf, b""
    (binary_length,) = struct.unpack_from("<I", content, start)
    return gltf, content[start + 8 : start + 8 + binary_length]


def _glb_json(file: Path) -> Json:
    """Return the JSON of a .glb alone: what follows may be large."""
    with file.open("rb") as content:
        (length,) = struct.unpack_from("<I", content.read(20), 12)
        gltf: Json = jsontext.loads(content.read(length))
    return gltf


def _buffer_file(file: Path, uri: str) -> Path:
    """Return the file of a buffer's URI, which lies in the folder of the glTF file or below it."""
    name = urllib.parse.unquote(uri)
    found = file.parent / name
    if "://" in name or not Path(os.path.realpath(found)).is_relative_to(os.path.realpath(file.parent)):
        raise MrmError(
            f"{file}: its data, {name}, lies outside of its folder; save it as one self-contained .glb"
        )
    return Path(os.path.normpath(found))


class _Reader:
    """One file's JSON and buffers, and what was found that is not drawn."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._gltf, self._binary = _content(file)
        self._buffers: dict[int, bytes] = {}
        self._notes: dict[str, None] = {}

    def parts(self) -> list[Part]:
        self._check_extensions()
        placed = list(self._placed_meshes())
        self._check_amount([mesh for mesh, _ in placed])
        parts = [part for mesh, matrix in placed for part in self._mesh(mesh, matrix)]
        for note in self._notes:
            warnings.warn(f"{self._file}: {note}", MrmWarning, stacklevel=5)
        return parts

    def _note(self, text: str) -> None:
        self._notes[text] = None

    def _list(self, name: str) -> list[Json]:
        found: list[Json] = self._gltf.get(name, [])
        return found

    def _check_extensions(self) -> None:
        required = self._gltf.get("extensionsRequired", ())
        compressed = sorted(name for name in required if "compression" in name)
        if compressed:
            raise self._compressed(", ".join(compressed))
        for name in required:
            if name != _INSTANCING and not name.startswith(_HARMLESS):
                self._note(f"requires {name}, which is not applied")

    def _compressed(self, extensions: str) -> MrmError:
        return MrmError(f"{self._file}: uses {extensions}, which is not read; save it uncompressed")

    def _placed_meshes(self) -> Iterator[tuple[int, NDArray[np.float64]]]:
        """Yield each mesh of the scene with the matrix (column vectors) of its node."""
        nodes, scenes = self._list("nodes"), self._list("scenes")
        if not self._list("meshes"):
            return
        if not nodes:
            yield from ((index, np.eye(4)) for index in range(len(self._list("meshes"))))
            return
        if scenes:
            scene = _index(self._gltf.get("scene", 0), scenes)
            roots = scenes[scene].get("nodes", [])
            if len(scenes) > 1:
                self._note(f"has {len(scenes)} scenes; scene {scene} is drawn")
        else:
            children = {child for node in nodes for child in node.get("children", ())}
            roots = [index for index in range(len(nodes)) if index not in children]
        seen: set[int] = set()
        stack = [(_index(root, nodes), np.eye(4)) for root in reversed(roots)]
        while stack:
            index, above = stack.pop()
            if index in seen:
                raise MrmError(f"{self._file}: node {index} hangs in its tree twice")
            seen.add(index)
            node = nodes[index]
            matrix = above @ _node_matrix(node)
            if not np.isfinite(matrix).all():
                raise MrmError(f"{self._file}: the transformation of node {index} is NaN or infinite")
            if "mesh" in node:
                self._name_unapplied(node)
                yield _index(node["mesh"], self._list("meshes")), matrix
            stack += [(_index(child, nodes), matrix) for child in reversed(node.get("children", ()))]

    def _check_amount(self, meshes: list[int]) -> None:
        """Check what all that is drawn will take, before anything is read."""
        total = 0
        for mesh in meshes:
            for primitive in self._list("meshes")[mesh]["primitives"]:
                for index in (*primitive["attributes"].values(), primitive.get("indices")):
                    if index is not None:
                        accessor = self._accessor(index)
                        total += accessor["count"] * _COMPONENTS[accessor["type"]]
                        if total > _MOST_VALUES:
                            raise MrmError(
                                f"{self._file}: accessor {index} claims {accessor['count']} values; all that is drawn "
                                f"may have {_MOST_VALUES} numbers"
                            )

    def _name_unapplied(self, node: Json) -> None:
        if "skin" in node:
            self._note("its skin (JOINTS_0, WEIGHTS_0) is not applied")
        if _INSTANCING in node.get("extensions", ()):
            self._note(f"{_INSTANCING} is not applied: one instance is drawn")

    def _mesh(self, index: int, matrix: NDArray[np.float64]) -> Iterator[Part]:
        for primitive in self._list("meshes")[index]["primitives"]:
            mode = primitive.get("mode", _TRIANGLES)
            if mode not in (_TRIANGLES, _TRIANGLE_STRIP, _TRIANGLE_FAN):
                self._note("its points and lines are not drawn")
                continue
            if "POSITION" not in primitive["attributes"]:
                self._note("a primitive without POSITION is not drawn")
                continue
            if primitive.get("targets"):
                self._note("its morph targets are not applied")
            part = self._primitive(primitive, mode)
            if len(part.triangles):
                yield _moved(part, matrix)

    def _primitive(self, primitive: Json, mode: int) -> Part:
        draco = [name for name in primitive.get("extensions", ()) if "compression" in name]
        accessors = primitive["attributes"]
        used = [*accessors.values(), *([primitive["indices"]] if "indices" in primitive else [])]
        if draco and any("bufferView" not in self._accessor(accessor) for accessor in used):
            raise self._compressed(", ".join(draco))
        count = self._accessor(accessors["POSITION"])["count"]
        streams: Streams = {}
        for name, accessor in accessors.items():
            data = self._values(accessor)
            if len(data) != count:
                raise MrmError(f"{self._file}: {name} has {len(data)} values for {count} vertices")
            streams |= self._streams(name, data)
        if not np.isfinite(streams["position"]).all():
            raise MrmError(f"{self._file}: a position is NaN or infinite")
        if "normal" not in streams:
            # glTF 2.0, section 3.7.2.1: without normals, tangents are ignored.
            streams.pop("tangent", None)
            streams.pop("bitangent_sign", None)
        if "indices" in primitive:
            indices = self._values(primitive["indices"], normalize=False).ravel().astype(np.int64)
            if len(indices) and int(indices.max()) >= count:
                raise MrmError(
                    f"{self._file}: a triangle refers to vertex {int(indices.max())}, but there are {count}"
                )
        else:
            indices = np.arange(count)
        return Part(streams, _triangles(indices, mode))

    def _streams(self, name: str, data: NDArray[Any]) -> Streams:
        """Return vertex data by MaterialX's names, from that of one attribute."""
        kind, _, number = name.rpartition("_")
        if data.shape[1] not in _WIDTHS.get(kind or name, (data.shape[1],)):
            raise MrmError(f"{self._file}: {name} has {data.shape[1]} numbers for a vertex")
        if name in ("POSITION", "NORMAL"):
            return {name.lower(): data}
        if name == "TANGENT":
            return {"tangent": data[:, :3], "bitangent_sign": data[:, 3:4]}
        if kind == "TEXCOORD" and number.isdecimal():
            # MaterialX's v grows upwards and glTF's downwards.
            return {f"texcoord_{int(number)}": data * (1, -1) + (0, 1)}
        if kind == "COLOR" and number.isdecimal():
            alpha = np.ones((len(data), 4 - data.shape[1]))
            return {f"color_{int(number)}": np.concatenate([data, alpha], axis=1)}
        if name.startswith("_"):
            # An application's own: MaterialX makes no names of two underscores.
            return {f"geomprop_{name}": data, f"geomprop_{name[1:]}": data}
        if kind not in ("JOINTS", "WEIGHTS"):
            self._note(f"its vertex attribute {name} is not read")
        return {}

    def _accessor(self, index: int) -> Json:
        accessor: Json = self._list("accessors")[_index(index, self._list("accessors"))]
        return accessor

    def _values(self, index: int, *, normalize: bool = True) -> NDArray[Any]:
        """Return an accessor's values (count, components): float64, or integers where they are no numbers."""
        accessor = self._accessor(index)
        count, components = accessor["count"], _COMPONENTS[accessor["type"]]
        kind = np.dtype(_COMPONENT_TYPES[accessor["componentType"]])
        where = f"accessor {index}"
        if count < 0:
            raise MrmError(f"{self._file}: {where} claims {count} values")
        if "bufferView" in accessor:
            offset = accessor.get("byteOffset", 0)
            values = self._view(accessor["bufferView"], offset, kind, count, components, where)
        else:
            values = np.zeros((count, components), kind)
        if "sparse" in accessor:
            values = self._replaced(values, accessor["sparse"], where)
        if not normalize:
            return values
        if not (accessor.get("normalized") and kind.kind in "iu"):
            return values.astype(np.float64)
        # glTF 2.0, section 3.6.2.2
        return np.maximum(values / np.iinfo(kind).max, -1.0)

    def _replaced(self, values: NDArray[Any], sparse: Json, where: str) -> NDArray[Any]:
        """Return values in place of some of which others stand in a sparse accessor."""
        count, place, new = sparse["count"], sparse["indices"], sparse["values"]
        kind = np.dtype(_COMPONENT_TYPES[place["componentType"]])
        indices = self._view(place["bufferView"], place.get("byteOffset", 0), kind, count, 1, where).ravel()
        if len(indices) and int(indices.max()) >= len(values):
            raise MrmError(
                f"{self._file}: {where} replaces value {int(indices.max())}, but there are {len(values)}"
            )
        result = values.copy()
        offset = new.get("byteOffset", 0)
        result[indices] = self._view(new["bufferView"], offset, values.dtype, count, values.shape[1], where)
        return result

    def _view(
        self, index: int, offset: int, kind: np.dtype[Any], count: int, components: int, where: str
    ) -> NDArray[Any]:
        view = self._list("bufferViews")[_index(index, self._list("bufferViews"))]
        compressed = [name for name in view.get("extensions", ()) if "compression" in name]
        if compressed:
            raise self._compressed(", ".join(compressed))
        data = self._buffer(_index(view["buffer"], self._list("buffers")))
        size = kind.itemsize * components
        stride = view.get("byteStride", size)
        needed = offset + stride * (count - 1) + size if count else offset
        start = view.get("byteOffset", 0)
        if min(offset, start, count, stride) < 0 or needed > view["byteLength"] or start + needed > len(data):
            raise MrmError(f"{self._file}: {where} refers to data outside its buffer")
        return np.ndarray((count, components), kind, data, start + offset, (stride, kind.itemsize))

    def _buffer(self, index: int) -> bytes:
        if index not in self._buffers:
            buffer = self._list("buffers")[index]
            length = buffer["byteLength"]
            data = self._buffer_data(buffer.get("uri"), index)
            if length > len(data):
                raise MrmError(f"{self._file}: truncated: {len(data)} of {length} bytes of data are there")
            self._buffers[index] = data
        return self._buffers[index]

    def _buffer_data(self, uri: str | None, index: int) -> bytes:
        if uri is None:
            return self._binary if index == 0 else b""
        if uri.startswith("data:"):
            head, _, text = uri.partition(",")
            try:
                if head.endswith(";base64"):
                    return base64.b64decode(urllib.parse.unquote_to_bytes(text), validate=True)
                return urllib.parse.unquote_to_bytes(text)
            except binascii.Error as error:
                raise MrmError(f"{self._file}: buffer {index} is not base64: {error}") from None
        file = _buffer_file(self._file, uri)
        if not file.is_file():
            raise MrmError(f"{self._file}: its data, {file}, is missing or is no file")
        return file.read_bytes()


def _index(value: Any, of: list[Json]) -> int:
    """Return an index into a list of the file.

    Raises:
        IndexError: it is none.
    """
    if not isinstance(value, int) or not 0 <= value < len(of):
        raise IndexError(f"{value} of {len(of)}")
    return value


def _node_matrix(node: Json) -> NDArray[np.float64]:
    """Return a node's transformation of column vectors."""
    if "matrix" in node:
        # glTF stores columns.
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64) / (
        np.linalg.norm(node.get("rotation", (0, 0, 0, 1))) or 1.0
    )
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _triangles(indices: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Return the triangles (m, 3) of a primitive: glTF 2.0, section 3.7.2.1."""
    if mode == _TRIANGLES:
        return indices[: len(indices) // 3 * 3].reshape(-1, 3)
    i = np.arange(max(len(indices) - 2, 0))
    if mode == _TRIANGLE_STRIP:
        return indices[np.stack([i, i + 1 + i % 2, i + 2 - i % 2], axis=-1)]
    return indices[np.stack([i + 1, i + 2, np.zeros_like(i)], axis=-1)]


def _moved(part: Part, matrix: NDArray[np.float64]) -> Part:
    """Return a part where its node stands; a mirror turns triangles and bitangents round."""
    linear = matrix[:3, :3]
    mirrors = bool(np.linalg.det(linear) < 0.0)
    streams = dict(part.streams)
    streams["position"] = streams["position"] @ linear.T + matrix[:3, 3]
    # Directions that are none are made anew.
    with np.errstate(invalid="ignore"):
        directions = _moved_directions(streams, linear, mirrors)
    return Part(streams | directions, part.triangles[:, ::-1] if mirrors else part.triangles)


def _moved_directions(streams: Streams, linear: NDArray[np.float64], mirrors: bool) -> Streams:
    moved = {}
    if "normal" in streams:
        # The inverse transposed, but for a positive factor; it exists for a scale of 0 too.
        columns = linear.T
        cofactors = np.cross(columns[[1, 2, 0]], columns[[2, 0, 1]]).T * (-1.0 if mirrors else 1.0)
        moved["normal"] = streams["normal"] @ cofactors.T
    if "tangent" in streams:
        moved["tangent"] = streams["tangent"] @ linear.T
        moved["bitangent_sign"] = streams["bitangent_sign"] * (-1.0 if mirrors else 1.0)
    return moved
