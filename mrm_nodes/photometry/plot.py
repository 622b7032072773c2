"""R_A against the observation and the entrance angle, with the minima of a class as steps."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.files import write_bytes
from mrm_nodes.photometry.classes import Requirement, RetroClass
from mrm_nodes.photometry.coefficients import retroreflection
from mrm_nodes.photometry.colour import luminance
from mrm_nodes.plotfile import check_plot, figure_bytes
from mrm_nodes.reference.polar import Scatterer

Array = NDArray[np.float64]

_COLOURS = ("#2b5fb3", "#d9822b", "#2a8a3a", "#c0392b")
_OBSERVATIONS, _ENTRANCES = (0.2, 0.3333, 1.0, 2.0), (5.0, 30.0, 40.0)
"""Degrees that are drawn where no class has others."""
_MOST_OBSERVATION, _MOST_ENTRANCE = 3.0, 60.0


def write_plot(
    path: Path,
    bsdf: Scatterer,
    title: str,
    retro_class: RetroClass | None = None,
    asked: tuple[Requirement, ...] = (),
) -> None:
    """Draw R_A of a BSDF, of several points the mean, in luminance under illuminant A.

    asked: of the class, in R_A; what is not in R_A is not drawn.

    Raises:
        MrmError: as `check_plot`; the file cannot be written.
    """
    check_plot(path)
    from matplotlib.figure import Figure

    sheets = tuple(each for each in asked if each.quantity == "R_A")
    observations = sorted({each.observation or 0.0 for each in sheets}) or list(_OBSERVATIONS)
    entrances = sorted({each.beta1 or 0.0 for each in sheets}, key=abs) or list(_ENTRANCES)
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    _panel(left, "observation", "entrance", observations, entrances, bsdf, sheets)
    _panel(right, "entrance", "observation", observations, entrances, bsdf, sheets)
    left.set_ylabel("R_A (cd/(lx m²)), illuminant A")
    figure.suptitle(
        title if retro_class is None else f"{title}; steps: minima of {retro_class.name}", fontsize=11
    )
    write_bytes(path, figure_bytes(figure, path))


def _panel(
    axis: Any,
    along: str,
    other: str,
    observations: list[float],
    entrances: list[float],
    bsdf: Scatterer,
    sheets: tuple[Requirement, ...],
) -> None:
    """R_A along one angle, a curve for each value of the other."""
    if along == "observation":
        least = 0.5 * observations[0]
        x, fixed = np.geomspace(least, max(_MOST_OBSERVATION, observations[-1]), 241), entrances
        axis.set_xscale("log")
        ticks = sorted({*observations, _MOST_OBSERVATION})
        axis.set_xticks(ticks, [f"{each:.2g}" for each in ticks])
        axis.minorticks_off()
    else:
        x, fixed = np.linspace(0.0, _MOST_ENTRANCE, 241), observations
    for each, colour in zip(fixed, _COLOURS * 2, strict=False):
        angles = (x, np.full(x.shape, each)) if along == "observation" else (np.full(x.shape, each), x)
        y = luminance(retroreflection(bsdf, angles[0][:, None], angles[1][:, None])).mean(axis=-1)
        axis.plot(x, np.where(y > 0.0, y, np.nan), color=colour, lw=1.6, label=f"{other} {each:.3g}°")
        minima = sorted(
            (abs(b) if along == "entrance" else a, asked.minimum)
            for asked in sheets
            for a, b in [(asked.observation or 0.0, asked.beta1 or 0.0)]
            if (b if along == "observation" else a) == each
        )
        if minima:
            # A minimum holds up to its angle, from that of the one before.
            edges = [x[0], *(angle for angle, _ in minima)]
            axis.stairs([value for _, value in minima], edges, color=colour, ls="--", lw=1.1, baseline=None)
            axis.plot(*zip(*minima, strict=True), "v", color=colour, ms=5)
    axis.set_yscale("log")
    axis.set_xlabel(f"{along} angle (degrees)")
    axis.grid(alpha=0.25)
    axis.legend(fontsize=9)
