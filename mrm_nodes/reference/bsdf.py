"""The lobes: conductor, dielectric and generalised Schlick, forward and retroreflective.

A lobe is a small value class: what it is made of, already checked, and four questions (`eval`, `pdf`, `sample`,
`albedo`). The work is done by the compiled passes of `pipeline`.
"""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import energy_formulas as energy
from . import microsurface as surface
from . import pipeline
from .albedo_fit import COEFFICIENTS
from .compiled import Array, run
from .fresnel import CONDUCTOR, DIELECTRIC, SCHLICK

DISTRIBUTIONS = {
    "ggx": surface.GGX,
    "beckmann": surface.BECKMANN,
    "beckmann-rational": surface.BECKMANN_RATIONAL,
    "phong": surface.PHONG,
}
MASKINGS = {
    "smith": surface.SMITH,
    "vcavity": surface.VCAVITY,
    "cook-torrance": surface.VCAVITY,
    "implicit": surface.IMPLICIT,
    "schlick-smith": surface.SCHLICK_SMITH,
    "kelemen": surface.KELEMEN,
}
CORRELATIONS = {
    "height": surface.HEIGHT,
    "separable": surface.SEPARABLE,
    "direction": surface.DIRECTION,
    "height_direction": surface.HEIGHT_DIRECTION,
}
SCATTER_MODES = {"R": pipeline.REFLECT, "T": pipeline.TRANSMIT, "RT": pipeline.BOTH}
COMPENSATIONS = {
    None: energy.NONE,
    "materialx-1.39.5": energy.MATERIALX_1_39_5,
    "materialx-1.39.6": energy.MATERIALX_1_39_6,
    "turquin": energy.TURQUIN,
    "kulla-conty": energy.KULLA_CONTY,
}


class BsdfSample(NamedTuple):
    """What `sample` drew.

    l : (..., 3) unit directions. weight : (..., 3), f |l.n| / pdf. pdf : (...) per steradian; for a delta, the
    probability with which it was chosen. delta : (...) whether l is the only direction that it could have been.
    A rejected sample has weight 0 and pdf 0.
    """

    l: Array  # noqa: E741
    weight: Array
    pdf: Array
    delta: NDArray[np.bool_]


def _first(array: Array, bad: NDArray[np.bool_]) -> str:
    where = np.argwhere(bad)[0]
    value = float(array[tuple(where)])
    return f"{value:g}" if array.ndim == 0 else f"{value:g} at index {tuple(int(k) for k in where)}"


def _numbers(name: str, value: ArrayLike, low: float, high: float, open_low: bool = False) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be a number or an array of numbers, not {value!r}") from error
    good = (array > low) if open_low else (array >= low)
    good &= array <= high
    good &= np.isfinite(array)
    if not good.all():
        bounds = f"{'above' if open_low else 'at least'} {low:g}" + (f" and at most {high:g}" if high < np.inf else "")
        raise ValueError(f"{name} must be finite, {bounds}, not {_first(array, ~good)}")
    return array


def scalar(name: str, value: ArrayLike, low: float, high: float = np.inf, open_low: bool = False) -> Array:
    """A parameter of shape (...), as (..., 1); `ValueError` outside its range."""
    return _numbers(name, value, low, high, open_low)[..., np.newaxis]


def colour(name: str, value: ArrayLike, low: float, high: float = np.inf, open_low: bool = False) -> Array:
    """A parameter that is a number or has shape (..., 3), as (..., 3); `ValueError` outside its range."""
    array = _numbers(name, value, low, high, open_low)
    if array.ndim == 0:
        array = array[np.newaxis]
    if array.shape[-1] not in (1, 3):
        raise ValueError(f"{name} must be a number or have shape (..., 3), not {array.shape}")
    return np.broadcast_to(array, (*array.shape[:-1], 3))


def _pair(name: str, value: ArrayLike, low: float, high: float, open_low: bool) -> Array:
    array = _numbers(name, value, low, high, open_low)
    if array.ndim == 0:
        array = array[np.newaxis]
    if array.shape[-1] not in (1, 2):
        raise ValueError(f"{name} must be a number, a pair or have shape (..., 2), not {array.shape}")
    return np.broadcast_to(array, (*array.shape[:-1], 2))


