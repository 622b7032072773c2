"""Image light as a shader sums it: the same samples of the same map in the evaluator, and the bounds of each lobe."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.library import host
from mrm_nodes.reference import image_light, refracted_light
from mrm_nodes.reference.image_light import AXES, UNIT, VIEW, Driver, Map, Sum
from mrm_nodes.regression.truth.environment_reference import compensation, view_in
from mrm_nodes.regression.truth.fresnel_errors import phase_jumps
from mrm_nodes.regression.truth.material import as_float32
from mrm_nodes.regression.truth.reference_image import evaluator
from mrm_nodes.regression.verdict.compare import fresnel_bounds, lobe_bounds
from mrm_nodes.render.arithmetic import Arithmetic
from mrm_nodes.render.environment import Environment

Array = NDArray[np.float64]
Method = Literal["fis", "prefilter"]

WHITE = {
    "color0": (1.0,) * 3,
    "color82": (1.0,) * 3,
    "color90": (1.0,) * 3,
    "exponent": 5.0,
    "scatter_mode": "R",
}


@dataclass(frozen=True)
class Surroundings:
    """An environment, the driver that reads it, and how the host evaluates its light."""

    environment: Environment
    arithmetic: Arithmetic
    method: Method = "fis"

    @property
    def driver(self) -> Driver:
        """What the driver makes of the shader's arithmetic."""
        found = self.arithmetic
        arcs = np.stack([found.arc_sine, found.arc_tangent], axis=-1)
        return Driver(arcs, found.sine, found.logarithm, found.texel, found.level)

    @property
    def levels(self) -> int:
        """How many mip levels the host says that the map has."""
        return int(self.environment.uniforms()["u_envRadianceMips"])

    def turned(self, vectors: Array) -> Array:
        """Vectors `(..., 3)` of the world in the space of the map."""
        inside: Array = vectors @ as_float32(self.environment.matrix[:3, :3]).T
        return inside


# The largest take 270 MB.
@functools.lru_cache(maxsize=1)
def _map(environment: Environment) -> Map:
    return _joined(environment.levels)


@functools.lru_cache(maxsize=1)
def _irradiance(environment: Environment) -> Map:
    return _joined([environment.irradiance])


def _joined(levels: list[NDArray[np.float32]]) -> Map:
    sizes = [each.shape[:2] for each in levels]
    begins = np.cumsum([0, *(height * width for height, width in sizes[:-1])])
    texels = np.concatenate([each.reshape(-1, 3) for each in levels]).astype(np.float64)
    return Map(texels, np.column_stack([begins, sizes]).astype(np.float64))


def lobe_sum(
    node: str,
    values: Mapping[str, Any],
    view: Array,
    frame: Array,
    around: Surroundings,
    mirrors: bool = False,
) -> Sum:
    """What one of our nodes, of weight 1, shows of its surroundings at n points, tint and compensation included.

    mirrors: whether it is MaterialX's own with its switch on: that mirrors the view, where ours turn each sample.
    """
    mirrored = mirrors and float(values["retroreflectivity"]) > 0.0
    if mirrored:
        values = {**values, "retroreflectivity": 0.0}
    if around.method == "prefilter":
        values = {**values, "distribution": "ggx", "masking": "smith"}
    bsdf = evaluator(node, values, compensated=False)
    v = view_in(frame, view)
    if around.method == "fis":
        seen = v * (-1.0, -1.0, 1.0) if mirrored else v
        found = image_light.filtered_samples(
            bsdf,
            seen,
            around.turned(frame),
            _map(around.environment),
            around.environment.samples,
            around.levels,
            around.driver,
        )
    else:
        found = _prefiltered(bsdf, values, v, frame, mirrored, around)
    tint = np.maximum(as_float32(values.get("tint", 1.0)), 0.0)
    factor = compensation(node, values, view, frame)
    # Of a white lobe it is one over its albedo.
    least = compensation(
        "mrm_generalized_schlick_bsdf", {**values, **WHITE, "thinfilm_thickness": 0.0}, view, frame
    )
    return _scaled(
        found,
        node,
        values,
        values["distribution"],
        factor * tint * around.environment.intensity,
        (least - 1.0) / factor,
    )


def _scaled(
    found: Sum,
    node: str,
    values: Mapping[str, Any],
    distribution: str,
    scale: Array,
    of_factor: Array | float = 0.0,
) -> Sum:
    """A sum times a scale, its bounds with those of the lobe's arithmetic and Fresnel factor; of_factor: by how much
    the scale changes with that factor, relative to it."""
    arithmetic = lobe_bounds(1.0, distribution)
    of_fresnel = fresnel_bounds(as_float32(values["thinfilm_thickness"]), as_float32(values["thinfilm_ior"]))

    jumps = phase_jumps(node, values)

    def allowed(error: Array, relative: Array, fresnel: Array) -> Array:
        fresnel = np.where(jumps, 1.0, fresnel)
        wrong = error + np.abs(found.value) * (relative + fresnel * of_factor) + found.white * fresnel
        return np.asarray(wrong * scale)

    return Sum(
        found.value * scale,
        allowed(found.most, arithmetic.max_rel, of_fresnel.max_rel),
        allowed(found.usual, arithmetic.p999_rel, of_fresnel.p999_rel),
        found.white * scale,
    )


