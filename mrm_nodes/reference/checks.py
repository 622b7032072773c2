"""What a caller may pass: names, ranges and shapes, and the errors that say which was wrong."""

import inspect
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import block, masking, microsurface
from . import energy_formulas as energy
from .albedo_fit import COEFFICIENTS
from .compiled import Array

DISTRIBUTIONS = {name: name for name in microsurface.NAMES}
MASKINGS = {
    "smith": masking.SMITH,
    "vcavity": masking.VCAVITY,
    "cook-torrance": masking.VCAVITY,
    "implicit": masking.IMPLICIT,
    "schlick-smith": masking.SCHLICK_SMITH,
    "kelemen": masking.KELEMEN,
}
#: The distributions of a node, each with the maskings that are physics with it: of which there is a fit of albedo.
PAIRS = tuple(COEFFICIENTS)
CORRELATIONS = {
    "height": masking.HEIGHT,
    "separable": masking.SEPARABLE,
    "direction": masking.DIRECTION,
    "height_direction": masking.HEIGHT_DIRECTION,
}
SCATTER_MODES = {"R": block.REFLECT, "T": block.TRANSMIT, "RT": block.BOTH}
COMPENSATIONS = {
    None: energy.NONE,
    "materialx-1.39.5": energy.MATERIALX_1_39_5,
    "materialx-1.39.6": energy.MATERIALX_1_39_6,
    "turquin": energy.TURQUIN,
    "kulla-conty": energy.KULLA_CONTY,
}

#: Below it D leaves float64's range at grazing normals: it divides by at least z⁴ (αx αy)⁴, and a half vector's z is at
#: least twice the horizon of 1e-60, so that (2e-60)⁴ α⁸ must stay above float64's smallest normal, 2.2e-308.
SMALLEST_ALPHA = 2.5e-9

#: Beyond it the squares of squares in Fresnel's equations leave float64's range.
LARGEST_INDEX = 1e6


def first(array: Array, bad: NDArray[np.bool_]) -> str:
    """The first bad value and where it is."""
    where = np.argwhere(bad)[0]
    value = float(array[tuple(where)])
    return f"{value:g}" if array.ndim == 0 else f"{value:g} at index {tuple(int(k) for k in where)}"


def _real(value: ArrayLike) -> Array:
    if np.iscomplexobj(value):
        raise TypeError("complex numbers have no place here")
    return np.asarray(value, dtype=np.float64)


def numbers(
    name: str, value: ArrayLike, low: float = -np.inf, high: float = np.inf, open_low: bool = False
) -> Array:
    """A parameter of any shape; `ValueError` for what is not a number or outside its range."""
    try:
        array = _real(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} must be a number or an array of numbers, not {value!r}") from error
    good = (array > low) if open_low else (array >= low)
    good &= array <= high
    good &= np.isfinite(array)
    if not good.all():
        bounds = f", {'above' if open_low else 'at least'} {low:g}" if low > -np.inf else ""
        bounds += f" and at most {high:g}" if high < np.inf else ""
        raise ValueError(f"{name} must be finite{bounds}, not {first(array, ~good)}")
    return array


def scalar(name: str, value: ArrayLike, low: float, high: float = np.inf, open_low: bool = False) -> Array:
    """A parameter of shape (...), as (..., 1); `ValueError` outside its range."""
    return numbers(name, value, low, high, open_low)[..., np.newaxis]


def colour(name: str, value: ArrayLike, low: float, high: float = np.inf, open_low: bool = False) -> Array:
    """A parameter that is a number or has shape (..., 3), as (..., 3); `ValueError` outside its range."""
    array = numbers(name, value, low, high, open_low)
    if array.ndim == 0:
        array = array[np.newaxis]
    if array.shape[-1] not in (1, 3):
        raise ValueError(f"{name} must be a number or have shape (..., 3), not {array.shape}")
    return np.broadcast_to(array, (*array.shape[:-1], 3))


def pair(name: str, value: ArrayLike, low: float, high: float, open_low: bool = False) -> Array:
    """A parameter that is a number, a pair or has shape (..., 2), as (..., 2); `ValueError` outside its
    range.
    """
    array = numbers(name, value, low, high, open_low)
    if array.ndim == 0:
        array = array[np.newaxis]
    if array.shape[-1] not in (1, 2):
        raise ValueError(f"{name} must be a number, a pair or have shape (..., 2), not {array.shape}")
    return np.broadcast_to(array, (*array.shape[:-1], 2))


def choice(name: str, value: object, choices: Mapping[Any, Any]) -> Any:
    """What a name stands for; `ValueError` that lists the names."""
    try:
        return choices[value]
    except (KeyError, TypeError):
        known = ", ".join(repr(key) for key in choices)
        raise ValueError(f"{name} must be one of {known}, not {value!r}") from None


def directions(name: str, value: ArrayLike) -> Array:
    """Directions as float64 of shape (..., 3); `ValueError` for another shape."""
    try:
        array = _real(value)
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
        raise ValueError(
            f"{name} must be of unit length: {array[where]} at index {where} has length {length[where]:g}"
        )


def check_shapes(**shapes: tuple[int, ...]) -> tuple[int, ...]:
    """The shape to which the named shapes broadcast; `ValueError` that names them where they do not."""
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        named = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise ValueError(f"shapes do not broadcast: {named}") from None


def name_of(code: object, names: Mapping[Any, Any]) -> Any:
    """The name that `choice` took a code for; the first of several."""
    return next(name for name, each in names.items() if each == code)


def call_of(kind: type, given: Mapping[str, Any]) -> str:
    """The call that makes an object, without what is as by default. Of many values it has their shape.

    given: what was passed, as it is kept: names as they are, numbers as arrays whose last axis is the components'.
    """
    shown = []
    for name, parameter in inspect.signature(kind).parameters.items():
        value = given[name]
        if isinstance(value, np.ndarray):
            alike = value.size and np.all(value == value.flat[0])
            many = value.ndim > 1 and value.size > value.shape[-1]
            value = float(value.flat[0]) if alike else value if many else tuple(map(float, value.flat))
        if isinstance(value, np.ndarray):
            shown.append(f"{name}=<{' x '.join(map(str, value.shape[:-1]))} values>")
        elif value != parameter.default:
            shown.append(f"{name}={value!r}")
    return f"{kind.__name__}({', '.join(shown)})"
