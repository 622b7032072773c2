"""ALTA's text format (.dat): a header of `#KEY value`, then a sample a line, its coordinates first.

What the coordinates are is ALTA's `PARAM_IN`, by its own definitions. What the values are is `PARAM_OUT`, which real
files have wrong or not at all; reciprocity tells what they are, where the file has both of a pair of directions.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from mrm_nodes.errors import MrmError, MrmWarning, unknown
from mrm_nodes.measured.angles import Array, directions
from mrm_nodes.measured.measurement import Measurement, above, check_values
from mrm_nodes.measured.reciprocity import cosine_power

COSINES = {"none": 0, "view": 1, "light": -1}
"""What a value may be multiplied by."""
_POWERS = {power: name for name, power in COSINES.items()}
_SAID = {"none": "plain f", "view": "f cos θ_v", "light": "f cos θ_l"}

_HEADER = re.compile(r"#\s*(DIM|VS|PARAM_IN|PARAM_OUT|SAMPLE)\b\s*[:=]?\s*(.*)", re.IGNORECASE)
LIMIT = 0.5 * np.pi * 1.02
"""The largest angle from the normal, with what rounding may add."""


def _projected(c: Array) -> tuple[Array, Array]:
    polar = np.hypot(c[:, 1], c[:, 2])
    return directions(polar, np.arctan2(c[:, 2], c[:, 1])), directions(c[:, 0], 0.0)


def _about_light(c: Array) -> tuple[Array, Array]:
    """θ_l, and the viewer about the light: θ_vl cos φ, θ_vl sin φ, φ from the direction to the normal."""
    light = directions(c[:, 0], 0.0)
    angle, phi = np.hypot(c[:, 1], c[:, 2]), np.arctan2(c[:, 2], c[:, 1])
    up = np.stack([-np.cos(c[:, 0]), np.zeros(len(c)), np.sin(c[:, 0])], axis=-1)
    across = np.array([0.0, 1.0, 0.0])
    turned = np.cos(phi)[:, None] * up + np.sin(phi)[:, None] * across
    return np.cos(angle)[:, None] * light + np.sin(angle)[:, None] * turned, light


def _about_back(c: Array) -> tuple[Array, Array]:
    """θ_l, and the back vector: θ_k cos φ, θ_k sin φ."""
    light = directions(c[:, 0], 0.0)
    back, _ = _projected(c)
    mirrored = light * [-1.0, 1.0, 1.0]
    view = 2.0 * (mirrored * back).sum(axis=-1, keepdims=True) * back - mirrored
    return view, light


def half_to_directions(theta_h: Array, phi_h: Array, theta_d: Array, phi_d: Array) -> tuple[Array, Array]:
    """The viewer's and the light's directions from Rusinkiewicz's half and difference angles, each (n)."""
    d = directions(theta_d, phi_d)
    x = np.cos(theta_h) * d[:, 0] + np.sin(theta_h) * d[:, 2]
    z = np.cos(theta_h) * d[:, 2] - np.sin(theta_h) * d[:, 0]
    view = np.stack(
        [np.cos(phi_h) * x - np.sin(phi_h) * d[:, 1], np.sin(phi_h) * x + np.cos(phi_h) * d[:, 1], z], -1
    )
    h = directions(theta_h, phi_h)
    return view, 2.0 * (view * h).sum(axis=-1, keepdims=True) * h - view


PARAMETRIZATIONS: Mapping[str, tuple[int, tuple[int, ...], Callable[[Array], tuple[Array, Array]]]] = {
    "ISOTROPIC_TL_TV_PROJ_DPHI": (3, (0, 1, 2), _projected),
    "ISOTROPIC_TV_TL_DPHI": (3, (0, 1), lambda c: (directions(c[:, 0], 0.0), directions(c[:, 1], c[:, 2]))),
    "ISOTROPIC_TV_PROJ_DPHI": (2, (0, 1), lambda c: _projected(np.insert(c, 0, 0.0, axis=1))),
    "SPHERICAL_TL_PL_TV_PV": (
        4,
        (0, 2),
        lambda c: (directions(c[:, 2], c[:, 3]), directions(c[:, 0], c[:, 1])),
    ),
    "RETRO_TL_TVL_PROJ_DPHI": (3, (0,), _about_light),
    "SCHLICK_TL_TK_PROJ_DPHI": (3, (0, 1, 2), _about_back),
    "RUSIN_TH_TD_PD": (3, (0, 1), lambda c: half_to_directions(c[:, 0], np.zeros(len(c)), c[:, 1], c[:, 2])),
    "RUSIN_TH_PH_TD_PD": (4, (0, 2), lambda c: half_to_directions(c[:, 0], c[:, 1], c[:, 2], c[:, 3])),
    "CARTESIAN": (6, (), lambda c: (c[:, :3], c[:, 3:])),
}
"""By name: how many coordinates, which of them are angles from the normal, and the directions that they are."""

OUTPUTS: Mapping[str, str | None] = {
    "INV_STERADIAN": "none",
    "INV_STERADIAN_COSINE_FACTOR": "view",
    "RGB_COLOR": "none",
    "UNKNOWN_OUTPUT": None,
    "": None,
}


def is_alta(text: str) -> bool:
    """Whether the header is ALTA's."""
    return (
        re.search(r"^\ufeff?\s*#\s*(DIM|PARAM_IN|PARAM_OUT|SAMPLE|VS)\b", text, re.MULTILINE | re.IGNORECASE)
        is not None
    )


