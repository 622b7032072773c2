"""The lobes: conductor, dielectric and generalised Schlick, forward and retroreflective.

A lobe is a small value class: what it is made of, already checked, and four questions (`eval`, `pdf`,
`sample`, `albedo`). The work is done by the compiled passes of `kernels`."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import block, kernels
from . import energy_formulas as energy
from . import microsurface as surface
from .albedo_fit import COEFFICIENTS, split_sum
from .checks import (
    COMPENSATIONS,
    CORRELATIONS,
    DISTRIBUTIONS,
    LARGEST_INDEX,
    MASKINGS,
    SCATTER_MODES,
    check_unit,
    choice,
    colour,
    directions,
    first,
    pair,
    scalar,
)
from .compiled import Array, Kernel, run
from .energy import any_lobe_table, white_albedo_table
from .fresnel import CONDUCTOR, DIELECTRIC, SCHLICK
from .quadrature import quadrature_nodes


class BsdfSample(NamedTuple):
    """What `sample` drew.

    l : (..., 3) unit directions. weight : (..., 3), f |l.n| / pdf. pdf : (...) per steradian; for a delta,
    the probability with which it was chosen. delta : (...) whether l is the only direction that it could
    have been. A rejected sample has weight 0 and pdf 0."""

    l: Array  # noqa: E741
    weight: Array
    pdf: Array
    delta: NDArray[np.bool_]


class Lobe:
    """What the three lobes share: one reflection lobe, one transmission lobe, each forward, retro or a blend.

    Every parameter is a number or an array: scalars `(...)`, colours `(..., 3)`, `alpha` a number, a pair
    or `(..., 2)`; all broadcast with the directions. Directions are unit vectors away from the surface, in
    a frame whose normal is +z and whose tangent is +x. Phong's masking is the V-cavities' whatever `masking` says;
    its Smith masking is that of `Phong`. Sources: "The Minimal Retroreflective Microfacet
    Model" (001) and Heitz 2014."""

    def __init__(
        self,
        kind: int,
        colours: tuple[Array, Array, Array],
        exponent: ArrayLike,
        tint: ArrayLike,
        alpha: ArrayLike,
        retroreflectivity: ArrayLike,
        distribution: str,
        masking: str,
        correlation: str,
        energy_compensation: str | None,
        thinfilm_thickness: ArrayLike,
        thinfilm_ior: ArrayLike,
        scatter_mode: str,
        retro_transmission: bool,
        slope_correlation: ArrayLike,
        mean_slope: ArrayLike,
    ) -> None:
        power = scalar("exponent", exponent, 0.0)
        self._kind = kind
        self._distribution = choice("distribution", distribution, DISTRIBUTIONS)
        self._masking = choice("masking", masking, MASKINGS)
        if self._distribution == surface.PHONG:
            if self._masking not in (surface.SMITH, surface.VCAVITY):
                raise ValueError(
                    f"masking must be 'smith' or 'vcavity' for the phong distribution, not {masking!r}"
                )
            # Phong has no Smith masking in closed form; the V-cavity's asks nothing of the distribution.
            self._masking = surface.VCAVITY
        self._correlation = choice("correlation", correlation, CORRELATIONS)
        self._compensation = choice("energy_compensation", energy_compensation, COMPENSATIONS)
        self._scatter = choice("scatter_mode", scatter_mode, SCATTER_MODES)
        self._retro_transmission = bool(retro_transmission)
        self._alpha = pair("alpha", alpha, 0.0, np.inf, open_low=True)
        self._retro = scalar("retroreflectivity", retroreflectivity, 0.0, 1.0)
        self._rxy = scalar("slope_correlation", slope_correlation, -0.9999, 0.9999)
        self._mean = pair("mean_slope", mean_slope, -1e300, 1e300)
        shifted = bool(self._mean.any())
        skewed = shifted or bool(self._rxy.any())
        if skewed and self._distribution == surface.PHONG:
            raise ValueError("slope_correlation and mean_slope must be 0 for the phong distribution")
        if shifted and (self._masking == surface.VCAVITY or self._retro.any()):
            raise ValueError(
                "mean_slope must be 0 with V-cavities and with retroreflectivity: "
                "both need a distribution that is symmetric about the normal"
            )
        if shifted and self._compensation in (energy.TURQUIN, energy.KULLA_CONTY):
            raise ValueError(
                f"mean_slope must be 0 with energy_compensation {energy_compensation!r}: "
                "its tables are of slopes that are centred on the normal"
            )
        unphysical = self._masking not in (surface.SMITH, surface.VCAVITY)
        if unphysical and self._scatter != block.REFLECT:
            raise ValueError(
                f"masking {masking!r} is for reflection only: scatter_mode must be 'R', not {scatter_mode!r}"
            )
        self._parameters = [
            self._alpha,
            self._retro,
            *colours,
            power,
            scalar("thinfilm_thickness", thinfilm_thickness, 0.0),
            scalar("thinfilm_ior", thinfilm_ior, 0.0, open_low=True),
            self._rxy,
            self._mean,
            colour("tint", tint, 0.0),
        ]
        self._modes = [
            kind,
            self._distribution,
            self._masking,
            self._correlation,
            self._compensation,
            self._scatter,
            int(self._retro_transmission),
            int(skewed),
            int(bool(np.all(power == 5.0))),
        ]
        try:
            self._shape = np.broadcast_shapes(*(p.shape[:-1] for p in self._parameters))
        except ValueError as error:
            raise ValueError(f"the parameters' shapes do not broadcast: {error}") from None

    @functools.cached_property
    def _table(self) -> Array:
        """What the compensation reads its albedo from."""
        if self._compensation in (energy.MATERIALX_1_39_5, energy.MATERIALX_1_39_6):
            return np.array(COEFFICIENTS[self._fit_pair()])
        if self._compensation in (energy.TURQUIN, energy.KULLA_CONTY):
            isotropic = not self._rxy.any() and np.array_equal(self._alpha[..., 0], self._alpha[..., 1])
            make = white_albedo_table if isotropic else any_lobe_table
            return make(self._distribution, self._masking, self._correlation)
        return np.ones((2, 2))

    def _fit_pair(self) -> tuple[str, str]:
        name = {surface.GGX: "ggx", surface.PHONG: "phong"}.get(self._distribution, "beckmann")
        return name, "vcavity" if self._masking == surface.VCAVITY else "smith"

    def _run(
        self, kernel: Kernel, v: Array, second: Array, components: Sequence[int], *tables: Array
    ) -> tuple[list[Array], int]:
        inputs = [v, second, *self._parameters]
        try:
            return run(kernel, inputs, self._modes, components, [self._table, *tables])
        except ValueError as error:
            shapes = f"v {v.shape}, l or u {second.shape}, parameters {self._shape}"
            raise ValueError(f"shapes do not broadcast: {shapes} ({error})") from None

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The scattering function f(v, l) in 1/sr, without the cosine: shape (..., 3).

        Eq. 1 and 2 of 001, with v' for v in the retro share (eq. 10). v.z > 0 is seen from outside (index
        1), v.z < 0 from inside (index `ior`); l on the other side than v gives the transmitted radiance's
        function, which is zero where `scatter_mode` has none and where the index is 1 (a delta, which
        `sample` and `albedo` know). `ValueError` for directions whose length is not 1 to 1e-6, and for
        shapes that do not broadcast."""
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run(kernels.EVALUATE, view, light, [3])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows: a polar plot."""
        from .polar import polar_png

        return polar_png(self)

    def pdf(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The density per steradian with which `sample(v, u)` draws l: shape (...). Errors as in `eval`.

        001 Section 4; in transmission its eq. 5 with ηl², as differentiation with respect to l gives it.
        """
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run(kernels.DENSITY, view, light, [1])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result[..., 0]

    def sample(self, v: ArrayLike, u: ArrayLike) -> BsdfSample:
        """Draw a direction l for each v from uniforms u in [0, 1), shape (..., 3).

        Visible normals (Heitz and d'Eon 2014) are reflected or refracted by Fresnel's law; a blend turns
        the result about the normal with probability `retroreflectivity`, and `pdf` is the mixture's (001
        Section 4)."""
        view = directions("v", v)
        uniforms = directions("u", u)
        if not ((uniforms >= 0.0) & (uniforms <= 1.0)).all():
            bad = ~((uniforms >= 0.0) & (uniforms <= 1.0))
            raise ValueError(f"u must be in [0, 1], not {first(uniforms, bad)}")
        (drawn,), rejected = self._run(kernels.DRAW, view, uniforms, [8])
        if rejected:
            check_unit("v", view)
        light = np.ascontiguousarray(drawn[..., :3])
        value, density = self.eval(view, light), self.pdf(view, light)[..., np.newaxis]
        (weight, chance), _ = run(kernels.WEIGH, [drawn, value, density], [], [3, 1])
        return BsdfSample(light, weight, chance[..., 0], drawn[..., 3] > 0.0)

    def albedo(self, v: ArrayLike) -> Array:
        """Directional albedo as energy, reflected and transmitted together: shape (..., 3).

        The average of F G2 / G1 over visible normals by quadrature. Forward and retro lobes have the same
        (001 eq. 18). A delta (index 1) is counted. `ValueError` as in `eval`."""
        view = directions("v", v)
        (parts,), rejected = self._run(kernels.INTEGRATE, view, np.zeros(3), [3], quadrature_nodes())
        if rejected:
            check_unit("v", view)
        return parts

    def _reflectance(self, cosine: Array, scheme: int) -> Array:
        """RGB reflectance from outside at cosines of shape (..., 1)."""
        padded = np.broadcast_to(cosine, (*cosine.shape[:-1], 3))
        modes = list(self._modes)
        modes[block.COMPENSATION] = scheme
        inputs = [np.array([0.0, 0.0, 1.0]), padded, *self._parameters]
        (result,), _ = run(kernels.REFLECTANCE, inputs, modes, [3], [self._table])
        return result

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        """What MaterialX's `layer` multiplies the base with when this lobe lies on top: shape (..., 3).

        1 - weight * directional albedo, the albedo being MaterialX's split-sum fit F0 A + F90 B times the
        factor of its energy compensation. That factor takes F at v.h of each lobe for a light l, and at v.n
        without one (environments) up to 1.39.5; the lobes of a blend are mixed linearly. A conductor lets
        nothing through, a lobe without reflection everything. `ValueError` for the compensations that
        MaterialX does not have."""
        view = directions("v", v)
        shape = np.broadcast_shapes(view.shape[:-1], self._shape)
        amount = scalar("weight", weight, 0.0)
        check_unit("v", view)
        if self._kind == CONDUCTOR:
            return np.zeros((*np.broadcast_shapes(shape, amount.shape[:-1]), 3))
        if self._compensation not in (energy.NONE, energy.MATERIALX_1_39_5, energy.MATERIALX_1_39_6):
            raise ValueError(
                "throughput is MaterialX's: energy_compensation must be None or one of its versions"
            )
        cosine = np.clip(np.abs(view[..., 2:]), 1e-8, 1.0)
        mean_alpha = np.sqrt(self._alpha[..., :1] * self._alpha[..., 1:])
        a, b = split_sum(self._fit_pair(), cosine, mean_alpha)
        if self._kind == SCHLICK:
            f0, f90 = self._parameters[2], self._parameters[4]
        else:
            f0 = ((self._parameters[2] - 1.0) / (self._parameters[2] + 1.0)) ** 2
            f90 = np.ones(3)
        bare = f0 * a + f90 * b

        def covered(mirrored: Array) -> Array:
            if self._compensation == energy.NONE:
                return bare
            at = cosine
            if l is not None and self._compensation == energy.MATERIALX_1_39_5:
                light = directions("l", l)
                check_unit("l", light)
                half = mirrored + light
                at = np.clip(0.5 * np.linalg.norm(half, axis=-1, keepdims=True), 1e-8, 1.0)
            f = self._reflectance(at, self._compensation)
            return np.asarray(bare * (1.0 + f * (1.0 - (a + b)) / (a + b)))

        side = np.where(view[..., 2:] < 0.0, -1.0, 1.0)
        forward, retro = side * view, side * view * np.array([-1.0, -1.0, 1.0])
        albedo = (1.0 - self._retro) * covered(forward) + self._retro * covered(retro)
        if self._kind == SCHLICK:
            albedo = np.broadcast_to(albedo.mean(axis=-1, keepdims=True), albedo.shape)
        if self._scatter == block.TRANSMIT:
            albedo = np.zeros_like(albedo)
        return np.asarray(1.0 - amount * albedo)


class Conductor(Lobe):
    """A conductor: reflection only, opaque from inside.

    `ior` > 0 and `extinction` >= 0 are the complex index relative to the outside, a number or (..., 3).
    `ValueError` names the argument that makes no sense."""

    def __init__(
        self,
        ior: ArrayLike,
        extinction: ArrayLike,
        alpha: ArrayLike,
        retroreflectivity: ArrayLike = 0.0,
        distribution: str = "ggx",
        masking: str = "smith",
        correlation: str = "height",
        energy_compensation: str | None = None,
        thinfilm_thickness: ArrayLike = 0.0,
        thinfilm_ior: ArrayLike = 1.5,
        slope_correlation: ArrayLike = 0.0,
        mean_slope: ArrayLike = 0.0,
    ) -> None:
        colours = (
            colour("ior", ior, 0.0, LARGEST_INDEX, open_low=True),
            colour("extinction", extinction, 0.0, LARGEST_INDEX),
            np.zeros(3),
        )
        super().__init__(
            CONDUCTOR, colours, 5.0, 1.0, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, "R", False, slope_correlation, mean_slope,
        )  # fmt: skip


class Dielectric(Lobe):
    """A dielectric interface of index `ior` > 0 inside, 1 outside: reflection ("R"), transmission ("T") or
    both ("RT").

    `tint` (>= 0, a number or (..., 3)) multiplies both lobes, as in MaterialX. `retro_transmission` turns the
    transmission lobe as well; off is the advice of 001, Section 5.
    """

    def __init__(
        self,
        ior: ArrayLike,
        alpha: ArrayLike,
        tint: ArrayLike = 1.0,
        scatter_mode: str = "R",
        retro_transmission: bool = False,
        retroreflectivity: ArrayLike = 0.0,
        distribution: str = "ggx",
        masking: str = "smith",
        correlation: str = "height",
        energy_compensation: str | None = None,
        thinfilm_thickness: ArrayLike = 0.0,
        thinfilm_ior: ArrayLike = 1.5,
        slope_correlation: ArrayLike = 0.0,
        mean_slope: ArrayLike = 0.0,
    ) -> None:
        index = scalar("ior", ior, 0.0, LARGEST_INDEX, open_low=True)
        colours = (np.broadcast_to(index, (*index.shape[:-1], 3)), np.zeros(3), np.zeros(3))
        super().__init__(
            DIELECTRIC, colours, 5.0, tint, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, scatter_mode, retro_transmission,
            slope_correlation, mean_slope,
        )  # fmt: skip


class GeneralizedSchlick(Lobe):
    """A lobe with Schlick's reflectance from `color0` to `color90`, tinted by `color82` at 82 degrees.

    Colours are >= 0, numbers or (..., 3); `exponent` >= 0. Transmission refracts with the index that
    MaterialX derives from the mean of `color0`."""

    def __init__(
        self,
        color0: ArrayLike,
        color82: ArrayLike = 1.0,
        color90: ArrayLike = 1.0,
        exponent: ArrayLike = 5.0,
        alpha: ArrayLike = 0.0025,
        scatter_mode: str = "R",
        retro_transmission: bool = False,
        retroreflectivity: ArrayLike = 0.0,
        distribution: str = "ggx",
        masking: str = "smith",
        correlation: str = "height",
        energy_compensation: str | None = None,
        thinfilm_thickness: ArrayLike = 0.0,
        thinfilm_ior: ArrayLike = 1.5,
        slope_correlation: ArrayLike = 0.0,
        mean_slope: ArrayLike = 0.0,
    ) -> None:
        colours = (
            colour("color0", color0, 0.0),
            colour("color82", color82, 0.0),
            colour("color90", color90, 0.0),
        )
        super().__init__(
            SCHLICK, colours, exponent, 1.0, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, scatter_mode, retro_transmission,
            slope_correlation, mean_slope,
        )  # fmt: skip