def _prefiltered(
    bsdf: Any, values: Mapping[str, Any], v: Array, frame: Array, mirrored: bool, around: Surroundings
) -> Sum:
    """The split sum: one look-up in the mirrored view, and back along it, at a level for alpha, times the albedo."""
    level, of_level = _level(values, around)
    retro = np.clip(as_float32(values["retroreflectivity"]), 0.0, 1.0)[..., None]
    if mirrored:
        retro = np.ones(1)
    reflected = v * (-1.0, -1.0, 1.0)
    value, most, usual = (np.zeros(v.shape) for _ in range(3))
    for share, local in ((1.0 - retro, reflected), (retro, v)):
        toward = around.turned(np.einsum("nji,nj->ni", frame, local))
        seen = image_light.look_up(
            _map(around.environment), toward, VIEW + AXES, level, of_level, around.driver
        )
        value, most, usual = value + share * seen.value, most + share * seen.most, usual + share * seen.usual
    albedo = image_light.split_sum_albedo(bsdf, v)
    return Sum(value * albedo, most * albedo, usual * albedo, value)


def _level(values: Mapping[str, Any], around: Surroundings) -> tuple[Array, float]:
    """The mip level for alpha of the prefiltered method, and its error."""
    alpha = np.clip(as_float32(values["roughness"]), image_light.SMALLEST, 1.0)
    mean = np.sqrt(alpha[..., 0] * alpha[..., 1])
    level = np.where(mean < 0.25, np.sqrt(mean), 0.5 * mean + 0.375) * (around.levels - 1)
    return level, 8 * UNIT * around.levels


def transmits(values: Mapping[str, Any]) -> bool:
    """Whether a node with these inputs lets light through."""
    return "T" in values.get("scatter_mode", "R")


def transmitted_sum(
    node: str,
    values: Mapping[str, Any],
    view: Array,
    frame: Array,
    around: Surroundings,
    own: bool = True,
) -> Sum:
    """What a node that transmits, of weight 1, shows of what lies behind it, tint included: as MaterialX has it, GGX.

    Only our dielectric has `retro_transmission`, by which its `retroreflectivity` counts here too.

    own: whether it is ours, or MaterialX's.
    """
    plain = {**values, "distribution": "ggx", "masking": "smith"}
    index = refracted_light.host_index(evaluator(node, plain, compensated=False))
    if own and "exponent" in plain:
        # A curve with the exponent 0 is its colour at 90 degrees, also for the phase of a film.
        exponent, color0, color90 = (as_float32(plain[name]) for name in ("exponent", "color0", "color90"))
        plain["color0"] = np.where((exponent == 0.0)[..., None], color90, color0)
        plain["exponent"] = np.where(exponent == 0.0, 5.0, exponent)
    bsdf = evaluator(node, plain, compensated=False)
    retro = np.zeros(1)
    if values.get("retro_transmission", False):
        retro = np.clip(as_float32(values["retroreflectivity"]), 0.0, 1.0)[..., None]
    v = view_in(frame, view)
    map_, inside = _map(around.environment), around.turned(frame)
    if around.method == "fis":
        found = refracted_light.refracted_samples(
            bsdf, index, retro, v, inside, map_, around.environment.samples, around.levels, around.driver
        )
    else:
        level, of_level = _level(values, around)
        seen = refracted_light.refracted_look_up(
            index, retro, v, inside, map_, level, of_level, around.driver
        )
        share, of_share = refracted_light.transmitted_share(bsdf, v, host().prefilters_by_albedo)
        size, wrong = np.abs(share), seen.value * of_share
        found = Sum(seen.value * share, seen.most * size + wrong, seen.usual * size + wrong, seen.value)
    tint = np.maximum(as_float32(values.get("tint", 1.0)), 0.0)
    return _scaled(found, node, values, "ggx", tint * around.environment.intensity)


def diffuse_sum(
    values: Mapping[str, Any], view: Array, frame: Array, around: Surroundings, of_albedo: Array | float
) -> Sum:
    """What MaterialX's `oren_nayar_diffuse_bsdf`, of weight 1, shows of its surroundings: irradiance times albedo.

    of_albedo: the error, `(n, 1)`, of the albedo of single scattering, on which an energy-compensated one stands.
    """
    normal = around.turned(frame[:, 2])
    found = image_light.look_up(
        _irradiance(around.environment), normal, VIEW, np.zeros(1), 0.0, around.driver
    )
    if len(np.unique(normal, axis=0)) < len(normal) / 2:
        # Points that share a normal are off alike: what holds for most directions says nothing of one.
        found = found._replace(usual=found.most)
    color, roughness = as_float32(values["color"]), as_float32(values["roughness"])[..., None]
    cosine = np.clip(view_in(frame, view)[:, 2:], image_light.SMALLEST, 1.0)
    albedo = image_light.oren_nayar_albedo(color, roughness, cosine, bool(values["energy_compensation"]))
    arithmetic = lobe_bounds(1.0, "ggx")
    scale = albedo * around.environment.intensity
    value = found.value * scale
    multiple = image_light.scattered_color(color, roughness)
    wrong = np.abs(color - multiple) * of_albedo * found.value * around.environment.intensity
    return Sum(
        value,
        found.most * np.abs(scale) + np.abs(value) * arithmetic.max_rel + wrong,
        found.usual * np.abs(scale) + np.abs(value) * arithmetic.p999_rel + wrong,
        value,
    )
