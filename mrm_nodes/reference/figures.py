"""Figures: 001's Figure 2, lobe plots, albedo and furnace curves, and Heitz's Figure 12 and Table 3.

Each is drawn as PNG and SVG with its numbers beside it as CSV. Matplotlib is imported when a figure is drawn.
"""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .bsdf import GeneralizedSchlick
from .checks import PAIRS
from .compiled import Array
from .diffuse import eon, lambert
from .distributions import GGX, Beckmann, BeckmannRational
from .energy import average_albedo

GREEN, BLUE, ORANGE, RED, GREY = "#2a8a3a", "#2b5fb3", "#d9822b", "#c0392b", "#777777"
COLOURS = (BLUE, GREEN, ORANGE, RED, GREY)
MASKINGS = ("smith", "vcavity", "implicit", "schlick-smith", "kelemen")


@dataclass(frozen=True)
class Curve:
    """One line: a name, its abscissae and ordinates, and how it is drawn."""

    label: str
    x: Array
    y: Array
    colour: str = GREY
    style: str = "-"


@dataclass(frozen=True)
class Panel:
    """One pair of axes; `polar` takes x as degrees from the normal."""

    title: str
    curves: Sequence[Curve]
    x_label: str
    y_label: str
    logarithmic: bool = False
    polar: bool = False


def direction(theta: Array | float, phi: float = 0.0) -> Array:
    """Unit vectors (..., 3) at polar angles in radians; negative angles lie on the other side of the
    normal.
    """
    angle = np.asarray(theta, np.float64)
    return np.stack([np.sin(angle) * math.cos(phi), np.sin(angle) * math.sin(phi), np.cos(angle)], axis=-1)


def figure_2() -> list[Panel]:
    """001 Figure 2: MRM, GGX with F = 1, EON and Lambert over the view angle, for a fixed light.

    Light at 45° and 80°, azimuth of the view 0° and 45°, perceptual roughness 0.1 (dashed) and 0.666.
    """
    degrees = np.linspace(-89.5, 89.5, 717)
    panels = []
    for theta_i in (45.0, 80.0):
        for phi in (0.0, 45.0):
            light = direction(math.radians(theta_i))
            view = direction(np.radians(degrees), math.radians(phi))
            curves = []
            for roughness, style in ((0.1, "--"), (0.666, "-")):
                lobes = {
                    "MRM": GeneralizedSchlick(1.0, alpha=roughness**2, retroreflectivity=1.0),
                    "GGX": GeneralizedSchlick(1.0, alpha=roughness**2),
                }
                for (name, lobe), colour in zip(lobes.items(), (GREEN, BLUE), strict=True):
                    y = lobe.eval(view, light)[:, 0]
                    curves.append(Curve(f"{name}, roughness {roughness}", degrees, y, colour, style))
                y = eon(1.0, roughness, view, light)[:, 0]
                curves.append(Curve(f"EON, roughness {roughness}", degrees, y, ORANGE, style))
            curves.append(Curve("Lambert", degrees, lambert(1.0, view, light)[:, 0], RED))
            title = f"θi = {theta_i:g}°, φ = {phi:g}°"
            panels.append(Panel(title, curves, "θo (degrees)", "f (1/sr)", logarithmic=True))
    return panels


def lobes() -> list[Panel]:
    """Forward, retro and half-half lobes in the plane of incidence, for three view angles."""
    degrees = np.linspace(-90.0, 90.0, 1201)[1:-1]
    light = direction(np.radians(degrees))
    panels = []
    for theta in (10.0, 45.0, 75.0):
        view = direction(math.radians(theta))
        curves = []
        for share, colour in ((0.0, BLUE), (0.5, ORANGE), (1.0, GREEN)):
            lobe = GeneralizedSchlick(1.0, alpha=0.2, retroreflectivity=share)
            y = lobe.eval(view, light)[:, 0] * light[:, 2]
            curves.append(Curve(f"retroreflectivity {share:g}", degrees, y, colour))
        title = f"f cos θl (1/sr), view at {theta:g}°, alpha 0.2"
        panels.append(Panel(title, curves, "θl (degrees)", "f cos θl (1/sr)", polar=True))
    return panels


