"""Curves of measured and modelled scattering in the plane of incidence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mrm_nodes.measured.angles import Array, directions

if TYPE_CHECKING:
    from mrm_nodes.measured.measurement import Measurement

COLOURS = ("#2a8a3a", "#2b5fb3", "#d9822b", "#c0392b")
PLANE = np.radians(1.5)
"""How far from the plane of incidence a sample may lie to be drawn."""
LIGHTS = (15.0, 30.0, 60.0)
"""Degrees of the light that are drawn where samples do not share a few."""


def in_plane(measurement: Measurement, light: float) -> tuple[Array, Array]:
    """Signed degrees of the viewer, positive on the light's side, and the channels' mean, of samples in the plane."""
    shared = measurement.light_angles()
    near = measurement.at_light(light) if shared else np.abs(np.degrees(measurement.theta_l) - light) < 1.0
    some = measurement.where(near) if near.any() else None
    if some is None:
        return np.zeros(0), np.zeros(0)
    azimuth = np.arctan2(some.v[:, 1], some.v[:, 0]) - np.arctan2(some.l[:, 1], some.l[:, 0])
    across = np.arcsin(np.clip(np.sin(some.theta_v) * np.sin(azimuth), -1.0, 1.0))
    mask = np.abs(across) < PLANE
    angle = np.degrees(some.theta_v * np.sign(np.cos(azimuth)))[mask]
    order = np.argsort(angle)
    return angle[order], some.value.mean(axis=1)[mask][order]


def pyplot() -> Any:
    """Matplotlib without a window.

    Raises:
        ImportError: it is missing; the message says what to install.
    """
    try:
        import matplotlib
    except ImportError as error:
        raise ImportError("a plot needs Matplotlib: pip install matplotlib") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def draw_lobes(
    measurement: Measurement, bsdfs: Sequence[tuple[str, Any]] = (), angles: Sequence[float] = ()
) -> Any:
    """A figure with a panel for each angle of the light: dots are samples, lines models."""
    plt = pyplot()
    lights = list(angles) or measurement.light_angles() or list(LIGHTS)
    figure, axes = plt.subplots(
        1, len(lights), figsize=(4.2 * len(lights), 4.0), squeeze=False, sharey=True, layout="constrained"
    )
    for axis, light in zip(axes.flat, lights, strict=True):
        x, y = in_plane(measurement, light)
        axis.plot(x, np.where(y > 0.0, y, np.nan), ".", color="black", ms=4, label="measured")
        degrees = np.linspace(-85.0, 85.0, 1701)
        view, lit = directions(np.radians(degrees), 0.0), directions(np.radians(light), 0.0)
        for (name, bsdf), colour in zip(bsdfs, COLOURS, strict=False):
            axis.plot(degrees, bsdf.eval(view, lit).mean(axis=-1), color=colour, lw=1.4, label=name)
        axis.set(title=f"light at {light:g}°", xlabel="viewer (degrees, + is the light's side)", yscale="log")
        axis.set_xticks(range(-90, 91, 30))
        axis.grid(alpha=0.25)
    axes[0, 0].set_ylabel("f (1/sr)")
    low = float(np.percentile(measurement.value[measurement.value > 0.0], 1.0))
    axes[0, 0].set_ylim(bottom=0.3 * low)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(4, len(labels)), fontsize=9)
    return figure
