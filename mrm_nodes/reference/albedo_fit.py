"""Rational fits of directional albedo: one table of coefficients for each pair of distribution and masking.

A lobe whose reflectance is Schlick's, F0 + (F90 - F0)(1 - v.h)^5, has the directional albedo F0 A + F90 B,
and a white one E = A + B. Each of A and B is a ratio of biquadratics in x = n.v and y = alpha, clamped to
[0, 1]. Rows are the terms 1, x, y, xy, x², y², x²y, xy², x²y²; columns are the numerators of A and B, then
their denominators.

GGX with Smith's height-correlated masking is MaterialX 1.39's own fit. The others are ours, made by
`fit_albedo.py`, as close to E as the form allows but not below it, so that compensation makes less than 1e-3
of energy."""

import numpy as np

from .compiled import Array

Pair = tuple[str, str]

COEFFICIENTS: dict[Pair, tuple[tuple[float, float, float, float], ...]] = {
    ("ggx", "smith"): (
        (0.1003, 0.9345, 1.0, 1.0),
        (-0.6303, -2.323, -1.765, 0.2281),
        (9.748, 2.229, 8.263, 15.94),
        (-2.038, -3.748, 11.53, -55.83),
        (29.34, 1.424, 28.96, 13.08),
        (-8.245, -0.7684, -7.507, 41.26),
        (-26.44, 1.436, -36.11, 54.9),
        (19.99, 0.2913, 15.86, 300.2),
        (-5.448, 0.6286, 33.37, -285.1),
    ),
    ("beckmann", "smith"): (
        (0.0946861, 0.967962, 1.0, 1.0),
        (2.5994, -2.48216, 0.436913, 1.19956),
        (3.12764, 3.37487, 4.49907, 8.35735),
        (-4.37287, -7.20072, -6.60675, -11.6218),
        (12.7692, 1.55673, 13.9937, 9.70631),
        (25.7803, -1.8122, 25.0374, 27.8384),
        (-22.7625, 3.82591, -23.7459, -18.5952),
        (-41.0986, 4.9172, -33.2682, 152.147),
        (26.7961, -3.16218, 25.009, -45.6325),
    ),
    ("ggx", "vcavity"): (
        (0.0803966, 0.967925, 1.0, 1.0),
        (2.7595, -2.50922, 1.02541, 1.20187),
        (3.6312, 8.71976, 2.86007, 14.6826),
        (8.33639, -19.4702, 10.4527, 38.693),
        (14.0144, 1.59174, 14.3571, 8.96971),
        (0.299377, 0.576299, 1.17927, 33.4676),
        (-27.8601, 10.6316, -23.6969, -83.5233),
        (-4.33858, -0.723628, -7.42861, 248.805),
        (11.9557, 0.906006, 23.5901, 335.757),
    ),
    ("beckmann", "vcavity"): (
        (0.093397, 0.960774, 1.0, 1.0),
        (2.67898, -2.48274, 0.444015, 0.997426),
        (1.91866, 7.45955, 0.368186, 10.8893),
        (6.17382, -17.4874, 14.3399, 33.6533),
        (10.2466, 1.56777, 11.555, 10.085),
        (0.286226, 0.089415, 1.5982, 25.4723),
        (-24.892, 10.0404, -34.2631, -119.027),
        (-1.14729, 3.44741, -9.85759, 167.69),
        (9.78894, -3.30176, 26.0562, 392.26),
    ),
    ("phong", "vcavity"): (
        (0.08913, 0.964842, 1.0, 1.0),
        (2.616, -2.50751, 0.570903, 1.06384),
        (2.08616, 9.08648, 0.528736, 12.8548),
        (8.02243, -20.8134, 14.0484, 32.7231),
        (12.1187, 1.59183, 13.0638, 9.81871),
        (-0.626121, -1.39751, 0.420407, 27.6483),
        (-37.2993, 11.6757, -42.9426, -95.0587),
        (-10.2897, 4.58033, -16.1699, 212.028),
        (27.2182, -2.59107, 38.947, 284.87),
    ),
}


def split_sum(pair: Pair, cosine: Array, alpha: Array) -> tuple[Array, Array]:
    """The terms A and B of a pair's directional albedo F0 A + F90 B, at n.v and alpha, which broadcast."""
    x, y = np.broadcast_arrays(cosine, alpha)
    terms = terms_of(x, y)
    sums = np.einsum("kc,...k->c...", np.array(COEFFICIENTS[pair]), terms)
    return np.clip(sums[0] / sums[2], 0.0, 1.0), np.clip(sums[1] / sums[3], 0.0, 1.0)


def terms_of(cosine: Array, alpha: Array) -> Array:
    """The nine terms (..., 9) that the rows of `COEFFICIENTS` belong to."""
    x, y = cosine, alpha
    return np.stack([np.ones_like(x), x, y, x * y, x * x, y * y, x * x * y, x * y * y, (x * y) ** 2], axis=-1)
