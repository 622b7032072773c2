"""What a BSDF's colours are to a photometer: luminances, and the colour by night."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError, unknown

Array = NDArray[np.float64]
Illuminant = Literal["A", "D65"]

ROWS: dict[str, tuple[float, float, float]] = {
    "A": (0.3311, 0.6300, 0.0389),
    "D65": (0.2126, 0.7152, 0.0722),
}
"""Weights of linear Rec.709 red, green and blue in the luminance under an illuminant; each row's sum is 1.

D65's are Rec.709's own. A's are fitted to the ColorChecker and to spectra like those of sheeting: 0.8 % off at most.
Rec.709's row under A would be 17 % off (rms): red 31 % too dark, green 26 % and blue 45 % too bright.
"""

# IEC 61966-2-1, linear Rec.709 to XYZ; the CIE's white points; Bradford's cones (Lam 1985).
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_WHITE_A = np.array([1.09850, 1.0, 0.35585])
_CONES = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def luminance(value: ArrayLike, illuminant: Illuminant = "A") -> Array:
    """The luminous part of a colour: shape (...), in the colour's unit.

    Args:
        value: a BSDF, R_A, R_L or Q_d in linear Rec.709 under D65: (..., 3).
        illuminant: `A` is what sheeting is measured under, a headlamp; `D65` is daylight.

    Raises:
        MrmError: another illuminant.
    """
    if illuminant not in ROWS:
        raise MrmError(unknown("illuminant", illuminant, ROWS))
    result: Array = np.asarray(value, np.float64) @ np.array(ROWS[illuminant])
    return result


def night_chromaticity(value: ArrayLike) -> Array:
    """CIE 1931 x, y under illuminant A of a colour: shape (..., 2).

    value is linear Rec.709 under D65, (..., 3). Bradford's adaptation from D65 to A. Three numbers are no spectrum: for
    yellow, orange and red it is right to 0.006 in x and y, for blue to 0.02, for green to 0.05. NaN for black.
    """
    to_cones = _CONES @ _XYZ
    scale = (_CONES @ _WHITE_A) / to_cones.sum(axis=-1)
    adapted = np.linalg.inv(_CONES) @ (scale[:, None] * to_cones)
    xyz = np.asarray(value, np.float64) @ adapted.T
    with np.errstate(invalid="ignore", divide="ignore"):
        chromaticity: Array = xyz[..., :2] / xyz.sum(axis=-1, keepdims=True)
    return chromaticity