def read_alta(path: Path, text: str, cosine: str | None = None) -> Measurement:
    """The samples of an ALTA file.

    cosine: what its values are multiplied by; None: what reciprocity says, and where that cannot be seen, the header.

    Raises:
        MrmError: it is no such file, or not whole.
    """
    header, rows = _parse(path, text)
    if "PARAM_IN" not in header:
        raise MrmError(
            f"{path}: no PARAM_IN in its header, so what its columns are is not known; add a line such as "
            "#PARAM_IN ISOTROPIC_TL_TV_PROJ_DPHI"
        )
    name = header["PARAM_IN"].upper()
    if name not in PARAMETRIZATIONS:
        raise MrmError(f"{path}: {unknown('PARAM_IN', header['PARAM_IN'], PARAMETRIZATIONS)}")
    count, polar, convert = PARAMETRIZATIONS[name]
    values = _dimensions(path, header, name, count, rows.shape[1])
    coordinates = rows[:, :count]
    _check_radians(path, name, coordinates, polar)
    v, l = convert(coordinates)  # noqa: E741  the field's own name
    for direction in (v, l):
        length = np.linalg.norm(direction, axis=-1, keepdims=True)
        if not (np.abs(length - 1.0) < 1e-3).all():
            raise MrmError(
                f"{path}: sample {int(np.argmax(np.abs(length - 1.0) >= 1e-3)) + 1}: a direction is not of unit length"
            )
        direction /= length
    value = rows[:, count : count + values]
    check_values(path, value)
    claimed = OUTPUTS.get(header.get("PARAM_OUT", "").upper(), "?")
    if claimed == "?":
        raise MrmError(f"{path}: {unknown('PARAM_OUT', header['PARAM_OUT'], filter(None, OUTPUTS))}")
    factor = _cosine(path, v, l, value, claimed, cosine)
    divided = {"none": np.ones(len(v)), "view": v[:, 2], "light": l[:, 2]}[factor]
    channels = ("R", "G", "B") if values == 3 else tuple(f"{i}" for i in range(values))
    with np.errstate(divide="ignore", invalid="ignore"):
        f = value / divided[:, None]
    return above(v, l, f, ("luminance",) if values == 1 else channels, header.get("SAMPLE", "").strip('"'))


def _parse(path: Path, text: str) -> tuple[dict[str, str], Array]:
    header: dict[str, str] = {}
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        stripped = line.strip().lstrip("\ufeff")
        if stripped.startswith("#"):
            found = _HEADER.match(stripped)
            if found and not rows:
                header.setdefault(found[1].upper(), found[2].split("#")[0].strip())
            continue
        words = stripped.split("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise MrmError(f"{path}: line {number}: {stripped[:40]!r} is no row of numbers") from None
        if rows and len(row) != len(rows[0]):
            raise MrmError(
                f"{path}: line {number} has {len(row)} numbers, the first row {len(rows[0])}: is the file whole?"
            )
        rows.append(row)
    if not rows:
        raise MrmError(f"{path}: no sample in it")
    return header, np.array(rows)


def _dimensions(path: Path, header: Mapping[str, str], name: str, count: int, columns: int) -> int:
    """How many values a sample has."""
    stated = header.get("DIM", "").split()
    try:
        inputs, values = (int(each) for each in stated[:2]) if stated else (count, columns - count)
    except ValueError:
        raise MrmError(f"{path}: DIM {header['DIM']}: write the numbers of coordinates and values") from None
    if inputs != count:
        raise MrmError(f"{path}: DIM says {inputs} coordinates, but {name} has {count}")
    # What follows the values may be their errors (VS): one number each, or two.
    spread = any(each not in ("0", "") for each in header.get("VS", "").split())
    allowed = [count + values] + ([count + 2 * values, count + 3 * values] if spread else [])
    if values < 1 or columns not in allowed:
        raise MrmError(
            f"{path}: a row has {columns} numbers, but {count} coordinates and {values} values are stated"
        )
    return values


def _check_radians(path: Path, name: str, coordinates: Array, polar: tuple[int, ...]) -> None:
    bad = ~np.isfinite(coordinates)
    if bad.any():
        raise MrmError(
            f"{path}: a coordinate of sample {int(np.argwhere(bad)[0][0]) + 1} is no finite number"
        )
    for column in polar:
        largest = float(np.abs(coordinates[:, column]).max()) if len(coordinates) else 0.0
        if largest > LIMIT:
            raise MrmError(
                f"{path}: {name}: an angle from the normal is {largest:g}, beyond π/2 = 1.5708: it looks like degrees, "
                "and radians are meant; convert them"
            )


def _cosine(
    path: Path,
    v: Array,
    l: Array,  # noqa: E741
    value: Array,
    claimed: str | None,
    asked: str | None,
) -> str:
    """Which cosine the values are multiplied by."""
    seen = cosine_power(v, l, value.mean(axis=1))
    found = None if seen is None else _POWERS[seen]
    if asked is not None:
        if asked not in COSINES:
            raise MrmError(unknown("cosine", asked, COSINES))
        if found not in (None, asked):
            warnings.warn(
                f"{path}: read as {_SAID[asked]}, as asked; by reciprocity its values are {_SAID[str(found)]}",
                MrmWarning,
                stacklevel=2,
            )
        return asked
    if found is None:
        if claimed is None:
            warnings.warn(
                f"{path}: neither its header nor reciprocity says whether its values have a cosine; "
                "read as plain f: say --cosine view where they are f cos θ_v",
                MrmWarning,
                stacklevel=2,
            )
        return claimed or "none"
    if found != claimed and not (claimed is None and found == "none"):
        says = f"says {_SAID[claimed]}" if claimed else "says nothing of a cosine"
        warnings.warn(
            f"{path}: its header {says}; by reciprocity its values are {_SAID[found]}, as which they are read",
            MrmWarning,
            stacklevel=2,
        )
    return found
