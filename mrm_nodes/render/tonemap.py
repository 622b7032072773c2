"""From exposed scene light to what a screen shows: tone mapping, and sRGB's encoding."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown

Floats = NDArray[np.float32]

CONFIGURATION = "ocio://default"
"""OpenColorIO's built-in configuration; which views it has, and what they do, differs by version."""

_SCENE = "Linear Rec.709 (sRGB)"
LEAST_HEADROOM, MOST_HEADROOM = 0.98, 4.0
_NEARLY_WHITE = 254.0 / 255.0
_BRIGHTEST = 1e6
"""More is white in every mapping, and would overflow in some."""


@dataclass(frozen=True)
class ToneMap:
    """A mapping of exposed linear Rec. 709 of shape (..., 3) to linear light of an sRGB screen, 0 to 1.

    Args:
        name: as the command line has it.
        description: what a file says of it; names the configuration's version, where pixels depend on one.
    """

    name: str
    description: str
    _map: Callable[[Floats], Floats]

    def __call__(self, exposed: NDArray[Any]) -> Floats:
        # What is not finite is no colour: NaN is shown black, infinity white.
        finite = np.nan_to_num(np.asarray(exposed, np.float32), nan=0.0, posinf=_BRIGHTEST, neginf=0.0)
        return np.clip(self._map(np.clip(finite, 0.0, _BRIGHTEST)), 0.0, 1.0)

    @functools.cached_property
    def headroom(self) -> float:
        """The brightest exposed grey, up to two stops above white, that is not shown as white."""
        greys = np.linspace(LEAST_HEADROOM, MOST_HEADROOM, 200, dtype=np.float32)
        shown = srgb_encoded(self(np.repeat(greys[:, None], 3, axis=1))).max(axis=-1)
        return float(greys[shown < _NEARLY_WHITE].max(initial=LEAST_HEADROOM))


def neutral(color: Floats) -> Floats:
    """Khronos' PBR Neutral: colours up to 0.8 stay as they are, brighter ones roll off to white, hue kept for long.

    https://github.com/KhronosGroup/ToneMapping/tree/main/PBR_Neutral

    color: (..., 3), linear Rec. 709, not negative.
    """
    start, desaturation = 0.8 - 0.04, 0.15
    least = color.min(axis=-1, keepdims=True)
    shifted = color - np.where(least < 0.08, least - 6.25 * least * least, 0.04)
    peak = shifted.max(axis=-1, keepdims=True)
    room = 1.0 - start
    compressed = 1.0 - room * room / (np.maximum(peak, start) + room - start)
    white = 1.0 - 1.0 / (desaturation * (peak - compressed) + 1.0)
    rolled = shifted * (compressed / np.maximum(peak, start))
    return np.asarray(np.where(peak < start, shifted, rolled + (compressed - rolled) * white), np.float32)


def srgb_encoded(linear: Floats) -> Floats:
    """Display values of linear ones, each from 0 to 1 and of any shape (IEC 61966-2-1)."""
    return np.asarray(
        np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055), np.float32
    )


def srgb_decoded(encoded: Floats) -> Floats:
    """Linear values of display values, each from 0 to 1 and of any shape: the inverse of `srgb_encoded`."""
    return np.asarray(
        np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4), np.float32
    )


_OWN = {
    "none": ToneMap("none", "none", lambda color: color),
    "neutral": ToneMap("neutral", "Khronos PBR Neutral", neutral),
}


def tone_maps() -> list[str]:
    """Every name that `find_tonemap` takes: ours, and the views that OpenColorIO's built-in configuration has."""
    return [*_OWN, *_configuration()[1]]


@functools.cache
def find_tonemap(name: str) -> ToneMap:
    """Return `none`, `neutral`, or a view of OpenColorIO's built-in configuration, letters of either case.

    Raises:
        MrmError: an unknown name.
    """
    if name.casefold() in _OWN:
        return _OWN[name.casefold()]
    display, views = _configuration()
    found = next((view for view in views if view.casefold() == name.casefold()), None)
    if found is None:
        raise MrmError(unknown("tone mapping", name, [*_OWN, *views]))
    description = f"{found} of {display}, {CONFIGURATION} of OpenColorIO {opencolorio_version()}"
    return ToneMap(found, description, functools.partial(_viewed, display, found))


def opencolorio_version() -> str:
    """Of the library that OpenImageIO brings."""
    found = re.search(r"OpenColorIO (\d[\w.]*)", str(oiio.get_string_attribute("build:dependencies")))
    return found[1] if found else f"in OpenImageIO {oiio.VERSION_STRING}"


@functools.cache
def _configuration() -> tuple[str, tuple[str, ...]]:
    """Its display for sRGB screens, and the views of that."""
    configuration = oiio.ColorConfig(CONFIGURATION)
    displays = configuration.getDisplayNames()
    display = next(
        (name for name in displays if name.startswith("sRGB")), configuration.getDefaultDisplayName()
    )
    return display, tuple(configuration.getViewNames(display)) if display else ()


def _viewed(display: str, view: str, color: Floats) -> Floats:
    pixels = np.ascontiguousarray(color.reshape(1, -1, 3))
    shown = oiio.ImageBufAlgo.ociodisplay(
        oiio.ImageBuf(pixels), display, view, _SCENE, colorconfig=CONFIGURATION
    )
    if shown.has_error:
        raise MrmError(f"tone mapping {view}: {shown.geterror()}")
    encoded = np.clip(np.asarray(shown.get_pixels(oiio.FLOAT), np.float32), 0.0, 1.0)
    return srgb_decoded(encoded).reshape(color.shape)
