"""An image against its reference: figures, bounds, verdict.

The relative error of a channel is `|image - reference| / max(|reference|, 1e-4)`. Bounds are relative too,
and scale with 1/alpha: a lobe of width alpha magnifies float32's rounding of a direction by that much. Of a material of
several lobes each has its own bound, and the pixel the sum of what they are of its response (`physics`).
"""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError

Verdict = Literal["pass", "fail", "undecided", "error", "skipped"]
VERDICTS: tuple[Verdict, ...] = ("fail", "error", "undecided", "skipped", "pass")

FLOOR = 1e-4
"""Below this reference value an error counts as absolute, in units of this value."""

FILM_MAX = 3e-4
FILM_P999 = 1e-5
"""Allowed error of the thin film's Fresnel factor: its sum cancels in float32."""

FRESNEL_MAX = 1e-6
FRESNEL_P999 = 3e-7
"""The same without a film: the 82 degree tint subtracts, and an index near 1 leaves only rounding."""

HALF_COSINE_MAX, HALF_COSINE_P999 = 7e-7, 4e-7
"""Error of the half angle's cosine, of which the Fresnel factor is taken. The virtual mirror of the view has six
roundings a component (a sum of three products, its double, a difference), the half vector two, the products one, their
sum two and a half: 11.5 of 2^-24 at most, and 6.6 in 999 of 1000 sums of as many uniform errors."""

HALF_ANGLE = 0.06
"""Cosine of the half angle below which the bounds grow as HALF_ANGLE / cosine: of two nearly opposite directions the
half vector keeps their rounding over the length of their sum."""

LIGHT_COSINE = 0.005
"""Cosine of the light below which the bounds grow as LIGHT_COSINE / cosine: the response is proportional to it, and
it is a sum of products rounded to float32."""

OTHER_DISTRIBUTIONS = 5.0
"""Beckmann and Phong are exponentials: their bounds are this many times GGX's."""

HALF_VECTOR_MAX = 2.5e-6
HALF_VECTOR_P999 = 1e-6
"""Error of the half vector's slope, tangent of its angle to the normal. GGX is 1/(t² + alpha²)² in a slope t, whose
logarithm changes by 4 t/(t² + alpha²), at most 2/alpha: to first order the bound of a lobe is twice this by alpha."""

NARROW = 1e-3
"""Alpha below which that first order is not enough: the error is a part of the lobe's own width."""

NOTICED = 0.1
"""A relative fault of every value that a verdict has to notice: a case that would not is undecided, never pass."""

NOTICED_SHARE = 0.01
"""Share of the lit values that have to notice a fault."""


@dataclass(frozen=True)
class Bounds:
    """What an error may be: at most `max_rel` anywhere, and `p999_rel` for 99.9 % of the values.

    Scalars, or arrays `(n, 1)` or `(n, 3)` where the bound differs from point to point.
    """

    max_rel: NDArray[np.float64]
    p999_rel: NDArray[np.float64]

    def loosest(self) -> dict[str, float]:
        """The largest of each, as the report gives them."""
        return {"max_rel": float(np.max(self.max_rel)), "p999_rel": float(np.max(self.p999_rel))}


@dataclass(frozen=True)
class Figures:
    """How far an image is from its reference."""

    max_abs: float
    max_rel: float
    p999_rel: float
    rmse: float
    used: float
    """Share of the bounds that was used up: 1 is the limit."""
    pixels: int
    lit: int
    """Pixels whose reference is above zero."""
    flip: float | None = None
    """Mean FLIP, where it was asked for."""
    hdr_flip: float | None = None
    uncertainty: float | None = None
    """What the reference's standard error may add to `used` or take from it; None where the reference is exact."""
    notices: float | None = None
    """The smallest relative fault of all values that this verdict would have noticed, 1 being a black image, where
    the bounds are float32's. Infinite where nothing is lit."""

    def as_dict(self) -> dict[str, Any]:
        """The figures for JSON; a value that is not finite becomes null."""
        return {name: finite_or_none(value) for name, value in vars(self).items()}


def finite_or_none(value: float | None) -> float | None:
    """JSON has no NaN and no infinity."""
    return value if value is not None and np.isfinite(value) else None


