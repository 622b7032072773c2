"""An image against its reference: figures, bounds, verdict.

The relative error of a channel is `|image - reference| / max(|reference|, 1e-4)`. Bounds are relative too,
and scale with 1/alpha: a lobe of width alpha magnifies float32's rounding of a direction by that much. Of a material of
several lobes each has its own bound, and the pixel the sum of what they are of its response (`physics`).
"""

import functools
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError

Array = NDArray[np.float64]
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

UNIT = 2.0**-24
"""Half a unit in the last place of a float32 below 1: one rounding."""

OUTER_ROUNDING = 1.75 * UNIT
"""Error of what a film hardly denser than air reflects at its outer side: (t1 - t2) / (t1 + t2), where t1 is a sum,
rounded, of cos², rounded, and t0, and t2 twice the product of the cosine and a root of t0, both rounded; t0 is
nearly cos², too."""

FILM_OUTER = 2.9
"""By how much a film's colour changes with the root of that. Of two amplitudes, r and the root of R below, the first
term of the series is 2 r (1 - R) sqrt(R), at most 0.77 r; a row of the matrix to RGB adds up to 3.74 at most."""

HALF_COSINE_MAX, HALF_COSINE_P999 = 7e-7, 4e-7
"""Error of the half angle's cosine, of which the Fresnel factor is taken. MaterialX's mirror of the view has six
roundings a component (a sum of three products, its double, a difference), the half vector two, the products one, their
sum two and a half: 11.5 of 2^-24 at most, and 6.6 in 999 of 1000 sums of as many uniform errors. Ours is no worse."""

VIEW_MAX, VIEW_P999 = 2 * UNIT, 1.4 * UNIT
"""Error of the view across itself: the host rounds a difference and a quotient in each component. The half vector of
two directions has it over the length of their sum, twice the cosine of the half angle."""

NEAR_COSINE_MAX, NEAR_COSINE_P999 = 3 * UNIT, 2 * UNIT
"""Error of n.l: three products with a normal that is rounded, and the first of two sums. That of n.v has
`VIEW_MAX` more."""

SUM_COSINE_MAX, SUM_COSINE_P999 = 8 * UNIT, 4 * UNIT
"""Error of n.l + n.v where the sum of both directions is long and grazing, as that of the retro lobe: four roundings of
products of which two add up to at most 2. By it the half vector leans to the normal, or from it."""

MATERIALX_HALF_ANGLE = 0.06
"""Cosine of the half angle below which the bounds of MaterialX's own nodes grow as this over it: their half vector has
the errors of both lengths, too."""

OTHER_DISTRIBUTIONS = 5.0
"""Beckmann and Phong are exponentials: their bounds are this many times GGX's."""

HALF_VECTOR_MAX = 2.5e-6
HALF_VECTOR_P999 = 1e-6
"""Error of the half vector's slope, tangent of its angle to the normal. GGX is 1/(t² + alpha²)² in a slope t, whose
logarithm changes by 4 t/(t² + alpha²), at most 2/alpha: to first order the bound of a lobe is twice this by alpha."""

NARROW = 2.5e-3
"""Part of its alpha from which on an error of the slope is a part of the lobe's own width, and that first order is not
enough."""

NOTICED = 0.1
"""A relative fault of every value that a verdict has to notice: a case that would not is undecided, never pass."""

NOTICED_SHARE = 0.01
"""Share of the lit values that have to notice a fault."""

BEYOND = 1e-3
"""The probability with which a value may be beyond the second bound."""

BY_CHANCE = 1e-4
"""The probability with which a sound image may have more such points than are allowed."""


@dataclass(frozen=True)
class Bounds:
    """What an error may be: at most `max_rel` anywhere, and beyond `p999_rel` with a probability of 1/1000.

    Scalars, or arrays `(n, 1)` or `(n, 3)` where the bound differs from point to point.
    """

    max_rel: Array
    p999_rel: Array

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
    notices: float | None = None
    """The smallest relative fault of all values that this verdict would have noticed, 1 being a black image, where
    the bounds are float32's. Infinite where nothing is lit."""

    def as_dict(self) -> dict[str, Any]:
        """The figures for JSON; a value that is not finite becomes null."""
        return {name: finite_or_none(value) for name, value in vars(self).items()}


