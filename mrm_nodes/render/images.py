"""Images in and out, through OpenImageIO: EXR for data, PNG for eyes."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import write_bytes
from mrm_nodes.render import imagelayers
from mrm_nodes.render.tonemap import srgb_encoded

#: Formats that hold one picture after another; what others have beside their first is a part of it.
_PAGED = ("tiff", "gif", "webp")


def read_image(path: str | os.PathLike[str], layer: str = "") -> NDArray[np.float32]:
    """Read an image as float32 of shape (height, width, channels), row 0 at the top; 8 bits become 0..1.

    Alpha stays as stored: colours are not multiplied with it. Of an EXR with layers it is the one with the colours
    (MrmWarning where that is a choice), in its display window; of a file with pages the first (MrmWarning too). An
    orientation that a camera noted is not applied.

    Args:
        layer: the layer's name, where it is not to be chosen.

    Raises:
        MrmError: the file is missing, truncated, in no format that OpenImageIO knows, or no picture (a deep image);
            no such layer.
    """
    return np.asarray(read_pixels(path, oiio.FLOAT, layer), dtype=np.float32)


def read_pixels(path: str | os.PathLike[str], kind: Any = oiio.UNKNOWN, layer: str = "") -> NDArray[Any]:
    """Read an image as `read_image` does, but in the number format `kind`, by default the file's own.

    Raises:
        MrmError: as `read_image`.
    """
    file = Path(path)
    if not file.is_file():
        raise MrmError(f"{file}: no such image")
    options = oiio.ImageSpec()
    options.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(file), options)
    if source is None:
        raise MrmError(f"{file}: not an image that can be read: {_message(complaint_of(oiio.geterror))}")
    try:
        layers = imagelayers.layers_of(source)
        chosen = imagelayers.choose_layer(layers, str(file), layer)
        source.seek_subimage(chosen.part, 0)
        spec = source.spec()
        if source.format_name() == "openexr":
            imagelayers.check_shown(spec, str(file))
        wanted = imagelayers.number_format(spec, chosen.channels) if kind == oiio.UNKNOWN else kind
        imagelayers.check_size(spec, chosen.channels, wanted, str(file))
        first, last = min(chosen.channels), max(chosen.channels) + 1
        pixels = source.read_image(chosen.part, 0, first, last, wanted)
        # Some formats fill in what a truncated file lacks, and only leave a message.
        complaint = complaint_of(source.geterror)
        has_more_pages = source.format_name() in _PAGED and bool(source.seek_subimage(1, 0))
    finally:
        source.close()
    if pixels is None or complaint:
        raise MrmError(f"{file}: the image is damaged or truncated: {_message(complaint)}")
    pixels = np.asarray(pixels)[:, :, [channel - first for channel in chosen.channels]]
    if source.format_name() == "openexr":
        pixels = imagelayers.shown(pixels, spec)
    if len(layers) > 1 and not layer and (chosen.name or not chosen.is_color):
        names = ", ".join(each.name or "the one without a name" for each in layers if each is not chosen)
        message = f"{file}: shown is its layer {chosen.name or '(without a name)'}, and not {names}"
        warnings.warn(message, MrmWarning, stacklevel=2)
    if has_more_pages:
        warnings.warn(f"{file}: it has several pages: the first is shown", MrmWarning, stacklevel=2)
    return np.ascontiguousarray(pixels)


def exr_bytes(array: NDArray[Any], name: str = "image") -> bytes:
    """The bytes that `write_exr` writes. A fourth channel is alpha, and colours are multiplied with it.

    name: what an error calls it.

    Raises:
        MrmError: it cannot be encoded.
    """
    pixels = np.ascontiguousarray(array, dtype=np.float32)
    # Without a date of its own a file gets today's, and equal images would be different files.
    # "zip" packs sixteen rows together: a third of the time of "zips", and smaller.
    return _encoded(pixels, {"compression": "zip:1", "DateTime": "1970:01:01 00:00:00"}, "exr", name)


def write_exr(path: str | os.PathLike[str], array: NDArray[Any]) -> None:
    """Write float32 EXR of an array of shape (height, width), or (height, width, channels), row 0 at the top.

    The file appears complete or not at all.

    Raises:
        MrmError: the folder or the file cannot be written.
    """
    write_bytes(Path(path), exr_bytes(array, str(path)))


def png_bytes(pixels: NDArray[np.uint8], said: Mapping[str, str] | None = None, name: str = "image") -> bytes:
    """The bytes of a PNG of sRGB's display values, (height, width) or (height, width, channels), row 0 at the top.

    A fourth channel is alpha, and colours are not multiplied with it.

    Args:
        said: what the file says of itself, by keyword.
        name: what an error calls it.

    Raises:
        MrmError: it cannot be encoded.
    """
    attributes: dict[str, str | int] = {"oiio:ColorSpace": "sRGB", "png:compressionLevel": 2}
    return _encoded(pixels, attributes | {"oiio:UnassociatedAlpha": 1} | dict(said or {}), "png", name)


def write_png(path: str | os.PathLike[str], array: NDArray[Any], exposure: float = 0.0) -> None:
    """Write an 8-bit sRGB PNG, for eyes, of linear values; 1 is white and what is brighter is clipped.

    The file appears complete or not at all.

    Args:
        array: shape (height, width) or (height, width, channels), row 0 at the top. A fourth channel is alpha, which is
            neither exposed nor encoded.
        exposure: stops to brighten by before the clipping.

    Raises:
        MrmError: the folder or the file cannot be written.
    """
    # float32 is more than 8 bits need, and its powers cost a tenth.
    linear = np.atleast_3d(np.array(array, dtype=np.float32))
    linear[..., :3] *= np.float32(2.0**exposure)
    encoded = np.clip(np.nan_to_num(linear, copy=False, nan=0.0, posinf=1.0), 0.0, 1.0)
    encoded[..., :3] = srgb_encoded(encoded[..., :3])
    write_bytes(Path(path), png_bytes(np.round(encoded * 255.0).astype(np.uint8), name=str(path)))


def _encoded(pixels: NDArray[Any], attributes: Mapping[str, str | int], kind: str, name: str) -> bytes:
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.ndim != 3 or pixels.size == 0:
        raise MrmError(f"{name}: an array of shape {pixels.shape} is not an image")
    height, width, channels = pixels.shape
    specification = oiio.ImageSpec(
        width, height, channels, oiio.UINT8 if pixels.dtype == np.uint8 else oiio.FLOAT
    )
    for key, value in attributes.items():
        specification.attribute(key, value)
    # OpenImageIO passes over some failures of a disk: it writes to memory, and what it wrote is then written whole.
    handle = os.memfd_create("image")
    place = f"/proc/self/fd/{handle}"
    try:
        target = oiio.ImageOutput.create(kind)
        if target is None:
            raise MrmError(f"{name}: cannot be written: {_message(complaint_of(oiio.geterror))}")
        written = target.open(place, specification) and target.write_image(np.ascontiguousarray(pixels))
        complaint = complaint_of(target.geterror)
        if not (target.close() and written):
            raise MrmError(
                f"{name}: cannot be written: {_message(complaint or complaint_of(target.geterror))}"
            )
        return Path(place).read_bytes()
    finally:
        os.close(handle)


def complaint_of(ask: Callable[[], str]) -> str:
    """What OpenImageIO has to say; it may quote bytes of a damaged file that are no text."""
    try:
        return ask()
    except UnicodeDecodeError as error:
        return bytes(error.object).decode(errors="replace")


def _message(text: str) -> str:
    return " ".join(text.split()) or "unknown fault"