def bounds_for(
    alpha: ArrayLike,
    distribution: str,
    reference: ArrayLike,
    grazing: ArrayLike,
    white: ArrayLike,
    film: ArrayLike,
) -> Bounds:
    """The bounds of n points of one lobe.

    Args:
        alpha: the smaller roughness, `(n,)` or a scalar.
        distribution: its name.
        reference: `(n, 3)`.
        grazing: `(n, 3)`, the reference with each light's part multiplied by `grazing_factor`.
        white: `(n, 3)`, the reference for a Fresnel factor of 1: it turns the bound on that factor into
            one on the image.
        film: whether there is a thin film, `(n,)` or a scalar.
    """
    size = np.maximum(np.abs(np.asarray(reference, np.float64)), FLOOR)
    stretch = np.maximum(np.abs(np.asarray(grazing)) / size, 1.0)
    per_fresnel = np.asarray(white) / size
    lobe, fresnel = lobe_bounds(alpha, distribution), fresnel_bounds(film)
    return Bounds(
        stretch * lobe.max_rel + fresnel.max_rel * per_fresnel,
        stretch * lobe.p999_rel + fresnel.p999_rel * per_fresnel,
    )


def lobe_bounds(alpha: ArrayLike, distribution: str) -> Bounds:
    """The relative error of a lobe but for its Fresnel factor, for directions that do not graze, `(n, 1)`."""
    alpha = np.asarray(alpha, np.float64)[..., None]
    factor = 1.0 if distribution == "ggx" else OTHER_DISTRIBUTIONS
    return Bounds(
        factor * np.maximum(2 * HALF_VECTOR_MAX / alpha, 2e-5),
        factor * np.maximum(2 * HALF_VECTOR_P999 / alpha, 5e-6),
    )


def fresnel_bounds(film: ArrayLike) -> Bounds:
    """The absolute error of a Fresnel factor, `(n, 1)`. film: whether there is one, `(n,)` or a scalar."""
    film = np.asarray(film, bool)[..., None]
    return Bounds(np.where(film, FILM_MAX, FRESNEL_MAX), np.where(film, FILM_P999, FRESNEL_P999))


def narrow_bounds(
    alpha: ArrayLike,
    distribution: str,
    v: ArrayLike,
    l: ArrayLike,  # noqa: E741  the field's own name
    growth: ArrayLike,
) -> Bounds:
    """By how much a lobe may exceed its value beyond the first order where the half vector's error is a part of its
    width, relative, `(n, 1)`: its value for a slope that is smaller by that error, over its value.

    Args:
        alpha: the smaller roughness, `(n,)` or a scalar.
        distribution: its name; any but GGX is an exponential of the slope's square.
        v, l: `(n, 3)`, in its frame; of the forward and the retro lobe's slopes the smaller counts.
        growth: of the half vector's error, `(n, 1)` or a scalar.
    """
    alpha = np.asarray(alpha, np.float64)[..., None]
    v, l = np.asarray(v, np.float64), np.asarray(l, np.float64)  # noqa: E741
    across = np.minimum(
        np.sum((l[..., :2] + v[..., :2]) ** 2, axis=-1, keepdims=True),
        np.sum((l[..., :2] - v[..., :2]) ** 2, axis=-1, keepdims=True),
    )
    slope = np.sqrt(across) / np.maximum(np.abs(v[..., 2:] + l[..., 2:]), 1e-12)

    def beyond(error: float) -> NDArray[np.float64]:
        nearer = np.maximum(slope - error * np.asarray(growth), 0.0)
        if distribution == "ggx":
            excess = ((slope**2 + alpha**2) / (nearer**2 + alpha**2)) ** 2 - 1
        else:
            # An exponential of more is no number any longer, and its value none but 0.
            excess = np.expm1(np.minimum((slope**2 - nearer**2) / alpha**2, 600.0))
        return np.where(alpha < NARROW, excess, 0.0)

    return Bounds(beyond(HALF_VECTOR_MAX), beyond(HALF_VECTOR_P999))


def grazing_factor(v: ArrayLike, l: ArrayLike) -> NDArray[np.float64]:  # noqa: E741  the field's own name
    """How much the bounds grow for a view and a light, `(n, 3)` in the shading frame, `(n, 1)`: 1 unless grazing.

    The half angle is the smaller of the forward and the retro lobe's.
    """
    v, l = np.asarray(v, np.float64), np.asarray(l, np.float64)  # noqa: E741
    across = np.abs(np.sum(v[..., :2] * l[..., :2], axis=-1, keepdims=True))
    half_cosine = np.sqrt(np.maximum(1 - across + v[..., 2:] * l[..., 2:], 0) / 2)
    growth: NDArray[np.float64] = np.maximum(
        HALF_ANGLE / np.maximum(half_cosine, 1e-12), LIGHT_COSINE / np.maximum(l[..., 2:], 1e-12)
    )
    return np.maximum(growth, 1.0)