def albedo() -> list[Panel]:
    """White albedo over the view angle, bare and compensated."""
    degrees = np.linspace(0.0, 89.0, 90)
    view = direction(np.radians(degrees))
    panels = []
    for alpha in (0.2, 0.6, 1.0):
        curves = []
        for scheme, style in ((None, "-"), ("turquin", ":"), ("materialx-1.39.5", "--")):
            for (distribution, masking), colour in zip(PAIRS[:3], COLOURS, strict=False):
                lobe = GeneralizedSchlick(
                    1.0, alpha=alpha, distribution=distribution, masking=masking, energy_compensation=scheme
                )
                label = f"{distribution}, {masking}" + (f", {scheme}" if scheme else "")
                curves.append(Curve(label, degrees, lobe.albedo(view)[:, 0], colour, style))
        panels.append(Panel(f"white albedo, alpha {alpha:g}", curves, "θv (degrees)", "albedo"))
    return panels


def mean_albedo() -> list[Panel]:
    """The cosine-weighted mean of the white albedo over alpha."""
    widths = np.linspace(0.01, 1.0, 100)
    curves = [
        Curve(f"{d}, {m}", widths, average_albedo(widths, d, m), colour)
        for (d, m), colour in zip(PAIRS, COLOURS, strict=True)
    ]
    return [Panel("average white albedo", curves, "alpha", "albedo")]


def _furnace(masking: str, alpha: float, theta: Array) -> Array:
    """∫ D_v(m) dm of GGX by quadrature over stretched slopes: 1 for a physical masking function (eq. 18)."""
    t, w = np.polynomial.legendre.leggauss(200)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    rho = t / (1.0 - t)
    psi = (np.arange(400) + 0.5) * 2.0 * np.pi / 400
    slope_x, slope_y = alpha * np.outer(rho, np.cos(psi)), alpha * np.outer(rho, np.sin(psi))
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    length = np.linalg.norm(normals, axis=-1)
    normals /= length[..., np.newaxis]
    weight = (w * rho / (1.0 - t) ** 2)[:, np.newaxis] * alpha**2 / length**3 * 2.0 * np.pi / 400
    d = GGX(alpha)
    return np.array([(d.pdf_visible(v, normals, masking) * weight).sum() for v in direction(theta)])


def furnace() -> list[Panel]:
    """The weak white furnace over the view angle for the five masking functions of Heitz's Table 3."""
    degrees = np.linspace(0.0, 85.0, 18)
    panels = []
    for alpha in (0.3, 1.0):
        # Smith and V-cavity are both 1: dashes show the one below the other.
        curves = [
            Curve(
                name,
                degrees,
                _furnace(name, alpha, np.radians(degrees)),
                colour,
                "--" if name == "vcavity" else "-",
            )
            for name, colour in zip(MASKINGS, COLOURS, strict=True)
        ]
        panels.append(Panel(f"weak white furnace, alpha {alpha:g}", curves, "θv (degrees)", "integral"))
    return panels


def heitz_figure_12() -> list[Panel]:
    """Smith's and Schlick's masking and their rational fits at alpha 1, over the view angle (Heitz Figure
    12).
    """
    degrees = np.linspace(0.0, 89.9, 300)
    v = direction(np.radians(degrees))
    up = np.array([0.0, 0.0, 1.0])
    a = v[:, 2] / np.maximum(np.sin(np.radians(degrees)), 1e-12)
    erf = np.vectorize(math.erf)(a)
    # He's formula without its exponential, from which Schlick started (his eq. 18).
    g = a * math.sqrt(math.pi) * (1.0 + erf)
    curves = [
        Curve("Smith", degrees, Beckmann(1.0).G1(v, up), BLUE),
        Curve("Smith, rational fit", degrees, BeckmannRational(1.0).G1(v, up), BLUE, "--"),
        Curve("Schlick-Smith", degrees, g / (1.0 + g), RED),
        Curve("Schlick-Smith, rational fit", degrees, Beckmann(1.0).G1(v, up, "schlick-smith"), RED, "--"),
    ]
    return [Panel("masking, alpha 1", curves, "θo (degrees)", "G1")]


FIGURES: dict[str, Callable[[], list[Panel]]] = {
    "mrm_figure_2": figure_2,
    "lobes": lobes,
    "albedo": albedo,
    "average_albedo": mean_albedo,
    "furnace": furnace,
    "heitz_figure_12": heitz_figure_12,
}


