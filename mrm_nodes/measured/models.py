"""The models that are fitted: which parameters of the layered retroreflector are free, and where each starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown
from mrm_nodes.photometry.retroreflector import ClearTop, Retroreflector, SecondWidth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """A number that is fitted, by its logarithm (above 0) or its logit (between 0 and 1)."""

    scale: Literal["log", "logit"]
    start: float
    low: float
    high: float
    """Bounds, so that no step of the search leaves what can be evaluated."""
    colour: bool = False
    """Whether each channel has its own."""

    def to_free(self, value: float) -> float:
        """The number that the search moves."""
        return float(np.log(value) if self.scale == "log" else np.log(value / (1.0 - value)))

    def from_free(self, free: Array) -> Array:
        """And back."""
        return np.asarray(np.exp(free) if self.scale == "log" else 1.0 / (1.0 + np.exp(-free)))

    def slope(self, value: float) -> float:
        """The derivative of the parameter by what the search moves."""
        return value if self.scale == "log" else value * (1.0 - value)


PARAMETERS: Mapping[str, Parameter] = {
    "alpha": Parameter("log", 0.02, 5e-4, 1.0),
    "f0": Parameter("logit", 0.2, 1e-7, 1.0 - 1e-7, colour=True),
    "f82": Parameter("logit", 0.5, 1e-6, 1.0 - 1e-6),
    "exponent": Parameter("log", 1.0, 1e-3, 100.0),
    "falloff": Parameter("log", 2.0, 1e-3, 60.0),
    "widening": Parameter("log", 0.5, 1e-3, 10.0),
    "retroreflectivity": Parameter("logit", 0.9, 1e-4, 1.0 - 1e-6),
    "second_alpha": Parameter("log", 0.1, 5e-4, 1.0),
    "second_share": Parameter("logit", 0.3, 1e-6, 1.0 - 1e-6),
    "film": Parameter("logit", 0.3, 1e-7, 1.0 - 1e-7, colour=True),
    "top_alpha": Parameter("log", 0.05, 5e-4, 1.0),
    "top_f0": Parameter("logit", 0.05, 1e-7, 1.0 - 1e-7),
    "top_f90": Parameter("logit", 0.5, 1e-6, 1.0 - 1e-6),
}
"""Every parameter that a model may have, in the order in which they are told."""


@dataclass(frozen=True)
class Model:
    """What is free, and what is known."""

    about: str
    free: tuple[str, ...]
    distribution: str = "ggx"
    fixed: Mapping[str, float] | None = None
    beside: bool = False
    """Whether the beads lie bare beside the film, not all over it: `f0` is then their share of the surface times their
    reflectance, and of the two only the product is known."""

    def names(self, channels: Sequence[str]) -> list[str]:
        """The parameters' names, one for each channel of a colour."""
        found: list[str] = []
        for name in self.free:
            by_channel = PARAMETERS[name].colour and len(channels) == 3
            found += [f"{name}.{channel}" for channel in channels] if by_channel else [name]
        return found

    def bsdf(self, values: Mapping[str, Array], channels: Sequence[str]) -> Retroreflector:
        """The retroreflector of values, each (...): a colour's channels stand under their own names."""

        def number(name: str, default: float | None = None) -> Array | float | None:
            return values.get(name, (self.fixed or {}).get(name, default))

        def colour(name: str) -> Array | None:
            if name in values:
                return np.asarray(values[name])[..., np.newaxis]
            if f"{name}.{channels[0]}" in values:
                return np.stack([values[f"{name}.{channel}"] for channel in channels], axis=-1)
            return None

        top = second = None
        if "top_alpha" in values:
            top = ClearTop(
                values["top_alpha"],
                np.asarray(values["top_f0"])[..., None],
                np.asarray(values["top_f90"])[..., None],
            )
        if "second_alpha" in values:
            second = SecondWidth(values["second_alpha"], values["second_share"])
        f0 = colour("f0")
        assert f0 is not None
        cover = f0.max(axis=-1) if self.beside else None
        if cover is not None:
            f0 = f0 / cover[..., np.newaxis]
        f90 = number("f90")
        f82 = number("f82", 1.0)
        return Retroreflector(
            alpha=values["alpha"],
            f0=f0,
            falloff=number("falloff"),
            widening=number("widening"),
            film=colour("film"),
            top=top,
            second=second,
            f82=1.0 if f82 is None else np.asarray(f82)[..., None],
            f90=None if f90 is None else np.asarray(f90)[..., None],
            exponent=5.0 if (power := number("exponent")) is None else power,
            retroreflectivity=1.0 if (share := number("retroreflectivity")) is None else share,
            distribution=self.distribution,
            cover=cover,
        )


_TOP = ("top_alpha", "top_f0", "top_f90")

MODELS: Mapping[str, Model] = {
    "retro": Model(
        "the paper's: one retroreflective lobe, F82 tint", ("alpha", "f0", "f82"), fixed={"f90": 1.0}
    ),
    "plain": Model(
        "that lobe on a film below a clear top", ("alpha", "f0", "f82", "film", *_TOP), fixed={"f90": 1.0}
    ),
    "exponent": Model(
        "Schlick's fall to 0 with a free exponent, no graph",
        ("alpha", "f0", "exponent", "film", *_TOP),
        fixed={"f90": 0.0},
    ),
    "layered": Model("a fall by a power of |n.v|", ("alpha", "f0", "falloff", "film", *_TOP)),
    "beckmann": Model(
        "layered, with Beckmann's distribution", ("alpha", "f0", "falloff", "film", *_TOP), "beckmann"
    ),
    "blend": Model(
        "layered, a part of the lobe mirrored", ("alpha", "f0", "falloff", "retroreflectivity", "film", *_TOP)
    ),
    "widths": Model(
        "layered, a part of the return in a second width",
        ("alpha", "f0", "falloff", "second_alpha", "second_share", "film", *_TOP),
    ),
    "beside": Model(
        "beads that lie bare beside the film, as much as they return; a fall by a power of |n.v|",
        ("alpha", "f0", "falloff", "film", *_TOP),
        beside=True,
    ),
    "widening": Model(
        "beside, and the lobe widens by a power of |n.v|",
        ("alpha", "f0", "falloff", "widening", "film", *_TOP),
        beside=True,
    ),
    "full": Model(
        "widening, and a part of the return in a second width",
        ("alpha", "f0", "falloff", "widening", "second_alpha", "second_share", "film", *_TOP),
        beside=True,
    ),
}


def find_model(name: str) -> Model:
    """A model by its name.

    Raises:
        MrmError: there is none of that name.
    """
    if name not in MODELS:
        raise MrmError(unknown("model", name, MODELS))
    return MODELS[name]