def relative_error(image: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """`|image - reference| / max(|reference|, 1e-4)` in float64, shape of the images."""
    with np.errstate(invalid="ignore"):
        difference = np.abs(np.subtract(image, reference, dtype=np.float64))
    return _relative(difference, np.asarray(reference, np.float64))


def _relative(difference: NDArray[np.float64], reference: NDArray[np.float64]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):
        error: NDArray[np.float64] = difference / np.maximum(np.abs(reference), FLOOR)
    return error


def compare(image: ArrayLike, reference: ArrayLike, bounds: Bounds) -> tuple[Verdict, Figures]:
    """Verdict and figures of the points of an image against their reference.

    An image within its bounds is `undecided` where they are so wide that it would be with every value 10 % off.

    image, reference: `(n, 3)`, the points that count. A value of the image that is not finite fails.

    Raises:
        MrmError: nothing can be said: no points, or a reference that is not finite.
    """
    image = np.asarray(image, np.float64)
    reference = np.asarray(reference, np.float64)
    if image.shape != reference.shape:
        raise MrmError(f"image {image.shape} and reference {reference.shape} differ in shape")
    if image.size == 0:
        raise MrmError("no pixel shows the mesh: nothing to compare (look at the case's camera and mesh)")
    if not np.isfinite(reference).all():
        bad = np.argwhere(~np.isfinite(reference).all(axis=-1))
        raise MrmError(
            f"the reference is not finite at {len(bad)} of {len(reference)} points, first at {bad[0][0]}"
        )

    with np.errstate(invalid="ignore"):
        difference = image - reference
    np.abs(difference, out=difference)
    error = _relative(difference, reference)
    if not np.isfinite(error).all():
        error[~np.isfinite(error)] = np.inf
    max_rel, p999_rel = float(np.max(error)), quantile(error, 0.999)
    # One bound for all points is divided by once.
    used = max(
        max_rel / bounds.max_rel if np.ndim(bounds.max_rel) == 0 else np.max(error / bounds.max_rel),
        p999_rel / bounds.p999_rel
        if np.ndim(bounds.p999_rel) == 0
        else quantile(error / bounds.p999_rel, 0.999),
    )
    notices = _notices(reference, bounds)
    figures = Figures(
        max_abs=float(np.max(difference)),
        max_rel=max_rel,
        p999_rel=p999_rel,
        rmse=float(np.sqrt(np.mean(np.square(difference, out=difference)))),
        used=float(used),
        pixels=len(image),
        lit=int(np.logical_or.reduce([channel > 0 for channel in reference.T]).sum()),
        notices=notices,
    )
    if used > 1:
        return "fail", figures
    return ("pass" if notices <= NOTICED else "undecided"), figures


def _notices(reference: NDArray[np.float64], bounds: Bounds) -> float:
    """The smallest fault, relative to every value, that breaks a bound, and at `NOTICED_SHARE` of the lit values."""
    values = np.abs(reference)
    lit = values > 0
    if not lit.any():
        return math.inf
    with np.errstate(over="ignore"):
        scale = np.maximum(values, FLOOR)[lit] / values[lit]
    most, usual = (
        np.sort(np.broadcast_to(each, values.shape)[lit] * scale)
        for each in (bounds.max_rel, bounds.p999_rel)
    )
    enough = math.ceil(NOTICED_SHARE * len(scale)) - 1
    # One in a thousand values may exceed the second bound.
    beyond = max(enough, math.floor(values.size / 1000))
    return float(min(most[enough], usual[beyond] if beyond < len(usual) else math.inf))


def why_undecided(figures: Figures) -> str:
    """Why an image within its bounds says nothing."""
    if figures.lit == 0:
        return "nothing is lit, and a black image would pass: turn the light or the camera"
    return (
        "an image 10 % off would pass: its lobes are too narrow for float32, or too dark; give it a larger roughness, "
        "or more light"
    )


def quantile(values: NDArray[np.float64], share: float) -> float:
    """The value at `share` of the sorted values, which may be infinite: `np.quantile`'s method "higher"."""
    flat = np.ravel(values)
    above = flat.size - 1 - math.ceil((flat.size - 1) * share)
    # A sample tells where the largest values begin: only those are sorted.
    begin = np.quantile(flat[:: flat.size // 4096 + 1], max(0.0, 4 * share - 3), method="lower")
    largest = flat[flat >= begin]
    if len(largest) <= above:
        largest = flat
    at = len(largest) - 1 - above
    return float(np.partition(largest, at)[at])
