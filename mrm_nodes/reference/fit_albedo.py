"""How the coefficients of `albedo_fit` were made: rational fits of the evaluator's own quadrature.

`python -m mrm_nodes.reference.fit_albedo` makes them again, to 3e-3 in E: the optimum is flat. It prints each as
`albedo_fit.py` has it, and as `mrm_microfacet.glsl` does. It needs SciPy."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .albedo_fit import COEFFICIENTS, Pair, terms_of
from .bsdf import GeneralizedSchlick
from .compiled import Array


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
    steps = np.arange(1, 29) / 28.0
    cosine, alpha = np.concatenate([[1e-4], steps**2]), np.concatenate([[0.002], steps**1.5])
    v = np.stack([np.sqrt(1.0 - cosine**2), np.zeros_like(cosine), cosine], axis=-1)[:, np.newaxis]
    width = np.stack([alpha, alpha], axis=-1)

    def albedo(f0: float) -> Array:
        lobe = GeneralizedSchlick(f0, alpha=width, distribution=pair[0], masking=pair[1])
        return lobe.albedo(v)[..., 0].ravel()

    white, edge = albedo(1.0), albedo(0.0)
    x, y = (grid.ravel() for grid in np.meshgrid(cosine, alpha, indexing="ij"))
    terms, weight = terms_of(x, y), np.clip(x / 0.05, 0.2, 1.0)
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
