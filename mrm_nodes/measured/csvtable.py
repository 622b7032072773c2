"""Tables of text with named columns: CSV, and ASTM E1392's, whose columns are named after `VARS`."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.measured.alta import LIMIT
from mrm_nodes.measured.angles import Array, directions
from mrm_nodes.measured.measurement import Measurement, above, check_values

ANGLES = ("theta_v", "theta_l", "phi_v", "phi_l", "dphi")
GONIOMETER = ("observation", "beta1", "beta2", "rotation")
VECTORS = ("vx", "vy", "vz", "lx", "ly", "lz")
VALUES = (("f",), ("value",), ("brdf",), ("luminance",), ("r", "g", "b"), ("r_a",))
HELP = (
    "columns are theta_v and theta_l in radians (theta_v_deg in degrees), phi_v and phi_l or dphi, and f or R, G, B; "
    "or vx, vy, vz, lx, ly, lz and f; or observation and beta1 in degrees, and R_A"
)


def read_csv(path: Path, text: str) -> Measurement:
    """The samples of a table whose first line names its columns; lines that begin with # are comments.

    Commas, semicolons, tabs or spaces stand between the columns, whose cells may be quoted. Where it is no comma, a
    number may have a decimal comma.

    Raises:
        MrmError: columns are missing, or it is not whole.
    """
    lines = [
        (number, line.strip())
        for number, line in enumerate(text.splitlines(), 1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise MrmError(f"{path}: no line in it")
    said = re.fullmatch(r"sep=(.)", lines[0][1])  # Excel's first line
    lines = lines[1:] if said else lines
    if not lines:
        raise MrmError(f"{path}: no line in it")
    header = re.sub(r'"[^"]*"', "", lines[0][1])
    separator = said[1] if said else next((each for each in (";", "\t", ",") if each in header), None)
    cells = _cells(path, *lines[0], separator)
    while cells and not cells[-1]:
        cells.pop()
    names = [_plain(each) for each in cells]
    if all(_number(each, separator) is not None for each in cells):
        raise MrmError(f"{path}: its first line names no columns: {HELP}")
    if len(set(names)) != len(names):
        raise MrmError(f"{path}: a column is named twice: {', '.join(names)}")
    return _measured(path, dict(zip(names, _numbers(path, lines[1:], separator, len(names)).T, strict=True)))


def is_astm(text: str) -> bool:
    """Whether columns are named after `VARS`."""
    return re.search(r"^\s*VARS[ \t=]", text, re.MULTILINE) is not None


def read_astm(path: Path, text: str) -> Measurement:
    """The samples of an ASTM E1392 text: θ_i, φ_i, θ_s, φ_s in radians, and values, by commas.

    The layout is the one that libbsdf reads; the standard was not read, nor a file of a laboratory.

    Raises:
        MrmError: it is not whole.
    """
    lines = list(enumerate(text.splitlines(), 1))
    start = next(k for k, (_, line) in enumerate(lines) if re.match(r"\s*VARS[ \t=]", line))
    names = [each.strip() for each in lines[start][1].strip()[5:].split(",")]
    if len(names) < 5:
        raise MrmError(f"{path}: VARS names {len(names)} columns: four angles and a value are needed")
    data = [(number, line.strip()) for number, line in lines[start + 1 :] if line.strip()]
    stated = re.search(r"^\s*NUM_POINTS[ \t=]+(\d+)", text, re.MULTILINE)
    if stated and int(stated[1]) != len(data):
        raise MrmError(f"{path}: NUM_POINTS says {stated[1]}, but there are {len(data)}: is the file whole?")
    rows = _numbers(path, data, ",", len(names))
    channels = ("luminance",) if len(names) == 5 else tuple(names[4:])
    columns = {"theta_l": rows[:, 0], "phi_l": rows[:, 1], "theta_v": rows[:, 2], "phi_v": rows[:, 3]}
    v, l = _directions(path, columns)  # noqa: E741  the field's own name
    check_values(path, rows[:, 4:])
    return above(v, l, rows[:, 4:], channels, path.stem)


def _measured(path: Path, columns: Mapping[str, Array]) -> Measurement:
    value_names = next((names for names in VALUES if all(name in columns for name in names)), None)
    if value_names is None:
        raise MrmError(f"{path}: no column of values among {', '.join(columns)}: {HELP}")
    v, l = _directions(path, columns)  # noqa: E741
    value = np.column_stack([columns[name] for name in value_names])
    check_values(path, value)
    if value_names == ("r_a",):
        value = value / np.maximum(v[:, 2:] * l[:, 2:], 1e-9)
    channels = ("R", "G", "B") if len(value_names) == 3 else ("luminance",)
    return above(v, l, value, channels, path.stem)


def _directions(path: Path, columns: Mapping[str, Array]) -> tuple[Array, Array]:
    if all(name in columns for name in VECTORS):
        pair = [np.column_stack([columns[name] for name in VECTORS[k : k + 3]]) for k in (0, 3)]
        for each in pair:
            length = np.linalg.norm(each, axis=1, keepdims=True)
            wrong = ~(np.abs(length - 1.0) < 1e-3)
            if wrong.any():
                raise MrmError(
                    f"{path}: sample {int(np.argmax(wrong)) + 1}: a direction is not of unit length"
                )
            each /= length
        return pair[0], pair[1]
    if "observation" in columns and "beta1" in columns:
        from mrm_nodes.photometry import directions as goniometer

        zero = np.zeros(len(columns["beta1"]))
        given = [columns.get(name, zero) for name in GONIOMETER]
        for name, each in zip(GONIOMETER, given, strict=True):
            _check_finite(path, name, each)
        if any(
            np.abs(each).max() > limit for each, limit in zip(given[:3], (180.0, 90.0, 90.0), strict=True)
        ):
            raise MrmError(f"{path}: an angle is beyond 90°")
        view, light = goniometer(*given)
        return np.asarray(view, np.float64), np.asarray(light, np.float64)
    others = [name for name in columns if name.startswith(("observation", "entrance", "alpha", "beta"))]
    if others:
        raise MrmError(
            f"{path}: {', '.join(others)}: name the observation angle's column observation, and the entrance angle's "
            f"beta1, both in degrees ({HELP})"
        )
    angles = _in_radians(path, columns)
    for name in ("theta_v", "theta_l"):
        if name not in angles:
            raise MrmError(f"{path}: no column {name}; {suggestion(name, columns)} ({HELP})")
    if "dphi" not in angles and not ("phi_v" in angles and "phi_l" in angles):
        raise MrmError(f"{path}: no column dphi, nor phi_v and phi_l ({HELP})")
    phi_l = angles.get("phi_l", np.zeros(len(angles["theta_l"])))
    phi_v = angles["phi_v"] if "phi_v" in angles else phi_l + angles["dphi"]
    if "phi_l" not in angles and "phi_v" in angles:
        phi_v = angles["dphi"]
    return directions(angles["theta_v"], phi_v), directions(angles["theta_l"], phi_l)


def _in_radians(path: Path, columns: Mapping[str, Array]) -> dict[str, Array]:
    angles = {}
    for name in ANGLES:
        if name in columns and f"{name}_deg" in columns:
            raise MrmError(f"{path}: {name} is given in radians and in degrees")
        if f"{name}_deg" in columns:
            angles[name] = np.radians(columns[f"{name}_deg"])
        elif name in columns:
            angles[name] = columns[name]
    for name, values in angles.items():
        _check_finite(path, name, values)
        largest = float(np.abs(values).max()) if len(values) else 0.0
        if largest > (LIMIT if name.startswith("theta") else 2.02 * np.pi):
            raise MrmError(
                f"{path}: {name} is {largest:g}: it looks like degrees, and radians are meant; "
                f"name the column {name}_deg"
            )
    return angles


def _check_finite(path: Path, name: str, values: Array) -> None:
    finite = np.isfinite(values)
    if not finite.all():
        raise MrmError(f"{path}: {name} of sample {int(np.argmin(finite)) + 1} is no finite number")


def _cells(path: Path, number: int, line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    try:
        return [each.strip() for each in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    except csv.Error as error:
        raise MrmError(f"{path}: line {number}: {error}") from None


def _numbers(path: Path, lines: Sequence[tuple[int, str]], separator: str | None, count: int) -> Array:
    rows = []
    for number, line in lines:
        cells = _cells(path, number, line, separator)
        while len(cells) > count and not cells[-1]:
            cells.pop()
        row = [each for each in (_number(cell, separator) for cell in cells) if each is not None]
        if len(row) != len(cells):
            raise MrmError(f"{path}: line {number}: {line[:40]!r} is no row of numbers")
        if len(row) != count:
            raise MrmError(f"{path}: line {number} has {len(row)} numbers, not {count}: is the file whole?")
        rows.append(row)
    if not rows:
        raise MrmError(f"{path}: no sample in it")
    return np.array(rows)


def _plain(name: str) -> str:
    """A column's name in small letters, with a unit in brackets as its ending."""
    found = re.fullmatch(r"(.*?)\s*[\[(](.*)[\])]", name.strip().strip('"').lower())
    bare, unit = (found[1], found[2]) if found else (name.strip().strip('"').lower(), "")
    degrees = "_deg" if unit in ("deg", "degrees", "°") else ""
    plain = bare.strip().replace(" ", "_").replace("θ", "theta").replace("φ", "phi")
    return plain + ("" if plain.endswith("_deg") or plain in GONIOMETER else degrees)


def _number(text: str, separator: str | None) -> float | None:
    """A number, which has a decimal comma where that separates nothing; None for what is none."""
    if separator != "," and "." not in text:
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError:
        return None