def heitz_table_3() -> list[tuple[str, float, bool]]:
    """Masking function, largest deviation of its furnace from 1, and whether it is physical (Heitz Table
    3).
    """
    theta = np.radians([10.0, 30.0, 50.0, 70.0])
    rows = []
    for name in MASKINGS:
        worst = max(float(np.abs(_furnace(name, alpha, theta) - 1.0).max()) for alpha in (0.3, 1.0))
        rows.append((name, worst, worst < 0.01))
    return rows


def _write_numbers(path: Path, panels: list[Panel]) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["panel", "curve", "x", "y"])
        for panel in panels:
            for curve in panel.curves:
                for x, y in zip(curve.x, curve.y, strict=True):
                    writer.writerow([panel.title, curve.label, f"{x:.10g}", f"{y:.10g}"])


def _draw(plt: Any, panels: list[Panel], directory: Path, name: str) -> list[Path]:
    columns = 2 if len(panels) == 4 else len(panels)
    rows = -(-len(panels) // columns)
    polar, logarithmic = panels[0].polar, panels[0].logarithmic
    size = (4.4 if polar else 5.6) * columns, 4.0 * rows + (0.2 if polar else 0.8)
    figure, axes = plt.subplots(
        rows, columns, figsize=size, squeeze=False, layout="constrained", sharey=logarithmic,
        subplot_kw={"projection": "polar" if polar else None},
    )  # fmt: skip
    for axis, panel in zip(axes.flat, panels, strict=True):
        for curve in panel.curves:
            x = np.radians(curve.x) if panel.polar else curve.x
            y = np.where(curve.y > 0.0, curve.y, np.nan) if panel.logarithmic else curve.y
            axis.plot(x, y, label=curve.label, color=curve.colour, ls=curve.style, lw=1.4)
        axis.set_title(panel.title, fontsize=11, y=0.85 if polar else None)
        if panel.polar:
            axis.set(theta_zero_location="N", theta_direction=-1, thetamin=-90.0, thetamax=90.0)
            axis.set_yticks(axis.get_yticks()[:-1:2])
        else:
            axis.set(xlabel=panel.x_label, ylabel=panel.y_label)
            if panel.curves[0].x[0] < 0.0:
                axis.set_xticks(range(-90, 91, 30))
        if panel.logarithmic:
            axis.set_yscale("log")
        axis.grid(alpha=0.25)
    if logarithmic:
        axes[0, 0].set_ylim(bottom=1e-4)
    # The curves of all panels are the same.
    handles, labels = axes.flat[0].get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="outside lower center", ncols=min(len(labels), 2 * columns), fontsize=9
    )
    return _save(plt, figure, directory, name)


def _draw_table(plt: Any, rows: Sequence[tuple[str, str, str]], directory: Path, name: str) -> list[Path]:
    figure, axis = plt.subplots(figsize=(6.4, 0.34 * len(rows) + 0.2), layout="constrained")
    axis.set_axis_off()
    table = axis.table(
        cellText=rows[1:], colLabels=rows[0], colWidths=(0.25, 0.5, 0.25), cellLoc="left", loc="center"
    )
    table.auto_set_font_size(False)
    table.set_fontsize(10)
    table.scale(1.0, 1.5)
    return _save(plt, figure, directory, name)


def _save(plt: Any, figure: Any, directory: Path, name: str) -> list[Path]:
    written = [directory / f"{name}.png", directory / f"{name}.svg"]
    for path in written:
        figure.savefig(path, dpi=150)
    plt.close(figure)
    return written


def write_figures(directory: str | Path) -> list[Path]:
    """Draw every figure and Table 3 into `directory` as PNG, SVG and CSV; returns the paths.

    `ImportError` that says what to install where Matplotlib is missing.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError("figures need Matplotlib: pip install matplotlib") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    target = Path(directory)
    target.mkdir(parents=True, exist_ok=True)
    written = []
    for name, make in FIGURES.items():
        panels = make()
        written += _draw(plt, panels, target, name)
        _write_numbers(target / f"{name}.csv", panels)
        written.append(target / f"{name}.csv")
    rows = [("masking", "furnace off 1 by at most", "physical")]
    rows += [(name, f"{worst:.2g}", "yes" if physical else "no") for name, worst, physical in heitz_table_3()]
    written += _draw_table(plt, rows, target, "heitz_table_3")
    table = target / "heitz_table_3.csv"
    with table.open("w", newline="") as stream:
        csv.writer(stream).writerows(rows)
    return [*written, table]
