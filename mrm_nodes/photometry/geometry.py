"""Where source and receiver stand about a sheet: the goniometer of the CIE, and a driver's eyes above a road.

Angles are in degrees, as all tables of retroreflection have them; directions are unit vectors away from the
sheet, in its own frame: the normal is +z, the datum mark +x.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError

Array = NDArray[np.float64]

ROAD_OBSERVATION, ROAD_ENTRANCE, ROAD_ELEVATION = 1.05, 88.76, 2.29
"""The 30 m geometry of ASTM E1710 and EN 1436: observation, beta1, and the eye's angle above the road.

A driver looks 30 m ahead, the lamp 0.65 m and the eye 1.2 m above the road. The eye is on the side of the road's
normal: beta1 is positive. At -88.76 it would be below the lamp, and a rough retroreflector two and a half times as
bright.
"""


_LEAST_COSINE = 1e-12
"""What float64 makes of the cosine of 90° is below it."""


def directions(
    observation: ArrayLike, beta1: ArrayLike, beta2: ArrayLike = 0.0, rotation: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Directions v to the receiver and l to the source, each (..., 3), of a goniometer's angles.

    The source stands at +z of the laboratory, the receiver at (0, sin, cos) of the observation angle. The sheet is
    turned by Rx(-beta1) Ry(beta2) Rz(rotation): the cosine of the entrance angle is cos(beta1) cos(beta2), and a
    positive beta1 has the normal on the receiver's side. Source: CIE 54 and ASTM E808, whose signs of beta2 and
    rotation could not be confirmed; a lobe that is the same all around does not know them.

    Args:
        observation: angle between receiver and source, in degrees: (...).
        beta1: first component of the entrance angle, in degrees: (...).
        beta2: second component, in degrees: (...).
        rotation: of the sheet about its normal, in degrees: (...).

    Raises:
        MrmError: an angle that is no number, or at which source or receiver does not see the front of the sheet.
    """
    v, l = around(observation, 0.0, beta1, beta2, rotation)  # noqa: E741  the field's own name
    hidden = ~((v[..., 2] > _LEAST_COSINE) & (l[..., 2] > _LEAST_COSINE))
    if hidden.any():
        alpha, first, second = (
            float(np.broadcast_to(angle, hidden.shape)[hidden][0]) for angle in (observation, beta1, beta2)
        )
        who = "receiver" if l[hidden][0, 2] > _LEAST_COSINE else "source"
        raise MrmError(
            f"observation {alpha:g}°, entrance {first:g}°, {second:g}°: the {who} does not see the front of the "
            "sheet, from which it has to be less than 90° away"
        )
    return v, l


def around(
    observation: ArrayLike,
    azimuth: ArrayLike,
    beta1: ArrayLike,
    beta2: ArrayLike = 0.0,
    rotation: ArrayLike = 0.0,
) -> tuple[Array, Array]:
    """As `directions`, the receiver turned about the source by an azimuth in degrees; both may be behind the sheet."""
    names = ("observation", "azimuth", "beta1", "beta2", "rotation")
    given = (observation, azimuth, beta1, beta2, rotation)
    alpha, phi, b1, b2, epsilon = np.broadcast_arrays(*map(_radians, names, given))
    source = np.stack([np.zeros_like(alpha), np.zeros_like(alpha), np.ones_like(alpha)], axis=-1)
    ring = np.sin(alpha)
    receiver = np.stack([ring * np.sin(phi), ring * np.cos(phi), np.cos(alpha)], axis=-1)
    # What turns the sheet, transposed, takes a direction of the laboratory into its frame.
    v, l = (_turned(_turned(_turned(w, b1, 1, 2), b2, 0, 2), epsilon, 1, 0) for w in (receiver, source))  # noqa: E741
    return v, l


def _radians(name: str, angle: ArrayLike) -> Array:
    degrees = np.asarray(angle, np.float64)
    wrong = ~(np.abs(degrees) <= 360.0)
    if wrong.any():
        raise MrmError(f"{name} is an angle of at most 360 degrees, not {degrees[wrong].flat[0]:g}")
    return np.radians(degrees)


def _turned(w: Array, angle: Array, first: int, second: int) -> Array:
    """Vectors (..., 3) turned in the plane of two axes, the first one towards the second."""
    turned = w.copy()
    turned[..., first] = np.cos(angle) * w[..., first] - np.sin(angle) * w[..., second]
    turned[..., second] = np.sin(angle) * w[..., first] + np.cos(angle) * w[..., second]
    return turned
