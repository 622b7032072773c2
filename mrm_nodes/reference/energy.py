"""Tables of directional albedo, which forward and retro lobes share (001 eq. 18), and what is built on them.

E of a lobe depends on four numbers: one for the direction, and three for the ellipse of slopes as it is seen from
there, along, across, and how the two are correlated. In these a lobe may have any alphas, azimuth and correlated
roughness, and E is smooth down to alpha 0, where it is that of slopes that have nothing but a direction's own size to
be compared with. A table is made where one asks for it, once a process, in a second or two.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import block, kernels, parts
from . import energy_formulas as formulas
from .checks import CORRELATIONS, DISTRIBUTIONS, MASKINGS, choice, scalar
from .compiled import Array, Kernel, run
from .energy_formulas import ACROSS, AVERAGES, COLUMNS, FREE, NARROW, ROWS, WIDEST, WIDTHS
from .fresnel import DIELECTRIC
from .lobe import facets
from .masking import VCAVITY
from .microsurface import PHONG
from .quadrature import quadrature_nodes

#: Largest error of E by a table, absolute and relative: for any direction and alpha, with the slopes' alphas along
#: their own axes up to 20 to 1 and correlated up to 0.95.
TABLE_ERROR = 6e-3

# Chebyshev points that a table is interpolated from, and its quadrature's resolution: a step of any of them changes E
# by less than half of TABLE_ERROR.
POINTS = (20, 12, 9, 5)
RESOLUTION = 32


def _integrated(v: Array, alpha: Array, distribution: str, masking: str, correlation: str) -> Array:
    """E by quadrature, of a lobe with F = 1."""
    # Total reflection inside a dense dielectric: F is 1 and its formula is not asked.
    white = block.Parameters(
        alpha=alpha,
        retroreflectivity=np.zeros(1),
        a=np.full(3, 1e6),
        b=np.zeros(3),
        c=np.zeros(3),
        exponent=np.full(1, 5.0),
        thinfilm_thickness=np.zeros(1),
        thinfilm_ior=np.ones(1),
        slope_correlation=np.zeros(1),
        mean_slope=np.zeros(2),
        tint=np.ones(3),
    )
    modes = block.Modes(
        kind=DIELECTRIC, compensation=formulas.NONE, scatter=block.REFLECT, retro_transmission=0
    )
    modes = parts.answering("albedo", modes, facets(distribution, masking, correlation, False), True)
    tables = [np.ones((2, 2)), quadrature_nodes(RESOLUTION)]
    (albedo,), _ = run(kernels.INTEGRATE, [-v, np.zeros(3), *white], modes, [3], tables)
    return np.asarray(albedo[..., 0])


@lru_cache(maxsize=32)
def white_albedo_table(distribution: str, masking: str, correlation: str) -> Array:
    """E of any lobe, and its averages in the last rows.

    Over [0, 1] the grid is even in: the roughness across v over WIDEST; the free share of the slopes across v,
    sqrt(1 - r²) where r is their correlation with those along v; the cosine of v in the standard configuration;
    and, columns, sqrt of the roughness along v over WIDEST. E is smooth in them, so that it is integrated at a
    few Chebyshev points and interpolated to the grid, where a look-up is linear."""
    cosine, along, across, free = np.meshgrid(*(_chebyshev(n) for n in POINTS), indexing="ij")
    along, across = np.maximum(WIDEST * along**2, 1e-5), np.maximum(WIDEST * across, 1e-5)
    # The slopes' ellipse has its axes elsewhere than v; Phong knows no other correlation.
    joint = np.sqrt(1.0 - np.maximum(free, 1e-3) ** 2) * along * across
    squares, axes = np.linalg.eigh(
        np.stack([along**2, joint, joint, across**2], -1).reshape(*along.shape, 2, 2)
    )
    alpha = np.sqrt(np.maximum(squares, 1e-12))
    tangent = np.sqrt(1.0 - cosine**2)[..., np.newaxis] * axes[..., 0, :]
    v = np.concatenate([tangent, (np.maximum(cosine, 1e-3) * along)[..., np.newaxis]], axis=-1)
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    values = _integrated(v, alpha, distribution, masking, correlation)
    for axis, count in enumerate((ROWS, COLUMNS, ACROSS, FREE)):
        values = np.moveaxis(
            np.tensordot(_interpolation(values.shape[axis], count), values, (1, axis)), 0, axis
        )
    table = np.minimum(values.transpose(2, 3, 0, 1).reshape(-1, COLUMNS), 1.0)
    return np.concatenate([table, _averages(table)])


def _chebyshev(count: int) -> Array:
    """Chebyshev's points of the second kind on [0, 1]."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.arange(count) / (count - 1)))


