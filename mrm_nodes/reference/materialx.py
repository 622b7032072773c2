"""MaterialX's closure trees: what `mix`, `add`, `multiply` and `layer` do with scattering functions.

A closure answers `eval(v, l)`, MaterialX's response without the cosine, `throughput(v, l)`, what it lets through
to a layer below by the fit that MaterialX's shaders have of its albedo, and `exact_throughput(v)`, the same by the
albedo itself. A leaf is a lobe of `bsdf`, of which the host's rule says both, or any object with these three."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from . import block
from . import energy_formulas as energy
from .albedo_fit import split_sum
from .bsdf import Lobe
from .checks import check_unit, choice, colour, directions, scalar
from .compiled import Array
from .diffuse import lambert, oren_nayar
from .fresnel import CONDUCTOR, SCHLICK

LAYERINGS = {"materialx": 0, "exact": 1}
"""How a top's share of the light is found: MaterialX's fit, or the albedo."""


class BSDF(Protocol):
    """What a leaf needs of anything but a `Lobe`."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l), shape (..., 3)."""

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        """The share that a lower layer keeps, shape (..., 3)."""

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        """The same by the exact rule, shape (..., 3); what `layering="exact"` asks for, and nothing else."""


class Closure:
    """A node of MaterialX's closure tree; it is not made by itself.

    Directions are unit vectors away from the surface, (..., 3), in a frame whose normal is +z: v to the viewer, l to
    the light, None for light from all around. What is returned is (..., 3). Methods raise `ValueError` for a
    direction that is none and for shapes that do not broadcast.
    """

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l) in 1/sr, without the cosine: (..., 3)."""
        raise NotImplementedError

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        """The factor of a base below this closure, as MaterialX's `layer` takes it: (..., 3)."""
        raise NotImplementedError

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        """The same by the exact rule, 1 less the directional albedo towards v, and 0 of what is opaque: (..., 3).

        A `layer` within counts as one of the exact rule.

        Args:
            weight: what the response is multiplied by: a number or (..., 3).
        """
        raise NotImplementedError

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows: a polar plot."""
        from .polar import polar_png

        return polar_png(self)


@dataclass(frozen=True)
class Leaf(Closure):
    """A lobe as a node of MaterialX's closure tree.

    Throughputs of a conductor are 0, whatever its weight. `throughput` of another lobe is 1 - weight * directional
    albedo, the albedo being MaterialX's split-sum fit F0 A + F90 B times the factor of its energy compensation. That
    factor takes F at v.h of each lobe for a light l, and at v.n without one (environments) up to 1.39.5; the lobes of
    a blend are mixed linearly. A lobe without reflection lets everything through. `exact_throughput` is
    1 - weight * `Lobe.albedo`, at least 0: albedo scaling as the specification of MaterialX's `layer` has it, with the
    albedo of the response that is really there, for each channel: all of Fresnel's curve (its tint at 82 degrees, its
    film), `tint`, the energy compensation, the masking, and in `T` and `RT` what is transmitted, too, which a base
    would else show a second time. Its quadrature takes a millisecond a view.

    Raises:
        ValueError: `throughput` of an energy compensation that MaterialX does not have.
    """

    lobe: Lobe | BSDF
    """One of the lobes, or anything that has `eval`, `throughput` and `exact_throughput`."""
    weight: ArrayLike = 1.0
    """The node's, at least 0: (...)."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.lobe.eval(v, l) * scalar("weight", self.weight, 0.0)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        if not isinstance(self.lobe, Lobe):
            return self.lobe.throughput(v, l, self.weight)
        view = directions("v", v)
        check_unit("v", view)
        light = None if l is None else directions("l", l)
        if light is not None:
            check_unit("l", light)
        albedo = _fitted_albedo(self.lobe, view, light)
        through = 1.0 - scalar("weight", self.weight, 0.0) * albedo
        return np.asarray(np.zeros(through.shape) if self.lobe._kind == CONDUCTOR else through)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        amount = scalar("weight", self.weight, 0.0) * colour("weight", weight, 0.0)
        if not isinstance(self.lobe, Lobe):
            return self.lobe.exact_throughput(v, amount)
        view = directions("v", v)
        check_unit("v", view)
        is_opaque = self.lobe._kind == CONDUCTOR
        if is_opaque or not amount.any():
            shape = np.broadcast_shapes(view.shape[:-1], self.lobe._shape, amount.shape[:-1])
            return np.full((*shape, 3), 0.0 if is_opaque else 1.0)
        return np.maximum(1.0 - amount * self.lobe.albedo(view), 0.0)


