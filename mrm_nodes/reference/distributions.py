"""Microfacet distributions as value classes whose methods are the symbols of Heitz 2014.

Directions and normals are unit vectors of shape (..., 3) in a frame whose normal is +z; everything
broadcasts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from . import asking
from .checks import (
    CORRELATIONS,
    DISTRIBUTIONS,
    MASKINGS,
    SMALLEST_ALPHA,
    call_of,
    check_shapes,
    check_unit,
    choice,
    directions,
    numbers,
    pair,
    scalar,
)
from .compiled import Array
from .masking import HEIGHT, SMITH, VCAVITY
from .microsurface import BECKMANN, BECKMANN_RATIONAL, PHONG
from .microsurface import GGX as GGX_NAME


def sampling_uniforms(u: ArrayLike, needed: int) -> Array:
    """Uniforms (..., 3) of which `needed` were asked for; `ValueError` for another shape or range."""
    uniforms = numbers("u", u, 0.0, 1.0)
    if uniforms.ndim == 0 or uniforms.shape[-1] not in (needed, 3):
        raise ValueError(f"u must have shape (..., {needed}), not {uniforms.shape}")
    if uniforms.shape[-1] == 2:
        uniforms = np.concatenate([uniforms, np.zeros((*uniforms.shape[:-1], 1))], axis=-1)
    return uniforms


class Distribution:
    """What the distributions of normals share; it is not made by itself. Equations are those of Heitz 2014.

    Directions v, l and w and normals m are unit vectors, (..., 3), in a frame whose normal is +z; they and the
    parameters broadcast. masking is "smith" (eq. 43) or "vcavity" (eq. 49), which are physics, or one of those of
    `G1`.

    Args:
        ax: microfacet width alpha along the tangent, 2.5e-9 or more: (...).
        ay: across it, by default the same: (...).
        slope_correlation: within ±0.9999, stretches along other axes (eq. 88): (...).
        mean_slope: slope of the mesosurface (eq. 94): (..., 2).

    Raises:
        ValueError: a parameter outside its range, a direction of another length than 1, another masking, or shapes
            that do not broadcast; so do the methods.
    """

    _distribution = GGX_NAME

    def __init__(
        self,
        ax: ArrayLike,
        ay: ArrayLike | None = None,
        slope_correlation: ArrayLike = 0.0,
        mean_slope: ArrayLike = 0.0,
    ) -> None:
        x = scalar("ax", ax, SMALLEST_ALPHA)
        y = x if ay is None else scalar("ay", ay, SMALLEST_ALPHA)
        check_shapes(ax=x.shape[:-1], ay=y.shape[:-1])
        self._alpha = np.concatenate(np.broadcast_arrays(x, y), axis=-1)
        self._rxy = scalar("slope_correlation", slope_correlation, -0.9999, 0.9999)
        self._mean = pair("mean_slope", mean_slope, -1e300, 1e300)

    def __repr__(self) -> str:
        return self._call_of(type(self))

    def _call_of(self, kind: type) -> str:
        x, y = self._alpha[..., :1], self._alpha[..., 1:]
        given = {"ax": x, "ay": None if np.array_equal(x, y) else y}
        return call_of(kind, {**given, "slope_correlation": self._rxy, "mean_slope": self._mean})

    @property
    def _is_sheared(self) -> bool:
        return bool(self._rxy.any() or self._mean.any())

    def _ask(
        self,
        question: str,
        v: ArrayLike | None = None,
        l: ArrayLike | None = None,  # noqa: E741
        m: ArrayLike | None = None,
        masking: str = SMITH,
        correlation: str = HEIGHT,
    ) -> Array:
        mask, correlated = (
            choice("masking", masking, MASKINGS),
            choice("correlation", correlation, CORRELATIONS),
        )
        up = np.array([0.0, 0.0, 1.0])
        arrays = []
        for name, value in (("v", v), ("l", l), ("m", m)):
            array = up if value is None else directions(name, value)
            if not (name == "l" and question == asking.VISIBLE_NORMAL):
                check_unit(name, array)
            arrays.append(array)
        try:
            part = asking.part(question, self._distribution, mask, correlated, self._is_sheared)
            v_, l_, m_ = arrays
            numbers_, normals = asking.ask(part, v_, l_, m_, self._alpha, self._rxy, self._mean)
            return normals if question == asking.VISIBLE_NORMAL else numbers_
        except ValueError as error:
            raise ValueError(f"shapes do not broadcast: {error}") from None
        except NotImplementedError as error:
            raise NotImplementedError(f"{type(self).__name__}: there is no {question}: {error}") from None

    def quadrature(self, resolution: int = 64) -> tuple[Array, Array]:
        """Normals (n, 3) and weights (n) in steradians for integrals over the hemisphere, dense where D is.

        Gauss-Legendre in the stretched slope's length over 1 + length, equal steps in its azimuth: n is
        2 `resolution`².

        Raises:
            ValueError: parameters that are arrays; a resolution that is no integer, or below 1.
        """
        if not isinstance(resolution, int) or resolution < 1:
            raise ValueError(f"resolution must be an integer, at least 1, not {resolution!r}")
        if self._alpha.size != 2 or self._rxy.size != 1 or self._mean.size != 2:
            raise ValueError(
                "a quadrature is for single parameters, not for arrays of them: ax, ay and slopes"
            )
        ax, ay, rxy, mean_x, mean_y = (
            float(value)
            for value in (*self._alpha.reshape(2), self._rxy.item(), *np.broadcast_to(self._mean, 2))
        )
        t, w = np.polynomial.legendre.leggauss(resolution)
        t, w = 0.5 * (t + 1.0), 0.5 * w
        length = t / (1.0 - t)
        azimuth = (np.arange(2 * resolution) + 0.5) * np.pi / resolution
        x, y = np.outer(length, np.cos(azimuth)), np.outer(length, np.sin(azimuth))
        root = math.sqrt(1.0 - rxy * rxy)
        slopes = ax * x + mean_x, ay * (rxy * x + root * y) + mean_y
        normals = np.stack([-slopes[0], -slopes[1], np.ones_like(x)], axis=-1).reshape(-1, 3)
        size = np.linalg.norm(normals, axis=-1)
        weights = np.repeat(w * length / (1.0 - t) ** 2, 2 * resolution) * (
            ax * ay * root * np.pi / resolution
        )
        return normals / size[:, np.newaxis], weights / size**3

    def D(self, m: ArrayLike) -> Array:
        """Density of normals per steradian and unit of geometric area: ∫ D(m) (m.n) dm = 1. Shape (...)."""
        return self._ask(asking.D, m=m)

    def Lambda(self, w: ArrayLike) -> Array:
        """Smith's Λ of a direction above the mesosurface (eqs. 83, 86, 96), infinite below it. Shape (...)."""
        return self._ask(asking.LAMBDA, v=w)

    def G1(self, w: ArrayLike, m: ArrayLike, masking: str = "smith") -> Array:
        """Share of facets with normal m that are seen from w. Shape (...).

        "smith" (eq. 43) and "vcavity" (49) are physics. "implicit" (56), "schlick-smith" and "kelemen" (59)
        belong to no microsurface and fail the white furnace test: they are here to reproduce Heitz's Table
        3."""
        return self._ask(asking.G1, v=w, m=m, masking=masking)

    def G2(
        self,
        v: ArrayLike,
        l: ArrayLike,  # noqa: E741
        m: ArrayLike,
        masking: str = "smith",
        correlation: str = "height",
    ) -> Array:
        """Share of facets with normal m that are seen from both v and l. Shape (...).

        Smith's `correlation` is "height" (eq. 99), "separable" (98), "direction" (100) or
        "height_direction" (101); with l on the other side than v, height correlation is the Beta function
        of Λ and direction correlation has no meaning. V-cavities ignore it: min(G1, G1), which is Cook and
        Torrance's min(1, M, S), and max(0, G1 + G1 - 1) across."""
        return self._ask(asking.G2, v=v, l=l, m=m, masking=masking, correlation=correlation)

    def sample_visible(self, v: ArrayLike, u: ArrayLike, masking: str = "smith") -> Array:
        """Normals drawn from those visible from v (Heitz and d'Eon 2014). Shape (..., 3).

        Args:
            u: uniforms in [0, 1], (..., 2), or (..., 3) for V-cavities.

        Raises:
            ValueError: v is below the surface.
        """
        uniforms = sampling_uniforms(u, 3 if choice("masking", masking, MASKINGS) == VCAVITY else 2)
        view = directions("v", v)
        if not (view[..., 2] - (self._mean * view[..., :2]).sum(axis=-1) >= 0.0).all():
            raise ValueError("v must be above the surface whose visible normals are sampled")
        return self._ask(asking.VISIBLE_NORMAL, v=view, l=uniforms, masking=masking)

    def pdf_visible(self, v: ArrayLike, m: ArrayLike, masking: str = "smith") -> Array:
        """Density of visible normals, G1(v, m) <v, m> D(m) / (v.n) (eq. 16), per steradian. Shape (...)."""
        return self._ask(asking.PDF, v=v, m=m, masking=masking)


