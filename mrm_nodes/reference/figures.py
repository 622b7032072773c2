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
from .compiled import Array
from .diffuse import eon, lambert
from .distributions import GGX, Beckmann, BeckmannRational
from .energy import average_albedo

GREEN, BLUE, ORANGE, RED, GREY = "#2a8a3a", "#2b5fb3", "#d9822b", "#c0392b", "#777777"


@dataclass(frozen=True)
class Curve:
    """One line: a name, its abscissae and ordinates, and how it is drawn."""

    label: str
    x: Array
    y: Array
    colour: str = GREY
    dashed: bool = False


@dataclass(frozen=True)
class Panel:
    """One pair of axes."""

    title: str
    curves: Sequence[Curve]
    x_label: str
    y_label: str
    logarithmic: bool = False


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
            for roughness, dashed in ((0.1, True), (0.666, False)):
                lobes = {
                    "MRM": GeneralizedSchlick(1.0, alpha=roughness**2, retroreflectivity=1.0),
                    "GGX": GeneralizedSchlick(1.0, alpha=roughness**2),
                }
                for (name, lobe), colour in zip(lobes.items(), (GREEN, BLUE), strict=True):
                    y = lobe.eval(view, light)[:, 0]
                    curves.append(Curve(f"{name}, roughness {roughness}", degrees, y, colour, dashed))
                y = eon(1.0, roughness, view, light)[:, 0]
                curves.append(Curve(f"EON, roughness {roughness}", degrees, y, ORANGE, dashed))
            curves.append(Curve("Lambert", degrees, lambert(1.0, view, light)[:, 0], RED))
            title = f"θi = {theta_i:g}°, φ = {phi:g}°"
            panels.append(Panel(title, curves, "θo (degrees)", "f (1/sr)", logarithmic=True))
    return panels


def lobes() -> list[Panel]:
    """Forward, retro and half-half lobes in the plane of incidence, for three view angles."""
    degrees = np.linspace(-89.9, 89.9, 1200)
    light = direction(np.radians(degrees))
    panels = []
    for theta in (10.0, 45.0, 75.0):
        view = direction(math.radians(theta))
        curves = []
        for share, colour in ((0.0, BLUE), (0.5, ORANGE), (1.0, GREEN)):
            lobe = GeneralizedSchlick(1.0, alpha=0.2, retroreflectivity=share)
            y = lobe.eval(view, light)[:, 0] * light[:, 2]
            curves.append(Curve(f"retroreflectivity {share:g}", degrees, y, colour))
        panels.append(Panel(f"θv = {theta:g}°, alpha 0.2", curves, "θl (degrees)", "f cos θl (1/sr)"))
    return panels


def albedo() -> list[Panel]:
    """White albedo over the view angle, bare and compensated, and its average over alpha."""
    degrees = np.linspace(0.0, 89.0, 90)
    view = direction(np.radians(degrees))
    panels = []
    for alpha in (0.2, 0.6, 1.0):
        curves = []
        for (distribution, masking), colour in zip(
            (("ggx", "smith"), ("beckmann", "smith"), ("ggx", "vcavity")), (BLUE, GREEN, ORANGE), strict=True
        ):
            for scheme in (None, "turquin", "materialx-1.39.5"):
                lobe = GeneralizedSchlick(
                    1.0, alpha=alpha, distribution=distribution, masking=masking, energy_compensation=scheme
                )
                label = f"{distribution}, {masking}" + (f", {scheme}" if scheme else "")
                curves.append(Curve(label, degrees, lobe.albedo(view)[:, 0], colour, scheme is not None))
        panels.append(Panel(f"white albedo, alpha {alpha:g}", curves, "θv (degrees)", "albedo"))
    widths = np.linspace(0.01, 1.0, 100)
    pairs = (
        ("ggx", "smith"),
        ("beckmann", "smith"),
        ("ggx", "vcavity"),
        ("beckmann", "vcavity"),
        ("phong", "vcavity"),
    )
    curves = [
        Curve(f"{d}, {m}", widths, average_albedo(widths, d, m), colour)
        for (d, m), colour in zip(pairs, (BLUE, GREEN, ORANGE, RED, GREY), strict=True)
    ]
    return [*panels, Panel("average white albedo", curves, "alpha", "albedo")]


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
    names = ("smith", "vcavity", "implicit", "schlick-smith", "kelemen")
    panels = []
    for alpha in (0.3, 1.0):
        curves = [
            Curve(name, degrees, _furnace(name, alpha, np.radians(degrees)), colour)
            for name, colour in zip(names, (BLUE, GREEN, ORANGE, RED, GREY), strict=True)
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
        Curve("Smith, rational fit", degrees, BeckmannRational(1.0).G1(v, up), BLUE, True),
        Curve("Schlick-Smith", degrees, g / (1.0 + g), RED),
        Curve("Schlick-Smith, rational fit", degrees, Beckmann(1.0).G1(v, up, "schlick-smith"), RED, True),
    ]
    return [Panel("masking, alpha 1", curves, "θo (degrees)", "G1")]


FIGURES: dict[str, Callable[[], list[Panel]]] = {
    "mrm_figure_2": figure_2,
    "lobes": lobes,
    "albedo": albedo,
    "furnace": furnace,
    "heitz_figure_12": heitz_figure_12,
}


def heitz_table_3() -> list[tuple[str, float, bool]]:
    """Masking function, largest deviation of its furnace from 1, and whether it is physical (Heitz Table
    3).
    """
    theta = np.radians([10.0, 30.0, 50.0, 70.0])
    rows = []
    for name in ("smith", "vcavity", "implicit", "schlick-smith", "kelemen"):
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
    columns = min(len(panels), 2)
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(6.4 * columns, 4.2 * rows), squeeze=False)
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, panel in zip(axes.flat, panels, strict=False):
        for curve in panel.curves:
            y = np.where(curve.y > 0.0, curve.y, np.nan) if panel.logarithmic else curve.y
            axis.plot(
                curve.x, y, label=curve.label, color=curve.colour, ls="--" if curve.dashed else "-", lw=1.2
            )
        axis.set(title=panel.title, xlabel=panel.x_label, ylabel=panel.y_label)
        if panel.logarithmic:
            axis.set_yscale("log")
            axis.set_ylim(bottom=1e-4)
        axis.grid(alpha=0.25)
    axes.flat[0].legend(fontsize=7)
    figure.tight_layout()
    written = [directory / f"{name}.png", directory / f"{name}.svg"]
    for path in written:
        figure.savefig(path, dpi=150)
    plt.close(figure)
    return written


def write_figures(directory: str | Path) -> list[Path]:
    """Draw every figure into `directory` as PNG, SVG and CSV, and Table 3 as CSV; returns the paths.

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
    table = target / "heitz_table_3.csv"
    with table.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["masking", "largest deviation of the furnace from 1", "physical"])
        writer.writerows((name, f"{worst:.6g}", physical) for name, worst, physical in heitz_table_3())
    return [*written, table]