_compensation: Any = energy.compensation.py_func
"""Of arrays."""


def _fitted_albedo(lobe: Lobe, view: Array, light: Array | None) -> Array:
    """MaterialX's albedo of a lobe's reflection, (..., 3), as `Leaf` says; directions (..., 3)."""
    shape = np.broadcast_shapes(view.shape[:-1], lobe._shape)
    if lobe._kind == CONDUCTOR or lobe._scatter == block.TRANSMIT:
        return np.zeros((*shape, 3))
    if lobe._compensation not in (energy.NONE, energy.MATERIALX_1_39_5, energy.MATERIALX_1_39_6):
        raise ValueError("throughput is MaterialX's: energy_compensation must be None or one of its versions")
    cosine = np.clip(np.abs(view[..., 2:]), 1e-8, 1.0)
    mean_alpha = np.sqrt(lobe._alpha[..., :1] * lobe._alpha[..., 1:])
    a, b = split_sum(lobe._fit_pair(), cosine, mean_alpha)
    if lobe._kind == SCHLICK:
        f0, f90 = lobe._parameters.a, lobe._parameters.c
    else:
        index = lobe._parameters.a
        f0 = ((index - 1.0) / (index + 1.0)) ** 2
        f90 = np.ones(3)
    bare = f0 * a + f90 * b

    def compensated(mirrored: Array) -> Array:
        if lobe._compensation == energy.NONE:
            return bare
        at = cosine
        if light is not None and lobe._compensation == energy.MATERIALX_1_39_5:
            at = np.clip(0.5 * np.linalg.norm(mirrored + light, axis=-1, keepdims=True), 1e-8, 1.0)
        f = lobe._reflectance(at, lobe._compensation)
        return np.asarray(bare * _compensation(f, a + b))

    side = np.where(view[..., 2:] < 0.0, -1.0, 1.0)
    forward, retro = side * view, side * view * np.array([-1.0, -1.0, 1.0])
    albedo = (1.0 - lobe._retro) * compensated(forward) + lobe._retro * compensated(retro)
    if lobe._kind == SCHLICK:
        albedo = np.broadcast_to(albedo.mean(axis=-1, keepdims=True), albedo.shape)
    return np.asarray(albedo)


