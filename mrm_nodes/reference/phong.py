"""The Phong (Blinn) distribution: not shape-invariant, so that its Smith masking is an integral of its own."""

import math

import numpy as np
from numpy.typing import ArrayLike

from . import microsurface as surface
from .checks import CORRELATIONS, MASKINGS, check_unit, choice, directions
from .compiled import Array
from .distributions import Distribution

# Steps of the rule below; its error is under 1e-6 for alpha from 0.01 to 1 and any direction.
AZIMUTHS = 96
RADII = 64


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
    tail = 0.5 * _beta_tail(1.0 / (1.0 + cot2), a - 0.5)
    return np.maximum(first / np.sqrt(np.maximum(cot2, 1e-300)) - tail, 0.0)


def _log_gamma(x: Array) -> Array:
    return np.asarray(np.vectorize(math.lgamma, otypes=[np.float64])(x))


def _beta_tail(x: Array, a: Array) -> Array:
    """The regularised incomplete beta function I_x(a, ½), by its continued fraction (modified Lentz)."""
    b = 0.5
    log_front = a * np.log(np.maximum(x, 1e-300)) + b * np.log1p(-np.minimum(x, 1.0 - 1e-16))
    log_front -= _log_gamma(a) + math.lgamma(b) - _log_gamma(a + b)
    direct = x < (a + 1.0) / (a + b + 2.0)
    p, q, z = np.where(direct, a, b), np.where(direct, b, a), np.where(direct, x, 1.0 - x)
    tiny = 1e-300
    c = np.ones_like(z)
    d = 1.0 - (p + q) * z / (p + 1.0)
    d = 1.0 / np.where(np.abs(d) < tiny, tiny, d)
    result = d.copy()
    for m in range(1, 200):
        for numerator in (
            m * (q - m) * z / ((p + 2 * m - 1.0) * (p + 2 * m)),
            -(p + m) * (p + q + m) * z / ((p + 2 * m) * (p + 2 * m + 1.0)),
        ):
            d = 1.0 + numerator * d
            d = 1.0 / np.where(np.abs(d) < tiny, tiny, d)
            c = 1.0 + numerator / np.where(np.abs(c) < tiny, tiny, c)
            result *= c * d
    value = np.exp(log_front) * result / p
    return np.where(direct, value, 1.0 - value)


class Phong(Distribution):
    """Blinn's distribution with the exponent 2/alpha² - 2, anisotropic as Ashikhmin and Shirley's.

    It knows no correlated or shifted slopes. Visible normals are those of V-cavities: Smith's are not
    sampled."""

    _code = surface.PHONG

    def __init__(self, ax: ArrayLike, ay: ArrayLike | None = None) -> None:
        super().__init__(ax, ay)

    def Lambda(self, w: ArrayLike) -> Array:
        """Smith's Λ (Heitz eq. 124): closed where isotropic, by quadrature to 1e-6 where not. Shape (...)."""
        direction = directions("w", w)
        check_unit("w", direction)
        direction, alpha = np.broadcast_arrays(direction[..., np.newaxis, :], self._alpha[..., :, np.newaxis])
        direction, alpha = direction[..., 0, :], alpha[..., 0]
        cosine = direction[..., 2]
        result = np.full(cosine.shape, np.inf)
        up = cosine > 0.0
        even = up & (alpha[..., 0] == alpha[..., 1])
        result[even] = isotropic_lambda(np.minimum(cosine[even], 1.0), alpha[even][:, 0])
        odd = up & ~even
        result[odd] = self._quadrature(direction[odd], alpha[odd])
        return result

    @staticmethod
    def _quadrature(direction: Array, alpha: Array) -> Array:
        """∫ <-w, m> D(m) dm / (w.n): facets turned away, whose area is Λ of what is seen (eqs. 41 and 43)."""
        t, weight = np.polynomial.legendre.leggauss(RADII)
        t, weight = 0.5 * (t + 1.0), 0.5 * weight
        # The steepest facets that still face a grazing w lie where a root starts: smaller steps there too.
        t, weight = t * (2.0 - t), 2.0 * (1.0 - t) * weight
        # Half the circle, the azimuths opposite to w, with steps that shrink where a grazing w sees the last
        # facets.
        s, step = np.polynomial.legendre.leggauss(AZIMUTHS)
        delta, step = 0.5 * np.pi * np.sin(0.5 * np.pi * s), 0.25 * np.pi**2 * np.cos(0.5 * np.pi * s) * step
        out = np.zeros(len(direction))
        for k, ((x, y, z), (ax, ay)) in enumerate(zip(direction, alpha, strict=True)):
            sine = math.hypot(x, y)
            if sine < 1e-150:
                continue
            azimuth = math.atan2(-y, -x) + delta
            toward = sine * np.cos(delta)
            power = 2.0 * (np.cos(azimuth) ** 2 / ax**2 + np.sin(azimuth) ** 2 / ay**2)
            # Along an azimuth the facets that face away are steeper than a limit; u is (cos / cos
            # limit)^power.
            limit = np.sqrt(toward**2 / (toward**2 + z**2))
            u = t**4
            jacobian = 4.0 * t**3 * weight
            cos = limit[:, None] * u[None, :] ** (1.0 / power[:, None])
            facing = toward[:, None] * np.sqrt(np.maximum(1.0 - cos**2, 0.0)) - z * cos
            inner = (facing / cos * jacobian).sum(axis=1) * limit**power / power
            out[k] = (inner * step).sum() / (np.pi * ax * ay) / z
        return out

    def G1(self, w: ArrayLike, m: ArrayLike, masking: str = "smith") -> Array:
        if choice("masking", masking, MASKINGS) != surface.SMITH:
            return super().G1(w, m, masking)
        facing = (directions("w", w) * directions("m", m)).sum(axis=-1) > 0.0
        return np.where(facing, 1.0 / (1.0 + self.Lambda(w)), 0.0)

    def G2(
        self,
        v: ArrayLike,
        l: ArrayLike,  # noqa: E741
        m: ArrayLike,
        masking: str = "smith",
        correlation: str = "height",
    ) -> Array:
        if choice("masking", masking, MASKINGS) != surface.SMITH:
            return super().G2(v, l, m, masking, correlation)
        code = choice("correlation", correlation, CORRELATIONS)
        if code not in (surface.HEIGHT, surface.SEPARABLE):
            raise ValueError("Phong's Smith masking knows the correlations 'height' and 'separable' only")
        first, second = self.G1(v, m), self.G1(l, m)
        with np.errstate(divide="ignore"):
            joint = 1.0 / (1.0 / first + 1.0 / second - 1.0)
        return first * second if code == surface.SEPARABLE else np.asarray(joint)

    def sample_visible(self, v: ArrayLike, u: ArrayLike, masking: str = "vcavity") -> Array:
        if choice("masking", masking, MASKINGS) != surface.VCAVITY:
            raise ValueError("Phong's visible normals are sampled with masking 'vcavity' only")
        return super().sample_visible(v, u, masking)

    def pdf_visible(self, v: ArrayLike, m: ArrayLike, masking: str = "vcavity") -> Array:
        if choice("masking", masking, MASKINGS) != surface.SMITH:
            return super().pdf_visible(v, m, masking)
        view = directions("v", v)
        seen = np.maximum((view * directions("m", m)).sum(axis=-1), 0.0)
        return np.asarray(self.G1(view, m) * seen * self.D(m) / view[..., 2])
