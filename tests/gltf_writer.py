"""Writes small glTF files: what other programs would have written, with arrays in the formats that they take."""

import base64
import json
import struct

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}

SQUARE = {
    "POSITION": [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)],
    "NORMAL": [(0, 0, 1)] * 4,
    "TEXCOORD_0": [(0, 0), (1, 0), (1, 1), (0, 1)],
    "indices": [0, 1, 2, 0, 2, 3],
}


def gltf_of(shapes, nodes=None, **changes):
    """The JSON and the data of shapes: lists of primitives, dicts of arrays by attribute (and indices, mode, …).

    Arrays of whole numbers are colours and the like, normalized; lists are float32, indices uint16.
    """
    data, views, accessors = b"", [], []

    def add(array, normalized):
        nonlocal data
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        accessors.append(
            {
                "bufferView": len(views) - 1,
                "componentType": COMPONENTS[array.dtype.str[1:]],
                "count": len(array),
                "type": TYPES[array.shape[1] if array.ndim > 1 else 1],
            }
            | ({"normalized": True} if normalized else {})
        )
        return len(accessors) - 1

    def primitive_of(arrays):
        arrays = dict(arrays)
        primitive = {key: arrays.pop(key) for key in ("mode", "targets", "extensions") if key in arrays}
        if "indices" in arrays:
            indices = arrays.pop("indices")
            primitive["indices"] = add(
                indices if isinstance(indices, np.ndarray) else np.array(indices, "<u2"), False
            )
        primitive["attributes"] = {
            name: add(array, True)
            if isinstance(array, np.ndarray) and array.dtype.kind in "iu"
            else add(np.array(array, "<f4"), False)
            for name, array in arrays.items()
        }
        return primitive

    gltf = {
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [primitive_of(arrays) for arrays in primitives]} for primitives in shapes],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
        "nodes": nodes or [{"mesh": index} for index in range(len(shapes))],
        "scene": 0,
        "scenes": [{"nodes": [0] if nodes else list(range(len(shapes)))}],
    } | changes
    return gltf, data


def write_glb(path, shapes, nodes=None, **changes):
    """Write a self-contained .glb."""
    write_chunks(path, *gltf_of(shapes, nodes, **changes))


def write_chunks(path, gltf, data):
    """Write a .glb of its JSON and its data."""
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def data_uri(data):
    """A buffer's data as a URI."""
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()
