"""The reference of a material: its closure tree in the evaluator, at the points that the renderer shaded.

Every lobe stands in its own frame, because each may have a normal of its own; a response holds that frame's
cosine, as MaterialX's does, so that `mix`, `add`, `multiply` and `layer` apply to it unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.reference import layers
from mrm_nodes.regression import closure
from mrm_nodes.regression.closure import DIFFUSE_NODE, PLAIN_NODES, Lobe, Port, Tree
from mrm_nodes.regression.compare import FLOOR, Bounds, bounds_for, grazing_factor
from mrm_nodes.regression.environment_reference import Estimate, environment_image, irradiance
from mrm_nodes.regression.material import as_float32
from mrm_nodes.regression.reference_image import (
    LightData,
    evaluator,
    light_at,
    shading_frame,
    white_evaluator,
)
from mrm_nodes.render.environment import Environment

Array = NDArray[np.float64]
Resolve = Callable[[Port], Any]
"""What an input is at each of n points: a constant, `(n,)` or `(n, k)`; None stays None."""

LEAKED_COSINE = 1e-8
"""MaterialX's M_FLOAT_EPS, below which its nodes take no cosine to be."""


@dataclass(frozen=True)
class Points:
    """What the renderer shaded: n points in world space, each array `(n, 3)`, and the camera's position."""

    position: Array
    normal: Array
    tangent: Array
    eye: tuple[float, float, float]


def shade_tree(
    tree: Tree, points: Points, lights: Sequence[LightData], resolve: Resolve
) -> tuple[Array, Bounds]:
    """Radiance `(n, 3)` towards the camera, and the bounds that float32 keeps there.

    Raises:
        MrmError: a value that the evaluator has no model of, such as an anisotropic roughness of MaterialX's nodes.
    """
    placed = _Placed(points, resolve)
    kinds = [placed.tree(tree, kind) for kind in (_Response, _Grazing, _White, _Leak)]
    view = _view(points)
    sums = [np.zeros(view.shape) for _ in kinds]
    try:
        for light in lights:
            direction, intensity = light_at(light, points.position)
            for total, each in zip(sums, kinds, strict=True):
                total += each.eval(view, direction) * intensity
    except ValueError as error:
        raise MrmError(f"the evaluator: {error}") from None
    reference, grazing, white, leak = sums
    bounds = bounds_for(placed.alpha, placed.distribution, reference, grazing, white, placed.film)
    allowed = leak / np.maximum(np.abs(reference), FLOOR)
    return reference, Bounds(bounds.max_rel + allowed, bounds.p999_rel + allowed)


def respond(tree: Tree, points: Points, direction: Array, resolve: Resolve) -> Array:
    """The response `(n, 3)` to light from directions `(n, 3)` in world space, each lobe's cosine included.

    Raises:
        MrmError: as `shade_tree`.
    """
    try:
        return _Placed(points, resolve).tree(tree, _Response).eval(_view(points), direction)
    except ValueError as error:
        raise MrmError(f"the evaluator: {error}") from None


def light_tree(tree: Tree, points: Points, environment: Environment, resolve: Resolve) -> Estimate:
    """Radiance `(n, 3)` towards the camera from an environment, with the standard error of its integral.

    Errors of several lobes are added up: they are no smaller than that.

    Raises:
        MrmError: as `shade_tree`.
    """
    placed = _Placed(points, resolve, environment)
    view = _view(points)
    try:
        mean, error = (placed.tree(tree, kind).eval(view, view) for kind in (_Surrounded, _Uncertain))
    except ValueError as error_of_values:
        raise MrmError(f"the evaluator: {error_of_values}") from None
    return Estimate(mean, error)


def _view(points: Points) -> Array:
    """The direction to the camera, `(n, 3)`."""
    away = points.eye - points.position
    view: Array = away / np.linalg.norm(away, axis=-1, keepdims=True)
    return view


class _Placed:
    """Lobes with their values and frames at n points, and what the bounds depend on."""

    def __init__(self, points: Points, resolve: Resolve, environment: Environment | None = None) -> None:
        self._points = points
        self._resolve = resolve
        self._environment = environment
        self._estimates: dict[str, Estimate] = {}
        self._lobes: dict[str, Mapping[str, Any]] = {}
        self.alpha: Array = np.ones(len(points.position))
        self.film: NDArray[np.bool_] = np.zeros(len(points.position), bool)
        self.distribution = "ggx"

    def tree(self, tree: Tree, kind: type[_Response]) -> layers.Closure:
        """The evaluator's tree, its leaves of one kind."""
        match tree:
            case Lobe():
                return self._leaf(tree, kind)
            case closure.Nothing(opaque):
                return _Dark(0.0 if opaque else 1.0)
            case closure.Mix(fg, bg, amount):
                return layers.Mix(self.tree(fg, kind), self.tree(bg, kind), self._number(amount))
            case closure.Add(in1, in2):
                return layers.Add(self.tree(in1, kind), self.tree(in2, kind))
            case closure.Multiply(in1, in2):
                # MaterialX clamps the factor.
                return layers.Multiply(self.tree(in1, kind), np.clip(self._number(in2), 0.0, 1.0))
            case closure.Layer(top, base):
                return layers.Layer(self.tree(top, kind), self.tree(base, kind))

    def _number(self, port: Port) -> Array:
        return as_float32(self._resolve(port))

    def _leaf(self, lobe: Lobe, kind: type[_Response]) -> layers.Closure:
        if lobe.path not in self._lobes:
            self._lobes[lobe.path] = {name: self._resolve(port) for name, port in lobe.inputs.items()}
            if lobe.node != DIFFUSE_NODE:
                self._note(lobe, self._lobes[lobe.path])
        values = self._lobes[lobe.path]
        points = self._points
        normal = points.normal if values["normal"] is None else values["normal"]
        tangent = points.tangent if values.get("tangent") is None else values["tangent"]
        view, frame = shading_frame(points.position, normal, tangent, points.eye)
        try:
            placed = kind(lobe.node, _as_ours(lobe, values), frame)
        except ValueError as error:
            raise MrmError(f"{lobe.path}: the evaluator: {error}") from None
        if self._environment is not None:
            if lobe.path not in self._estimates:
                self._estimates[lobe.path] = _around(placed, view, self._environment)
            placed.around = self._estimates[lobe.path]
        return placed

    def _note(self, lobe: Lobe, values: Mapping[str, Any]) -> None:
        alpha = np.clip(as_float32(values["roughness"]), 1e-8, 1.0)
        if lobe.node in PLAIN_NODES and not np.allclose(alpha[..., 0], alpha[..., 1], rtol=1e-6, atol=0.0):
            raise MrmError(
                f"{lobe.path}/roughness is anisotropic, and MaterialX approximates the masking of such a "
                f'{lobe.node}: give the case truth = "baseline", or use mrm_{lobe.node}, which is exact'
            )
        self.alpha = np.minimum(self.alpha, alpha.min(axis=-1))
        self.film = self.film | (np.asarray(values["thinfilm_thickness"]) > 0)
        if values["distribution"] != "ggx":
            self.distribution = values["distribution"]


