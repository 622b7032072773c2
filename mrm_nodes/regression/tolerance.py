"""An image against a reference of any origin: what may differ, what does, and whether that can be told at all.

Physics has bounds of its own, which follow from float32 (`compare`). Here the thresholds are the user's: any of
a largest and a percentile relative error, a root mean square, and two kinds of FLIP; a case must keep all that it
names. A reference that was sampled carries its standard error, and is a distribution rather than a number: a
verdict that another run of the sampler could turn round is `undecided`.
"""

from __future__ import annotations

import importlib.util
import statistics
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.compare import FLOOR, Figures, Verdict, quantile, relative_error

Array = NDArray[np.float64]

SEEN = ("flip",) if importlib.util.find_spec("flip_evaluator") else ()
"""To be measured besides where errors may be large enough to be seen."""

CHANCE = 1e-3
"""Probability with which noise alone may decide a verdict, over all values of an image together."""


@dataclass(frozen=True)
class Tolerance:
    """What an image may differ by; None is not asked for.

    Raises:
        MrmError: a threshold that is no number, negative, or not finite.
    """

    max_rel: float | None = None
    """Relative error of the worst value; see `compare.relative_error`."""
    p999_rel: float | None = None
    """Relative error that 99.9 % of the values keep."""
    rmse: float | None = None
    """Root mean square of the differences, in the image's own unit."""
    flip: float | None = None
    """Mean FLIP of the pictures as shown, 0 to 1."""
    hdr_flip: float | None = None
    """Mean HDR-FLIP, 0 to 1."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < np.inf:
                raise MrmError(f"tolerance {name} is {value!r}; it is a number, 0 or more")

    def asked(self) -> dict[str, float]:
        """The thresholds that are asked for, by name."""
        return {name: float(value) for name, value in vars(self).items() if value is not None}


@dataclass(frozen=True)
class Comparison:
    """A verdict and what it rests on."""

    verdict: Verdict
    figures: Figures
    used: Array | None
    """`(h, w)`: a pixel's error as a share of its bound; None where no threshold is one on pixels."""
    flip: Array | None
    """`(h, w)`: FLIP, 0 to 1, of the kind that used more of its threshold; None where neither was measured."""


class _Measured(NamedTuple):
    """A figure, and the interval in which another run of the sampler would put it."""

    value: float
    low: float
    high: float


def compare_images(
    image: ArrayLike,
    reference: ArrayLike,
    mask: ArrayLike,
    tolerance: Tolerance,
    standard_error: ArrayLike | None = None,
    shown: Collection[str] = (),
) -> Comparison:
    """Compare the pixels of a mask; a value of the image that is not finite fails.

    Args:
        image, reference: `(h, w, 3)`, linear.
        mask: `(h, w)`, true where pixels count.
        standard_error: `(h, w, 3)`, that of the reference's values, taken as independent; None is exact.
        shown: `flip`, `hdr_flip` or both, to be measured where no threshold asks for them too.

    Raises:
        MrmError: nothing can be said: no threshold, no pixels, shapes that differ, or a reference or standard
            error that is not finite.
    """
    asked = tolerance.asked()
    if not asked:
        raise MrmError("the tolerance asks for nothing: give max_rel, p999_rel, rmse, flip or hdr_flip")
    pixels = np.asarray(image, np.float64)
    truth = np.asarray(reference, np.float64)
    covered = np.asarray(mask, bool)
    noise = np.zeros_like(truth) if standard_error is None else np.asarray(standard_error, np.float64)
    _check(pixels, truth, covered, noise)

    measured, maps = _measure(pixels[covered], truth[covered], noise[covered]), {}
    for name, perceive in _perceivers().items():
        if name in asked or name in shown:
            maps[name] = perceive(pixels, truth, covered)
            measured[name] = _perceived(maps[name], perceive, truth, covered, noise)
    kept = {name: measured[name] for name in asked}
    worst_map = max(
        maps, key=lambda name: _share(measured[name].value, asked.get(name, np.inf)), default=None
    )
    figures = Figures(
        max_abs=_magnitude(pixels[covered] - truth[covered]),
        **{name: each.value for name, each in measured.items()},
        used=max(_share(each.value, asked[name]) for name, each in kept.items()),
        pixels=int(covered.sum()),
        lit=int((truth[covered] > 0).any(axis=-1).sum()),
    )
    if standard_error is not None:
        spread = max(_share(max(m.value - m.low, m.high - m.value), asked[name]) for name, m in kept.items())
        figures = replace(figures, uncertainty=spread)
    return Comparison(
        _verdict(kept, asked) if np.isfinite(pixels[covered]).all() else "fail",
        figures,
        _used(pixels, truth, covered, asked),
        maps[worst_map] if worst_map else None,
    )


