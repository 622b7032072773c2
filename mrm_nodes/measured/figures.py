"""001's Figure 4 again: the tape's f, the paper's parameters, our fit, and what dividing by the wrong cosine does."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from mrm_nodes import reference as ref
from mrm_nodes.errors import MrmError
from mrm_nodes.files import write_together
from mrm_nodes.measured.angles import Array, directions
from mrm_nodes.measured.fitting import Fit, fit
from mrm_nodes.measured.measurement import Measurement
from mrm_nodes.measured.plots import COLOURS, in_plane, pyplot
from mrm_nodes.measured.reciprocity import exchanged
from mrm_nodes.plotfile import figure_bytes

PAPER = ref.GeneralizedSchlick(0.19, color82=0.0, color90=1.0, alpha=0.23**2, retroreflectivity=1.0)
"""001, Section 5: roughness 0.23, F0 = 0.19, F82 = 0; no other layer is named."""
NAME = "mrm_figure_4"


def pairs(measurement: Measurement) -> tuple[Array, Array]:
    """f(v, l) and f(l, v), each (p), of the pairs of directions that a measurement has both of."""
    value = measurement.value.mean(axis=1)
    found, other = exchanged(measurement.v, measurement.l)
    slanted = measurement.v[found, 2] < measurement.l[found, 2] - 0.05
    return value[found[slanted]], value[other[slanted]]


def write_figure_4(measurement: Measurement, directory: Path) -> list[Path]:
    """Draw the figure as PNG and SVG, with its curves as CSV; returns the paths.

    Above: f against the viewer's angle, a panel a light. Below: each pair of samples whose directions are exchanged,
    one over the other, once for the values divided by cos θ_v and once by cos θ_l.

    Raises:
        ImportError: Matplotlib is missing.
        MrmError: the measurement has several channels, or too few samples; a file cannot be written.
    """
    if len(measurement.channels) != 1:
        raise MrmError("Figure 4 shows one channel: name a file that has one")
    plt = pyplot()
    found = fit(measurement, "layered")
    lights = measurement.light_angles()[:3]
    if not lights:
        raise MrmError("Figure 4 needs samples that share a few angles of the light")
    figure = plt.figure(figsize=(4.2 * len(lights), 8.2), layout="constrained")
    above, below = figure.subfigures(2, 1, height_ratios=(1.0, 0.85))
    rows = _curves(above, measurement, found, lights)
    _reciprocity(below, measurement)
    written = [directory / f"{NAME}.png", directory / f"{NAME}.svg", directory / f"{NAME}.csv"]
    files = {path: figure_bytes(figure, path) for path in written[:2]}
    plt.close(figure)
    table = io.StringIO()
    csv.writer(table).writerows([("panel", "curve", "x", "y"), *rows])
    write_together({**files, written[2]: table.getvalue().encode()})
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
    not_grazing = (measurement.v[:, 2] > 0.17) & (measurement.l[:, 2] > 0.17)
    for axis, (title, cosine), colour in zip(
        axes,
        {"divided by cos θv": measurement.v[:, 2:], "divided by cos θl": measurement.l[:, 2:]}.items(),
        (COLOURS[1], COLOURS[3]),
        strict=True,
    ):
        f = Measurement(measurement.v, measurement.l, raw / cosine, measurement.channels).where(not_grazing)
        there, back = pairs(f)
        if not len(there):
            raise MrmError("Figure 4 needs samples whose directions are exchanged, and there are none")
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
