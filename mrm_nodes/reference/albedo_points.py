"""The directional albedo of a lobe at many points at once, as an image has them.

`Lobe.albedo` takes a millisecond a view, for five digits. An image needs three, and most of its points have a lobe in
common: what differs is the view's cosine, over which albedo is a smooth curve. So it is integrated along one curve for
points that are alike, and point by point where a texture makes each another lobe."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .bsdf import Lobe
from .compiled import Array, run
from .quadrature import quadrature_nodes

#: Largest error of an albedo of at most 1, absolute: that of the fewer nodes, and of the curve.
ALBEDO_ERROR = 3e-3
#: The same where total reflection or transmission begins at an edge, which few nodes see as steps: of an index below
#: 1, from inside, and of V-cavities that transmit.
EDGE_ERROR = 2.5e-2

#: Resolution of the quadrature at a point, and of a curve.
AT_A_POINT, ON_A_CURVE = 48, 64
#: Points of a curve, even in asinh(cosine / alpha): dense where masking changes, and no less so elsewhere.
COSINES = 65
#: A curve is good enough where its every other point alone tells the others to within this.
CURVE_ERROR = 1e-3


def albedo_of_points(lobe: Lobe, v: Array) -> Array:
    """`Lobe.albedo` of n views, within `ALBEDO_ERROR`: shape (n, 3).

    Args:
        lobe: whose parameters are single values, or n.
        v: (n, 3), unit vectors.
    """
    # Forward and retro lobes have the same albedo.
    parameters = lobe._parameters._replace(retroreflectivity=np.zeros(1))
    rows = np.concatenate([np.broadcast_to(each, (len(v), each.shape[-1])) for each in parameters], axis=1)
    splits = np.cumsum([each.shape[-1] for each in parameters])[:-1]
    found = np.empty(v.shape)
    alone = np.ones(len(v), bool)
    is_isotropic = not lobe._is_sheared and bool((rows[:, 0] == rows[:, 1]).all())
    if is_isotropic and len(v) >= COSINES:
        kinds, of_kind = np.unique(rows, axis=0, return_inverse=True)
        if len(kinds) * COSINES <= len(v):
            which = of_kind.ravel().astype(np.intp)
            curves = _curves(lobe, np.split(kinds[:, np.newaxis], splits, axis=-1), kinds[:, :1])
            between = _cubic(
                curves[:, ::2], np.broadcast_to(np.arange(COSINES // 2) + 0.5, (len(kinds), COSINES // 2))
            )
            is_smooth = np.abs(between - curves[:, 1::2]).max(axis=(1, 2)) <= CURVE_ERROR
            alone = ~is_smooth[which] | (v[:, 2] < 0.0)
            along = _place(np.clip(v[:, 2], 0.0, 1.0), kinds[which, 0])
            found = _cubic(curves, along[:, np.newaxis], which)[:, 0]
    if alone.any():
        split = np.split(rows[alone], splits, axis=-1)
        found[alone] = _integrated(lobe, v[alone], split, AT_A_POINT, is_isotropic)
    return found


def _curves(lobe: Lobe, parameters: list[Array], alpha: Array) -> Array:
    """The albedo of k isotropic lobes, whose alphas are (k, 1), at the points of their curves: (k, COSINES, 3)."""
    cosine = np.clip(alpha * np.sinh(np.linspace(0.0, 1.0, COSINES) * np.arcsinh(1.0 / alpha)), 1e-9, 1.0)
    v = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(cosine.shape), cosine], axis=-1)
    return _integrated(lobe, v, parameters, ON_A_CURVE, True)


def _place(cosine: Array, alpha: Array) -> Array:
    """Where on its curve a cosine lies, in points from its start."""
    return np.asarray((COSINES - 1) * np.arcsinh(cosine / alpha) / np.arcsinh(1.0 / alpha))


def _integrated(lobe: Lobe, v: Array, parameters: list[Array], resolution: int, is_isotropic: bool) -> Array:
    nodes = quadrature_nodes(resolution)
    if is_isotropic:
        # The plane of v is a mirror.
        nodes = nodes[nodes[:, 0] < 0.5]
    inputs, modes = [v, np.zeros(3), *parameters], lobe._answering("albedo")
    (albedo,), _ = run(kernels.INTEGRATE, inputs, modes, [3], [lobe._table, nodes])
    return albedo


def _cubic(curves: Array, at: Array, which: NDArray[np.intp] | None = None) -> Array:
    """Values of curves (k, m, 3) between their even points, by the cubic through four of them: (k, j, 3).

    at: (k, j), in points from the start; which: of the curves, one for each row of `at`.
    """
    first = np.clip(at.astype(int) - 1, 0, curves.shape[1] - 4)
    t = (at - first)[..., np.newaxis]
    rows = (np.arange(len(curves)) if which is None else which)[:, np.newaxis]
    a, b, c, d = (curves[rows, first + k] for k in range(4))
    inner = b * t * (t - 2.0) * (t - 3.0) / 2.0 - c * t * (t - 1.0) * (t - 3.0) / 2.0
    outer = d * t * (t - 1.0) * (t - 2.0) / 6.0 - a * (t - 1.0) * (t - 2.0) * (t - 3.0) / 6.0
    return np.asarray(inner + outer)
