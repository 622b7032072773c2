"""What of an image file is the picture: its colour layer, as it stands in its display window."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown

#: Names of layers that hold what a renderer's other layers are parts of.
_BEAUTY = ("", "rgba", "rgb", "beauty", "combined", "color", "colour", "c", "main", "default")
_CHANNELS = {"red": "r", "green": "g", "blue": "b", "alpha": "a"}

#: A display window may say anything; no driver draws more.
_MAX_SIDE = 32768

LARGEST = 2 << 30
"""Bytes of a picture as it is read: what 16384 × 16384 pixels of three 16-bit channels have."""


@dataclass(frozen=True)
class ImageLayer:
    """Channels of one part of a file that belong together.

    Args:
        name: what its file calls it; empty for the channels that have no layer's name.
        part: number of the part (OpenImageIO's subimage).
        channels: numbers of its channels, colours first.
        is_color: whether they are red, green and blue, or a grey.
    """

    name: str
    part: int
    channels: tuple[int, ...]
    is_color: bool


def layers_of(source: Any) -> list[ImageLayer]:
    """The layers of an open file, in its order; one of everything for formats that have none."""
    if source.format_name() != "openexr":
        return [ImageLayer("", 0, tuple(range(source.spec().nchannels)), True)]
    found: list[ImageLayer] = []
    for part, spec in enumerate(_parts(source)):
        groups: dict[str, dict[str, int]] = {}
        for number, name in enumerate(spec.channelnames):
            layer, _, channel = name.rpartition(".")
            groups.setdefault(layer, {})[_CHANNELS.get(channel.lower(), channel.lower())] = number
        part_name = str(spec.getattribute("oiio:subimagename") or "")
        for layer, channels in groups.items():
            # The Y of an X is a coordinate, as in a layer of normals, and no luminance.
            known = ("rgb", "xyz", "xy", "y")
            colors = next((each for each in known if set(each) <= set(channels)), "")
            if {"y", "ry", "by"} <= set(channels):
                colors = ""
            chosen = [channels[each] for each in (*colors, *("a" if colors and "a" in channels else ""))]
            found.append(
                ImageLayer(
                    layer or part_name,
                    part,
                    tuple(chosen or channels.values()),
                    is_color=colors in ("rgb", "y"),
                )
            )
    return found


def _parts(source: Any) -> Iterator[Any]:
    part = 0
    while source.seek_subimage(part, 0):
        yield source.spec()
        part += 1


def choose_layer(layers: Sequence[ImageLayer], file: str, name: str = "") -> ImageLayer:
    """The layer of a name, or the picture: the colours without a layer's name, or those of the first such layer.

    Raises:
        MrmError: no such layer.
    """
    if name:
        named = [layer for layer in layers if layer.name == name]
        if not named:
            raise MrmError(f"{file}: {unknown('layer', name, [each.name for each in layers if each.name])}")
        return named[0]

    def rank(layer: ImageLayer) -> tuple[bool, int]:
        beauty = layer.name.lower()
        return (not layer.is_color, _BEAUTY.index(beauty) if beauty in _BEAUTY else len(_BEAUTY))

    return min(layers, key=rank)


def check_size(spec: Any, channels: Sequence[int], kind: Any, file: str) -> None:
    """Check what a part will take, before anything is taken: a file of a few bytes may say that it is any size.

    Args:
        channels: those that are read.
        kind: the number format that they are read in.

    Raises:
        MrmError: it is more than `LARGEST`.
    """
    # The channels between the first and the last are read with them.
    count = max(channels) + 1 - min(channels)
    for width, height in ((spec.width, spec.height), (spec.full_width, spec.full_height)):
        if width * height * count * oiio.TypeDesc(kind).size() > LARGEST:
            raise MrmError(
                f"{file}: {width} × {height} pixels of {count} channels are more than {LARGEST >> 30} GiB, "
                "which is no picture to draw with: make it smaller"
            )


def check_shown(spec: Any, file: str) -> None:
    """Check that a part can be shown as a picture.

    Raises:
        MrmError: it is deep or a volume, has colours as luminance and chroma, or a display window that is no picture.
    """
    if spec.deep:
        raise MrmError(f"{file}: a deep image has several samples a pixel: flatten it first")
    if spec.depth > 1:
        raise MrmError(f"{file}: a volume of {spec.depth} slices is no picture")
    if {"RY", "BY"} & {name.rpartition(".")[2].upper() for name in spec.channelnames}:
        raise MrmError(f"{file}: its colours are luminance and chroma (Y, RY, BY): save it as RGB")
    if max(spec.full_width, spec.full_height) > _MAX_SIDE:
        raise MrmError(f"{file}: its display window is {spec.full_width} × {spec.full_height} pixels")
    if _overlap(spec) is None:
        raise MrmError(f"{file}: its data window lies outside of its display window: nothing of it is shown")


def shown(pixels: NDArray[Any], spec: Any) -> NDArray[Any]:
    """A part's pixels (h, w, k) as they stand in its display window, which is 0 where there are none."""
    overlap = _overlap(spec)
    if overlap is None or pixels.shape[:2] == (spec.full_height, spec.full_width) == (
        overlap[1] - overlap[0],
        overlap[3] - overlap[2],
    ):
        return pixels
    top, bottom, left, right = overlap
    window = np.zeros((spec.full_height, spec.full_width, pixels.shape[2]), pixels.dtype)
    window[top - spec.full_y : bottom - spec.full_y, left - spec.full_x : right - spec.full_x] = pixels[
        top - spec.y : bottom - spec.y, left - spec.x : right - spec.x
    ]
    return window


def _overlap(spec: Any) -> tuple[int, int, int, int] | None:
    """Top, bottom, left and right of what both windows have; None where they have nothing."""
    top, left = max(spec.y, spec.full_y), max(spec.x, spec.full_x)
    bottom = min(spec.y + spec.height, spec.full_y + spec.full_height)
    right = min(spec.x + spec.width, spec.full_x + spec.full_width)
    return (top, bottom, left, right) if top < bottom and left < right else None


def number_format(spec: Any, channels: Sequence[int]) -> Any:
    """The format that holds all of some channels: a part's channels may differ."""
    if not spec.channelformats:
        return spec.format
    kinds = {str(spec.channelformats[channel]) for channel in channels}
    return spec.channelformats[channels[0]] if len(kinds) == 1 else oiio.FLOAT
