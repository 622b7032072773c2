"""What is seen where nothing was drawn: nothing, a colour, or the environment."""

from __future__ import annotations

import math
import re

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.scene import Camera
from mrm_nodes.render.tonemap import srgb_decoded

Floats = NDArray[np.float32]

TRANSPARENT, ENVIRONMENT = "transparent", "environment"
COLORS = {"black": "#000000", "gray": "#808080", "grey": "#808080", "white": "#ffffff"}
SYNTAX = "transparent, environment, black, grey, white, #RRGGBB, or R,G,B from 0 to 1 (linear)"


def parse_background(text: str) -> str | Floats:
    """Return `transparent`, `environment`, or a colour: linear light of the screen, (3,), which is shown as it is.

    Raises:
        MrmError: anything else.
    """
    word = text.strip().lower()
    if word in (TRANSPARENT, ENVIRONMENT):
        return word
    digits = COLORS.get(word, word)
    if re.fullmatch(r"#[0-9a-f]{3}", digits):
        digits = "#" + "".join(2 * digit for digit in digits[1:])
    if re.fullmatch(r"#[0-9a-f]{6}", digits):
        return srgb_decoded(np.array([int(digits[i : i + 2], 16) / 255.0 for i in (1, 3, 5)], np.float32))
    try:
        color = np.array([float(part) for part in word.split(",")], np.float32)
    except ValueError:
        near = suggestion(word, [TRANSPARENT, ENVIRONMENT, *COLORS])
        raise MrmError(
            f"background {text}: {near if near.startswith('did') else f'write {SYNTAX}'}"
        ) from None
    if color.shape != (3,) or not ((color >= 0.0) & (color <= 1.0)).all():
        raise MrmError(f"background {text}: write {SYNTAX}")
    return color


def environment_behind(
    environment: Environment, camera: Camera, size: tuple[int, int], offset: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Radiance of the environment behind each pixel, (h, w, 3): what a ray through it meets.

    Args:
        size: width and height.
        offset: of the samples from the pixels' middles, in pixels to the right and upwards.
    """
    width, height = size
    across = (2.0 * (np.arange(width) + 0.5 + offset[0]) / width - 1.0)[None, :]
    upwards = (1.0 - 2.0 * (np.arange(height) + 0.5 - offset[1]) / height)[:, None]
    half = 0.0 if camera.width is not None else math.tan(math.radians(camera.fov) / 2.0)
    shape = (height, width)
    toward = np.stack(
        [
            np.broadcast_to(across * half * width / height, shape),
            np.broadcast_to(upwards * half, shape),
            np.full(shape, -1.0),
        ],
        axis=-1,
    )
    # From the camera's space to the world, and on to the map's.
    toward = toward @ (environment.matrix[:3, :3] @ camera.view_matrix()[:3, :3].T).T
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    # mx_latlong_projection
    u = np.arctan2(toward[..., 0], -toward[..., 2]) / (2.0 * math.pi) + 0.5
    v = 0.5 - np.arcsin(np.clip(toward[..., 1], -1.0, 1.0)) / math.pi
    # A pixel that sees many texels takes their mean.
    texels = 2.0 * half / height * environment.radiance.shape[0] / math.pi
    level = min(max(int(math.log2(max(texels, 1.0))), 0), len(environment.levels) - 1)
    return environment.intensity * _between_texels(environment.levels[level], u, v)


def _between_texels(texels: Floats, u: NDArray[np.float64], v: NDArray[np.float64]) -> Floats:
    """Bilinear look-up; u goes round, v ends at the poles."""
    height, width, _ = texels.shape
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
    left, top = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), max(height - 2, 0))
    x, y = (x - left)[..., None].astype(np.float32), (y - top)[..., None].astype(np.float32)
    bottom, right = np.minimum(top + 1, height - 1), (left + 1) % width
    left = left % width
    upper = texels[top, left] * (1.0 - x) + texels[top, right] * x
    lower = texels[bottom, left] * (1.0 - x) + texels[bottom, right] * x
    return np.asarray(upper * (1.0 - y) + lower * y, np.float32)
