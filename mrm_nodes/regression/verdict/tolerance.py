"""An image against a reference of any origin: what may differ, and what does.

Physics has bounds of its own, which follow from float32 (`compare`). Here the thresholds are the user's: any of
a largest and a percentile relative error, a root mean square, and two kinds of FLIP; a case must keep all that it
names.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.verdict.compare import Figures, Verdict, quantile, relative_error

Array = NDArray[np.float64]

SEEN = ("flip",) if importlib.util.find_spec("flip_evaluator") else ()
"""To be measured besides where errors may be large enough to be seen."""


@dataclass(frozen=True)
class Tolerance:
    """What an image may differ by; None sets no threshold.

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

    def limits(self) -> dict[str, float]:
        """The thresholds that are set, by name."""
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


def compare_images(
    image: ArrayLike,
    reference: ArrayLike,
    mask: ArrayLike,
    tolerance: Tolerance,
    shown: Collection[str] = (),
) -> Comparison:
    """Compare the pixels of a mask; a value of the image that is not finite fails.

    Args:
        image, reference: `(h, w, 3)`, linear.
        mask: `(h, w)`, true where pixels count.
        shown: `flip`, `hdr_flip` or both, to be measured where no threshold asks for them too.

    Raises:
        MrmError: nothing can be said: no threshold, no pixels, shapes that differ, or a reference that is not
            finite.
    """
    limits = tolerance.limits()
    if not limits:
        raise MrmError("the tolerance asks for nothing: give max_rel, p999_rel, rmse, flip or hdr_flip")
    pixels = np.asarray(image, np.float64)
    truth = np.asarray(reference, np.float64)
    covered = np.asarray(mask, bool)
    _check(pixels, truth, covered)

    measured, maps = _measure(pixels[covered], truth[covered]), {}
    for name, perceive in _perceivers().items():
        if name in limits or name in shown:
            maps[name] = perceive(pixels, truth, covered)
            measured[name] = float(np.mean(maps[name][covered]))
    worst_map = max(maps, key=lambda name: _share(measured[name], limits.get(name, np.inf)), default=None)
    figures = Figures(
        max_abs=_magnitude(pixels[covered] - truth[covered]),
        **measured,
        used=max(_share(measured[name], threshold) for name, threshold in limits.items()),
        pixels=int(covered.sum()),
        lit=int((truth[covered] > 0).any(axis=-1).sum()),
    )
    is_kept = all(measured[name] <= threshold for name, threshold in limits.items())
    return Comparison(
        "pass" if is_kept and np.isfinite(pixels[covered]).all() else "fail",
        figures,
        _used(pixels, truth, covered, limits),
        maps[worst_map] if worst_map else None,
    )


def _check(image: Array, reference: Array, mask: NDArray[np.bool_]) -> None:
    if image.shape != reference.shape or image.ndim != 3 or image.shape[-1] != 3:
        raise MrmError(f"image {image.shape} and reference {reference.shape} are not two images of one size")
    if mask.shape != image.shape[:2]:
        raise MrmError(f"mask {mask.shape} does not fit an image {image.shape}")
    if not mask.any():
        raise MrmError("no pixel shows the mesh: nothing to compare (look at the case's camera and mesh)")
    bad = np.argwhere((~np.isfinite(reference)).any(axis=-1) & mask)
    if len(bad):
        row, column = bad[0]
        raise MrmError(
            f"the reference is not finite at {len(bad)} of {mask.sum()} pixels, first at column {column}, row {row}"
        )


def _measure(image: Array, reference: Array) -> dict[str, float]:
    """The numerical figures of n points, `(n, 3)`."""
    error = relative_error(image, reference)
    error[~np.isfinite(error)] = np.inf
    square = np.square(image - reference)
    return {
        "max_rel": float(np.max(error)),
        "p999_rel": quantile(error, 0.999),
        "rmse": float(np.sqrt(np.mean(square))) if np.isfinite(square).all() else np.inf,
    }


_Perceiver = Callable[[ArrayLike, ArrayLike, ArrayLike], Array]


def _perceivers() -> dict[str, _Perceiver]:
    from mrm_nodes.regression.verdict import perceptual

    return {"flip": perceptual.flip_map, "hdr_flip": perceptual.hdr_flip_map}


def _used(image: Array, reference: Array, mask: NDArray[np.bool_], limits: dict[str, float]) -> Array | None:
    """What each pixel uses of the bound on the worst value; else on the percentile; else, alone, on the mean square."""
    if "max_rel" in limits or "p999_rel" in limits:
        size = np.max(relative_error(image, reference), axis=-1)
        bound = limits.get("max_rel", limits.get("p999_rel", 0.0))
    elif "rmse" in limits:
        size = np.sqrt(np.sum((image - reference) ** 2, axis=-1) / (3 * mask.sum()))
        bound = limits["rmse"]
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
