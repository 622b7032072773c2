"""ASAM OpenMATERIAL 3D's look-up tables (.xompt): rows of wavelength, θ_i, θ_o, φ_o and f, in metres and radians.

φ_o counts from the light's own azimuth: at 0 the viewer and the light lie on the same side of the normal.
"""

from __future__ import annotations

import json
import re
import uuid
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mrm_nodes import jsontext
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import write_text
from mrm_nodes.measured.alta import LIMIT
from mrm_nodes.measured.angles import directions
from mrm_nodes.measured.measurement import Measurement, above

VERSION = "1.0.0"
"""Of OpenMATERIAL 3D."""
WAVELENGTHS = {"luminance": 555.0, "R": 611.4, "G": 549.1, "B": 464.3}
"""Nanometres that channels which are none are written with: the eye's best, and those of Rec.709's primaries."""
_HUGE = 10**300
_LARGEST = (1.570796, 1.570796, 6.283185)
"""What the schema lets θ_i, θ_o and φ_o be."""


def read_xompt(path: Path, text: str) -> Measurement:
    """The samples of a table, a channel for each wavelength.

    Raises:
        MrmError: it is no such table, or not whole.
    """
    try:
        table = jsontext.loads(text)
    except ValueError as error:
        raise MrmError(f"{path}: no JSON: {error}; is the file whole?") from None
    brdf = table.get("brdf") if isinstance(table, dict) else None
    rows = brdf.get("lookupTable") if isinstance(brdf, dict) else None
    if not isinstance(rows, list) or not rows:
        raise MrmError(
            f"{path}: no brdf.lookupTable in it: of OpenMATERIAL's tables, those of BRDFs are read"
        )
    for k, row in enumerate(rows):
        if not (isinstance(row, list) and len(row) == 5 and all(map(_is_number_or_none, row))):
            raise MrmError(f"{path}: row {k + 1} of lookupTable is not five numbers: λ, θi, θo, φo, f")
    whole = [row for row in rows if None not in row]
    if len(whole) < len(rows):
        warnings.warn(
            f"{path}: {len(rows) - len(whole)} rows have no value, and are left out", MrmWarning, stacklevel=2
        )
    if not whole:
        raise MrmError(f"{path}: no row has a value")
    data = np.array(whole, np.float64)
    _check(path, data)
    wavelengths = np.unique(data[:, 0])
    places, index = np.unique(data[:, 1:4], axis=0, return_inverse=True)
    value = np.full((len(places), len(wavelengths)), np.nan)
    value[index.ravel(), np.searchsorted(wavelengths, data[:, 0])] = data[:, 4]
    complete = np.isfinite(value).all(axis=1)
    if not complete.all():
        warnings.warn(
            f"{path}: {int((~complete).sum())} directions lack one of the {len(wavelengths)} wavelengths, "
            "and are left out",
            MrmWarning,
            stacklevel=2,
        )
    if not complete.any():
        raise MrmError(f"{path}: no direction has a value at each wavelength")
    names = [f"{1e9 * each:g} nm" for each in wavelengths]
    metadata = table.get("metadata")
    written = _channels(metadata if isinstance(metadata, dict) else {}, wavelengths)
    sample = metadata.get("name", "") if isinstance(metadata, dict) else ""
    places, value = places[complete], value[complete]
    if written:
        order = np.argsort([WAVELENGTHS[each] for each in written])
        value = value[:, np.argsort(order)]
        names = written
    v, l = directions(places[:, 1], places[:, 2]), directions(places[:, 0], 0.0)  # noqa: E741
    return above(v, l, value, tuple(names), sample if isinstance(sample, str) else "")


def _is_number_or_none(value: object) -> bool:
    """Whether float64 holds it, or it is a gap."""
    if isinstance(value, int):
        return not isinstance(value, bool) and abs(value) <= _HUGE
    return value is None or isinstance(value, float)


