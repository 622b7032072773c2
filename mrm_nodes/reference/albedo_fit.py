"""Rational fits of directional albedo: one table of coefficients for each pair of distribution and masking.

A lobe whose reflectance is Schlick's, F0 + (F90 - F0)(1 - v.h)^5, has the directional albedo F0 A + F90 B,
and a white one E = A + B. Each of A and B is a ratio of biquadratics in x = n.v and y = alpha, clamped to
[0, 1]. Rows are the terms 1, x, y, xy, x², y², x²y, xy², x²y²; columns are the numerators of A and B, then
their denominators.

GGX with Smith's height-correlated masking is MaterialX 1.39's own fit. The others are ours, made by `fit`
below from the evaluator's quadrature, as close to E as the form allows but not below it, so that
compensation makes less than 1e-3 of energy. `python -m mrm_nodes.reference.albedo_fit` makes them again, to
3e-3 in E: the optimum is flat. It prints each for this table, and as `mrm_microfacet.glsl` has it."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

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
    terms = _terms(x, y)
    sums = np.einsum("kc,...k->c...", np.array(COEFFICIENTS[pair]), terms)
    return np.clip(sums[0] / sums[2], 0.0, 1.0), np.clip(sums[1] / sums[3], 0.0, 1.0)


def _terms(cosine: Array, alpha: Array) -> Array:
    x, y = cosine, alpha
    return np.stack([np.ones_like(x), x, y, x * y, x * x, y * y, x * x * y, x * y * y, (x * y) ** 2], axis=-1)


def _linearised(terms: Array, target: Array, weight: Array) -> tuple[Array, Array] | None:
    """A start for the fit: numerator - target · denominator in least squares, reweighted (Sanathanan and
    Koerner).
    """
    denominator = np.ones(len(target))
    best: tuple[float, Any, Any] | None = None
    for _ in range(30):
        scale = (weight / denominator)[:, np.newaxis]
        matrix = np.concatenate([terms, -target[:, np.newaxis] * terms[:, 1:]], axis=1) * scale
        solution = np.linalg.lstsq(matrix, target * scale[:, 0], rcond=1e-10)[0]
        numerator = solution[:9]
        below = np.concatenate([np.ones(1), np.asarray(solution[9:], np.float64)])
        value = terms @ below
        if value.min() > 1e-3:
            error = float((weight * (np.clip(terms @ numerator / value, 0.0, 1.0) - target) ** 2).sum())
            if best is None or error < best[0]:
                best = error, numerator, below
        denominator = np.maximum(np.abs(value), 1e-3)
    return None if best is None else best[1:]


def _fit_ratio(
    terms: Array, target: Array, weight: Array, start: tuple[Array, Array], from_above: bool
) -> Array:
    """Numerator and denominator (2, 9) of a ratio near `target`, or near it and not below it."""
    from scipy.optimize import least_squares

    def residuals(p: Array, penalty: float) -> Array:
        below = terms @ np.concatenate([[1.0], p[9:]])
        r = np.clip(terms @ p[:9] / below, -0.5, 1.5) - target
        short = r * penalty if from_above else weight * r
        return np.concatenate([np.where(r < 0.0, short, weight * r), np.maximum(0.05 - below, 0.0) * 50.0])

    starts = [start, *filter(None, [_linearised(terms, target, weight)])]
    best = None
    for numerator, denominator in starts:
        p = np.concatenate([numerator, denominator[1:]]) / denominator[0]
        for penalty in (1.0, 4.0, 16.0, 60.0, 180.0) if from_above else (1.0,):
            scale = np.maximum(np.abs(p), 0.05)
            found = least_squares(
                residuals,
                p,
                args=(penalty,),
                x_scale=scale,
                ftol=1e-12,
                xtol=1e-12,
                gtol=1e-12,
                max_nfev=1500,
            )
            p = found.x
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return np.stack([best.x[:9], np.concatenate([[1.0], best.x[9:]])])


def fit(pair: Pair) -> Array:
    """Coefficients (9, 4) for a pair, from the evaluator's own albedo on a grid; needs SciPy, and half a
    minute.

    B is fitted in least squares; then A to E - B from above, so that the sum is not below E. Grazing
    directions, where E falls from 1 within n.v < alpha and no ratio of biquadratics can follow, count for
    less."""
    from .bsdf import GeneralizedSchlick

    steps = np.arange(1, 29) / 28.0
    cosine, alpha = np.concatenate([[1e-4], steps**2]), np.concatenate([[0.002], steps**1.5])
    v = np.stack([np.sqrt(1.0 - cosine**2), np.zeros_like(cosine), cosine], axis=-1)[:, np.newaxis]
    width = np.stack([alpha, alpha], axis=-1)

    def albedo(f0: float) -> Array:
        lobe = GeneralizedSchlick(f0, alpha=width, distribution=pair[0], masking=pair[1])
        return lobe.albedo(v)[..., 0].ravel()

    white, edge = albedo(1.0), albedo(0.0)
    x, y = (grid.ravel() for grid in np.meshgrid(cosine, alpha, indexing="ij"))
    terms, weight = _terms(x, y), np.clip(x / 0.05, 0.2, 1.0)
    start = np.array(COEFFICIENTS["ggx", "smith"])
    b = _fit_ratio(terms, edge, weight, (start[:, 1], start[:, 3]), from_above=False)
    rest = np.maximum(white - np.clip(terms @ b[0] / (terms @ b[1]), 0.0, 1.0), 0.0)
    a = _fit_ratio(terms, rest, weight, (start[:, 0], start[:, 2]), from_above=True)
    return np.stack([a[0], b[0], a[1], b[1]], axis=-1)


_TERMS = ("", " * x", " * y", " * x * y", " * x2", " * y2", " * x2 * y", " * x * y2", " * x2 * y2")


def as_glsl(rows: ArrayLike) -> str:
    """Coefficients (9, 4) as the sum in the nodes' GLSL."""
    sums = [
        f"vec4({', '.join(_text(value) for value in row)}){term}"
        for row, term in zip(np.asarray(rows), _TERMS, strict=True)
    ]
    return "            r = " + "\n                + ".join(sums) + ";"


def _text(value: float) -> str:
    text = f"{value:.6g}"
    return text if "." in text else f"{text}.0"


def main() -> None:
    """Fit every pair but MaterialX's, and print the table, then the GLSL's."""
    found = {pair: fit(pair) for pair in COEFFICIENTS if pair != ("ggx", "smith")}
    for pair, rows in found.items():
        print(f"    {pair}: (")
        for row in rows:
            print("        (" + ", ".join(map(_text, row)) + "),")
        print("    ),")
    for pair, rows in found.items():
        print(f"// {pair}\n{as_glsl(rows)}")


if __name__ == "__main__":
    main()
