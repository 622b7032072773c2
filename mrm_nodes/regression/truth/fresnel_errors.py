"""What float32 may make of a lobe's Fresnel factor: its change with a cosine that is rounded, and with what rounding
leaves of a difference. All for n points: a lobe's inputs may differ from one to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.reference.bsdf import Conductor, Dielectric, GeneralizedSchlick, Lobe
from mrm_nodes.regression.truth.material import as_float32
from mrm_nodes.regression.verdict.compare import UNIT

Array = NDArray[np.float64]

BETWEEN = (-1e-2, -1e-4, -1e-8)
"""Shares of an error at which a curve that is not monotonous is asked too."""

FAINT = 0.05
"""Extinction from which on rounding is no part of it."""

NEAR_TOTAL = 0.1
"""n² - sin² from which on its rounding is less than what is allowed a Fresnel factor anyway: half of 2^-23 over it."""

FILM = {"thinfilm_thickness": 1, "thinfilm_ior": 1}
COMPONENTS = {
    "conductor": {"ior": 3, "extinction": 3, **FILM},
    "dielectric": {"ior": 1, **FILM},
    "schlick": {"color0": 3, "color82": 3, "color90": 3, "exponent": 1, **FILM},
}
"""What a Fresnel factor is made of, by the kind of lobe, and how many components each has."""


@dataclass(frozen=True)
class Reflected:
    """The Fresnel factor of one node's lobe at n points."""

    kind: str
    """As in COMPONENTS."""
    values: Mapping[str, Array]
    """Of its inputs, each a constant or one for each point."""

    @classmethod
    def of(cls, node: str, values: Mapping[str, Any]) -> Reflected:
        """That of a node, ours or MaterialX's, with these inputs."""
        kind = next(kind for kind in COMPONENTS if node.endswith(f"{kind}_bsdf"))
        return cls(kind, {name: as_float32(values[name]) for name in COMPONENTS[kind]})

    def at(self, chosen: NDArray[np.bool_]) -> Reflected:
        """The same of some of the points, by a mask `(n,)`."""
        some = {
            name: np.broadcast_to(value, (*chosen.shape, *value.shape[1:]))[chosen]
            if value.ndim == (2 if COMPONENTS[self.kind][name] == 3 else 1)
            else value
            for name, value in self.values.items()
        }
        return replace(self, values=some)

    def changes(self, cosine: Array, errors: Sequence[float]) -> list[Array]:
        """By how much it changes with each error of the half angle's cosine `(n,)`, each `(n, 3)`: without bound at an
        angle of total reflection, or where a small exponent meets the mirror angle.
        """
        lobe = self._lobe()
        exact = lobe.reflectance(cosine)
        of_roots = self._root_rounding(cosine, exact) + self._film_rounding(cosine, exact)
        steep = np.broadcast_to(self.values.get("exponent", np.ones(())) < 1.0, cosine.shape)
        curve = self.at(steep)._lobe() if steep.any() else None
        found = []
        for error in errors:
            # What is nearer to 1 than float64 can tell is anywhere between.
            high = low = exact
            for shift in (-1.0, 1.0):
                beside = lobe.reflectance(np.clip(cosine + shift * error, 0.0, 1.0))
                high, low = np.maximum(high, beside), np.minimum(low, beside)
            if curve is not None:
                # Under a film such a curve is not monotonous on the way to 1.
                between = [
                    curve.reflectance(np.clip(cosine[steep] + shift * error, 0.0, 1.0)) for shift in BETWEEN
                ]
                high[steep] = np.max([high[steep], *between], axis=0)
                low[steep] = np.min([low[steep], *between], axis=0)
            found.append(high - low + of_roots)
        return found

    def _lobe(self, **changed: Array) -> Lobe:
        """What has this Fresnel factor, or that of other inputs."""
        given: dict[str, Any] = {**self.values, **changed}
        given["thinfilm_thickness"] = np.maximum(given["thinfilm_thickness"], 0.0)
        if self.kind == "conductor":
            return Conductor(alpha=1.0, **given)
        if self.kind == "dielectric":
            return Dielectric(alpha=1.0, **given)
        for name in ("color0", "color82", "color90"):
            given[name] = np.maximum(given[name], 0.0)
        return GeneralizedSchlick(alpha=1.0, **given)

    def _film_rounding(self, cosine: Array, exact: Array) -> Array:
        """What rounding makes of the cosine in a film that is hardly denser than air, near grazing angles, `(n, 3)`.

        Its square, 1 - sin² / index², is off by 8 units, as that of another index by 4 is. Arguments as of
        `_root_rounding`.
        """
        thickness, film = (np.broadcast_to(self.values[name], cosine.shape) for name in FILM)
        film = np.maximum(film, 1.0)
        at = (thickness > 0) & (film**2 - (1.0 - cosine**2) < NEAR_TOTAL)
        change: Array = np.zeros(exact.shape)
        if at.any():
            some = self.at(at)
            others = (np.maximum(film[at] * (1.0 + 4 * sign * UNIT), 1.0) for sign in (1.0, -1.0))
            reflected = (some._lobe(thinfilm_ior=each).reflectance(cosine[at]) for each in others)
            change[at] = np.maximum(*(np.abs(each - exact[at]) for each in reflected))
        return change

    def _root_rounding(self, cosine: Array, exact: Array) -> Array:
        """What rounding makes of the root of t = n² - k² - sin² near the angle of total reflection, `(n, 3)`.

        t is a difference of numbers near 1, off by 2 units (2^-24) of these, which is another index. Below a film its
        index is a quotient, 3 units of a square, and the square of its cosine is off by 8 of the film's. And where a
        metal that hardly absorbs reflects all, MaterialX takes the root of half of sqrt(t² + 4 n² k²) - |t|: of the
        first term, rounded by 4 units, no more is left than of another extinction.
        What a film shows in one channel is made of all three. cosine: `(n,)`; exact: the reflectance there.
        """
        change: Array = np.zeros(exact.shape)
        if self.kind == "schlick":
            return change
        is_metal = self.kind == "conductor"
        n = self.values["ior"]
        n = np.broadcast_to(n if is_metal else n[..., None], exact.shape)
        k = np.broadcast_to(self.values["extinction"] if is_metal else 0.0, exact.shape)
        t = n**2 - k**2 - (1.0 - cosine**2)[..., None]
        near, faint = np.abs(t) < NEAR_TOTAL, (n < 1.0) & (k < FAINT) & is_metal
        at = (near | faint).any(-1)
        if not at.any():
            return change
        some = self.at(at)
        n, k, t, near, faint, exact, cosine = (each[at] for each in (n, k, t, near, faint, exact, cosine))
        thickness, film = (np.broadcast_to(some.values[name], cosine.shape)[..., None] for name in FILM)
        units = np.where(thickness > 0, 3 * n**2 + 8 * np.maximum(film, 1.0) ** 2, 2 * np.maximum(n**2, 1.0))
        of_index = np.where(near, UNIT * units, 0.0)
        of_extinction = np.where(faint, 2 * UNIT * np.hypot(t, 2 * n * k) * np.abs(t) / n**2, 0.0)

        def moved(**changed: Array) -> Array:
            return np.abs(some._lobe(**changed).reflectance(cosine) - exact)

        # Of a metal the channels are rounded apart.
        for channel in np.eye(3) if is_metal else np.ones((1, 3)):
            if near.any():
                squares = (n**2 + sign * of_index * channel for sign in (1.0, -1.0))
                indices = (np.sqrt(np.maximum(each, 0.25 * n**2)) for each in squares)
                change[at] += np.maximum(*(moved(ior=each if is_metal else each[..., 0]) for each in indices))
            if faint.any():
                squares = (k**2 + sign * of_extinction * channel for sign in (1.0, -1.0))
                change[at] += np.maximum(
                    *(moved(extinction=np.sqrt(np.maximum(each, 0.0))) for each in squares)
                )
        return change


def phase_jumps(node: str, values: Mapping[str, Any]) -> NDArray[np.bool_]:
    """Where rounding decides whether the index that a Schlick curve stands for is below its film's, `(n, 1)`: the
    phase of what it reflects is half a turn further then, and its Fresnel factor another one.
    """
    if not node.endswith("schlick_bsdf"):
        return np.zeros(1, bool)
    film = np.maximum(as_float32(values["thinfilm_ior"]), 1.0)[..., None]
    root = np.sqrt(np.clip(as_float32(values["color0"]), 0.01, 0.99))
    index = (1.0 + root) / (1.0 - root)
    # The index has six roundings, of which two are of 1 - sqrt(F0) at most 0.995.
    covered = as_float32(values["thinfilm_thickness"])[..., None] > 0
    jumps: NDArray[np.bool_] = covered & (np.abs(index - film) <= 16 * UNIT * index**2)
    # What a film shows in one channel is made of all three.
    return np.asarray(jumps.any(-1, keepdims=True))
