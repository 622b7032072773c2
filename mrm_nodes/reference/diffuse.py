"""Diffuse reflection: Lambert, EON, MaterialX's Oren-Nayar, and microfacets that are diffuse themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .checks import check_shapes, check_unit, colour, directions, first, scalar
from .compiled import Array
from .distributions import Distribution

# Fujii's constants in the albedo of the qualitative model (EON, eqs. 11 and 20).
C1 = 0.5 - 2.0 / (3.0 * np.pi)
C2 = 2.0 / 3.0 - 28.0 / (15.0 * np.pi)


def lambert(albedo: ArrayLike, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
    """Lambert's f = albedo / π in 1/sr where both directions are above the surface, else 0: shape (..., 3).

    Source: Pharr, Jakob and Humphreys 2023, Physically Based Rendering, section 9.2.

    Args:
        albedo: 0 to 1: a number or (..., 3).
        v: (..., 3), unit vectors to the viewer, in a frame whose normal is +z.
        l: (..., 3), to the light.

    Raises:
        ValueError: an albedo or a direction that is none, or shapes that do not broadcast.
    """
    rho = colour("albedo", albedo, 0.0, 1.0)
    view, light = directions("v", v), directions("l", l)
    check_unit("v", view)
    check_unit("l", light)
    check_shapes(albedo=rho.shape[:-1], v=view.shape[:-1], l=light.shape[:-1])
    lit = (view[..., 2:] > 0.0) & (light[..., 2:] > 0.0)
    return np.where(lit, rho / np.pi, 0.0)


def fujii_albedo(cosine: ArrayLike, roughness: ArrayLike) -> Array:
    """Directional albedo of Fujii's qualitative Oren-Nayar for unit single-scattering albedo (EON, eq. 14)."""
    mu, r = np.broadcast_arrays(np.asarray(cosine, np.float64), np.asarray(roughness, np.float64))
    mu = np.maximum(mu, 1e-300)
    sine = np.sqrt(np.maximum(1.0 - mu * mu, 0.0))
    # (1 - sin³) / cos without the cancellation at grazing angles.
    rest = mu * (1.0 + sine + sine * sine) / (1.0 + sine)
    g = sine * (np.arccos(np.minimum(mu, 1.0)) - sine * mu) + (2.0 / 3.0) * (sine * rest - sine)
    scale = 1.0 / (1.0 + C1 * r)
    return np.asarray(scale + r * scale * g / np.pi)


def _fujii_lost(roughness: Array) -> Array:
    """What the mean of `fujii_albedo` lacks of 1 (EON, eq. 20)."""
    return roughness * (C1 - C2) / (1.0 + C1 * roughness)