def _check(path: Path, data: np.ndarray[Any, Any]) -> None:
    if not np.isfinite(data).all():
        raise MrmError(f"{path}: row {int(np.argwhere(~np.isfinite(data))[0][0]) + 1}: no finite number")
    if (data[:, 4] < 0.0).any():
        raise MrmError(f"{path}: row {int(np.argmax(data[:, 4] < 0.0)) + 1}: the value is negative")
    if data[:, 1:3].max() > LIMIT or data[:, 3].max() > 2.02 * np.pi:
        largest = data[:, 1:4].max()
        raise MrmError(
            f"{path}: an angle is {largest:g}: it looks like degrees, and radians are meant; convert them"
        )
    if (data[:, 1:3] < 0.0).any() or data[:, 3].min() < -1.01 * np.pi:
        raise MrmError(f"{path}: an angle is below 0")
    if not ((data[:, 0] >= 1e-9) & (data[:, 0] <= 17.16e-3)).all():
        raise MrmError(f"{path}: a wavelength is {data[:, 0].max():g}: metres are meant, such as 5.5e-7")


_WRITTEN = re.compile(r"channels written by mrm-nodes: ([\w, ]+?)(?:;|$)")


def _channels(metadata: dict[str, Any], wavelengths: np.ndarray[Any, Any]) -> list[str]:
    """The names of channels that stand for wavelengths only because the format asks for some."""
    found = _WRITTEN.search(str(metadata.get("sources", "")))
    names = [each.strip() for each in found[1].split(",")] if found else []
    fits = len(names) == len(wavelengths) and all(name in WAVELENGTHS for name in names)
    return names if fits else []


def write_xompt(
    path: str | Path, measurement: Measurement, name: str = "", sources: str = "measurement"
) -> None:
    """Write a measurement as a table of OpenMATERIAL 3D.

    Isotropic: of azimuths it has the difference. A channel that is no wavelength ("555 nm") gets one of
    `WAVELENGTHS`, and `sources` says so.

    Args:
        path: of the file.
        measurement: n samples.
        name: of the material.
        sources: where its values are from, in words.

    Raises:
        MrmError: a channel without a wavelength, or the file cannot be written.
    """
    wavelengths = [_wavelength(each) for each in measurement.channels]
    theta_i, theta_o = measurement.theta_l, measurement.theta_v
    azimuth_v = np.arctan2(measurement.v[:, 1], measurement.v[:, 0])
    azimuth_l = np.where(theta_i > 0.0, np.arctan2(measurement.l[:, 1], measurement.l[:, 0]), 0.0)
    phi = np.mod(azimuth_v - azimuth_l, 2.0 * np.pi)
    columns = [np.clip(each, 0.0, most) for each, most in zip((theta_i, theta_o, phi), _LARGEST, strict=True)]
    rows: list[list[float]] = []
    for k in np.argsort(wavelengths):
        table = np.column_stack([*columns, measurement.value[:, k]])
        order = np.lexsort(table.T[::-1])
        rows += [[wavelengths[k], *map(float, row)] for row in table[order]]
    if all(each in WAVELENGTHS for each in measurement.channels):
        sources = f"{sources}; channels written by mrm-nodes: {', '.join(measurement.channels)}"
    identity = uuid.uuid5(uuid.NAMESPACE_URL, json.dumps([name, sources, rows[: 1 << 16]]))
    table_of = {
        "metadata": {
            "name": name or measurement.sample or "measured",
            "description": "Measured scattering, written by mrm-nodes.",
            "uuid": str(identity),
            "materialVersion": "1.0.0",
            "openMaterial3dVersion": VERSION,
            "copyrights": ["unknown"],
            "license": "unknown",
            "authors": ["unknown"],
            "sources": sources,
        },
        "brdf": {"wavelengths": sorted(wavelengths), "lookupTable": rows},
    }
    write_text(Path(path), json.dumps(table_of, indent=1) + "\n")


def _wavelength(channel: str) -> float:
    """Metres."""
    found = re.fullmatch(r"([\d.]+(?:e[+-]?\d+)?) ?nm", channel)
    if found is None and channel not in WAVELENGTHS:
        known: Sequence[str] = sorted(WAVELENGTHS)
        raise MrmError(f"channel {channel} is no wavelength such as 555 nm, nor one of {', '.join(known)}")
    return round(1e-9 * (float(found[1]) if found else WAVELENGTHS[channel]), 16)