def finite_or_none(value: float | None) -> float | None:
    """JSON has no NaN and no infinity."""
    return value if value is not None and np.isfinite(value) else None


def lobe_bounds(alpha: ArrayLike, distribution: str) -> Bounds:
    """The relative error of a lobe but for its Fresnel factor, for directions that do not graze, `(n, 1)`."""
    alpha = np.asarray(alpha, np.float64)[..., None]
    factor = 1.0 if distribution == "ggx" else OTHER_DISTRIBUTIONS
    return Bounds(
        factor * np.maximum(2 * HALF_VECTOR_MAX / alpha, 2e-5),
        factor * np.maximum(2 * HALF_VECTOR_P999 / alpha, 5e-6),
    )


def fresnel_bounds(thickness: ArrayLike, index: ArrayLike) -> Bounds:
    """The absolute error of a Fresnel factor, `(n, 1)`. thickness, index: a film's, each `(n,)` or a scalar."""
    film = np.asarray(thickness)[..., None] > 0
    index = np.maximum(np.asarray(index, np.float64), 1.0)[..., None]
    # At other angles it reflects more, and rounding is less of it.
    outer = (index - 1.0) / (index + 1.0)
    rounded = np.maximum(
        np.sqrt(outer**2 + OUTER_ROUNDING) - outer,
        outer - np.sqrt(np.maximum(outer**2 - OUTER_ROUNDING, 0.0)),
    )
    usual = np.minimum(FILM_P999 + FILM_OUTER * rounded, FILM_MAX)
    return Bounds(np.where(film, FILM_MAX, FRESNEL_MAX), np.where(film, usual, FRESNEL_P999))


def direction_bounds(
    roughness: ArrayLike,
    distribution: str,
    masking: str,
    v: ArrayLike,
    l: ArrayLike,  # noqa: E741
    of_light: float = 0.0,
    materialx: bool = False,
) -> Bounds:
    """The relative error of a lobe but for its Fresnel factor, for directions `(n, 3)` in its frame, `(n, 1)`.

    Args:
        roughness: both alphas, `(n, 2)` or `(2,)`.
        distribution, masking: their names.
        v, l: `(n, 3)`, from the surface; the light above the horizon, else nothing is lit.
        of_light: error of the light's direction, each way, beyond that of one that is given.
        materialx: whether the lobe is MaterialX's own node, whose half vector keeps fewer digits.
    """
    roughness, v, l = (np.asarray(each, np.float64) for each in (roughness, v, l))  # noqa: E741
    alpha = np.min(roughness, axis=-1)[..., None]
    of_lobe = lobe_bounds(alpha[..., 0], distribution)
    up = np.maximum(np.abs(v[..., 2:] + l[..., 2:]), 1e-12)
    along, against = (
        np.linalg.norm(l[..., :2] + sign * v[..., :2], axis=-1, keepdims=True) for sign in (1.0, -1.0)
    )
    forward, retro = np.hypot(along, up), np.hypot(against, up)
    to_view, to_light = _masking_slopes(roughness, distribution, masking, v, l, np.minimum(forward, retro))

    def allowed(relative: Array, error: float, of_view: float, of_cosine: float, of_sum: float) -> Array:
        """By the error of the half vector itself, of the view across it, and of both cosines."""
        own, beyond = relative, np.zeros(1)
        for size, tangent, leaning in (
            (forward, along / up, 0.0),
            (retro, against / up, of_sum * forward * against / (2.0 * retro)),
        ):
            turned = error + (of_view + of_light + leaning) / size
            if materialx:
                turned = np.maximum(turned, error * 2.0 * MATERIALX_HALF_ANGLE / size)
            own = np.maximum(own, relative + _factor(distribution) * 2.0 * (turned - error) / alpha)
            beyond = np.maximum(beyond, _narrow_excess(alpha, distribution, tangent, turned))
        return own + beyond + to_view * (of_cosine + of_view) + to_light * (of_cosine + of_light)

    return Bounds(
        allowed(of_lobe.max_rel, HALF_VECTOR_MAX, VIEW_MAX, NEAR_COSINE_MAX, SUM_COSINE_MAX),
        allowed(of_lobe.p999_rel, HALF_VECTOR_P999, VIEW_P999, NEAR_COSINE_P999, SUM_COSINE_P999),
    )


