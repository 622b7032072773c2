"""Rational fits of directional albedo: one table of coefficients for each pair of distribution and masking.

A lobe whose reflectance is Schlick's, F0 + (F90 - F0)(1 - v.h)^5, has the directional albedo F0 A + F90 B, and a white
one E = A + B. Each of A and B is a ratio of biquadratics in x = n.v and y = alpha, clamped to [0, 1]. Rows are the terms
1, x, y, xy, x², y², x²y, xy², x²y²; columns are the numerators of A and B, then their denominators.

GGX with Smith's height-correlated masking is MaterialX 1.39's own fit. The others are ours, made by `fit` below from the
evaluator's quadrature and constrained to E_fit >= E - BOUND, so that compensation makes no energy beyond that.
`python -m mrm_nodes.reference.albedo_fit` makes them again.
"""

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
}
