"""What was measured: f at pairs of directions, in the evaluator's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError, unknown
from mrm_nodes.measured.angles import Array

NEIGHBOURS = 6
"""Samples that one between them is made of."""


@dataclass(frozen=True)
class Measurement:
    """n samples of f(v, l) in 1/sr, without a cosine. Samples that lie below the horizon are not part of it.

    Args:
        v: (n, 3), unit directions to the viewer; the normal is +z.
        l: (n, 3), to the light.
        value: (n, k), a column for each of `channels`.
        channels: their names, such as `R`, `G`, `B` or `555 nm`.
        sample: what was measured.

    Raises:
        MrmError: the shapes do not fit, no sample is left, or a value is negative or no number.
    """

    v: Array
    l: Array  # noqa: E741  the field's own name
    value: Array
    channels: tuple[str, ...] = ("luminance",)
    sample: str = ""
    """What was measured, as the file has it."""

    def __post_init__(self) -> None:
        n = len(self.value)
        if self.value.shape != (n, len(self.channels)) or self.v.shape != (n, 3) or self.l.shape != (n, 3):
            raise MrmError(
                f"a measurement has directions (n, 3) and values (n, {len(self.channels)}), "
                f"not {self.v.shape}, {self.l.shape} and {self.value.shape}"
            )
        for what, array in (("a direction", self.v), ("a direction", self.l), ("a value", self.value)):
            if not np.isfinite(array).all():
                raise MrmError(f"{what} of sample {_first(~np.isfinite(array))} is no finite number")
        if (self.value < 0.0).any():
            raise MrmError(f"the value of sample {_first(self.value < 0.0)} is negative")
        if n == 0:
            raise MrmError("it has no sample")

    def __repr__(self) -> str:
        sample = f" of {self.sample}" if self.sample else ""
        return f"<Measurement{sample}: {len(self)} samples of {', '.join(self.channels)}>"

    def __len__(self) -> int:
        return len(self.value)

    @property
    def theta_v(self) -> Array:
        """(n) radians between the viewer and the normal."""
        return np.arccos(np.clip(self.v[:, 2], -1.0, 1.0))

    @property
    def theta_l(self) -> Array:
        """(n) radians between the light and the normal."""
        return np.arccos(np.clip(self.l[:, 2], -1.0, 1.0))

    @property
    def from_retro(self) -> Array:
        """(n) radians between the viewer and the light."""
        return _angle(self.v, self.l)

    def where(self, mask: NDArray[Any]) -> Measurement:
        """The samples of a mask `(n)`, or of indices.

        Raises:
            MrmError: there is none.
        """
        return replace(self, v=self.v[mask], l=self.l[mask], value=self.value[mask])

    def light_angles(self) -> list[float]:
        """The angles of the light in whole tenths of degrees, where nearly all samples share a few; else none."""
        rounded = np.round(np.degrees(self.theta_l), 1)
        angles, counts = np.unique(rounded, return_counts=True)
        shared = counts >= SHARED
        is_series = shared.sum() <= MOST_ANGLES and counts[shared].sum() >= 0.9 * len(self)
        return [float(each) for each in angles[shared]] if is_series else []

    def at_light(self, degrees: float) -> NDArray[np.bool_]:
        """(n) which samples have the light at one of `light_angles`, in degrees."""
        return np.asarray(np.abs(np.degrees(self.theta_l) - degrees) < 0.0501)

    def pick(self, channels: Sequence[str]) -> Measurement:
        """The measurement with some of its channels.

        Raises:
            MrmError: it has no such channel.
        """
        for name in channels:
            if name not in self.channels:
                raise MrmError(unknown("channel", name, self.channels))
        chosen = [self.channels.index(name) for name in channels]
        return replace(self, value=self.value[:, chosen], channels=tuple(channels))

    def check_colour(self) -> None:
        """Check that it is grey or a colour.

        Raises:
            MrmError: channels other than one or three.
        """
        if len(self.channels) not in (1, 3):
            raise MrmError(
                f"{len(self.channels)} channels ({', '.join(self.channels[:6])}{'…' * (len(self.channels) > 6)}): "
                "take one or three of them"
            )

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741  the field's own name
        """f in 1/sr at other directions v and l, (..., 3), one channel three times.

        An isotropic table, between its samples: the weighted mean of the logarithms of the nearest ones; nothing is
        known of what lies far from them all.

        Raises:
            MrmError: channels other than one or three.
        """
        self.check_colour()
        value = self._between(v, l)
        return np.broadcast_to(value, (*value.shape[:-1], 3)).copy() if value.shape[-1] == 1 else value

    def resampled(self, v: ArrayLike, l: ArrayLike) -> Measurement:  # noqa: E741
        """The measurement at other directions v and l, (n, 3)."""
        view, light = np.broadcast_arrays(np.asarray(v, np.float64), np.asarray(l, np.float64))
        return replace(self, v=view.copy(), l=light.copy(), value=self._between(view, light))

    def _between(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741
        from scipy.spatial import cKDTree

        view, light = np.broadcast_arrays(np.asarray(v, np.float64), np.asarray(l, np.float64))
        tree = cKDTree(isotropic(self.v, self.l))
        count = min(NEIGHBOURS, len(self))
        distance, index = tree.query(isotropic(view, light).reshape(-1, 3), k=np.arange(1, count + 1))
        weight = 1.0 / np.maximum(distance, 1e-9) ** 2
        weight[distance > 3.0 * np.maximum(distance[:, :1], 1e-9)] = 0.0
        logarithm = np.log(np.maximum(self.value, 1e-30))[index]
        mean = (weight[..., None] * logarithm).sum(axis=1) / weight.sum(axis=1)[:, None]
        return np.asarray(np.exp(mean).reshape(*view.shape[:-1], len(self.channels)))

    def plot(self, bsdfs: Sequence[tuple[str, Any]] = (), angles: Sequence[float] = ()) -> Any:
        """A Matplotlib figure: ln f against the viewer's angle in the plane of incidence, a panel for each light.

        bsdfs: names and objects with `eval`, drawn as lines.
        angles: of the light, in degrees.

        Raises:
            ImportError: Matplotlib is missing.
        """
        from mrm_nodes.measured.plots import draw_lobes

        return draw_lobes(self, bsdfs, angles)


SHARED, MOST_ANGLES = 10, 12
"""Samples that make an angle of the light one that is shared, and angles beyond which a table is no set of curves."""


def above(
    v: Array,
    l: Array,  # noqa: E741  the field's own name
    value: Array,
    channels: tuple[str, ...],
    sample: str = "",
) -> Measurement:
    """The measurement of what lies above the horizon; a grazing angle may be a rounding beyond it."""
    seen = (v[:, 2] > 1e-6) & (l[:, 2] > 1e-6)
    return Measurement(v[seen], l[seen], value[seen], channels, sample)


def _angle(a: Array, b: Array) -> Array:
    """Radians between unit vectors, near 0 too."""
    return np.asarray(2.0 * np.arcsin(np.clip(0.5 * np.linalg.norm(a - b, axis=-1), 0.0, 1.0)))


def isotropic(v: Array, l: Array) -> Array:  # noqa: E741
    """(..., 3): the light's angle and the viewer's, turned so that the light lies over +x, and mirrored to one side."""
    theta_l = np.arccos(np.clip(l[..., 2], -1.0, 1.0))
    theta_v = np.arccos(np.clip(v[..., 2], -1.0, 1.0))
    turn = np.arctan2(v[..., 1], v[..., 0]) - np.arctan2(l[..., 1], l[..., 0])
    return np.stack([theta_l, theta_v * np.cos(turn), np.abs(theta_v * np.sin(turn))], axis=-1)


def _first(bad: NDArray[np.bool_]) -> int:
    return int(np.argwhere(bad)[0][0]) + 1


def check_values(path: Path, value: Array) -> None:
    """Check the values of a file, (n, k), as it has them.

    Raises:
        MrmError: one is negative, or no finite number; says which.
    """
    for bad, said in ((~np.isfinite(value), "no finite number"), (value < 0.0, "negative")):
        if bad.any():
            raise MrmError(f"{path}: the value of sample {_first(bad)} is {said}")
