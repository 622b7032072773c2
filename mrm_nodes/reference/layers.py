"""MaterialX's closure trees: what `mix`, `add`, `multiply` and `layer` do with scattering functions.

A closure answers `eval(v, l)`, MaterialX's response without the cosine, and `throughput(v, l)`, what it
lets through to a layer below. Any object with `eval` and `throughput`, such as the lobes of `bsdf`, becomes
a leaf."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .checks import check_unit, colour, directions, scalar
from .compiled import Array
from .diffuse import lambert, oren_nayar


class Scatterer(Protocol):
    """What a leaf needs."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l), shape (..., 3)."""

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        """The share that a lower layer keeps, shape (..., 3)."""


class Closure:
    """A node of the tree: f without the cosine, and throughput; both of shape (..., 3)."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        """f(v, l) in 1/sr, without the cosine."""
        raise NotImplementedError

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        """The factor of a base below this closure."""
        raise NotImplementedError

    def _repr_png_(self) -> bytes | None:
        """What a notebook shows: a polar plot."""
        from .polar import polar_png

        return polar_png(self)


@dataclass(frozen=True)
class Leaf(Closure):
    """A lobe with its node's `weight`, (...)."""

    lobe: Scatterer
    weight: ArrayLike = 1.0

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.lobe.eval(v, l) * scalar("weight", self.weight, 0.0)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self.lobe.throughput(v, l, self.weight)


@dataclass(frozen=True)
class Lambert:
    """A diffuse lobe of reflectance `albedo`; opaque, so that nothing below shows."""

    albedo: ArrayLike

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return lambert(self.albedo, v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        return _opaque(v)


@dataclass(frozen=True)
class OrenNayar:
    """MaterialX's `oren_nayar_diffuse_bsdf`; with `energy_compensation` it is EON but for light behind the
    viewer.
    """

    albedo: ArrayLike
    roughness: ArrayLike = 0.0
    energy_compensation: bool = False

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return oren_nayar(self.albedo, self.roughness, v, l, self.energy_compensation)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None, weight: ArrayLike = 1.0) -> Array:  # noqa: E741
        return _opaque(v)


def _opaque(v: ArrayLike) -> Array:
    view = directions("v", v)
    check_unit("v", view)
    return np.zeros(view.shape)


@dataclass(frozen=True)
class Mix(Closure):
    """`mix`: bg (1 - amount) + fg amount, for response and throughput; `amount` in [0, 1], (...)."""

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


@dataclass(frozen=True)
class Add(Closure):
    """`add`: responses add, and so do the albedos that throughputs are 1 less of."""

    in1: Closure
    in2: Closure

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.in1.eval(v, l) + self.in2.eval(v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return np.maximum(self.in1.throughput(v, l) + self.in2.throughput(v, l) - 1.0, 0.0)


@dataclass(frozen=True)
class Multiply(Closure):
    """`multiply`: the response times a factor, clamped to [0, 1]; the throughput as it is."""

    in1: Closure
    in2: ArrayLike

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.in1.eval(v, l) * np.clip(colour("in2", self.in2, 0.0), 0.0, 1.0)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self.in1.throughput(v, l)


@dataclass(frozen=True)
class Layer(Closure):
    """`layer`: the top's response plus the base's times the top's throughput; throughputs multiply."""

    top: Closure
    base: Closure

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        return self.top.eval(v, l) + self.base.eval(v, l) * self.top.throughput(v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self.top.throughput(v, l) * self.base.throughput(v, l)
