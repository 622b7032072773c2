"""Frames as one picture beside each other, and as one that moves. Frames are (h, w, 3) or (h, w, 4), 8 bits."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.render.tonemap import srgb_decoded, srgb_encoded

Bytes = NDArray[np.uint8]

ANIMATED = {".webp": "WEBP", ".apng": "PNG"}
"""Formats of what moves, by the ending of the file's name."""

LARGEST = {".webp": 16383}
"""Pixels of a side that a format can have, where that is few."""

MILLISECONDS = 80
_GAP, _GROUND, _TEXT = 6, 0.012, 0.55
"""Pixels between frames; linear grey of the sheet, and of what is written on it."""


def contact_sheet(frames: Sequence[Bytes], labels: Sequence[str]) -> Bytes:
    """Return frames in rows, about as many across as down, with a line below each: (H, W, 3), sRGB in 8 bits.

    Args:
        frames: one or more, all of one size: (h, w, 3) or, with straight alpha, (h, w, 4).
        labels: as many texts.

    Raises:
        ValueError: not as many.
    """
    height, width = frames[0].shape[:2]
    letters = max(10, min(24, width // 12))
    line = 2 * letters
    columns = math.ceil(math.sqrt(len(frames) * height / width))
    columns = min(max(columns, 1), len(frames))
    rows = math.ceil(len(frames) / columns)
    size = (_GAP + rows * (height + line), _GAP + columns * (width + _GAP), 3)
    sheet = np.full(size, _GROUND, np.float32)
    written = []
    for number, (frame, label) in enumerate(zip(frames, labels, strict=True)):
        top, left = _GAP + number // columns * (height + line), _GAP + number % columns * (width + _GAP)
        color = srgb_decoded(frame[..., :3].astype(np.float32) / 255.0)
        alpha = frame[..., 3:].astype(np.float32) / 255.0 if frame.shape[2] == 4 else np.float32(1.0)
        sheet[top : top + height, left : left + width] = color * alpha + _GROUND * (1.0 - alpha)
        written.append((label, left + width // 2, top + height + line // 2))
    return np.round(srgb_encoded(labelled(sheet, written, letters)) * 255.0).astype(np.uint8)


def labelled(
    picture: NDArray[np.float32], written: Sequence[tuple[str, int, int]], letters: int
) -> NDArray[np.float32]:
    """Return a linear picture (h, w, 3) with light grey texts on it, each centred on its x and y."""
    canvas = oiio.ImageBuf(np.ascontiguousarray(picture, dtype=np.float32))
    for text, x, y in written:
        oiio.ImageBufAlgo.render_text(
            canvas, x, y, text, letters, textcolor=(_TEXT,) * 3, alignx="center", aligny="center"
        )
    return np.clip(np.asarray(canvas.get_pixels(oiio.FLOAT), np.float32), 0.0, 1.0)


def animation(frames: Sequence[Bytes], ending: str, there_and_back: bool) -> bytes:
    """Return the bytes of an animation that is played for ever.

    Args:
        frames: one or more, all of one size: (h, w, 3) or, with straight alpha, (h, w, 4).
        ending: of `ANIMATED`.
        there_and_back: whether the frames are no circle.

    Raises:
        KeyError: another ending.
        RuntimeError, OSError: the encoder does not take them, as a size beyond `LARGEST`.
    """
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    if there_and_back:
        images += images[-2:0:-1]
    file = io.BytesIO()
    options = {"quality": 85, "method": 4} if ending == ".webp" else {}
    images[0].save(
        file,
        ANIMATED[ending],
        save_all=True,
        append_images=images[1:],
        duration=MILLISECONDS,
        loop=0,
        **options,
    )
    return file.getvalue()