def _choice(name: str, value: object, choices: dict[str, int] | dict[str | None, int]) -> int:
    try:
        return choices[value]  # type: ignore[index]
    except (KeyError, TypeError):
        known = ", ".join(repr(key) for key in choices)
        raise ValueError(f"{name} must be one of {known}, not {value!r}") from None


def directions(name: str, value: ArrayLike) -> Array:
    """Directions as float64 of shape (..., 3); `ValueError` for another shape."""
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be an array of directions, not {value!r}") from error
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name} must have shape (..., 3), not {array.shape}")
    return array


def check_unit(name: str, array: Array) -> None:
    """`ValueError` that names the first direction whose length is not 1 to 1e-6."""
    length = np.sqrt(np.einsum("...i,...i", array, array))
    bad = ~(np.abs(length - 1.0) <= 1e-6)
    if bad.any():
        where = tuple(int(k) for k in np.argwhere(bad)[0])
        raise ValueError(f"{name} must be of unit length: {array[where]} at index {where} has length {length[where]:g}")


class Lobe:
    """What the three lobes share: one reflection lobe, one transmission lobe, each forward, retro or a blend.

    Every parameter is a number or an array: scalars `(...)`, colours `(..., 3)`, `alpha` a number, a pair or `(..., 2)`;
    all broadcast with the directions. Directions are unit vectors away from the surface, in a frame whose normal is +z
    and whose tangent is +x. Sources: "The Minimal Retroreflective Microfacet Model" (001) and Heitz 2014.
    """

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
        self._distribution = _choice("distribution", distribution, DISTRIBUTIONS)
        self._masking = _choice("masking", masking, MASKINGS)
        if self._distribution == surface.PHONG:
            # Phong has no Smith masking in closed form; the V-cavity's asks nothing of the distribution.
            self._masking = surface.VCAVITY
        self._correlation = _choice("correlation", correlation, CORRELATIONS)
        self._compensation = _choice("energy_compensation", energy_compensation, COMPENSATIONS)
        self._scatter = _choice("scatter_mode", scatter_mode, SCATTER_MODES)
        self._retro_transmission = bool(retro_transmission)
        self._alpha = _pair("alpha", alpha, 0.0, np.inf, open_low=True)
        self._retro = scalar("retroreflectivity", retroreflectivity, 0.0, 1.0)
        self._rxy = scalar("slope_correlation", slope_correlation, -1.0, 1.0, open_low=True)
        self._mean = _pair("mean_slope", mean_slope, -np.inf, np.inf, open_low=True)
        shifted = bool(self._mean.any())
        skewed = shifted or bool(self._rxy.any())
        if skewed and self._distribution == surface.PHONG:
            raise ValueError("slope_correlation and mean_slope must be 0 for the phong distribution")
        if shifted and (self._masking == surface.VCAVITY or self._retro.any()):
            raise ValueError(
                "mean_slope must be 0 with V-cavities and with retroreflectivity: "
                "both need a distribution that is symmetric about the normal"
            )
        unphysical = self._masking not in (surface.SMITH, surface.VCAVITY)
        if unphysical and self._scatter != pipeline.REFLECT:
            raise ValueError(f"masking {masking!r} is for reflection only: scatter_mode must be 'R', not {scatter_mode!r}")
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
        names = {code: name for name, code in reversed(DISTRIBUTIONS.items())}
        if self._compensation in (energy.MATERIALX_1_39_5, energy.MATERIALX_1_39_6):
            pair = (names[self._distribution].split("-")[0], "vcavity" if self._masking == surface.VCAVITY else "smith")
            return np.array(COEFFICIENTS[pair])
        return np.ones((2, 2))

    def _run(
        self, kernel: object, v: Array, second: Array, components: Sequence[int], **changed: int
    ) -> tuple[list[Array], int]:
        modes = list(self._modes)
        for name, value in changed.items():
            modes[getattr(pipeline, name)] = value
        try:
            return run(kernel, [v, second, *self._parameters], modes, components, [self._table])  # type: ignore[arg-type]
        except ValueError as error:
            shapes = f"v {v.shape}, l or u {second.shape}, parameters {self._shape}"
            raise ValueError(f"shapes do not broadcast: {shapes} ({error})") from None

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The scattering function f(v, l) in 1/sr, without the cosine: shape (..., 3).

        Eq. 1 and 2 of 001, with v' for v in the retro share (eq. 10). v.z > 0 is seen from outside (index 1), v.z < 0
        from inside (index `ior`); l on the other side than v gives the transmitted radiance's function, which is zero
        where `scatter_mode` has none and where the index is 1 (a delta, which `sample` and `albedo` know).
        `ValueError` for directions whose length is not 1 to 1e-6, and for shapes that do not broadcast.
        """
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run(pipeline.EVALUATE, view, light, [3])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result

    def pdf(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """The density per steradian with which `sample(v, u)` draws l: shape (...). Errors as in `eval`.

        001 Section 4; in transmission its eq. 5 with ηl², as differentiation with respect to l gives it.
        """
        view, light = directions("v", v), directions("l", l)
        (result,), rejected = self._run(pipeline.DENSITY, view, light, [1])
        if rejected:
            check_unit("v", view)
            check_unit("l", light)
        return result[..., 0]

    def sample(self, v: ArrayLike, u: ArrayLike) -> BsdfSample:
        """Draw a direction l for each v from uniforms u in [0, 1), shape (..., 3).

        Visible normals (Heitz and d'Eon 2014) are reflected or refracted by Fresnel's law; a blend turns the result
        about the normal with probability `retroreflectivity`, and `pdf` is the mixture's (001 Section 4).
        """
        view = directions("v", v)
        uniforms = directions("u", u)
        if not ((uniforms >= 0.0) & (uniforms <= 1.0)).all():
            bad = ~((uniforms >= 0.0) & (uniforms <= 1.0))
            raise ValueError(f"u must be in [0, 1], not {_first(uniforms, bad)}")
        (drawn,), rejected = self._run(pipeline.DRAW, view, uniforms, [8])
        if rejected:
            check_unit("v", view)
        light = np.ascontiguousarray(drawn[..., :3])
        delta = drawn[..., 3] > 0.0
        density = np.where(delta, drawn[..., 4], np.where(drawn[..., 4] > 0.0, self.pdf(view, light), 0.0))
        value = self.eval(view, light) * np.abs(light[..., 2:])
        with np.errstate(divide="ignore", invalid="ignore"):
            weight = np.where(density[..., np.newaxis] > 0.0, value / density[..., np.newaxis], 0.0)
        weight = np.where(delta[..., np.newaxis], drawn[..., 5:], weight)
        return BsdfSample(light, weight, density, delta)


class Conductor(Lobe):
    """A conductor: reflection only, opaque from inside.

    `ior` > 0 and `extinction` >= 0 are the complex index relative to the outside, a number or (..., 3). `ValueError`
    names the argument that makes no sense.
    """

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
        colours = (colour("ior", ior, 0.0, open_low=True), colour("extinction", extinction, 0.0), np.zeros(3))
        super().__init__(
            CONDUCTOR, colours, 5.0, 1.0, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, "R", False, slope_correlation, mean_slope,
        )  # fmt: skip


class Dielectric(Lobe):
    """A dielectric interface of index `ior` > 0 inside, 1 outside: reflection ("R"), transmission ("T") or both ("RT").

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
        index = scalar("ior", ior, 0.0, open_low=True)
        colours = (np.broadcast_to(index, (*index.shape[:-1], 3)), np.zeros(3), np.zeros(3))
        super().__init__(
            DIELECTRIC, colours, 5.0, tint, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, scatter_mode, retro_transmission,
            slope_correlation, mean_slope,
        )  # fmt: skip


class GeneralizedSchlick(Lobe):
    """A lobe with Schlick's reflectance from `color0` to `color90`, tinted by `color82` at 82 degrees.

    Colours are >= 0, numbers or (..., 3); `exponent` >= 0. Transmission refracts with the index that MaterialX derives
    from the mean of `color0`.
    """

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
        colours = (colour("color0", color0, 0.0), colour("color82", color82, 0.0), colour("color90", color90, 0.0))
        super().__init__(
            SCHLICK, colours, exponent, 1.0, alpha, retroreflectivity, distribution, masking, correlation,
            energy_compensation, thinfilm_thickness, thinfilm_ior, scatter_mode, retro_transmission,
            slope_correlation, mean_slope,
        )  # fmt: skip