def _factor(distribution: str) -> float:
    return 1.0 if distribution == "ggx" else OTHER_DISTRIBUTIONS


def _narrow_excess(alpha: Array, distribution: str, slope: Array, error: Array) -> Array:
    """By how much a lobe may exceed its value beyond the first order where the half vector's error is a part of its
    width, relative, `(n, 1)`: its value for a slope that is smaller by that error, over its value.
    """
    nearer = np.maximum(slope - error, 0.0)
    if distribution == "ggx":
        excess = ((slope**2 + alpha**2) / (nearer**2 + alpha**2)) ** 2 - 1
    else:
        # An exponential of more is no float32 any longer, and its value none but 0.
        excess = np.expm1(np.minimum((slope**2 - nearer**2) / alpha**2, 80.0))
    return np.where(error > NARROW * alpha, excess, 0.0)


def _masking_slopes(
    roughness: Array,
    distribution: str,
    masking: str,
    v: Array,
    l: Array,  # noqa: E741
    size: Array,
) -> tuple[Array, Array]:
    """By how much the logarithm of G / n.v changes with n.v and with n.l, at most, each `(n, 1)`.

    size: length of the sum of both directions, the smaller one of the two lobes.
    """
    near_v, near_l = (np.maximum(each[..., 2:], NEAR_COSINE_MAX) for each in (v, l))
    if masking == "vcavity" or distribution == "phong":
        # min(1 / n.v, 2 n.h / v.h) where the view is the lower one, else that times n.l / n.v; n.h / v.h is
        # 2 (n.l + n.v) / size².
        both = 1.0 / (near_v + near_l)
        cavity = np.maximum(both, np.minimum(1.0 / near_v, 4.0 / (both * size**2)))
        lower = near_v < near_l
        return np.where(lower, cavity, 1.0 / near_v + both), np.where(lower, both, 1.0 / near_l + both)
    # n.l / (n.l g(v) + n.v g(l)), g(w)² = (n.w)² + (alpha sin)²: GGX's masking. Beckmann's changes less.
    wide_v, wide_l = (np.sum((roughness * each[..., :2]) ** 2, axis=-1, keepdims=True) for each in (v, l))
    g_v, g_l = np.sqrt(near_v**2 + wide_v), np.sqrt(near_l**2 + wide_l)
    both = near_l * g_v + near_v * g_l
    return (g_l + near_l * near_v / g_v) / both, near_v * wide_l / (g_l * near_l * both)


def relative_error(image: ArrayLike, reference: ArrayLike) -> Array:
    """`|image - reference| / max(|reference|, 1e-4)` in float64, shape of the images."""
    with np.errstate(invalid="ignore"):
        difference = np.abs(np.subtract(image, reference, dtype=np.float64))
    return _relative(difference, np.asarray(reference, np.float64))


def _relative(difference: Array, reference: Array) -> Array:
    with np.errstate(invalid="ignore"):
        error: Array = difference / np.maximum(np.abs(reference), FLOOR)
    return error