class GGX(Distribution):
    """The GGX (Trowbridge-Reitz) distribution (Heitz 2014): D eq. 85, Λ eq. 86. Parameters as of `Distribution`."""


class Beckmann(Distribution):
    """The Beckmann distribution (Heitz 2014): D eq. 82, Λ eq. 83, exact with erf. Parameters as of `Distribution`."""

    _distribution = BECKMANN


class BeckmannRational(Distribution):
    """Beckmann with Walter's rational fit of Λ (Heitz 2014, below eq. 69), which other renderers use.

    It is 0.4 % off in G1. Parameters as of `Distribution`.
    """

    _distribution = BECKMANN_RATIONAL


class _Named(Distribution):
    """One that has no class of its own."""

    _distribution = ""

    def __init__(self, name: str, *parameters: ArrayLike | None) -> None:
        super().__init__(*parameters)  # type: ignore[arg-type]
        self._distribution = name

    def __repr__(self) -> str:
        return self._call_of(Distribution).replace(
            "Distribution(", f"distribution({self._distribution!r}, ", 1
        )


def distribution(
    name: str,
    ax: ArrayLike,
    ay: ArrayLike | None = None,
    slope_correlation: ArrayLike = 0.0,
    mean_slope: ArrayLike = 0.0,
) -> Distribution:
    """A distribution by the name that lobes know it by. The other parameters are those of `Distribution`.

    Raises:
        ValueError: a name that is not known, slopes for phong, and as `Distribution`.
    """
    code = choice("distribution", name, DISTRIBUTIONS)
    sheared = np.any(slope_correlation) or np.any(mean_slope)
    if sheared and code == PHONG:
        raise ValueError("slope_correlation and mean_slope must be 0 for the phong distribution")
    slopes: tuple[ArrayLike, ...] = (slope_correlation, mean_slope) if sheared else ()
    for known in Distribution.__subclasses__():
        if known._distribution == code:
            return known(ax, ay, *slopes)
    return _Named(code, ax, ay, *slopes)
