"""A polar plot of what scatters, for notebooks: f |l.n| in the plane of incidence, each view to its own peak."""

from __future__ import annotations

import io
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VIEWS = (0.0, 30.0, 60.0)
"""Degrees of the views from the normal."""


class Scatterer(Protocol):
    """What has a value for each pair of directions: enough to be plotted, or measured as a retroreflector."""

    def eval(self, v: Any, l: Any) -> Any:  # noqa: E741
        """f(v, l) in 1/sr, without the cosine."""


def profile(bsdf: Scatterer, degrees: float) -> tuple[Array, Array]:
    """Angles of l from the normal in radians (n,), positive on the view's side, and f |l.n| (n,) for a view.

    They are dense about the mirrored and the retroreflected direction, where lobes of 0.01 degrees have room. A lobe
    of colours gives their mean.

    Raises:
        ValueError: parameters that do not broadcast with n directions: it is more than one lobe.
    """
    angle = np.radians(degrees)
    near = np.concatenate([[0.0], np.geomspace(1e-5, np.pi, 400)])
    offsets = np.concatenate([-near[:0:-1], near])
    whole = np.linspace(-np.pi, np.pi, 721)
    angles = np.unique(np.concatenate([whole, angle + offsets, -angle + offsets]))
    angles = angles[np.abs(angles) <= np.pi]
    v = np.array([np.sin(angle), 0.0, np.cos(angle)])
    l = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)  # noqa: E741
    f = np.asarray(bsdf.eval(v, l), np.float64)
    if f.shape != (len(angles), 3):
        raise ValueError(f"values of shape {f.shape}: more than one lobe")
    return angles, f.mean(axis=-1) * np.abs(np.cos(angles))


def polar_png(bsdf: Scatterer) -> bytes | None:
    """The bytes of a PNG; None where it is more than one lobe, or Matplotlib is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return None
    figure = Figure(figsize=(4.2, 4.2))
    axes: Any = figure.add_subplot(projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    for degrees in VIEWS:
        try:
            angles, values = profile(bsdf, degrees)
        except ValueError:
            return None
        peak = values.max()
        label = f"{degrees:g}°: up to {peak:.3g} /sr"
        (line,) = axes.plot(angles, values / peak if peak > 0.0 else values, label=label)
        axes.plot([np.radians(degrees)] * 2, [1.0, 1.12], color=line.get_color(), linestyle=":")
    axes.set_rticks([0.5, 1.0])
    axes.set_ylim(0.0, 1.12)
    axes.set_title(type(bsdf).__name__)
    axes.legend(title="f |l·n|, view at", loc="lower center", bbox_to_anchor=(0.5, -0.32), fontsize="small")
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=90, bbox_inches="tight", metadata={"Software": None})
    return file.getvalue()
