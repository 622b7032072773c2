"""The Phong (Blinn) distribution: not shape-invariant, so that its Smith masking is an integral of its own."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np
from numpy.typing import ArrayLike

from .checks import CORRELATIONS, MASKINGS, check_unit, choice, directions
from .compiled import Array, run
from .distributions import Distribution, sampling_uniforms
from .masking import SMITH, masking_of
from .microsurface import PHONG, Seen
from .phong_sampling import DRAW_VISIBLE, LAMBDA, incomplete_beta
from .vec import Vec


def isotropic_lambda(cosine: Array, alpha: Array) -> Array:
    """Λ of isotropic Phong in closed form, an incomplete beta function of cos² θ. Arguments broadcast, 0 <
    cosine <= 1.

    The slope's density along one axis, (1 + x²)^(-a) up to normalisation with a = (e + 3) / 2, follows from
    D by integrating across; then Λ = ∫ (x - cot) P2(x) dx / cot above cot (Heitz eq. 124), whose two parts
    are a power and a Student tail."""
    cos, width = np.broadcast_arrays(np.asarray(cosine, np.float64), np.asarray(alpha, np.float64))
    a = 1.0 / width**2 + 0.5
    cot2 = cos**2 / np.maximum(1.0 - cos**2, 1e-300)
    # Normalisation of (1 + x²)^(-a): Γ(a) / (sqrt π Γ(a - ½)).
    scale = np.exp(_log_gamma(a) - _log_gamma(a - 0.5)) / math.sqrt(math.pi)
    first = scale * np.exp((1.0 - a) * np.log1p(cot2)) / (2.0 * (a - 1.0))
    tail: Array = 0.5 * _incomplete_beta(1.0 / (1.0 + cot2), cot2 / (1.0 + cot2), a - 0.5, 0.5)
    return np.asarray(np.maximum(first / np.sqrt(np.maximum(cot2, 1e-300)) - tail, 0.0))


def _log_gamma(x: Array) -> Array:
    return np.asarray(np.vectorize(math.lgamma, otypes=[np.float64])(x))


#: I_x(a, b) for arrays (x, 1 - x, a, b).
_incomplete_beta: Any = numba.vectorize(incomplete_beta.py_func)  # type: ignore[no-untyped-call]


def _smith_visibility(correlation: str, v: Array, l: Array, one: Array, other: Array) -> Array:  # noqa: E741
    """G2 over both cosines by areas over cosines, 1 + Λ, of v and of l or, below, of -l."""
    masking = masking_of(SMITH, correlation)
    same_side: Any = masking.same_side
    across: Any = masking.across

    def at(vx: float, vy: float, lx: float, ly: float, lz: float, a: float, b: float) -> float:
        formula = (across if lz < 0.0 else same_side).py_func
        seen = Seen(1.0, a, 0.0), Seen(1.0, b, 0.0)
        value: float = formula(Vec(vx, vy, 1.0), Vec(lx, ly, lz), Vec(0.0, 0.0, 1.0), 1.0, 1.0, *seen)
        return value

    each = np.vectorize(at, otypes=[np.float64])
    return np.asarray(each(v[..., 0], v[..., 1], l[..., 0], l[..., 1], l[..., 2], one, other))


class Phong(Distribution):
    """Blinn's distribution with the exponent 2/alpha² - 2, anisotropic as Ashikhmin and Shirley 2000 have it.

    Its Λ is Heitz 2014, eq. 124. Parameters as of `Distribution`, but for slopes: they are neither correlated nor
    shifted. Smith's visible normals are drawn by inverting their distribution
    numerically, at some 20 microseconds each while v stays the same."""

    _distribution = PHONG

    def __init__(self, ax: ArrayLike, ay: ArrayLike | None = None) -> None:
        super().__init__(ax, ay)

    def Lambda(self, w: ArrayLike) -> Array:
        """Smith's Λ (Heitz eq. 124): closed where isotropic, by quadrature to 1e-6 where not. Shape (...)."""
        direction = directions("w", w)
        check_unit("w", direction)
        try:
            (numerical,), _ = run(LAMBDA, [direction, self._alpha], [], [1])
        except ValueError as error:
            raise ValueError(f"shapes do not broadcast: {error}") from None
        cosine, x, y = np.broadcast_arrays(direction[..., 2], self._alpha[..., 0], self._alpha[..., 1])
        even = (cosine > 0.0) & (x == y)
        result = numerical[..., 0]
        result[even] = isotropic_lambda(np.minimum(cosine[even], 1.0), x[even])
        return np.asarray(result)

    def G1(self, w: ArrayLike, m: ArrayLike, masking: str = "smith") -> Array:
        if choice("masking", masking, MASKINGS) != SMITH:
            return super().G1(w, m, masking)
        direction, normal = directions("w", w), directions("m", m)
        check_unit("m", normal)
        facing = (direction * normal).sum(axis=-1) > 0.0
        return np.where(facing, 1.0 / (1.0 + self.Lambda(w)), 0.0)

    def G2(
        self,
        v: ArrayLike,
        l: ArrayLike,  # noqa: E741
        m: ArrayLike,
        masking: str = "smith",
        correlation: str = "height",
    ) -> Array:
        if choice("masking", masking, MASKINGS) != SMITH:
            return super().G2(v, l, m, masking, correlation)
        view, light, normal = directions("v", v), directions("l", l), directions("m", m)
        across = light[..., 2] < 0.0
        turned = np.where(across[..., np.newaxis], -light, light)
        first, second = self.G1(view, normal), self.G1(turned, normal)
        both = (first > 0.0) & (second > 0.0)
        one, other = 1.0 / np.where(both, first, 1.0), 1.0 / np.where(both, second, 1.0)
        value = _smith_visibility(choice("correlation", correlation, CORRELATIONS), view, light, one, other)
        return np.where(both, value, 0.0)

    def sample_visible(self, v: ArrayLike, u: ArrayLike, masking: str = "smith") -> Array:
        if choice("masking", masking, MASKINGS) != SMITH:
            return super().sample_visible(v, u, masking)
        view, uniforms = directions("v", v), sampling_uniforms(u, 2)
        check_unit("v", view)
        if not (view[..., 2] > 0.0).all():
            raise ValueError("v must be above the surface whose visible normals are sampled")
        try:
            (normals,), _ = run(DRAW_VISIBLE, [view, uniforms, self._alpha], [], [3])
        except ValueError as error:
            raise ValueError(f"shapes do not broadcast: {error}") from None
        return normals

    def pdf_visible(self, v: ArrayLike, m: ArrayLike, masking: str = "smith") -> Array:
        if choice("masking", masking, MASKINGS) != SMITH:
            return super().pdf_visible(v, m, masking)
        view = directions("v", v)
        seen = np.maximum((view * directions("m", m)).sum(axis=-1), 0.0)
        above = view[..., 2] > 0.0
        cosine = np.where(above, view[..., 2], 1.0)
        return np.where(above, self.G1(view, m) * seen * self.D(m) / cosine, 0.0)
