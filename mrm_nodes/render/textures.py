"""A material's image files as GL textures, sampled as MaterialX's own GlslProgram samples them."""

from __future__ import annotations

import ctypes
import hashlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from mrm_nodes import colorspaces, filenames
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render.context import GLContext
from mrm_nodes.render.images import read_image, read_pixels
from mrm_nodes.render.recent import Recent

_GL_TEXTURE_2D, _GL_TEXTURE_WRAP_S, _GL_TEXTURE_WRAP_T = 0x0DE1, 0x2802, 0x2803
_GL_TEXTURE_BORDER_COLOR = 0x1004
_GL_CLAMP_TO_BORDER, _GL_CLAMP_TO_EDGE, _GL_REPEAT, _GL_MIRRORED_REPEAT = 0x812D, 0x812F, 0x2901, 0x8370

#: By MaterialX's ImageSamplingProperties::AddressMode: constant, clamp, periodic, mirror.
_WRAPS = (_GL_CLAMP_TO_BORDER, _GL_CLAMP_TO_EDGE, _GL_REPEAT, _GL_MIRRORED_REPEAT)
_CLOSEST = 0

#: As MaterialX's own GLTextureHandler filters every image, where the driver can.
_ANISOTROPY = 16.0

#: More than a program can read at once.
_KEPT_TEXTURES = 64

#: How moderngl names the number formats that textures keep; every other becomes float32.
_KEPT_FORMATS = {"uint8": "f1", "float16": "f2", "float32": "f4"}


@dataclass(frozen=True)
class Sampling:
    """How a shader reads an image.

    Args:
        address: modes in u and v as MaterialX numbers them (0 constant, 1 clamp, 2 periodic, 3 mirror); any
            other is periodic.
        filter_type: 0 for the closest texel; any other is trilinear.
        border: colour outside the image with address mode constant.
        space: OpenColorIO's name of the colour space that pixels are converted from; empty where the shader does it.
        layer: of an EXR, where it is not to be chosen.
        top_row_first: whether v = 0 is the top row, as in shaders generated with `fileTextureVerticalFlip`.
    """

    address: tuple[int, int] = (-1, -1)
    filter_type: int = -1
    border: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    space: str = ""
    layer: str = ""
    top_row_first: bool = True


