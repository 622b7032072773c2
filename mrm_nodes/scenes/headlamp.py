"""A headlamp: its luminous intensity by direction."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.files import read_bytes

Array = NDArray[np.float64]

BRIGHTEST = 1e7
"""cd: more is a mistake."""

COLUMNS = ("horizontal", "vertical", "candela")
"""Of a table: degrees to the right of straight ahead, degrees above it, and the intensity there."""


@dataclass(frozen=True, eq=False)
class Headlamp:
    """Luminous intensity in cd, linear between the angles of a table, and none beyond them.

    Args:
        horizontal: (m,), degrees to the right of straight ahead (-z), rising.
        vertical: (n,), degrees above it, rising.
        candela: (n, m).
    """

    horizontal: Array
    vertical: Array
    candela: Array

    def intensity(self, directions: Array) -> Array:
        """The intensity towards directions (..., 3), of any length: (...)."""
        x, y, z = np.moveaxis(np.asarray(directions, np.float64), -1, 0)
        across = np.degrees(np.arctan2(x, -z))
        upwards = np.degrees(np.arctan2(y, np.hypot(x, z)))
        column, in_columns = _between(self.horizontal, across)
        row, in_rows = _between(self.vertical, upwards)
        c, r = column.astype(int), row.astype(int)
        u, v = column - c, row - r
        last_c, last_r = (
            np.minimum(c + 1, len(self.horizontal) - 1),
            np.minimum(r + 1, len(self.vertical) - 1),
        )
        below = self.candela[r, c] * (1.0 - u) + self.candela[r, last_c] * u
        above = self.candela[last_r, c] * (1.0 - u) + self.candela[last_r, last_c] * u
        return np.where(in_columns & in_rows, below * (1.0 - v) + above * v, 0.0)

    def illuminance(self, position: tuple[float, float, float], points: Array) -> Array:
        """In lx at points (n, 3), on planes that face the lamp: (n,)."""
        offset = np.asarray(points, np.float64) - position
        found: Array = self.intensity(offset) / np.sum(offset * offset, axis=-1)
        return found

    def scaled(self, peak: float) -> Headlamp:
        """The same distribution with another largest intensity."""
        return Headlamp(self.horizontal, self.vertical, self.candela * (peak / self.candela.max()))


def _between(angles: Array, wanted: Array) -> tuple[Array, NDArray[np.bool_]]:
    place = np.interp(wanted, angles, np.arange(len(angles)))
    rounding = 1e-9
    return place, (wanted >= angles[0] - rounding) & (wanted <= angles[-1] + rounding)


def dipped() -> Headlamp:
    """A dipped beam in round numbers of ours, no measured lamp: 20000 cd just below the horizon, a little above it."""
    vertical = np.array([-15.0, -6.0, -3.0, -1.5, -0.8, -0.3, 0.0, 0.5, 2.0, 5.0, 12.0])
    ahead = np.array([300.0, 3000.0, 8000.0, 16000.0, 20000.0, 6000.0, 1000.0, 500.0, 400.0, 200.0, 0.0])
    horizontal = np.array([-45.0, -25.0, -12.0, -6.0, 0.0, 6.0, 12.0, 25.0, 45.0])
    share = np.array([0.0, 0.15, 0.4, 0.8, 1.0, 0.9, 0.5, 0.15, 0.0])
    return Headlamp(horizontal, vertical, ahead[:, None] * share)


def find_headlamp(text: str) -> Headlamp:
    """Return the dipped beam with another largest intensity in cd, or a table that a .csv file has.

    The file has a row for each direction, and columns named as COLUMNS; the directions make a grid.

    Raises:
        MrmError: no number above 0 and no such table; says where.
    """
    try:
        peak = float(text)
    except ValueError:
        return _read(Path(text))
    if not (math.isfinite(peak) and 0.0 < peak <= BRIGHTEST):
        raise MrmError(f"headlamp {text}: the largest intensity is above 0 and at most {BRIGHTEST:g} cd")
    return dipped().scaled(peak)


def _read(path: Path) -> Headlamp:
    try:
        text = read_bytes(path).decode("utf-8-sig")
    except OSError as error:
        raise MrmError(
            f"headlamp {path}: cannot be read: {error.strerror}; write a number of cd, or a .csv file"
        ) from None
    except UnicodeDecodeError:
        raise MrmError(f"headlamp {path}: is no text in UTF-8") from None
    rows = csv.DictReader(io.StringIO(text))
    try:
        found = _directions(rows, path)
    except csv.Error as error:
        raise MrmError(f"headlamp {path}: line {rows.line_num + 1}: {error}") from None
    horizontal, vertical = (np.array(sorted({each[axis] for each in found})) for axis in (0, 1))
    if len(horizontal) < 2 or len(vertical) < 2 or len(found) != len(horizontal) * len(vertical):
        raise MrmError(f"headlamp {path}: the directions make no grid of two by two or more")
    candela_grid = np.array([[found[x, y] for x in horizontal] for y in vertical])
    if not candela_grid.max() > 0.0:
        raise MrmError(f"headlamp {path}: gives no light")
    return Headlamp(horizontal, vertical, candela_grid)


def _directions(rows: csv.DictReader[str], path: Path) -> dict[tuple[float, float], float]:
    """The intensity by horizontal and vertical angle."""
    names = [name.strip().casefold() for name in rows.fieldnames or ()]
    if any(column not in names for column in COLUMNS):
        raise MrmError(f"headlamp {path}: the first line names the columns {', '.join(COLUMNS)}")
    rows.fieldnames = names
    found: dict[tuple[float, float], float] = {}
    for row in rows:
        try:
            across, upwards, candela = (float(row[column]) for column in COLUMNS)
        except (TypeError, ValueError):
            raise MrmError(f"headlamp {path}: line {rows.line_num}: three numbers are wanted") from None
        if not (abs(across) <= 180.0 and abs(upwards) <= 90.0 and 0.0 <= candela <= BRIGHTEST):
            raise MrmError(
                f"headlamp {path}: line {rows.line_num}: angles are in degrees, intensities from 0 to "
                f"{BRIGHTEST:g} cd"
            )
        if (across, upwards) in found:
            raise MrmError(f"headlamp {path}: line {rows.line_num}: this direction is there already")
        found[across, upwards] = candela
    return found
