"""The lobes: conductor, dielectric and generalised Schlick, forward and retroreflective.

A lobe is a small value class: what it is made of, already checked, and four questions (`eval`, `pdf`,
`sample`, `albedo`). The work is done by the compiled passes of `kernels`."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import block, kernels, parts
from . import energy_formulas as energy
from .albedo_fit import COEFFICIENTS
from .checks import (
    COMPENSATIONS,
    CORRELATIONS,
    DISTRIBUTIONS,
    LARGEST_INDEX,
    MASKINGS,
    SCATTER_MODES,
    SMALLEST_ALPHA,
    call_of,
    check_unit,
    choice,
    colour,
    directions,
    first,
    name_of,
    numbers,
    pair,
    scalar,
)
from .compiled import Array, Kernel, run
from .energy import white_albedo_table
from .fresnel import CONDUCTOR, DIELECTRIC, SCHLICK
from .lobe import Facets, facets
from .masking import SMITH, VCAVITY
from .microsurface import DISTRIBUTIONS as SHAPE_INVARIANT
from .microsurface import PHONG
from .quadrature import quadrature_nodes


class BsdfSample(NamedTuple):
    """What `Lobe.sample` drew (Portsmouth et al. 2026, Section 4). A rejected sample has weight 0 and pdf 0."""

    l: Array  # noqa: E741
    """(..., 3) unit directions."""
    weight: Array
    """(..., 3), f |l.n| / pdf."""
    pdf: Array
    """(...) per steradian; for a delta, the probability with which it was chosen."""
    delta: NDArray[np.bool_]
    """(...) whether l is the only direction that it could have been."""


class Lobe:
    """What `Conductor`, `Dielectric` and `GeneralizedSchlick` share; it is not made by itself.

    One reflection lobe, one transmission lobe, each forward, retro or a blend. Parameters, which are those of
    `Conductor`, broadcast with the directions. Directions are unit vectors away from the surface, (..., 3), in a
    frame whose normal is +z and whose tangent is +x. Sources: Portsmouth et al. 2026, "The Minimal Retroreflective
    Microfacet Model", eqs. 1 to 18, and Heitz 2014, "Understanding the Masking-Shadowing Function in
    Microfacet-Based BRDFs".

    Raises:
        ValueError: a parameter outside its range, names that are not known or do not go together, or shapes that do
            not broadcast.
    """

    _colours: ClassVar[tuple[str, ...]] = ()
    """What the reflectance's own parameters are called."""

    def __init__(
        self,
        *,
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
        if self._distribution == PHONG:
            if self._masking not in (SMITH, VCAVITY):
                raise ValueError(
                    f"masking must be 'smith' or 'vcavity' for the phong distribution, not {masking!r}"
                )
            # Phong has no Smith masking in closed form; the V-cavity's asks nothing of the distribution.
            self._masking = VCAVITY
        self._correlation = choice("correlation", correlation, CORRELATIONS)
        self._compensation = choice("energy_compensation", energy_compensation, COMPENSATIONS)
        self._scatter = choice("scatter_mode", scatter_mode, SCATTER_MODES)
        self._retro_transmission = bool(retro_transmission)
        self._alpha = pair("alpha", alpha, SMALLEST_ALPHA, np.inf)
        self._retro = scalar("retroreflectivity", retroreflectivity, 0.0, 1.0)
        self._rxy = scalar("slope_correlation", slope_correlation, -0.9999, 0.9999)
        self._mean = pair("mean_slope", mean_slope, -1e300, 1e300)
        shifted = bool(self._mean.any())
        skewed = shifted or bool(self._rxy.any())
        if skewed and self._distribution == PHONG:
            raise ValueError("slope_correlation and mean_slope must be 0 for the phong distribution")
        if shifted and (self._masking == VCAVITY or self._retro.any()):
            raise ValueError(
                "mean_slope must be 0 with V-cavities and with retroreflectivity: "
                "both need a distribution that is symmetric about the normal"
            )
        if shifted and self._compensation in (energy.TURQUIN, energy.KULLA_CONTY):
            raise ValueError(
                f"mean_slope must be 0 with energy_compensation {energy_compensation!r}: "
                "its tables are of slopes that are centred on the normal"
            )
        unphysical = self._masking not in (SMITH, VCAVITY)
        if unphysical and self._scatter != block.REFLECT:
            raise ValueError(
                f"masking {masking!r} is for reflection only: scatter_mode must be 'R', not {scatter_mode!r}"
            )
        self._parameters = block.Parameters(
            alpha=self._alpha,
            retroreflectivity=self._retro,
            a=colours[0],
            b=colours[1],
            c=colours[2],
            exponent=power,
            thinfilm_thickness=scalar("thinfilm_thickness", thinfilm_thickness, 0.0),
            thinfilm_ior=scalar("thinfilm_ior", thinfilm_ior, 0.0, open_low=True),
            slope_correlation=self._rxy,
            mean_slope=self._mean,
            tint=colour("tint", tint, 0.0),
        )
        self._is_sheared = skewed
        self._is_fifth = bool(np.all(power == 5.0))
        self._modes = block.Modes(
            kind=kind,
            compensation=self._compensation,
            scatter=self._scatter,
            retro_transmission=int(self._retro_transmission),
        )
        try:
            self._shape = np.broadcast_shapes(*(p.shape[:-1] for p in self._parameters))
        except ValueError as error:
            raise ValueError(f"the parameters' shapes do not broadcast: {error}") from None

    def __repr__(self) -> str:
        made_of = self._parameters
        given: dict[str, Any] = {
            **dict(zip(self._colours, (made_of.a, made_of.b, made_of.c), strict=False)),
            "exponent": made_of.exponent,
            "alpha": self._alpha,
            "retroreflectivity": self._retro,
            "distribution": name_of(self._distribution, DISTRIBUTIONS),
            "masking": name_of(self._masking, MASKINGS),
            "correlation": name_of(self._correlation, CORRELATIONS),
            "energy_compensation": name_of(self._compensation, COMPENSATIONS),
            "thinfilm_thickness": made_of.thinfilm_thickness,
            "thinfilm_ior": made_of.thinfilm_ior,
            "scatter_mode": name_of(self._scatter, SCATTER_MODES),
            "retro_transmission": self._retro_transmission,
            "slope_correlation": self._rxy,
            "mean_slope": self._mean,
            "tint": made_of.tint,
        }
        return call_of(type(self), given)

    @functools.cached_property
    def _table(self) -> Array:
        """What the compensation reads its albedo from."""
        if self._compensation in (energy.MATERIALX_1_39_5, energy.MATERIALX_1_39_6):
            return np.array(COEFFICIENTS[self._fit_pair()])
        if self._compensation in (energy.TURQUIN, energy.KULLA_CONTY):
            return white_albedo_table(self._distribution, self._masking, self._correlation)
        return np.ones((2, 2))

    def _fit_pair(self) -> tuple[str, str]:
        """Of what MaterialX's nodes can be: other maskings have Smith's fit."""
        known = SHAPE_INVARIANT.get(self._distribution)
        pair = (
            self._distribution if known is None else known.fitted,
            VCAVITY if self._masking == VCAVITY else SMITH,
        )
        if pair not in COEFFICIENTS:
            raise NotImplementedError(f"{self._distribution}: there is no fit of its albedo")
        return pair

    @property
    def _facets(self) -> Facets:
        """The formulas of what its arguments name; `NotImplementedError` where there are none."""
        return facets(self._distribution, self._masking, self._correlation, self._is_sheared)

    def _answering(self, question: str, scheme: int | None = None) -> block.Modes:
        """What a kernel is told: the parts that answer a question, with another compensation where one is named."""
        modes = self._modes if scheme is None else self._modes._replace(compensation=scheme)
        return parts.answering(question, modes, self._facets, self._is_fifth)

    def _run(
        self,
        question: str,
        kernel: Kernel,
        v: Array,
        second: Array,
        components: Sequence[int],
        *tables: Array,
    ) -> tuple[list[Array], int]:
        inputs = [v, second, *self._parameters]
        modes = self._answering(question)
        try:
            return run(kernel, inputs, modes, components, [self._table, *tables])
        except ValueError as error:
            shapes = f"v {v.shape}, l or u {second.shape}, parameters {self._shape}"
            raise ValueError(f"shapes do not broadcast: {shapes} ({error})") from None

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The scattering function f(v, l) in 1/sr, without the cosine: shape (..., 3).

        Portsmouth et al. 2026, eqs. 1 and 2, with v' for v in the retro share (eq. 10). v.z > 0 is seen from
        outside (index 1), v.z < 0 from inside (index `ior`); l on the other side than v gives the transmitted
        radiance's function, which is zero where `scatter_mode` has none and where the index is 1 (a delta, which
        `sample` and `albedo` know).

        Args:
            v: (..., 3), where the light goes.
            l: (..., 3), where it comes from.

        Raises:
            ValueError: a direction whose length is not 1 to 1e-6, or shapes that do not broadcast.
        """
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run("eval", kernels.EVALUATE, view, light, [3])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows: a polar plot."""
        from .polar import polar_png

        return polar_png(self)

    def pdf(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The density per steradian with which `sample(v, u)` draws l: shape (...).

        Portsmouth et al. 2026, Section 4; in transmission its eq. 5 with ηl², as differentiation with respect to l
        gives it. Arguments and errors as in `eval`.
        """
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run("pdf", kernels.DENSITY_KERNEL, view, light, [1])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result[..., 0]

    def sample(self, v: ArrayLike, u: ArrayLike) -> BsdfSample:
        """Draw a direction l for each v.

        Visible normals (Heitz and d'Eon 2014) are reflected or refracted by Fresnel's law; a blend turns the result
        about the normal with probability `retroreflectivity`, and `pdf` is the mixture's (Portsmouth et al. 2026,
        Section 4). Between reflection and transmission the mean of the three reflectances decides: without compensation
        the mean of a weight's channels, as energy, is at most 1 (times a tint), a single channel at most 3.

        Args:
            v: (..., 3), as in `eval`.
            u: (..., 3), uniforms in [0, 1).

        Raises:
            ValueError: a direction that is none, a number outside of [0, 1], or shapes that do not broadcast.
        """
        view = directions("v", v)
        uniforms = directions("u", u)
        (light, weight, density, delta), rejected = self._run(
            "sample", kernels.SAMPLE, view, uniforms, [3, 3, 1, 1]
        )
        if rejected:
            bad = ~((uniforms >= 0.0) & (uniforms <= 1.0))
            if bad.any():
                raise ValueError(f"u must be in [0, 1], not {first(uniforms, bad)}")
            check_unit("v", view)
        return BsdfSample(light, weight, density[..., 0], delta[..., 0] > 0.0)

    def albedo(self, v: ArrayLike) -> Array:
        """Directional albedo as energy, reflected and transmitted together: shape (..., 3).

        The average of F G2 / G1 over visible normals by quadrature. Forward and retro lobes have the same
        (Portsmouth et al. 2026, eq. 18). A delta (index 1) is counted. Errors as in `eval`, v too: (..., 3).
        """
        view = directions("v", v)
        (parts,), rejected = self._run(
            "albedo", kernels.INTEGRATE, view, np.zeros(3), [3], quadrature_nodes()
        )
        if rejected:
            check_unit("v", view)
        return parts

    def reflectance(self, cosine: ArrayLike) -> Array:
        """Fresnel reflectance from outside, its film's where it has one: shape (..., 3).

        Args:
            cosine: (...), of the half angle, in [0, 1].

        Raises:
            ValueError: a cosine outside its range, or shapes that do not broadcast.
        """
        at = numbers("cosine", cosine, 0.0, 1.0)[..., np.newaxis]
        return self._reflectance(at, energy.NONE)

    def _reflectance(self, cosine: Array, scheme: int) -> Array:
        """RGB reflectance from outside at cosines of shape (..., 1)."""
        padded = np.broadcast_to(cosine, (*cosine.shape[:-1], 3))
        inputs = [np.array([0.0, 0.0, 1.0]), padded, *self._parameters]
        (result,), _ = run(
            kernels.REFLECTANCE_KERNEL, inputs, self._answering("reflectance", scheme), [3], [self._table]
        )
        return result


class Conductor(Lobe):
    """A conductor: reflection only, opaque from inside.

    Portsmouth et al. 2026, eqs. 1 and 10, blended as in Section 4, with the reflectance of
    `fresnel_conductor`.

    Args:
        ior: real part of the complex index relative to the outside, above 0: a number or (..., 3).
        extinction: its imaginary part, at least 0: a number or (..., 3).
        alpha: microfacet width, 2.5e-9 or more: a number, a pair along tangent and bitangent, or (..., 2). It is
            the square of a perceptual roughness.
        retroreflectivity: share of the lobe that returns to the light, 0 to 1: (...).
        distribution: `ggx`, `beckmann`, `beckmann-rational` (Walter's fit of its masking) or `phong`.
        masking: `smith` or `vcavity` (`cook-torrance` is its other name); phong always has the V-cavities', and its
            Smith masking is that of `Phong`. `implicit`, `schlick-smith` and `kelemen` belong to no microsurface.
        correlation: of Smith's masking and shadowing: `height`, `separable`, `direction` or `height_direction`.
        energy_compensation: None, `materialx-1.39.5`, `materialx-1.39.6`, `turquin` or `kulla-conty`.
        thinfilm_thickness: in nm, at least 0; 0 for none: (...).
        thinfilm_ior: index of the film, above 0: (...).
        slope_correlation: of the slopes along tangent and bitangent, within ±0.9999 (Heitz 2014, eq. 88): (...).
        mean_slope: slope of the mesosurface (Heitz 2014, eq. 94): (..., 2).

    Raises:
        ValueError: names the argument that makes no sense.
    """

    _colours = ("ior", "extinction")

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
            kind=CONDUCTOR,
            colours=colours,
            exponent=5.0,
            tint=1.0,
            alpha=alpha,
            retroreflectivity=retroreflectivity,
            distribution=distribution,
            masking=masking,
            correlation=correlation,
            energy_compensation=energy_compensation,
            thinfilm_thickness=thinfilm_thickness,
            thinfilm_ior=thinfilm_ior,
            scatter_mode="R",
            retro_transmission=False,
            slope_correlation=slope_correlation,
            mean_slope=mean_slope,
        )


class Dielectric(Lobe):
    """A dielectric interface: reflection, transmission or both.

    Portsmouth et al. 2026, eqs. 1, 2 and 10, blended as in Section 4, with the reflectance of
    `fresnel_dielectric`. Parameters that are not listed are as for `Conductor`.

    Args:
        ior: index inside, above 0; outside it is 1: (...).
        tint: multiplies both lobes, at least 0, as in MaterialX: a number or (..., 3).
        scatter_mode: `R`, `T` or `RT`.
        retro_transmission: whether `retroreflectivity` turns the transmission lobe as well; off is the advice of
            Portsmouth et al. 2026, Section 5.

    Raises:
        ValueError: names the argument that makes no sense.
    """

    _colours = ("ior",)

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
            kind=DIELECTRIC,
            colours=colours,
            exponent=5.0,
            tint=tint,
            alpha=alpha,
            retroreflectivity=retroreflectivity,
            distribution=distribution,
            masking=masking,
            correlation=correlation,
            energy_compensation=energy_compensation,
            thinfilm_thickness=thinfilm_thickness,
            thinfilm_ior=thinfilm_ior,
            scatter_mode=scatter_mode,
            retro_transmission=retro_transmission,
            slope_correlation=slope_correlation,
            mean_slope=mean_slope,
        )


class GeneralizedSchlick(Lobe):
    """A lobe with Schlick's reflectance.

    Portsmouth et al. 2026, eqs. 1, 2 and 10, blended as in Section 4, with the reflectance of
    `fresnel_schlick`. Transmission refracts with the index that MaterialX derives from the mean of `color0`.
    Parameters that are not listed are as for `Dielectric`.

    Args:
        color0: reflectance at normal incidence, at least 0: a number or (..., 3).
        color82: its tint at 82 degrees, likewise: a number or (..., 3).
        color90: reflectance at grazing incidence, likewise: a number or (..., 3).
        exponent: of the curve, at least 0: (...).

    Raises:
        ValueError: names the argument that makes no sense.
    """

    _colours = ("color0", "color82", "color90")

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
            kind=SCHLICK,
            colours=colours,
            exponent=exponent,
            tint=1.0,
            alpha=alpha,
            retroreflectivity=retroreflectivity,
            distribution=distribution,
            masking=masking,
            correlation=correlation,
            energy_compensation=energy_compensation,
            thinfilm_thickness=thinfilm_thickness,
            thinfilm_ior=thinfilm_ior,
            scatter_mode=scatter_mode,
            retro_transmission=retro_transmission,
            slope_correlation=slope_correlation,
            mean_slope=mean_slope,
        )