def _check(image: Array, reference: Array, mask: NDArray[np.bool_], noise: Array) -> None:
    if image.shape != reference.shape or image.ndim != 3 or image.shape[-1] != 3:
        raise MrmError(f"image {image.shape} and reference {reference.shape} are not two images of one size")
    if mask.shape != image.shape[:2] or noise.shape != image.shape:
        raise MrmError(f"mask {mask.shape} or standard error {noise.shape} do not fit an image {image.shape}")
    if not mask.any():
        raise MrmError("no pixel shows the mesh: nothing to compare (look at the case's camera and mesh)")
    for what, wrong in (
        ("the reference is not finite", ~np.isfinite(reference)),
        ("the standard error is negative or not finite", ~((noise >= 0) & np.isfinite(noise))),
    ):
        bad = np.argwhere(wrong.any(axis=-1) & mask)
        if len(bad):
            row, column = bad[0]
            raise MrmError(
                f"{what} at {len(bad)} of {mask.sum()} pixels, first at column {column}, row {row}"
            )


def _measure(image: Array, reference: Array, noise: Array) -> dict[str, _Measured]:
    """The numerical figures of n points, `(n, 3)`."""
    error = relative_error(image, reference)
    error[~np.isfinite(error)] = np.inf
    # So that with this probability no value at all lies outside its interval (Bonferroni).
    deviations = statistics.NormalDist().inv_cdf(1 - CHANCE / (2 * error.size))
    spread = deviations * noise / np.maximum(np.abs(reference), FLOOR)
    low, high = np.maximum(error - spread, 0.0), error + spread

    def interval(figure: Callable[[Array], float]) -> _Measured:
        value = figure(error)
        return (
            _Measured(value, figure(low), figure(high)) if np.any(noise) else _Measured(value, value, value)
        )

    return {
        "max_rel": interval(lambda each: float(np.max(each))),
        "p999_rel": interval(lambda each: quantile(each, 0.999)),
        "rmse": _root_mean_square(image - reference, noise),
    }


def _root_mean_square(difference: Array, noise: Array) -> _Measured:
    """The root of the mean square that is left when the noise's own part is taken off.

    With d = δ + s ε, ε normal: E[d²] = δ² + s² and Var[d²] = 2 s⁴ + 4 δ² s².
    """
    if not np.isfinite(difference).all():
        return _Measured(np.inf, np.inf, np.inf)
    variance = noise**2
    cleared = difference**2 - variance
    scatter = np.sqrt(np.sum(2 * variance**2 + 4 * np.maximum(cleared, 0.0) * variance)) / cleared.size
    mean = np.mean(cleared)
    reach = statistics.NormalDist().inv_cdf(1 - CHANCE / 2) * scatter if np.any(noise) else 0.0
    return _Measured(*(float(np.sqrt(max(each, 0.0))) for each in (mean, mean - reach, mean + reach)))


_Perceiver = Callable[[ArrayLike, ArrayLike, ArrayLike], Array]


def _perceivers() -> dict[str, _Perceiver]:
    from mrm_nodes.regression import perceptual

    return {"flip": perceptual.flip_map, "hdr_flip": perceptual.hdr_flip_map}


def _perceived(
    seen: Array, perceive: _Perceiver, reference: Array, mask: NDArray[np.bool_], noise: Array
) -> _Measured:
    """Mean FLIP, uncertain by the FLIP between the reference and one that was sampled again."""
    value = float(np.mean(seen[mask]))
    if not np.any(noise):
        return _Measured(value, value, value)
    again = reference + noise * np.random.default_rng(0).standard_normal(reference.shape)
    own = float(np.mean(perceive(again, reference, mask)[mask]))
    return _Measured(value, max(value - own, 0.0), value + own)


def _verdict(measured: dict[str, _Measured], asked: dict[str, float]) -> Verdict:
    if any(each.low > asked[name] for name, each in measured.items()):
        return "fail"
    return "pass" if all(each.high <= asked[name] for name, each in measured.items()) else "undecided"


def _used(image: Array, reference: Array, mask: NDArray[np.bool_], asked: dict[str, float]) -> Array | None:
    """What each pixel uses of the bound on the worst value; else on the percentile; else, alone, on the mean square."""
    if "max_rel" in asked or "p999_rel" in asked:
        size = np.max(relative_error(image, reference), axis=-1)
        bound = asked.get("max_rel", asked.get("p999_rel", 0.0))
    elif "rmse" in asked:
        size = np.sqrt(np.sum((image - reference) ** 2, axis=-1) / (3 * mask.sum()))
        bound = asked["rmse"]
    else:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        used: Array = np.where(size == 0, 0.0, size / bound)
    return np.where(np.isfinite(used), used, np.inf)


def _share(value: float, threshold: float) -> float:
    if value == 0:
        return 0.0
    return value / threshold if threshold > 0 else np.inf


def _magnitude(difference: Array) -> float:
    return float(np.max(np.abs(np.where(np.isfinite(difference), difference, np.inf))))
