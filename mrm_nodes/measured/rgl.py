"""RGL's tensor files (.bsdf): Mitsuba's `measured` evaluates them, where it is installed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mrm_nodes.errors import MrmError
from mrm_nodes.measured.angles import Array, directions
from mrm_nodes.measured.measurement import Measurement, above

MAGIC = b"tensor_file\0"
LIGHTS = tuple(range(0, 80, 10))
"""Degrees of the light at which a table is looked up."""


def read_rgl(path: Path, content: bytes) -> Measurement:
    """f at `LIGHTS`, and for each at viewers all over the hemisphere, more of them about retroreflection.

    Mitsuba's variant is set to `scalar_rgb` meanwhile; where none was set before, it stays, as Mitsuba cannot unset it.

    Raises:
        MrmError: Mitsuba is missing, or does not take the file.
    """
    try:
        import mitsuba
    except ImportError:
        raise MrmError(f"{path}: RGL's format is read by Mitsuba: pip install mitsuba") from None
    v, l = _grid()  # noqa: E741  the field's own name
    before = mitsuba.variant()
    try:
        mitsuba.set_variant("scalar_rgb")
        value = _evaluated(mitsuba, path, v, l)
    except RuntimeError as error:
        first = str(error).strip().splitlines()[-1].strip()
        raise MrmError(f"{path}: Mitsuba does not read it: {first}") from None
    finally:
        if before is not None:
            mitsuba.set_variant(before)
    if not np.isfinite(value).all() or (value < 0.0).any():
        raise MrmError(f"{path}: a value is negative or no finite number")
    return above(v, l, value, ("R", "G", "B"), path.stem)


def _grid() -> tuple[Array, Array]:
    polar = np.concatenate([np.arange(0.0, 12.0, 1.0), np.arange(12.0, 160.0, 6.0)])
    views, lights = [], []
    for angle in np.radians(LIGHTS):
        light = directions(angle, 0.0)
        up = directions(angle - 0.5 * np.pi, 0.0)
        for phi in np.radians(np.arange(0.0, 181.0, 15.0)):
            turned = np.cos(phi) * up + np.sin(phi) * np.array([0.0, 1.0, 0.0])
            view = np.cos(np.radians(polar))[:, None] * light + np.sin(np.radians(polar))[:, None] * turned
            seen = view[:, 2] > 0.05
            views.append(view[seen])
            lights.append(np.broadcast_to(light, view[seen].shape))
    return np.concatenate(views), np.concatenate(lights)


def _evaluated(mitsuba: Any, path: Path, v: Array, l: Array) -> Array:  # noqa: E741
    """f without the cosine, which Mitsuba's answer has."""
    bsdf = mitsuba.load_dict({"type": "measured", "filename": str(path)})
    context, at = mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()
    value = np.empty(v.shape)
    for i in range(len(v)):
        at.wi = mitsuba.Vector3f(*l[i])
        value[i] = np.array(bsdf.eval(context, at, mitsuba.Vector3f(*v[i]))) / v[i, 2]
    return value
