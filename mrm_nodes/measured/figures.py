"""001's Figure 4 again: the tape's f, the paper's parameters, our fit, and what dividing by the wrong cosine does."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from mrm_nodes import reference as ref
from mrm_nodes.errors import MrmError
from mrm_nodes.measured.fitting import Fit, Progress, fit
from mrm_nodes.measured.measurement import Array, Measurement, directions, isotropic
from mrm_nodes.measured.plots import COLOURS, in_plane, pyplot

PAPER = ref.GeneralizedSchlick(0.19, color82=0.0, color90=1.0, alpha=0.23**2, retroreflectivity=1.0)
"""001, Section 5: roughness 0.23, F0 = 0.19, F82 = 0; no other layer is named."""
NAME = "mrm_figure_4"
NEAREST = np.radians(1.6)


def pairs(measurement: Measurement) -> tuple[Array, Array]:
    """f(v, l) and f(l, v), each (p), of the pairs of directions that a measurement has both of."""
    from scipy.spatial import cKDTree

    value = measurement.value.mean(axis=1)
    here, there = (
        isotropic(*each) for each in ((measurement.v, measurement.l), (measurement.l, measurement.v))
    )
    distance, index = cKDTree(here).query(there, distance_upper_bound=NEAREST)
    first = np.flatnonzero(np.isfinite(distance) & (measurement.v[:, 2] < measurement.l[:, 2] - 0.05))
    return value[first], value[index[first]]


def write_figure_4(measurement: Measurement, directory: Path, progress: Progress | None = None) -> list[Path]:
    """Draw the figure as PNG and SVG, with its curves as CSV; returns the paths.

    Above: f against the viewer's angle, a panel a light. Below: each pair of samples whose directions are exchanged,
    one over the other, once for the values divided by cos θ_v and once by cos θ_l.

    Raises:
        ImportError: Matplotlib is missing.
        MrmError: the measurement has several channels, or too few samples.
    """
    if len(measurement.channels) != 1:
        raise MrmError("Figure 4 shows one channel: name a file that has one")
    plt = pyplot()
    found = fit(measurement, "layered", progress=progress)
    lights = measurement.light_angles()[:3]
    if not lights:
        raise MrmError("Figure 4 needs samples that share a few angles of the light")
    figure = plt.figure(figsize=(4.2 * len(lights), 8.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 0.85))
    rows = _curves(above, measurement, found, lights)
    _reciprocity(below, measurement)
    written = [directory / f"{NAME}.png", directory / f"{NAME}.svg", directory / f"{NAME}.csv"]
    for path in written[:2]:
        figure.savefig(path, dpi=150)
    plt.close(figure)
    with written[2].open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["panel", "curve", "x", "y"])
        writer.writerows(rows)
    return written


def _curves(
    figure: object, measurement: Measurement, found: Fit, lights: list[float]
) -> list[tuple[str, ...]]:
    axes = figure.subplots(1, len(lights), sharey=True, squeeze=False)  # type: ignore[attr-defined]
    degrees = np.linspace(-85.0, 85.0, 681)
    view = directions(np.radians(degrees), 0.0)
    rows: list[tuple[str, ...]] = []
    for axis, light in zip(axes.flat, lights, strict=True):
        lit = directions(np.radians(light), 0.0)
        x, y = in_plane(measurement, light)
        axis.plot(x, y, ".", color="black", ms=4, label="measured, divided by cos θv")
        curves = {
            "001's parameters": PAPER.eval(view, lit)[:, 0],
            "our fit, layered": found.bsdf.eval(view, lit)[:, 0],
        }
        for (label, f), colour, style in zip(curves.items(), COLOURS, ("--", "-"), strict=False):
            axis.plot(degrees, np.where(f > 0.0, f, np.nan), color=colour, ls=style, lw=1.5, label=label)
        title = f"light at {light:g}°"
        for label, xs, ys in (("measured", x, y), *((label, degrees, f) for label, f in curves.items())):
            rows += [(title, label, f"{a:.10g}", f"{b:.10g}") for a, b in zip(xs, ys, strict=True)]
        axis.set(title=title, xlabel="viewer (degrees, + is the light's side)", yscale="log")
        axis.set_xticks(range(-90, 91, 30))
        axis.grid(alpha=0.25)
    axes[0, 0].set_ylabel("f (1/sr)")
    axes[0, 0].set_ylim(bottom=1e-3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)  # type: ignore[attr-defined]
    return rows


def _reciprocity(figure: object, measurement: Measurement) -> None:
    axes = figure.subplots(1, 2, sharex=True, sharey=True)  # type: ignore[attr-defined]
    raw = measurement.value * measurement.v[:, 2:]
    grazing = (measurement.v[:, 2] > 0.17) & (measurement.l[:, 2] > 0.17)
    for axis, (title, cosine), colour in zip(
        axes,
        {"divided by cos θv": measurement.v[:, 2:], "divided by cos θl": measurement.l[:, 2:]}.items(),
        (COLOURS[1], COLOURS[3]),
        strict=True,
    ):
        f = Measurement(measurement.v, measurement.l, raw / cosine, measurement.channels).where(grazing)
        there, back = pairs(f)
        ends = np.array([min(there.min(), back.min()), max(there.max(), back.max())])
        axis.plot(ends, ends, color="black", lw=0.8)
        axis.plot(back, there, ".", color=colour, ms=3)
        middle = float(np.median(there / back))
        axis.set(
            title=f"{title}: median ratio {middle:.2f}",
            xlabel="f(l, v), the viewer nearer to the normal (1/sr)",
            xscale="log",
            yscale="log",
        )
        axis.grid(alpha=0.25)
    axes[0].set_ylabel("f(v, l) (1/sr)")
    figure.suptitle("Directions exchanged: a reciprocal material lies on the line", fontsize=11)  # type: ignore[attr-defined]