def _interpolation(points: int, count: int) -> Array:
    """The matrix from values at Chebyshev's points to `count` even ones (Berrut and Trefethen 2004, eq. 5.4)."""
    weights = (-1.0) ** np.arange(points)
    weights[[0, -1]] *= 0.5
    apart = np.linspace(0.0, 1.0, count)[:, np.newaxis] - _chebyshev(points)
    same = np.abs(apart) < 1e-14
    share = weights / np.where(same, 1.0, apart)
    share = np.where(same.any(axis=1, keepdims=True), same, share)
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def _averages(table: Array) -> Array:
    """What is lost on average of what the table says, by the alphas along both principal axes.

    Its fourth root: what is lost falls like a power of alpha, and the term of Kulla and Conty divides by it."""
    # The fourth root of the cosine, so that many nodes lie where a narrow lobe loses anything.
    t, w = np.polynomial.legendre.leggauss(48)
    root, root_weight = 0.5 * (t + 1.0), 0.5 * w
    t, w = np.polynomial.legendre.leggauss(12)
    azimuth, azimuth_weight = 0.25 * np.pi * (t + 1.0), 0.5 * w
    weight = np.outer(8.0 * root**7 * root_weight, azimuth_weight)
    v = _direction(root[:, np.newaxis] ** 4, azimuth)
    alpha = np.maximum(NARROW * np.expm1(WIDTHS * np.linspace(0.0, 1.0, AVERAGES)), 1e-9)
    pairs = np.stack(np.broadcast_arrays(alpha[:, np.newaxis], alpha), axis=-1)
    values, _ = _look_up(v, pairs[:, :, np.newaxis, np.newaxis], table)
    return np.asarray(np.einsum("ijkl,kl", 1.0 - values, weight) ** 0.25).reshape(-1, COLUMNS)


def _direction(cosine: Array, azimuth: Array) -> Array:
    sine = np.sqrt(1.0 - cosine**2)
    parts = np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine)
    return np.stack(parts, axis=-1)


def _find(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    v, alpha, table = inputs[0], inputs[1], inputs[2]
    one, average = outputs[0], outputs[1]
    for i in range(start, stop):
        ax, ay = alpha[i, 0], alpha[i, 1]
        one[i] = formulas.albedo_lookup(v[i, 0], v[i, 1], v[i, 2], ax, ay, 0.0, table)
        average[i] = formulas.average_lookup(ax, ay, 0.0, table)
    return 0


#: E and E_avg for directions (3) and alphas (2).
FIND = Kernel(_find, 3, 2)


def _look_up(v: Array, alpha: Array, table: Array) -> tuple[Array, Array]:
    (one, average), _ = run(FIND, [v, alpha], [], [1, 1], [table])
    return one[..., 0], average[..., 0]


def _look_up_named(
    v: Array, alpha: ArrayLike, alpha_y: ArrayLike | None, distribution: str, masking: str, correlation: str
) -> tuple[Array, Array]:
    code = choice("distribution", distribution, DISTRIBUTIONS)
    mask = VCAVITY if code == PHONG else choice("masking", masking, MASKINGS)
    x = scalar("alpha", alpha, 0.0, open_low=True)[..., 0]
    y = x if alpha_y is None else scalar("alpha_y", alpha_y, 0.0, open_low=True)[..., 0]
    table = white_albedo_table(code, mask, choice("correlation", correlation, CORRELATIONS))
    both = np.stack(np.broadcast_arrays(x, y), axis=-1)
    return _look_up(v, np.minimum(both, 1.0), table)


def white_albedo(
    cos_theta: ArrayLike,
    alpha: ArrayLike,
    distribution: str = "ggx",
    masking: str = "smith",
    correlation: str = "height",
    alpha_y: ArrayLike | None = None,
    azimuth: ArrayLike = 0.0,
) -> Array:
    """Directional albedo of a lobe with F = 1, from a table: shape (...), within `TABLE_ERROR`.

    The same for the forward and the retro lobe (Portsmouth et al. 2026, eq. 18). Alpha above 1 is taken as 1.

    Args:
        cos_theta: cosine between the direction and the normal, 0 to 1: (...).
        alpha: microfacet width along x, above 0: (...).
        distribution: as in `Conductor`, likewise masking and correlation.
        alpha_y: along y, where it is another: (...).
        azimuth: of the direction, from x, in radians: (...).

    Raises:
        ValueError: an argument outside its range.
    """
    cosine = scalar("cos_theta", cos_theta, 0.0, 1.0)[..., 0]
    v = _direction(cosine, scalar("azimuth", azimuth, -np.inf)[..., 0])
    return _look_up_named(v, alpha, alpha_y, distribution, masking, correlation)[0]


def average_albedo(
    alpha: ArrayLike,
    distribution: str = "ggx",
    masking: str = "smith",
    correlation: str = "height",
    alpha_y: ArrayLike | None = None,
) -> Array:
    """The cosine-weighted mean of albedo over the hemisphere: shape (...).

    Arguments and errors (`ValueError`) as for `white_albedo`.
    """
    up = np.array([0.0, 0.0, 1.0])
    return _look_up_named(up, alpha, alpha_y, distribution, masking, correlation)[1]
