"""Tables of directional albedo, which forward and retro lobes share (001 eq. 18), and what is built on them.

The tables are those of isotropic lobes. An anisotropic one is looked up at the geometric mean of its two alphas, as in
MaterialX; of the means that were tried it is the one that makes the least energy. A compensated white albedo is then
no longer 1 but from 0.92 to 1.04 for alpha (0.5, 0.25), and from 0.65 to 1.05 for (0.9, 0.1).
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from . import block, kernels
from . import energy_formulas as formulas
from . import microsurface as surface
from .checks import CORRELATIONS, DISTRIBUTIONS, MASKINGS, choice, scalar
from .compiled import Array, run
from .fresnel import SCHLICK
from .quadrature import quadrature_nodes

ROWS = 48
COLUMNS = 24
RESOLUTION = 64

#: Largest error of a look-up, at grazing angles where E falls from 1 within n.v < alpha; 1e-3 for n.v above 0.1.
TABLE_ERROR = 6e-3

#: Most energy that compensation by these tables makes of an anisotropic lobe, alphas up to 9 to 1.
ANISOTROPIC_ERROR = 0.06


@lru_cache(maxsize=32)
def white_albedo_table(distribution: int, masking: int, correlation: int) -> Array:
    """E on a grid even in sqrt(n.v) (rows) and sqrt(alpha) (columns), over [0, 1]; the last row is the
    average.

    The average is that of the interpolated table, so that Kulla and Conty's term gives back just what it
    says is lost."""
    # At the very ends E is a limit: 1 for a mirror, and what grazing directions tend to.
    cosine = np.maximum(np.linspace(0.0, 1.0, ROWS) ** 2, 1e-6)
    alpha = np.maximum(np.linspace(0.0, 1.0, COLUMNS) ** 2, 1e-6)
    v = np.stack([np.sqrt(1.0 - cosine**2), np.zeros(ROWS), cosine], axis=-1)[:, np.newaxis]
    one, zero = np.ones(1), np.zeros(1)
    white = [
        np.repeat(alpha[:, np.newaxis], 2, axis=1), zero, np.ones(3), np.ones(3), np.ones(3),
        5.0 * one, zero, one, zero, np.zeros(2), np.ones(3),
    ]  # fmt: skip
    modes = [SCHLICK, distribution, masking, correlation, formulas.NONE, block.REFLECT, 0, 0, 1]
    nodes = quadrature_nodes(RESOLUTION)
    (albedo,), _ = run(kernels.INTEGRATE, [v, np.zeros(3), *white], modes, [3], [np.ones((2, 2)), nodes])
    table = albedo[..., 0]
    average = _grid_weights() @ table
    return np.concatenate([table, average[np.newaxis]])


def _grid_weights() -> Array:
    """Weights of the rows in 2 ∫ E cos dcos, exact for E piecewise linear in x = sqrt(cos): 4 x³ dx."""
    t, w = np.polynomial.legendre.leggauss(3)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    step = 1.0 / (ROWS - 1)
    x = (np.arange(ROWS - 1)[:, np.newaxis] + t) * step
    density = 4.0 * x**3 * w * step
    weights = np.zeros(ROWS)
    weights[:-1] += (density * (1.0 - t)).sum(axis=1)
    weights[1:] += (density * t).sum(axis=1)
    return weights


def _look_up(
    alpha: ArrayLike, cosine: ArrayLike | None, distribution: str, masking: str, correlation: str
) -> Array:
    code = choice("distribution", distribution, DISTRIBUTIONS)
    mask = surface.VCAVITY if code == surface.PHONG else choice("masking", masking, MASKINGS)
    table = white_albedo_table(code, mask, choice("correlation", correlation, CORRELATIONS))
    width = scalar("alpha", alpha, 0.0, open_low=True)[..., 0]
    if cosine is None:
        return np.asarray(np.interp(np.sqrt(width), np.linspace(0.0, 1.0, COLUMNS), table[-1]))
    x, y = np.broadcast_arrays(scalar("cos_theta", cosine, 0.0, 1.0)[..., 0], width)
    x, y = np.sqrt(x) * (ROWS - 1), np.minimum(np.sqrt(y), 1.0) * (COLUMNS - 1)
    i, j = np.minimum(x.astype(int), ROWS - 2), np.minimum(y.astype(int), COLUMNS - 2)
    x, y = x - i, y - j
    low = table[i, j] * (1.0 - y) + table[i, j + 1] * y
    high = table[i + 1, j] * (1.0 - y) + table[i + 1, j + 1] * y
    return np.asarray(low * (1.0 - x) + high * x)


def white_albedo(
    cos_theta: ArrayLike,
    alpha: ArrayLike,
    distribution: str = "ggx",
    masking: str = "smith",
    correlation: str = "height",
) -> Array:
    """Directional albedo of an isotropic lobe with F = 1, from a table: within `TABLE_ERROR`. Arguments
    broadcast.

    The same for the forward and the retro lobe. Alpha above 1 is taken as 1. `ValueError` outside the ranges.
    """
    return _look_up(alpha, cos_theta, distribution, masking, correlation)


def average_albedo(
    alpha: ArrayLike, distribution: str = "ggx", masking: str = "smith", correlation: str = "height"
) -> Array:
    """The cosine-weighted mean of `white_albedo` over the hemisphere."""
    return _look_up(alpha, None, distribution, masking, correlation)