class TextureCache:
    """Image files uploaded to one context, by path, contents and sampling.

    Times do not tell: a file may change twice within one tick, and copies keep the times of their originals.
    """

    def __init__(self, context: GLContext) -> None:
        self._context = context
        self._textures: Recent[tuple[str, bytes, Sampling], moderngl.Texture] = Recent(
            _KEPT_TEXTURES, lambda texture: texture.release()
        )

    def texture(self, file: Path, sampling: Sampling) -> moderngl.Texture:
        """Return an image's texture, uploaded now if it is not there; what a draw reads stays as it is.

        Raises:
            MrmError: the image is missing, truncated or unknown, or larger than the driver takes.
        """
        if not file.is_file():
            raise MrmError(f"{file}: no such image")
        with file.open("rb") as data:
            digest = hashlib.file_digest(data, "sha256").digest()
        key = (str(file.resolve()), digest, sampling)
        return self._textures.get(key, lambda: self._upload(file, sampling))

    def plain(self, sampling: Sampling) -> moderngl.Texture:
        """Return a texture of nothing but the border's colour, which MaterialX shows where there is no image."""
        color = np.array(sampling.border, np.float32).reshape(1, 1, 4)
        return self._textures.get(("", b"", sampling), lambda: self._made(color, sampling, "default"))

    def release(self) -> None:
        """Free the GPU's memory."""
        self._textures.clear()

    def _upload(self, file: Path, sampling: Sampling) -> moderngl.Texture:
        pixels = read_pixels(file, layer=sampling.layer)[:, :, :4]
        if sampling.space or pixels.dtype.name not in _KEPT_FORMATS:
            pixels = read_image(file, sampling.layer)[:, :, :4]
        broken = pixels.shape[0] * pixels.shape[1] - int(np.isfinite(pixels).all(axis=2).sum())
        if broken:
            message = f"{file}: {broken} of its texels are NaN or infinite, and what they reach is drawn so"
            warnings.warn(message, MrmWarning, stacklevel=2)
        if pixels.shape[2] == 2:
            message = f"{file}: it has two channels: MaterialX takes them for red and green, the second for no alpha"
            warnings.warn(message, MrmWarning, stacklevel=2)
        if sampling.space:
            if pixels.shape[2] == 1:
                pixels = np.repeat(pixels, 3, axis=2)
            elif pixels.shape[2] == 2:
                pixels = np.pad(pixels, ((0, 0), (0, 0), (0, 1)))
            pixels = colorspaces.linear(pixels, sampling.space)
        return self._made(pixels, sampling, str(file))

    def _made(self, pixels: NDArray[Any], sampling: Sampling, what: str) -> moderngl.Texture:
        if not sampling.top_row_first:
            pixels = pixels[::-1]
        # MaterialX's shaders take a texture of one texel for a missing image.
        if pixels.shape[:2] == (1, 1):
            pixels = np.broadcast_to(pixels, (2, 2, pixels.shape[2]))
        height, width, channels = pixels.shape
        limit = self._context.ctx.info["GL_MAX_TEXTURE_SIZE"]
        if max(height, width) > limit:
            raise MrmError(f"{what}: {width} × {height} pixels, but this driver takes {limit} at most")
        data = np.ascontiguousarray(pixels)
        kind = _KEPT_FORMATS[data.dtype.name]
        texture = self._context.ctx.texture((width, height), channels, data, alignment=1, dtype=kind)
        if channels == 1:
            texture.swizzle = "RRR1"
        if sampling.filter_type == _CLOSEST:
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        else:
            texture.build_mipmaps()
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            # Mesa's software driver has no closest texel beside it.
            texture.anisotropy = min(_ANISOTROPY, self._context.ctx.max_anisotropy)
        self._set_address_modes(texture, sampling)
        return texture

    def _set_address_modes(self, texture: moderngl.Texture, sampling: Sampling) -> None:
        """Set what moderngl cannot: a mirrored repeat and a border, in each direction by itself."""
        texture.use(self._context.upload_unit)
        for parameter, mode in zip((_GL_TEXTURE_WRAP_S, _GL_TEXTURE_WRAP_T), sampling.address, strict=True):
            wrap = _WRAPS[mode] if 0 <= mode < len(_WRAPS) else _GL_REPEAT
            self._context.call("glTexParameteri", _GL_TEXTURE_2D, parameter, wrap)
        border = (ctypes.c_float * 4)(*sampling.border)
        self._context.call("glTexParameterfv", _GL_TEXTURE_2D, _GL_TEXTURE_BORDER_COLOR, border)


def find_image(name: str, search_path: Sequence[Path], uniform: str) -> filenames.Files:
    """Return the file, or the tiles' files, that a material's input names.

    Raises:
        MrmError: there is none in the folders of the search path.
    """
    found = filenames.find(name, search_path)
    if found.file is None and not found.tiles:
        shown = f"{name[:100]}…" if len(name) > filenames.LONGEST else name if name.strip() else repr(name)
        raise MrmError(f"{shown}: no such image (input {uniform}): {filenames.absence(name, search_path)}")
    return found


def border_color(value: Any) -> tuple[float, float, float, float]:
    """Return the colour that MaterialX takes outside an image for an input's default value."""
    if isinstance(value, int | float):
        return (float(value), 0.0, 0.0, 0.0)
    numbers = [float(number) for number in value]
    red, green, blue, alpha = (numbers + [0.0] * 4)[:4]
    return (red, green, blue, alpha)
