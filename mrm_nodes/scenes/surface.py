"""Materials of the scenes: `mrm_open_pbr_surface`, its inputs numbers or textures."""

from __future__ import annotations

import hashlib
import tempfile
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
from numpy.typing import NDArray

from mrm_nodes.render import write_exr
from mrm_nodes.shadergen import Shader, generate_shader

_TEXTURES = tempfile.TemporaryDirectory(prefix="mrm-scenes-")


def open_pbr(tiles: tuple[float, float] = (1.0, 1.0), **inputs: Any) -> Shader:
    """Return the shader of an `mrm_open_pbr_surface`.

    Args:
        tiles: how often textures repeat in u and v.
        inputs: by name: a number, a colour of three, or a texture: an array (h, w) or (h, w, 3), row 0 at the top.
    """
    document = mx.createDocument()
    surface = document.addNode("mrm_open_pbr_surface", "surface", "surfaceshader")
    for name, value in inputs.items():
        data = np.asarray(value, np.float32)
        kind = "color3" if data.shape[-1:] == (3,) else "float"
        socket = surface.addInput(name, kind)
        if data.ndim < 2:
            socket.setValueString(", ".join(f"{x:.6g}" for x in np.ravel(data)))
            continue
        image = document.addNode("image", f"{name}_image", kind)
        image.addInput("file", "filename").setValueString(str(_stored(data)))
        if tiles != (1.0, 1.0):
            scaled = document.getNode("uv") or _scaled_uv(document, tiles)
            image.addInput("texcoord", "vector2").setConnectedNode(scaled)
        socket.setConnectedNode(image)
    document.addMaterialNode("material", surface)
    return generate_shader(document, max_lights=1, interface="reduced")


def _scaled_uv(document: mx.Document, tiles: tuple[float, float]) -> mx.Node:
    texcoord = document.addNode("texcoord", "st", "vector2")
    scaled = document.addNode("multiply", "uv", "vector2")
    scaled.addInput("in1", "vector2").setConnectedNode(texcoord)
    scaled.addInput("in2", "vector2").setValueString(f"{tiles[0]}, {tiles[1]}")
    return scaled


def _stored(texture: NDArray[np.float32]) -> Path:
    data = texture if texture.ndim == 3 else np.repeat(texture[..., None], 3, axis=-1)
    path = Path(_TEXTURES.name) / f"{hashlib.sha256(data.tobytes()).hexdigest()[:16]}.exr"
    if not path.exists():
        write_exr(path, np.ascontiguousarray(data))
    return path