def eon(albedo: ArrayLike, roughness: ArrayLike, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
    """The energy-preserving Oren-Nayar BRDF in 1/sr, without the cosine: shape (..., 3).

    Zero unless both directions are above the surface. Source: Portsmouth, Kutz and Hill 2025, "EON: a practical
    energy-preserving rough diffuse BRDF", with its exact albedo (eq. 14).

    Args:
        albedo: a facet's, 0 to 1: a number or (..., 3).
        roughness: 0 to 1: (...).
        v: (..., 3), unit vectors to the viewer, in a frame whose normal is +z.
        l: (..., 3), to the light.

    Raises:
        ValueError: an argument outside its range, a direction that is none, or shapes that do not broadcast.
    """
    rho = colour("albedo", albedo, 0.0, 1.0)
    r = scalar("roughness", roughness, 0.0, 1.0)
    view, light = directions("v", v), directions("l", l)
    check_unit("v", view)
    check_unit("l", light)
    check_shapes(albedo=rho.shape[:-1], roughness=r.shape[:-1], v=view.shape[:-1], l=light.shape[:-1])
    s = (view[..., :2] * light[..., :2]).sum(axis=-1, keepdims=True)
    return _eon(rho, r, view[..., 2:], light[..., 2:], s)


def _eon(rho: Array, r: Array, cos_v: Array, cos_l: Array, s: Array) -> Array:
    lit = (cos_v > 0.0) & (cos_l > 0.0)
    mu_v, mu_l = np.maximum(cos_v, 1e-300), np.maximum(cos_l, 1e-300)
    ratio = np.where(s > 0.0, s / np.maximum(mu_v, mu_l), s)
    scale = 1.0 / (1.0 + C1 * r)
    single = rho / np.pi * scale * (1.0 + r * ratio)
    # At roughness 0 nothing is lost, and nothing is put back.
    lost = np.maximum(_fujii_lost(r), 1e-300)
    multiple_rho = rho * rho * (1.0 - lost) / (1.0 - rho * lost)
    lost_v = np.maximum(1.0 - fujii_albedo(mu_v, r), 0.0)
    lost_l = np.maximum(1.0 - fujii_albedo(mu_l, r), 0.0)
    multiple = np.where(r > 0.0, multiple_rho / np.pi * lost_v * lost_l / lost, 0.0)
    return np.where(lit, single + multiple, 0.0)


def oren_nayar(
    albedo: ArrayLike,
    roughness: ArrayLike,
    v: ArrayLike,
    l: ArrayLike,  # noqa: E741
    energy_compensation: bool = False,
) -> Array:
    """MaterialX's `oren_nayar_diffuse_bsdf` in 1/sr, without the cosine: shape (..., 3).

    Without `energy_compensation` the qualitative model of Oren and Nayar 1994, otherwise EON; in both, MaterialX
    keeps v.l from being negative. Other arguments, and what is raised (`ValueError`), as for `eon`, but that an albedo
    may be above 1, as MaterialX has it; with `energy_compensation` up to where what the facets give each other no
    longer sums up: 1 / (1 - E) with Fujii's mean albedo E, 5.98 at roughness 1.
    """
    rho = colour("albedo", albedo, 0.0)
    r = scalar("roughness", roughness, 0.0, 1.0)
    if energy_compensation:
        lost = _fujii_lost(r)
        bad = rho * lost >= 1.0
        if bad.any():
            raise ValueError(
                f"albedo must be below {1.0 / lost.max():.3g} with energy compensation at roughness {r.max():g}, "
                f"not {first(np.broadcast_to(rho, bad.shape), bad)}: facets would give each other ever more light"
            )
    view, light = directions("v", v), directions("l", l)
    check_unit("v", view)
    check_unit("l", light)
    check_shapes(albedo=rho.shape[:-1], roughness=r.shape[:-1], v=view.shape[:-1], l=light.shape[:-1])
    mu_v, mu_l = view[..., 2:], light[..., 2:]
    s = np.maximum((view * light).sum(axis=-1, keepdims=True), 1e-8) - mu_v * mu_l
    if energy_compensation:
        return _eon(rho, r, mu_v, mu_l, s)
    lit = (mu_v > 0.0) & (mu_l > 0.0)
    ratio = np.where(s > 0.0, s / np.maximum(np.maximum(mu_v, mu_l), 1e-300), 0.0)
    constant = 1.0 - 0.5 * r * r / (r * r + 0.33)
    slope = 0.45 * r * r / (r * r + 0.09)
    return np.where(lit, rho / np.pi * (constant + slope * ratio), 0.0)


def diffuse_microfacets(
    distribution: Distribution,
    albedo: ArrayLike,
    v: ArrayLike,
    l: ArrayLike,  # noqa: E741
    masking: str = "smith",
    correlation: str = "height",
    shadowing: bool = True,
    resolution: int = 64,
) -> Array:
    """A microsurface whose facets are Lambertian, first bounce only, in 1/sr without the cosine: shape (..., 3).

    Heitz 2014, eq. 31, by quadrature over normals: to 1e-3 of a smooth lobe's value. Albedo and directions as for
    `lambert`.

    Args:
        distribution: of the facets; its parameters are single numbers.
        masking: as in `G2`.
        correlation: as in `G2`.
        shadowing: without it G2 is G1(v, m), the integrand of the weak white furnace (eq. 37), and l may lie anywhere.
        resolution: the quadrature has 2 `resolution`² nodes.

    Raises:
        ValueError: as `lambert`; a distribution of arrays.
    """
    rho = colour("albedo", albedo, 0.0, 1.0)
    view, light = directions("v", v), directions("l", l)
    check_unit("v", view)
    check_unit("l", light)
    normals, weights = distribution.quadrature(resolution)
    check_shapes(albedo=rho.shape[:-1], v=view.shape[:-1], l=light.shape[:-1])
    shape = np.broadcast_shapes(view.shape[:-1], light.shape[:-1])
    view, light = (np.broadcast_to(d, (*shape, 3)).reshape(-1, 3) for d in (view, light))
    weights = weights * distribution.D(normals)
    total = np.zeros(len(view))
    last: tuple[Array, Array] | None = None
    for k, (a, b) in enumerate(zip(view, light, strict=True)):
        if a[2] <= 0.0 or (b[2] <= 0.0 and shadowing):
            continue
        seen = np.maximum(normals @ a, 0.0) * np.maximum(normals @ b, 0.0)
        if not seen.any():
            continue
        if shadowing:
            visible = distribution.G2(a, b, normals, masking, correlation)
        elif last is not None and np.array_equal(last[0], a):
            # Masking alone knows nothing of l.
            visible = last[1]
        else:
            visible = distribution.G1(a, normals, masking)
        last = a, visible
        total[k] = (weights * seen * visible).sum() / (np.pi * a[2] * abs(b[2]))
    return np.asarray(total.reshape(*shape, 1) * rho)
