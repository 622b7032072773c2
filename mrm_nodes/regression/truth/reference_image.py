"""The reference image: the evaluator applied to the very points that the renderer shaded.

Everything starts from the float32 values that the renderer wrote or was given, and goes on in float64.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import mrm_nodes  # whose evaluator is imported when it is first used: that takes half a second
from mrm_nodes.errors import MrmError
from mrm_nodes.library import host
from mrm_nodes.regression.truth.material import as_float32
from mrm_nodes.regression.verdict.compare import UNIT

Array = NDArray[np.float64]
LightData = Mapping[str, Any]

DIRECTIONAL, POINT, SPOT = 1, 2, 3
"""`LightData.type`, as shader generation numbers MaterialX's light nodes."""

SMALLEST_ALPHA = 1e-8
"""Up to which MaterialX raises a roughness; the largest is 1."""


def evaluator(node: str, values: Mapping[str, Any], compensated: bool = True) -> Any:
    """The evaluator's BSDF for a node and its inputs (scalars, or arrays `(n,)` and `(n, 3)`).

    `weight` and the geometric inputs are not part of it.
    """
    common: dict[str, Any] = {
        "alpha": np.clip(as_float32(values["roughness"]), SMALLEST_ALPHA, 1.0),
        "retroreflectivity": np.clip(as_float32(values["retroreflectivity"]), 0.0, 1.0),
        "distribution": values["distribution"],
        "masking": values["masking"],
        "energy_compensation": host().compensation if compensated else None,
        # As MaterialX has it: no film.
        "thinfilm_thickness": np.maximum(as_float32(values["thinfilm_thickness"]), 0.0),
        "thinfilm_ior": as_float32(values["thinfilm_ior"]),
    }
    if node == "mrm_conductor_bsdf":
        return mrm_nodes.reference.Conductor(
            as_float32(values["ior"]), as_float32(values["extinction"]), **common
        )
    if node == "mrm_dielectric_bsdf":
        tint = np.maximum(as_float32(values["tint"]), 0.0)
        return mrm_nodes.reference.Dielectric(
            as_float32(values["ior"]), tint=tint, scatter_mode=values["scatter_mode"], **common
        )
    if node == "mrm_generalized_schlick_bsdf":
        colors = {
            name: np.maximum(as_float32(values[name]), 0.0) for name in ("color0", "color82", "color90")
        }
        return mrm_nodes.reference.GeneralizedSchlick(
            **colors, exponent=as_float32(values["exponent"]), scatter_mode=values["scatter_mode"], **common
        )
    raise MrmError(f"the evaluator has no {node}")


def white_evaluator(values: Mapping[str, Any], compensated: bool = True) -> Any:
    """The lobe of `values` with a Fresnel factor of 1 and no film: a Fresnel error's factor."""
    white = {"color0": 1.0, "color82": 1.0, "color90": 1.0, "exponent": 5.0, "scatter_mode": "R"}
    return evaluator(
        "mrm_generalized_schlick_bsdf", {**values, **white, "thinfilm_thickness": 0.0}, compensated
    )


def shading_frame(
    position: ArrayLike, normal: ArrayLike, tangent: ArrayLike, eye: ArrayLike
) -> tuple[Array, Array]:
    """View direction `(n, 3)` and frame `(n, 3, 3)` (rows: tangent, bitangent, normal), all in world space.

    The normal is turned to the viewer, as MaterialX's `mx_forward_facing_normal` does, and the tangent made
    perpendicular to it.
    """
    view = _unit(as_float32(eye) - np.asarray(position, np.float64))
    z = _unit(np.asarray(normal, np.float64))
    z = np.where(_dot(z, view) < 0, -z, z)
    x = np.asarray(tangent, np.float64)
    x = _unit(x - _dot(x, z) * z)
    return view, np.stack([x, np.cross(z, x), z], axis=-2)


def light_at(light: LightData, position: ArrayLike) -> tuple[Array, Array]:
    """Direction to the light and its intensity, each `(n, 3)`, at points `(n, 3)`: MaterialX's nodes.

    light: the members of MaterialX's `LightData`, as a light's `data(camera)` gives them.
    """
    position = np.asarray(position, np.float64)
    given = {name: as_float32(value) for name, value in light.items()}
    emitted = given["color"] * given["intensity"]
    if light["type"] == DIRECTIONAL:
        return np.broadcast_to(-given["direction"], position.shape), np.broadcast_to(emitted, position.shape)
    away = given["position"] - position
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    direction = away / distance
    intensity = emitted / (distance + 1.0) ** given["decay_rate"]
    if light["type"] == SPOT:
        cosine = _dot(direction, -given["direction"])
        low = np.minimum(given["inner_angle"], given["outer_angle"])
        intensity = intensity * _smoothstep(low, given["inner_angle"], cosine)
    elif light["type"] != POINT:
        raise MrmError(f"the reference knows no light of type {light['type']}")
    return direction, intensity


