"""A material of each class: the layered retroreflector whose values are nowhere below the class's, and little above."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.photometry.classes import ANY, UNITS, Requirement, RetroClass, Row, check, find_class, values
from mrm_nodes.photometry.colour import luminance
from mrm_nodes.photometry.retroreflector import ClearTop, Retroreflector

Array = NDArray[np.float64]
Colour = tuple[float, float, float]

COLOURS: dict[str, tuple[Colour, Colour]] = {
    "white": ((0.45, 0.45, 0.45), (1.0, 1.0, 1.0)),
    "yellow": ((0.45, 0.25, 0.008), (1.0, 0.50, 0.015)),
    "orange": ((0.45, 0.10, 0.005), (1.0, 0.20, 0.004)),
    "red": ((0.24, 0.012, 0.012), (1.0, 0.025, 0.004)),
    "green": ((0.006, 0.09, 0.045), (0.02, 1.0, 0.35)),
    "blue": ((0.006, 0.025, 0.13), (0.03, 0.18, 1.0)),
    "brown": ((0.07, 0.028, 0.012), (1.0, 0.30, 0.08)),
    "grey": ((0.20, 0.20, 0.20), (1.0, 1.0, 1.0)),
}
"""Linear Rec.709 of the film by day, and of what comes back by night up to a factor: colours of ours, no class's."""

_TOP = ClearTop(alpha=0.02, f0=0.04)
_PAINT_ALPHA = 0.3
"""One value of R_L says nothing of a lobe's width: that of glass beads in paint."""
_PAINT_F0 = 0.04
_SLACK = 1e-6
"""What a document's digits may take away."""


@dataclass(frozen=True)
class Design:
    """A retroreflector made for a class, and what it has in each of its geometries."""

    retro_class: RetroClass
    """What it was made for."""
    colour: str
    """The name of its colour in the class."""
    margin: float
    """By which share of each minimum its values are above it, at least."""
    bsdf: Retroreflector
    """What has `eval(v, l)`, f in 1/sr."""
    rows: list[Row]
    """What it has in each geometry."""

    @property
    def rms(self) -> float:
        """How far it is above the minima: the root of the mean square of ln(value / minimum)."""
        return math.sqrt(float(np.mean([math.log(1.0 + row.margin) ** 2 for row in self.rows])))

    @property
    def worst(self) -> Row:
        """Where it is the furthest above the minimum."""
        return max(self.rows, key=lambda row: row.margin)


def material_for(name: str, colour: str | None = None, margin: float = 0.0) -> Design:
    """The material of a class: no value below its minimum or above its maximum, and the smallest excess.

    A sheet has three numbers to be chosen (the lobe's width, its reflectance, and how fast that falls with the
    entrance angle) for up to sixteen minima, which no sheet has all at once: what is left over is a part of the
    answer. Of a road's paint the reflectance or the film's colour is chosen. The excess is the root of the mean
    square of ln(value / minimum).

    Args:
        name: of the class.
        colour: where the class has several.
        margin: by which share of each minimum the values are above it, 0 to 10.

    Raises:
        MrmError: no such class, colour, or margin; no such sheet, as with a margin that is above what a class allows.
    """
    if not (math.isfinite(margin) and 0.0 <= margin <= 10.0):
        raise MrmError(f"margin {margin:g}: a share of each minimum from 0 to 10, such as 0.1")
    found = find_class(name)
    asked = found.of(colour)
    named = found.resolve(colour)
    if named == ANY:
        named = "white"
    film, back = COLOURS[named]
    if asked[0].quantity == "R_A":
        bsdf = _sheet(asked, np.array(back) / luminance(back), film, margin)
    else:
        bsdf = _paint(asked[0], np.array(film), margin)
    design = Design(found, named, margin, bsdf, check(bsdf, name, colour))
    if not all(row.passes and row.margin >= margin for row in design.rows):
        raise MrmError(
            f"no retroreflector of this kind is {found.name}, {named}, with a margin of {margin:g}"
        )
    return design


def _sheet(asked: tuple[Requirement, ...], back: Array, film: Colour, margin: float) -> Retroreflector:
    """The sheet of the smallest excess. back: its return's colour, of luminance 1."""
    from scipy.optimize import minimize

    goal = np.log([each.minimum * (1.0 + margin) for each in asked])
    most = np.log([each.maximum or np.inf for each in asked])
    largest = 1.0 / back.max()

    def made(x: Array) -> Retroreflector:
        alpha, f0, falloff = np.exp(x[0]), np.exp(x[1]), x[2]
        return Retroreflector(alpha, f0 * back, falloff=falloff, film=film, top=_TOP)

    def excess(x: Array) -> Array:
        result: Array = np.log(values(made(x), asked)[:, 0]) - goal
        return result

    def room(x: Array) -> Array:
        above = excess(x)
        return np.concatenate([above, (most - goal - above)[np.isfinite(most)]])

    bounds = [(math.log(5e-4), math.log(0.3)), (math.log(1e-6), math.log(largest)), (0.0, 20.0)]
    tries = []
    for alpha in (0.005, 0.01):
        f0 = 4.0 * math.pi * alpha**2 * math.exp(goal.max())
        start = np.array([math.log(alpha), math.log(min(1.5 * f0, largest)), 4.0])
        tried = minimize(
            lambda x: float(np.sum(excess(x) ** 2)),
            start,
            method="SLSQP",
            bounds=bounds,
            constraints={"type": "ineq", "fun": room},
            options={"maxiter": 200, "ftol": 1e-10},
        )
        tries.append(tried)
    best = min(tries, key=lambda tried: (room(tried.x).min() <= -1e-4, tried.fun))
    x = np.array([math.log(_rounded(math.exp(best.x[0]))), best.x[1], round(best.x[2], 3)])
    for _ in range(4):
        x[1] -= excess(x).min() - _SLACK
    return made(x)


def _paint(asked: Requirement, film: Array, margin: float) -> Retroreflector:
    """The paint that has exactly what is asked: by its beads in the lamps' light, by its film in the sky's."""
    goal = asked.minimum * (1.0 + margin)

    def made(x: float) -> Retroreflector:
        if asked.quantity == "R_L":
            return Retroreflector(_PAINT_ALPHA, x, film=film.tolist())
        return Retroreflector(_PAINT_ALPHA, _PAINT_F0, film=(film / film.max() * x).tolist())

    x, below = 0.1, 0.0
    while abs(below - 1.0) > _SLACK:
        below = float(values(made(x), [asked])[0, 0]) / (goal * (1.0 + _SLACK))
        x /= below
        if x > 1.0:
            raise MrmError(f"no paint of this kind has {goal:g} {UNITS[asked.quantity]}")
    return made(x)


def _rounded(value: float) -> float:
    """To four digits."""
    return float(f"{value:.4g}")