@dataclass(frozen=True)
class Lambert:
    """A diffuse lobe for a `Leaf`, MaterialX's `oren_nayar_diffuse_bsdf` at roughness 0; nothing below it shows."""

    albedo: ArrayLike
    """Reflectance, 0 to 1: a number or (..., 3)."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l) in 1/sr, without the cosine: (..., 3); as `lambert`."""
        return lambert(self.albedo, v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        """Zero, (..., 3), whatever the weight (...): it is opaque. v and l as for `lambert`."""
        return _opaque(v)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        """As `throughput`."""
        return _opaque(v)


@dataclass(frozen=True)
class OrenNayar:
    """MaterialX's `oren_nayar_diffuse_bsdf` for a `Leaf`; nothing below it shows."""

    albedo: ArrayLike
    """Reflectance: a number or (..., 3); it may be above 1, as `oren_nayar` says."""
    roughness: ArrayLike = 0.0
    """0 to 1: (...)."""
    energy_compensation: bool = False
    """With it this is EON but for light behind the viewer."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l) in 1/sr, without the cosine: (..., 3); as `oren_nayar`."""
        return oren_nayar(self.albedo, self.roughness, v, l, self.energy_compensation)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        """Zero, (..., 3), whatever the weight (...): it is opaque. v and l as for `lambert`."""
        return _opaque(v)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        """As `throughput`."""
        return _opaque(v)


def _opaque(v: ArrayLike) -> Array:
    view = directions("v", v)
    check_unit("v", view)
    return np.zeros(view.shape)


@dataclass(frozen=True)
class Mix(Closure):
    """MaterialX's `mix`: bg (1 - amount) + fg amount, for response and throughput; `amount` in [0, 1], (...)."""

    fg: Closure
    bg: Closure
    amount: ArrayLike

    def _blend(self, front: Array, back: Array) -> Array:
        share = scalar("amount", self.amount, 0.0, 1.0)
        return np.asarray(back * (1.0 - share) + front * share)

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self._blend(self.fg.eval(v, l), self.bg.eval(v, l))

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self._blend(self.fg.throughput(v, l), self.bg.throughput(v, l))

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        return self._blend(self.fg.exact_throughput(v, weight), self.bg.exact_throughput(v, weight))


@dataclass(frozen=True)
class Add(Closure):
    """MaterialX's `add`: the responses of in1 and in2 add, and so do the albedos that throughputs are 1 less of."""

    in1: Closure
    in2: Closure

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.in1.eval(v, l) + self.in2.eval(v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return np.maximum(self.in1.throughput(v, l) + self.in2.throughput(v, l) - 1.0, 0.0)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        through = self.in1.exact_throughput(v, weight) + self.in2.exact_throughput(v, weight) - 1.0
        return np.maximum(through, 0.0)


@dataclass(frozen=True)
class Multiply(Closure):
    """MaterialX's `multiply`: the response of in1 times in2, a number or (..., 3), clamped to [0, 1].

    MaterialX's throughput stays as it is. By the exact rule the albedo is multiplied too.
    """

    in1: Closure
    in2: ArrayLike

    def _factor(self) -> Array:
        return np.clip(colour("in2", self.in2, 0.0), 0.0, 1.0)

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.in1.eval(v, l) * self._factor()

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self.in1.throughput(v, l)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        return self.in1.exact_throughput(v, self._factor() * colour("weight", weight, 0.0))


@dataclass(frozen=True)
class Layer(Closure):
    """MaterialX's `layer`: the top's response plus the base's times the top's throughput; throughputs multiply.

    By the exact rule what the top scatters and what it leaves to the base add up to no more than all of the light
    that comes from everywhere, where the top itself makes none. It is still albedo scaling: light that the base
    sends back to the top, and the way through it, are no part of it.

    Raises:
        ValueError: a `layering` that is none.
    """

    top: Closure
    base: Closure
    layering: str = "materialx"
    """`materialx`, its shaders' fit of the top's albedo, or `exact`, that albedo; layers within have their own."""

    def __post_init__(self) -> None:
        choice("layering", self.layering, LAYERINGS)

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        is_exact = self.layering == "exact"
        through = self.top.exact_throughput(v) if is_exact else self.top.throughput(v, l)
        return self.top.eval(v, l) + self.base.eval(v, l) * through

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self.top.throughput(v, l) * self.base.throughput(v, l)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        through = self.top.exact_throughput(v) * self.base.exact_throughput(v)
        share = colour("weight", weight, 0.0)
        if (share == 1.0).all():
            return through
        # Nothing reflected leaves what is not opaque.
        clear = self.top.exact_throughput(v, 0.0) * self.base.exact_throughput(v, 0.0)
        return through_of(through, clear, share)


def through_of(through: Array, clear: Array | float, share: Array) -> Array:
    """An exact throughput once the response is multiplied by a share: what is reflected less is let through.

    Args:
        through: with all of the response, (..., 3).
        clear: with none of it: 1 but for what is opaque.
        share: the factor, at least 0.
    """
    return np.maximum(clear - share * (clear - through), 0.0)