def compare(image: ArrayLike, reference: ArrayLike, bounds: Bounds) -> tuple[Verdict, Figures]:
    """Verdict and figures of the points of an image against their reference.

    An image within its bounds is `undecided` where they are so wide that it would be with every value 10 % off. A
    point whose own bound is 100 % or more, which black would keep, is left out of errors and bounds.

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
    max_error, p999_error = decided(error, bounds.max_rel), decided(error, bounds.p999_rel)
    max_rel = float(np.max(max_error))
    # One bound for all points is divided by once.
    used = max(
        max_rel / bounds.max_rel if np.ndim(bounds.max_rel) == 0 else np.max(max_error / bounds.max_rel),
        share_of_usual(p999_error, reference, bounds.p999_rel),
    )
    notices = _notices(reference, bounds)
    figures = Figures(
        max_abs=float(np.max(difference)),
        max_rel=max_rel,
        p999_rel=quantile(p999_error, 0.999),
        rmse=float(np.sqrt(np.mean(np.square(difference, out=difference)))),
        used=float(used),
        pixels=len(image),
        lit=_lit(reference),
        notices=notices,
    )
    if used > 1:
        return "fail", figures
    return ("pass" if notices <= NOTICED else "undecided"), figures


def _lit(reference: NDArray[Any]) -> int:
    """Points with a value above zero, `(n, 3)`."""
    return int(np.logical_or.reduce([channel > 0 for channel in reference.T]).sum())


def share_of_usual(error: Array, reference: Array, bound: float | Array) -> float:
    """The share of the second bound that is used: by the worst value but those that chance may put beyond it.

    error, reference: `(n, 3)`; bound: a scalar, `(n, 1)` or `(n, 3)`.
    """
    above = _allowed_beyond(reference, bound)
    if above >= error.size:
        return 0.0
    if np.ndim(bound) == 0:
        return float(_largest_but(error, above) / bound)
    return _largest_but(error / bound, above)


def _allowed_beyond(reference: Array, bound: float | Array) -> int:
    """How many values may be beyond the second bound: those of as many points as chance may put there. Points that are
    lit count, and of which float32 says anything."""
    counted = (reference > 0) & (np.asarray(bound) < 1.0)
    return int(reference.shape[-1]) * beyond_by_chance(_lit(counted))


@functools.lru_cache(maxsize=1024)
def beyond_by_chance(points: int) -> int:
    """How many of n points may be beyond the second bound: fewer than one sound image of 10,000 has more.

    A value may be beyond it with a probability of 1/1000, and the three of a point round alike, so that the points
    count: their number is binomial. Of 1,000 points 6 may be, of a million 1,120, and of 10 points one, where the
    largest of 30 values would have to be within it otherwise.
    """
    from scipy.special import bdtrik

    return max(math.ceil(bdtrik(1.0 - BY_CHANCE, points, BEYOND)), 0) if points else 0


def decided(error: Array, bound: float | Array) -> Array:
    """The errors but those of points whose bound black would keep: what float32 makes of them says nothing. A value
    that is not finite is wrong everywhere.
    """
    if np.ndim(bound) == 0:
        return error
    return np.where((np.asarray(bound) >= 1.0) & np.isfinite(error), 0.0, error)


def _notices(reference: Array, bounds: Bounds) -> float:
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
    beyond = max(enough, _allowed_beyond(values, bounds.p999_rel))
    return float(min(most[enough], usual[beyond] if beyond < len(usual) else math.inf))


def why_undecided(figures: Figures) -> str:
    """Why an image within its bounds says nothing."""
    if figures.lit == 0:
        return "nothing is lit, and a black image would pass: turn the light or the camera"
    return (
        "an image 10 % off would pass: its lobes are too narrow for float32, too dark, or under a film of a colour's "
        "own index; give it a larger roughness, more light, or another film"
    )


def quantile(values: Array, share: float) -> float:
    """The value at `share` of the sorted values, which may be infinite: `np.quantile`'s method "higher"."""
    return _largest_but(values, values.size - 1 - math.ceil((values.size - 1) * share))


def _largest_but(values: Array, above: int) -> float:
    """The largest value but as many as `above`, fewer than there are."""
    flat = np.ravel(values)
    # A sample tells where the largest values begin: only those are sorted.
    begin = np.quantile(
        flat[:: flat.size // 4096 + 1], max(0.0, 1 - 4 * (above + 1) / flat.size), method="lower"
    )
    largest = flat[flat >= begin]
    if len(largest) <= above:
        largest = flat
    at = len(largest) - 1 - above
    return float(np.partition(largest, at)[at])