def _as_ours(lobe: Lobe, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The inputs by which our nodes have what one of MaterialX's is."""
    if lobe.node not in PLAIN_NODES:
        return values
    return {**values, "masking": "smith", "retroreflectivity": float(values["retroreflective"])}


@dataclass(frozen=True)
class _Dark(layers.Closure):
    """No response, and one throughput everywhere."""

    through: float

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741  the field's own name
        return np.zeros(np.shape(v))

    def throughput(self, v: Any, l: Any = None) -> Array:  # noqa: E741
        return np.full(np.shape(v), self.through)


class _Response(layers.Closure):
    """A lobe in its frame: directions are in world space, and its cosine is part of the response."""

    around: Estimate | None = None
    """What it shows of an environment."""

    def __init__(self, node: str, values: Mapping[str, Any], frame: Array) -> None:
        self.node = node
        self.values = values
        self.frame = frame
        self.weight = as_float32(values["weight"])
        self.lobe = None if node == DIFFUSE_NODE else evaluator(_our_name(node), values)

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741
        view, light = self._local(v), self._local(l)
        lit = light[..., 2:] > 0
        response: Array = np.where(lit, self._value(view, light) * light[..., 2:], 0.0)
        return response * self.weight[..., None]

    def throughput(self, v: Any, l: Any = None) -> Array:  # noqa: E741
        if self.lobe is None:
            return np.zeros(np.shape(v))
        through: Array = self.lobe.throughput(
            self._local(v), None if l is None else self._local(l), self.weight
        )
        return through

    def _value(self, view: Array, light: Array) -> Array:
        if self.lobe is not None:
            value: Array = self.lobe.eval(view, light)
            return value
        color, roughness = as_float32(self.values["color"]), as_float32(self.values["roughness"])
        if self.values["energy_compensation"]:
            return layers.OrenNayar(color, roughness, True).eval(view, light)
        # Linear in the colour, which MaterialX allows to be above 1.
        return layers.OrenNayar(1.0, roughness).eval(view, light) * color

    def _local(self, direction: Any) -> Array:
        local: Array = np.einsum("nij,nj->ni", self.frame, direction)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local


class _Grazing(_Response):
    """The response times the factor by which the bounds grow."""

    def _value(self, view: Array, light: Array) -> Array:
        return super()._value(view, light) * grazing_factor(view, light)


class _White(_Response):
    """The response for a Fresnel factor of 1; a diffuse base has it of what lies above."""

    def __init__(self, node: str, values: Mapping[str, Any], frame: Array) -> None:
        super().__init__(node, values, frame)
        self._white = None if self.lobe is None else white_evaluator(values)

    def _value(self, view: Array, light: Array) -> Array:
        if self._white is None:
            return super()._value(view, light)
        value: Array = self._white.eval(view, light)
        return value


class _Leak(_White):
    """At most what MaterialX's own nodes let through of a light below the horizon: they take its cosine for 1e-8."""

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741
        view, light = self._local(v), self._local(l)
        if self.node.startswith("mrm_"):
            return np.zeros(view.shape)
        across = light * (1.0, 1.0, 0.0) + (1e-12, 0.0, 0.0)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        leak = self._value(view, across + np.array([0.0, 0.0, LEAKED_COSINE])) * LEAKED_COSINE
        return np.where(light[..., 2:] > 0, 0.0, leak) * self.weight[..., None]


class _Surrounded(_Response):
    """What a lobe shows of an environment, in place of a response to one light."""

    def throughput(self, v: Any, l: Any = None) -> Array:  # noqa: E741
        return super().throughput(v)

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741
        return self.around.mean if self.around is not None else np.zeros(np.shape(v))


class _Uncertain(_Surrounded):
    """The standard error of what a lobe shows of an environment."""

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741
        return self.around.standard_error if self.around is not None else np.zeros(np.shape(v))


def _around(lobe: _Response, view: Array, environment: Environment) -> Estimate:
    if lobe.lobe is not None:
        return environment_image(_our_name(lobe.node), lobe.values, view, lobe.frame, environment)
    # Lambert: no other diffuse lobe gets here.
    color = as_float32(lobe.values["color"]) * lobe.weight[..., None]
    mean = color * irradiance(environment, lobe.frame[:, 2])
    return Estimate(mean, np.zeros_like(mean))


def _our_name(node: str) -> str:
    return node if node.startswith("mrm_") else f"mrm_{node}"