@dataclass(frozen=True)
class LightErrors:
    """What float32 may make of a light: anywhere, and in 999 of 1000 values."""

    most: Array
    """Of the intensity, absolute, `(n, 3)`."""
    usual: Array
    cosine: float
    """Of the cosine with a surface's normal, absolute, beyond that of a direction that is given."""


SPOT_COSINE_MAX, SPOT_COSINE_P999 = 7 * UNIT, 5 * UNIT
"""Error of the cosine with a spot light's axis, near 1: a difference and a quotient round each component, two roundings
the length, three the sum of products. As many uniform errors are below five of them in 999 of 1000 sums."""


def light_errors(light: LightData, position: ArrayLike) -> LightErrors:
    """What float32 may make of a light at points `(n, 3)`, as MaterialX's nodes compute it.

    A power is `exp2(y log2(x))`, each as exact as Vulkan's table of precisions asks for, which drivers keep in OpenGL
    too: 3 units in the last place for `log2`, but 2^-21 below 2; 3 + 2 |x| for `exp2`.
    """
    position = np.asarray(position, np.float64)
    if light["type"] == DIRECTIONAL:
        return LightErrors(np.zeros(position.shape), np.zeros(position.shape), 0.0)
    given = {name: as_float32(value) for name, value in light.items()}
    emitted = np.abs(given["color"] * given["intensity"])
    away = given["position"] - position
    distance = np.linalg.norm(away, axis=-1, keepdims=True)
    decay, power = np.abs(given["decay_rate"]), np.log2(distance + 1.0)
    of_log = np.where(distance < 1.0, 2.0**-21, 6 * UNIT * power)
    relative = decay * math.log(2.0) * of_log + 2 * UNIT * (3.0 + 2.0 * decay * power)
    unfaded = emitted / (distance + 1.0) ** given["decay_rate"]
    most = usual = relative * unfaded
    if light["type"] == SPOT:
        low, high = np.minimum(given["inner_angle"], given["outer_angle"]), given["inner_angle"]
        cosine = _dot(away / distance, -given["direction"])
        faded = _smoothstep(low, high, cosine)

        def change(error: float) -> Array:
            """Of the fading, whose edge is where a relative error has no bound."""
            up, down = (_smoothstep(low, high, cosine + sign * error) for sign in (1.0, -1.0))
            return np.maximum(up - faded, faded - down) + 6 * UNIT * faded

        most = relative * unfaded * faded + unfaded * change(SPOT_COSINE_MAX)
        usual = relative * unfaded * faded + unfaded * change(SPOT_COSINE_P999)
    # A component of the direction is a difference and a quotient: two roundings, whose sum with a unit normal is
    # largest in one component.
    return LightErrors(most, usual, 2 * UNIT)


def shade(
    bsdf: Any, weight: ArrayLike, view: Array, frame: Array, position: ArrayLike, lights: Sequence[LightData]
) -> Array:
    """Radiance `(n, 3)` towards the viewer: the sum over lights of intensity, BSDF, cosine and weight.

    A light below the shading horizon gives exactly nothing. weight: `(n,)` or a scalar.
    """
    total = np.zeros(view.shape)
    v = _to_frame(frame, view)
    for light in lights:
        direction, intensity = light_at(light, position)
        l = _to_frame(frame, direction)  # noqa: E741  the field's own name
        total += np.where(l[..., 2:] > 0, bsdf.eval(v, _unit(l)) * intensity * l[..., 2:], 0.0)
    shaded: Array = total * np.asarray(as_float32(weight))[..., None]
    return shaded


def _to_frame(frame: Array, direction: Array) -> Array:
    local: Array = np.einsum("nij,nj->ni", frame, direction)
    return local


def _unit(vector: Array) -> Array:
    unit: Array = vector / np.linalg.norm(vector, axis=-1, keepdims=True)
    return unit


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.sum(a * b, axis=-1, keepdims=True)
    return product


def _smoothstep(low: Array, high: Array, x: Array) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
