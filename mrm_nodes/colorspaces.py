"""Colour spaces: which MaterialX's generators decode, and what OpenColorIO's built-in configuration knows besides."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import ArrayLike, NDArray

from mrm_nodes import library
from mrm_nodes.errors import MrmError, suggestion

LINEAR = "lin_rec709"
"""What all shading is done in."""

#: OpenColorIO's own configuration, whatever the variable OCIO says: a picture depends on no machine's settings.
_CONFIGURATION = "ocio://default"

#: Names that MaterialX's generators take for one of their own (DefaultColorManagementSystem).
_REMAPPED = {
    "gamma18": "g18_rec709",
    "gamma22": "g22_rec709",
    "gamma24": "rec709_display",
    "lin_ap1": "acescg",
}

_DATA = ("", "none", "raw", "data", "Utility - Raw")


@functools.cache
def _configuration() -> Any:
    return oiio.ColorConfig(_CONFIGURATION)


@functools.cache
def _ocio_names() -> frozenset[str]:
    return frozenset(_configuration().getColorSpaceNames())


@functools.cache
def ocio_name(space: str) -> str | None:
    """OpenColorIO's name of a colour space by any of its names; None for one that it does not know."""
    # It returns what it does not know.
    found = str(_configuration().resolve(space))
    return found if found in _ocio_names() else None


def is_data(space: str) -> bool:
    """Whether a name says that numbers are to be taken as they are."""
    found = ocio_name(space)
    return space in _DATA or (found is not None and bool(_configuration().isData(found)))


def is_linear(space: str) -> bool:
    """Whether a colour of that space is one of linear Rec. 709, as it is."""
    return is_data(space) or ocio_name(space) == ocio_name(LINEAR)


@functools.cache
def own_names() -> frozenset[str]:
    """The names that MaterialX's generators know themselves: its library decodes each of them."""
    ending = f"_to_{LINEAR}"
    nodes = {definition.getNodeString() for definition in library.shared_library().getNodeDefs()}
    decoded = {node.removesuffix(ending) for node in nodes if node.endswith(ending)}
    return frozenset(decoded | {LINEAR, *_REMAPPED})


def decoding_node(space: str) -> str:
    """The node of MaterialX's library that makes a colour of a space of its own linear."""
    return f"{_REMAPPED.get(space, space)}_to_{LINEAR}"


@functools.cache
def equivalents(own: frozenset[str]) -> Mapping[str, str]:
    """By OpenColorIO's names, those of MaterialX's that mean the same space."""
    named = {ocio_name(name): name for name in sorted(own - set(_REMAPPED), reverse=True)}
    return {ocio: name for ocio, name in named.items() if ocio is not None} | {
        ocio_name(LINEAR) or "": LINEAR
    }


def unknown_space(space: str, own: frozenset[str]) -> str:
    """What to say of a colour space that nobody knows."""
    known = {*own, *_ocio_names()}
    known |= {alias for name in _ocio_names() for alias in _configuration().getAliases(name)}
    return f"unknown colour space {space}; {suggestion(space, known)}"


def linear(values: ArrayLike, space: str) -> NDArray[np.float32]:
    """Colours of a space as linear Rec. 709, of shape (..., 3) or more channels, of which the fourth stays.

    Raises:
        MrmError: OpenColorIO cannot convert from that space.
    """
    colors = np.array(values, dtype=np.float32)
    pixels = np.ascontiguousarray(colors[..., :3]).reshape(1, -1, 3)
    converted = oiio.ImageBufAlgo.colorconvert(
        oiio.ImageBuf(pixels), space, ocio_name(LINEAR) or LINEAR, False, "", "", _CONFIGURATION
    )
    # A conversion that fails raises nothing.
    if converted.has_error:
        raise MrmError(f"colour space {space}: {' '.join(converted.geterror().split())}")
    colors[..., :3] = np.asarray(converted.get_pixels(oiio.FLOAT)).reshape(colors[..., :3].shape)
    return colors
