"""MERL's binary format: an isotropic table over half and difference angles, three channels."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from mrm_nodes.errors import MrmError
from mrm_nodes.measured.alta import half_to_directions
from mrm_nodes.measured.measurement import Measurement, above

SHAPE = (90, 90, 180)
"""θ_h, θ_d, φ_d. Steps of θ_h grow from the normal on: it is 90° (i/90)²."""
SCALES = (1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)


def is_merl(content: bytes) -> bool:
    """Whether the header is MERL's."""
    return len(content) >= 12 and struct.unpack("<3i", content[:12]) == SHAPE


def read_merl(path: Path, content: bytes) -> Measurement:
    """The samples of a MERL file, each at the middle of its cell; negative ones, which MERL has for none, are left out.

    Raises:
        MrmError: it is not whole, or of other dimensions.
    """
    if len(content) < 12:
        raise MrmError(f"{path}: {len(content)} bytes are no MERL file")
    shape = struct.unpack("<3i", content[:12])
    if shape != SHAPE:
        raise MrmError(f"{path}: dimensions {shape}; a MERL file has {SHAPE}")
    count = 3 * int(np.prod(SHAPE))
    if len(content) != 12 + 8 * count:
        raise MrmError(f"{path}: {len(content)} bytes, but {12 + 8 * count} are needed: is the file whole?")
    table = np.frombuffer(content, "<f8", count, 12).reshape(3, -1)
    if not np.isfinite(table).all():
        raise MrmError(f"{path}: value {int(np.argmax(~np.isfinite(table.ravel()))) + 1} is no finite number")
    measured = (table >= 0.0).all(axis=0)
    if not measured.any():
        raise MrmError(f"{path}: all values are negative, which stands for none")
    i, j, k = np.unravel_index(np.flatnonzero(measured), SHAPE)
    theta_h = 0.5 * np.pi * ((i + 0.5) / SHAPE[0]) ** 2
    theta_d, phi_d = 0.5 * np.pi * (j + 0.5) / SHAPE[1], np.pi * (k + 0.5) / SHAPE[2]
    v, l = half_to_directions(theta_h, np.zeros(len(i)), theta_d, phi_d)  # noqa: E741  the field's own name
    value = table[:, measured].T * SCALES
    return above(v, l, value, ("R", "G", "B"), path.stem)
