"""The reference of a material: its closure tree in the evaluator, at the points that the renderer shaded.

Every lobe stands in its own frame, because each may have a normal of its own; a response holds that frame's
cosine, as MaterialX's does, so that `mix`, `add`, `multiply` and `layer` apply to it unchanged.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.reference import GGX, diffuse, materialx
from mrm_nodes.reference.albedo_points import albedo_of_points
from mrm_nodes.reference.bsdf import BsdfSample
from mrm_nodes.regression.truth import closure
from mrm_nodes.regression.truth.closure import DIFFUSE_NODE, PLAIN_NODES, LobeNode, Port, Tree
from mrm_nodes.regression.truth.environment_reference import (
    SAMPLES,
    Estimate,
    environment_image,
    irradiance,
    reflected_radiance,
)
from mrm_nodes.regression.truth.fresnel_errors import Reflected, phase_jumps
from mrm_nodes.regression.truth.image_sum import (
    Surroundings,
    diffuse_sum,
    lobe_sum,
    transmits,
    transmitted_sum,
)
from mrm_nodes.regression.truth.material import as_float32
from mrm_nodes.regression.truth.reference_image import (
    SMALLEST_ALPHA,
    LightData,
    evaluator,
    light_at,
    light_errors,
    shading_frame,
    white_evaluator,
)
from mrm_nodes.regression.verdict.compare import (
    FLOOR,
    HALF_COSINE_MAX,
    HALF_COSINE_P999,
    NEAR_COSINE_MAX,
    NEAR_COSINE_P999,
    UNIT,
    Bounds,
    direction_bounds,
    fresnel_bounds,
    lobe_bounds,
    relative_error,
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

    def at(self, chosen: NDArray[np.intp]) -> Points:
        """Some of the points, by their indices."""
        return Points(self.position[chosen], self.normal[chosen], self.tangent[chosen], self.eye)


def shade_tree(
    tree: Tree,
    points: Points,
    lights: Sequence[LightData],
    resolve: Resolve,
    around: Surroundings | None = None,
) -> tuple[Array, Bounds]:
    """Radiance `(n, 3)` towards the camera, and the bounds that float32 keeps there.

    Light from around is summed as the shader sums it, by the same samples.

    Raises:
        MrmError: a value that the evaluator has no model of, such as an anisotropic roughness of MaterialX's nodes.
    """
    reference, bounds, _ = _shade(tree, points, lights, resolve, around, beside=False)
    return reference, bounds


def shade_both(
    tree: Tree,
    points: Points,
    lights: Sequence[LightData],
    resolve: Resolve,
    around: Surroundings | None = None,
) -> tuple[Array, Bounds, Array]:
    """`shade_tree`, and the radiance `(n, 3)` by the exact rule of layering, that of `Closure.exact_throughput`.

    Raises:
        MrmError: as `shade_tree`.
    """
    return _shade(tree, points, lights, resolve, around, beside=True)


def _shade(
    tree: Tree,
    points: Points,
    lights: Sequence[LightData],
    resolve: Resolve,
    around: Surroundings | None,
    beside: bool,
) -> tuple[Array, Bounds, Array]:
    placed = _Placed(points, resolve)
    view = _view(points)

    @functools.cache
    def passed(leaf: _Judged) -> Array:
        return leaf.exact_throughput(view)

    def part_of(judged: Callable[[_Judged], _Part], through: bool = False) -> _Part:
        # A lobe's own part serves both rules.
        once = functools.cache(judged)
        part = placed.judge(tree, view, once, through)
        if not beside:
            return part
        exact = placed.judge(
            tree, view, lambda leaf: replace(once(leaf), through=passed(leaf)), through, is_exact=True
        )
        return replace(part, exact=exact.value)

    def of_light(direction: Array, cosine: float) -> _Part:
        return part_of(lambda leaf: leaf.judge(view, direction, cosine))

    try:
        surroundings = []
        if around is not None:
            # Two closures of MaterialX's: each has its own layers.
            surroundings = [
                part_of(lambda leaf: leaf.judge_around(view, around)),
                part_of(lambda leaf: leaf.judge_through(view, around), True),
            ]
        return _lit(lights, points.position, view, of_light, surroundings)
    except ValueError as error:
        raise MrmError(f"the evaluator: {error}") from None


def beside_exact(reference: Array, exact: Array) -> dict[str, float]:
    """What the host's rule of layering costs: how far a radiance is from the one by the exact rule, over its values.

    Relative, as all errors here, to the exact one, or to FLOOR where that is less.
    """
    apart = relative_error(reference, exact)
    return {"max_rel": float(apart.max()), "mean_rel": float(apart.mean())}


def _lit(
    lights: Sequence[LightData],
    position: Array,
    view: Array,
    part_of: Callable[[Array, float], _Part],
    around: Sequence[_Part] = (),
) -> tuple[Array, Bounds, Array]:
    """The sum of what an environment gives and of all lights, whose part is that of a direction and of what its cosine
    is off by; its bounds; and the sum by the exact rule, where the parts have that."""
    reference, most, usual, exact = (np.zeros(view.shape) for _ in range(4))
    for part in around:
        reference, most, usual = reference + part.value, most + part.most, usual + part.usual
        exact += part.exact
    for light in lights:
        direction, intensity = light_at(light, position)
        errors = light_errors(light, position)
        part = part_of(direction, errors.cosine)
        reference += part.value * intensity
        exact += part.exact * intensity
        most += part.most * np.abs(intensity) + np.abs(part.value) * errors.most
        usual += part.usual * np.abs(intensity) + np.abs(part.value) * errors.usual
    size = np.maximum(np.abs(reference), FLOOR)
    # What is missing to the smallest value that counts is allowed the rounding of a wide lobe.
    missing, wide = 1.0 - np.minimum(np.abs(reference) / FLOOR, 1.0), lobe_bounds(1.0, "ggx")
    bounds = Bounds(most / size + missing * wide.max_rel, usual / size + missing * wide.p999_rel)
    return reference, bounds, exact


def shade_node(
    node: str,
    values: Mapping[str, Any],
    view: Array,
    frame: Array,
    position: Array,
    lights: Sequence[LightData],
) -> tuple[Array, Bounds]:
    """`shade_tree` of one node of ours, its inputs given: scalars, `(n,)` or `(n, k)`.

    view, frame, position: in world space, as `reference_image.shading_frame` gives them.
    """
    lobe = _Judged(node, values, frame)
    return _lit(lights, position, view, lambda direction, cosine: lobe.judge(view, direction, cosine))[:2]


def surround_node(
    node: str, values: Mapping[str, Any], view: Array, frame: Array, around: Surroundings
) -> tuple[Array, Bounds]:
    """`shade_node` in an environment, without lights."""
    lobe = _Judged(node, values, frame)
    around_it = [lobe.judge_around(view, around), lobe.judge_through(view, around)]
    return _lit([], view, view, lambda direction, cosine: lobe.judge(view, direction, cosine), around_it)[:2]


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
    # A mix beyond 0 to 1 takes one of its parts away.
    return Estimate(mean, np.abs(error))


def _view(points: Points) -> Array:
    """The direction to the camera, `(n, 3)`, whose place the shader has in float32."""
    away = as_float32(points.eye) - points.position
    view: Array = away / np.linalg.norm(away, axis=-1, keepdims=True)
    return view


_Kind = TypeVar("_Kind", bound="_Response")


class _Placed:
    """Lobes with their values and frames at n points."""

    def __init__(self, points: Points, resolve: Resolve, environment: Environment | None = None) -> None:
        self._points = points
        self._resolve = resolve
        self._environment = environment
        self._estimates: dict[str, Estimate] = {}
        self._lobes: dict[str, Mapping[str, Any]] = {}
        self._judged: dict[str, _Judged] = {}

    def tree(self, tree: Tree, kind: type[_Response]) -> materialx.Closure:
        """The evaluator's tree, its leaves of one kind."""
        match tree:
            case LobeNode():
                return self._leaf(tree, kind)
            case closure.Nothing(opaque):
                return _Dark(0.0 if opaque else 1.0)
            case closure.MixNode(fg, bg, amount):
                return _Mix(self.tree(fg, kind), self.tree(bg, kind), self._number(amount))
            case closure.AddNode(in1, in2):
                return materialx.Add(self.tree(in1, kind), self.tree(in2, kind))
            case closure.MultiplyNode(in1, in2):
                # MaterialX clamps the factor.
                return materialx.Multiply(self.tree(in1, kind), np.clip(self._number(in2), 0.0, 1.0))
            case closure.LayerNode(top, base):
                return materialx.Layer(self.tree(top, kind), self.tree(base, kind))
            case closure.VolumeNode(top, _):
                return self.tree(top, kind)

    def judge(
        self,
        tree: Tree,
        v: Array,
        judged: Callable[[_Judged], _Part],
        through: bool = False,
        is_exact: bool = False,
    ) -> _Part:
        """A tree's response to a light, and what float32 may make of it: each lobe's own error, times what the tree
        passes on of the lobe.

        judged: a lobe's own. through: whether that is what comes through the surface, and so through volumes.
        is_exact: whether what the lobes let through is by the exact rule.
        """

        def inner(part: Tree) -> _Part:
            return self.judge(part, v, judged, through, is_exact)

        match tree:
            case LobeNode(path=path):
                if path not in self._judged:
                    self._judged[path] = self._leaf(tree, _Judged)
                return judged(self._judged[path])
            case closure.Nothing(opaque):
                return _Part.nothing(v, 0.0 if opaque else 1.0)
            case closure.MixNode(fg, bg, amount):
                share = self._number(amount)[..., None]
                return inner(fg).mixed(inner(bg), share)
            case closure.AddNode(in1, in2):
                return inner(in1).added(inner(in2))
            case closure.MultiplyNode(in1, in2):
                return inner(in1).times(_colour(np.clip(self._number(in2), 0.0, 1.0)), is_exact)
            case closure.LayerNode(top, base):
                return inner(top).over(inner(base))
            case closure.VolumeNode(top, absorption):
                return inner(top).absorbed(self._number(absorption)) if through else inner(top)

    def _number(self, port: Port) -> Array:
        return as_float32(self._resolve(port))

    def _leaf(self, lobe: LobeNode, kind: type[_Kind]) -> _Kind:
        if lobe.path not in self._lobes:
            self._lobes[lobe.path] = {name: self._resolve(port) for name, port in lobe.inputs.items()}
            if lobe.node != DIFFUSE_NODE:
                _check_roughness(lobe, self._lobes[lobe.path])
        values = self._lobes[lobe.path]
        points = self._points
        normal = points.normal if values["normal"] is None else values["normal"]
        tangent = points.tangent if values.get("tangent") is None else values["tangent"]
        _check_normal(lobe, values["normal"])
        with np.errstate(invalid="ignore"):
            view, frame = shading_frame(points.position, normal, tangent, points.eye)
        if not np.isfinite(frame).all():
            raise MrmError(
                f"{lobe.path}: its tangent is zero or along its normal, and MaterialX divides by it"
            )
        try:
            placed = kind(lobe.node, _as_ours(lobe, values), frame)
        except ValueError as error:
            raise MrmError(f"{lobe.path}: the evaluator: {error}") from None
        if self._environment is not None:
            if lobe.path not in self._estimates:
                self._estimates[lobe.path] = _around(placed, view, self._environment)
            placed.around = self._estimates[lobe.path]
        return placed


UNIT_LENGTH = 1e-5
"""How far from 1 the length of a normal may be that counts as one."""


def _check_normal(lobe: LobeNode, normal: Array | None) -> None:
    """MaterialX's nodes take a normal as it is: a longer or shorter one is no surface's."""
    if normal is None:
        return
    length = np.linalg.norm(normal, axis=-1)
    if np.any(np.abs(length - 1.0) > UNIT_LENGTH):
        raise MrmError(
            f"{lobe.path}/normal is {length.min():.3g} to {length.max():.3g} long, and MaterialX takes it as it is: "
            f'put a normalize node before it, or give the case truth = "baseline"'
        )


def _check_roughness(lobe: LobeNode, values: Mapping[str, Any]) -> None:
    alpha = _alpha(values)
    reflects = values.get("scatter_mode") != "T"
    if (
        lobe.node in PLAIN_NODES
        and reflects
        and not np.allclose(alpha[..., 0], alpha[..., 1], rtol=1e-6, atol=0.0)
    ):
        raise MrmError(
            f"{lobe.path}/roughness is anisotropic, and MaterialX approximates the masking of such a "
            f'{lobe.node}: give the case truth = "baseline", or use mrm_{lobe.node}, which is exact'
        )


def _alpha(values: Mapping[str, Any]) -> Array:
    alpha: Array = np.clip(as_float32(values["roughness"]), SMALLEST_ALPHA, 1.0)
    return alpha


def _colour(value: Array) -> Array:
    """A factor as `(n, 3)` or `(1, 3)`: one number a point, or three."""
    return value if value.ndim and value.shape[-1] == 3 else value[..., None]


def _as_ours(lobe: LobeNode, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """The inputs by which our nodes have what one of MaterialX's is."""
    if lobe.node not in PLAIN_NODES:
        return values
    return {**values, "masking": "smith", "retroreflectivity": float(values["retroreflective"])}


class _Mix(materialx.Mix):
    """As MaterialX has it, which does not clamp `amount`."""

    def _blend(self, front: Array, back: Array) -> Array:
        share = np.asarray(self.amount)[..., None]
        return np.asarray(back * (1.0 - share) + front * share)


@dataclass(frozen=True)
class _Dark(materialx.Closure):
    """No response, and one throughput everywhere."""

    through: float

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741  the field's own name
        return np.zeros(np.shape(v))

    def throughput(self, v: Any, l: Any = None) -> Array:  # noqa: E741
        return np.full(np.shape(v), self.through)

    def exact_throughput(self, v: Any, weight: Any = 1.0) -> Array:
        return self.throughput(v)


class _Response(materialx.Closure):
    """A lobe in its frame: directions are in world space, and its cosine is part of the response."""

    around: Estimate | None = None
    """What it shows of an environment."""

    def __init__(self, node: str, values: Mapping[str, Any], frame: Array) -> None:
        self.node = node
        self.values = values
        self.frame = frame
        given = as_float32(values["weight"])
        # MaterialX's nodes return at once below this.
        self.weight = np.where(given < LEAKED_COSINE, 0.0, given)
        self.lobe = None if node == DIFFUSE_NODE else evaluator(_our_name(node), values)

    def eval(self, v: Any, l: Any) -> Array:  # noqa: E741
        view, light = self._local(v), self._local(l)
        lit = light[..., 2:] > 0
        response: Array = np.where(lit, self._value(view, light) * light[..., 2:], 0.0)
        return response * self.weight[..., None]

    def throughput(self, v: Any, l: Any = None) -> Array:  # noqa: E741
        if self.lobe is None:
            return np.zeros(np.shape(v))
        leaf = materialx.Leaf(self.lobe, self.weight)
        return leaf.throughput(self._local(v), None if l is None else self._local(l))

    @property
    def is_opaque(self) -> bool:
        """Whether nothing below it shows, whatever its weight."""
        return self.lobe is None or self.node.endswith("conductor_bsdf")

    def exact_throughput(self, v: Any, weight: Any = 1.0) -> Array:
        if self.lobe is None or self.is_opaque:
            return np.zeros(np.shape(v))
        albedo = albedo_of_points(self.lobe, self._local(v))
        return np.asarray(np.maximum(1.0 - weight * self.weight[..., None] * albedo, 0.0))

    def _value(self, view: Array, light: Array) -> Array:
        if self.lobe is not None:
            value: Array = self.lobe.eval(view, light)
            return value
        color, roughness = as_float32(self.values["color"]), as_float32(self.values["roughness"])
        return materialx.OrenNayar(color, roughness, bool(self.values["energy_compensation"])).eval(
            view, light
        )

    def _local(self, direction: Any) -> Array:
        local: Array = np.einsum("nij,nj->ni", self.frame, direction)
        local /= np.linalg.norm(local, axis=-1, keepdims=True)
        return local


THROUGH_MAX, THROUGH_P999 = 1.5e-6, 1e-6
"""Absolute error of a throughput but for its Fresnel factor: 1 less a fitted albedo, a quotient of sums of nine
products. Their own rounding comes to 4.4e-7, 1.5e-7 in 99.9 %; n.v, off by 2e-7, adds its slope's 7.3e-7 and 6e-7."""

MIX_ROUNDING = 2e-7
"""Error of a mix's amount, and of 1 less it: two roundings."""


@dataclass(frozen=True)
class _Part:
    """A response, the errors that float32 may give it anywhere and in 999 of 1000 values, and the same of what it
    lets through to a layer below: each `(n, 3)`, or what broadcasts to it."""

    value: Array
    most: Array
    usual: Array
    through: Array
    through_most: Array
    through_usual: Array
    clear: Array | float = 1.0
    """What it would let through if it reflected nothing: 1 but for what is opaque."""
    exact: Array | float = 0.0
    """The response by the exact rule of layering, of a whole tree, where that was asked for."""

    @staticmethod
    def nothing(v: Array, through: float) -> _Part:
        none = np.zeros(v.shape)
        return _Part(none, none, none, np.full(v.shape, through), none, none, through)

    def mixed(self, bg: _Part, amount: Array) -> _Part:
        """As the foreground of a mix. MaterialX does not clamp `amount`, `(n, 1)` or `(1,)`."""
        less = 1.0 - amount

        def blend(front: Array, back: Array) -> Array:
            return np.asarray(front * amount + back * less)

        def errors(front: Array, back: Array, rounding: Array | float) -> Array:
            return np.asarray(front * np.abs(amount) + back * np.abs(less) + rounding)

        shift = MIX_ROUNDING * (np.abs(self.value) + np.abs(bg.value))
        return _Part(
            blend(self.value, bg.value),
            errors(self.most, bg.most, shift),
            errors(self.usual, bg.usual, shift),
            blend(self.through, bg.through),
            errors(self.through_most, bg.through_most, MIX_ROUNDING),
            errors(self.through_usual, bg.through_usual, MIX_ROUNDING),
            self.clear * amount + bg.clear * less,
        )

    def added(self, other: _Part) -> _Part:
        return _Part(
            self.value + other.value,
            self.most + other.most,
            self.usual + other.usual,
            np.maximum(self.through + other.through - 1.0, 0.0),
            self.through_most + other.through_most,
            self.through_usual + other.through_usual,
            np.maximum(self.clear + other.clear - 1.0, 0.0),
        )

    def times(self, factor: Array, is_exact: bool) -> _Part:
        """As MaterialX's `multiply` has it, whose throughput stays; by the exact rule it does not."""
        through = materialx.through_of(self.through, self.clear, factor) if is_exact else self.through
        value, most, usual = (each * factor for each in (self.value, self.most, self.usual))
        return replace(self, value=value, most=most, usual=usual, through=through)

    def absorbed(self, exponent: Array) -> _Part:
        """Through a volume that leaves e^-exponent, `(n, 3)` or `(3,)`, of it."""
        left = np.exp(-exponent)
        # As exact as Vulkan asks of an exponential.
        error = left * 2 * UNIT * (3.0 + 2.0 * np.where(left > 0.0, np.abs(exponent), 0.0))
        return _Part(
            self.value * left,
            self.most * left + np.abs(self.value) * error,
            self.usual * left + np.abs(self.value) * error,
            self.through * left,
            self.through_most * left + self.through * error,
            self.through_usual * left + self.through * error,
            self.clear * left,
        )

    def over(self, base: _Part) -> _Part:
        """As the top of a layer."""
        return _Part(
            self.value + base.value * self.through,
            self.most + base.most * self.through + np.abs(base.value) * self.through_most,
            self.usual + base.usual * self.through + np.abs(base.value) * self.through_usual,
            self.through * base.through,
            self.through * base.through_most + base.through * self.through_most,
            self.through * base.through_usual + base.through * self.through_usual,
            self.clear * base.clear,
        )


class _Judged(_Response):
    """A lobe that knows what float32 may make of it."""

    def __init__(self, node: str, values: Mapping[str, Any], frame: Array) -> None:
        super().__init__(node, values, frame)
        # A compensated lobe is F (1 + c F), which changes with F by 1 + 2 c at most.
        self._whites = [] if self.lobe is None else [white_evaluator(values), white_evaluator(values, False)]
        # A dielectric's tint multiplies the whole lobe.
        self._tint = np.maximum(as_float32(values.get("tint", 1.0)), 0.0)
        self._alpha: Array = np.ones(2) if self.lobe is None else _alpha(values)
        self._distribution = "ggx" if self.lobe is None else values["distribution"]
        self._masking = "smith" if self.lobe is None else values["masking"]
        if self.lobe is not None:
            self._reflected = Reflected.of(node, values)
            self._jumps = phase_jumps(node, values)
        film = [0.0, 1.0] if self.lobe is None else [values["thinfilm_thickness"], values["thinfilm_ior"]]
        self._fresnel = fresnel_bounds(*map(as_float32, film))

    def judge(self, v: Array, l: Array, cosine: float) -> _Part:  # noqa: E741
        view, light = self._local(v), self._local(l)
        scale = np.maximum(light[..., 2:], 0.0) * self.weight[..., None]
        value = self._value(view, light) * scale
        white = value
        if self._whites:
            compensated, bare = (each.eval(view, light) for each in self._whites)
            white = np.maximum(2.0 * compensated - bare, bare) * self._tint * scale
        relative = self._relative(view, light, cosine)
        leak = self._leak(view, light)
        through, unsure = np.zeros(value.shape), np.zeros(1)
        if self.lobe is not None:
            through = materialx.Leaf(self.lobe, self.weight).throughput(view, light)
            unsure = self.weight[..., None]

        most_change, usual_change = self._fresnel_changes(view, light, (HALF_COSINE_MAX, HALF_COSINE_P999))

        def allowed(relative: Array, of_fresnel: Array, change: Array | float) -> Array:
            of_fresnel = of_fresnel + change
            own = np.abs(value) * relative + np.abs(white) * of_fresnel
            # Where rounding decides whether an exponential is there at all, its own value says nothing.
            own = np.where(relative > ANYTHING, ANYTHING, own)
            own = own + self._albedo_error(view, light) * scale
            # What leaks is known to no more than the lobe is.
            return np.asarray(own + leak * (1.0 + relative))

        return _Part(
            value,
            allowed(relative.max_rel, self._fresnel.max_rel, most_change),
            allowed(relative.p999_rel, self._fresnel.p999_rel, usual_change),
            through,
            # The compensation takes a Fresnel factor times what of an albedo of at most 1 is missing.
            unsure * (THROUGH_MAX + self._fresnel.max_rel),
            unsure * (THROUGH_P999 + self._fresnel.p999_rel),
            0.0 if self.is_opaque else 1.0,
        )

    def judge_around(self, v: Array, around: Surroundings) -> _Part:
        """What it shows of its surroundings, and what float32 may make of that."""
        weight = self.weight[..., None]
        if self.lobe is None:
            of_albedo: Array | float = 0.0
            if self.values["energy_compensation"]:
                cosine = np.clip(self._local(v)[..., 2:], LEAKED_COSINE, 1.0)
                of_albedo = _lost_albedo(cosine, as_float32(self.values["roughness"])[..., None])[1]
            seen = diffuse_sum(self.values, v, self.frame, around, of_albedo)
            through, unsure = np.zeros(v.shape), np.zeros(1)
        elif self.values.get("scatter_mode") == "T":
            return _Part.nothing(v, 1.0)
        else:
            mirrors = not self.node.startswith("mrm_")
            seen = lobe_sum(_our_name(self.node), self.values, v, self.frame, around, mirrors)
            through, unsure = materialx.Leaf(self.lobe, self.weight).throughput(self._local(v)), weight
        return _Part(
            seen.value * weight,
            seen.most * weight,
            seen.usual * weight,
            through,
            unsure * (THROUGH_MAX + self._fresnel.max_rel),
            unsure * (THROUGH_P999 + self._fresnel.p999_rel),
            0.0 if self.is_opaque else 1.0,
        )

    def judge_through(self, v: Array, around: Surroundings) -> _Part:
        """What it shows of what lies behind it, and what float32 may make of that."""
        if self.lobe is None or self.node.endswith("conductor_bsdf"):
            return _Part.nothing(v, 0.0)
        weight = self.weight[..., None]
        # Nothing is reflected by a node that only transmits, and yet it is missing here.
        both = {**self.values, "scatter_mode": "R"}
        lobe = evaluator(_our_name(self.node), both)
        through = materialx.Leaf(lobe, self.weight).throughput(self._local(v))
        none = np.zeros(v.shape)
        value, most, usual = none, none, none
        if transmits(self.values):
            own = self.node.startswith("mrm_")
            seen = transmitted_sum(_our_name(self.node), self.values, v, self.frame, around, own)
            value, most, usual = seen.value * weight, seen.most * weight, seen.usual * weight
        return _Part(
            value,
            most,
            usual,
            through,
            weight * (THROUGH_MAX + self._fresnel.max_rel),
            weight * (THROUGH_P999 + self._fresnel.p999_rel),
        )

    def _relative(self, view: Array, light: Array, of_light: float) -> Bounds:
        """The relative error but for the Fresnel factor: of a diffuse lobe, its rounding and that of n.l alone."""
        if self.lobe is not None:
            own = self.node.startswith("mrm_")
            return direction_bounds(
                self._alpha, self._distribution, self._masking, view, light, of_light, materialx=not own
            )
        wide = lobe_bounds(1.0, "ggx")
        near = np.maximum(light[..., 2:], NEAR_COSINE_MAX)
        return Bounds(
            wide.max_rel + (NEAR_COSINE_MAX + of_light) / near,
            wide.p999_rel + (NEAR_COSINE_P999 + of_light) / near,
        )

    def _fresnel_changes(self, view: Array, light: Array, errors: Sequence[float]) -> list[Array]:
        """By how much the Fresnel factor changes with each error of the half angle's cosine, forward or retro,
        `(n, 3)`, where anything is lit.
        """
        changes = [np.zeros(view.shape) for _ in errors]
        if self.lobe is None:
            return changes
        across = np.sum(view[..., :2] * light[..., :2], axis=-1)
        along = view[..., 2] * light[..., 2]
        retro = np.clip(as_float32(self.values["retroreflectivity"]), 0.0, 1.0)
        for share, sign in ((1.0 - retro, 1.0), (retro, -1.0)):
            at = (light[..., 2] > 0.0) & (share > 0.0)
            if not at.any():
                continue
            cosine = np.sqrt(np.clip(0.5 * (1.0 + sign * across[at] + along[at]), 0.0, 1.0))
            for change, found in zip(changes, self._reflected.at(at).changes(cosine, errors), strict=True):
                change[at] = np.maximum(change[at], found)
        return [np.where(self._jumps, 1.0, each) for each in changes]

    def _albedo_error(self, view: Array, light: Array) -> Array | float:
        """Of what an energy-compensated Oren-Nayar puts back: a product of what two albedos lack of 1, and these are
        as exact as the driver's arc cosine. Absolute, per cosine, `(n, 3)`.
        """
        if self.node != DIFFUSE_NODE or not self.values["energy_compensation"]:
            return 0.0
        color, roughness = as_float32(self.values["color"]), as_float32(self.values["roughness"])[..., None]
        scale = 1.0 / (1.0 + diffuse.C1 * roughness)
        average = scale * (1.0 + diffuse.C2 * roughness)
        lost = np.maximum(1.0 - average, UNIT)
        (lost_v, wrong_v), (lost_l, wrong_l) = (
            _lost_albedo(np.clip(each[..., 2:], LEAKED_COSINE, 1.0), roughness) for each in (view, light)
        )
        # What a colour above 1 leaves of 1 is as inexact as what the mean albedo lacks of it.
        left = 1.0 - color * (1.0 - average)
        back = color**2 * average / left / (np.pi * lost)
        unsure = 2 * UNIT / lost + 2 * UNIT * color / left
        wrong = wrong_v * lost_l + lost_v * wrong_l + lost_v * lost_l * unsure
        return np.asarray(back * wrong)

    def _leak(self, view: Array, light: Array) -> Array | float:
        """At most what MaterialX's own nodes let through of a light below the horizon, whose cosine they take for
        1e-8, `(n, 3)`.
        """
        below = light[..., 2:] <= 0
        if self.node.startswith("mrm_") or not below.any():
            return 0.0
        across = light * (1.0, 1.0, 0.0) + (1e-12, 0.0, 0.0)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        grazing = across + np.array([0.0, 0.0, LEAKED_COSINE])
        if self.lobe is None:
            value = self._value(view, grazing) * LEAKED_COSINE
        else:
            value = self._leaked_lobe(view, light, grazing)
        return np.where(below, value, 0.0) * self.weight[..., None]

    def _leaked_lobe(self, view: Array, light: Array, grazing: Array) -> Array:
        """D of the half vector, which may lie below the horizon, where D is what it is above; masked as for a light at
        the horizon, and reflected as by what is white: `(n, 3)`."""
        seen = np.concatenate([view[..., :2], np.maximum(view[..., 2:], LEAKED_COSINE)], axis=-1)
        ggx = GGX(self._alpha[..., 0], self._alpha[..., 1])
        retro = np.clip(as_float32(self.values["retroreflectivity"]), 0.0, 1.0)
        density: Array = np.zeros(view.shape[:-1])
        for share, turn in ((1.0 - retro, 1.0), (retro, -1.0)):
            half = seen * (turn, turn, 1.0) + light
            half[..., 2] = np.abs(half[..., 2]) + UNIT  # and is the normal where nothing is left of it
            density += share * ggx.D(half / np.linalg.norm(half, axis=-1, keepdims=True))
        up = np.array([0.0, 0.0, 1.0])
        visible = ggx.G2(seen, grazing, up) / (4.0 * seen[..., 2])
        compensated, bare = (each.eval(seen, up) for each in self._whites)
        brightest = np.ones(1)
        if self.node.endswith("schlick_bsdf"):
            colors = (as_float32(self.values[name]) for name in ("color0", "color90"))
            brightest = functools.reduce(np.maximum, colors, brightest)
        return np.asarray((density * visible)[..., None] * compensated / bare * brightest * self._tint)


ANYTHING = 1e30
"""A bound that is none."""

ARC_COSINE = 4096 * 2 * UNIT
"""Relative error of an arc cosine: what Vulkan asks of the arc tangent that it may be made of."""


def _lost_albedo(cosine: Array, roughness: Array) -> tuple[Array, Array]:
    """What Fujii's albedo lacks of 1, and the error of that as MaterialX computes it, each `(n, 1)`."""
    sine = np.sqrt(1.0 - cosine * cosine)
    # MaterialX divides what is left of 1 - sin³ by the cosine.
    geometry = sine * ARC_COSINE * np.arccos(cosine) + 2.0 / 3.0 * 2 * UNIT * sine / cosine
    wrong = roughness / (1.0 + diffuse.C1 * roughness) * geometry / np.pi + 2 * UNIT
    return np.maximum(1.0 - diffuse.fujii_albedo(cosine, roughness), 0.0), wrong


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
    weight = lobe.weight[..., None]
    if not np.any(as_float32(lobe.values["roughness"])):
        mean = as_float32(lobe.values["color"]) * irradiance(environment, lobe.frame[:, 2])
        return Estimate(mean * weight, np.zeros_like(mean))
    found = reflected_radiance(_Rough(lobe), view, lobe.frame, environment, SAMPLES)
    return Estimate(found.mean * weight, found.standard_error * weight)


@dataclass(frozen=True)
class _Rough:
    """A diffuse lobe as it is integrated: drawn by the cosine."""

    response: _Response

    def eval(self, v: Array, l: Array) -> Array:  # noqa: E741  the field's own name
        return self.response._value(v, l)

    def pdf(self, v: Array, l: Array) -> Array:  # noqa: E741
        return np.maximum(l[..., 2], 0.0) / np.pi

    def sample(self, v: Array, u: Array) -> BsdfSample:
        azimuth, radius = 2.0 * np.pi * u[..., 0], np.sqrt(u[..., 1])
        height = np.sqrt(1.0 - u[..., 1])
        drawn = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height], axis=-1)
        return BsdfSample(drawn, np.ones(drawn.shape), height / np.pi, np.zeros(height.shape, np.bool_))


def _our_name(node: str) -> str:
    return node if node.startswith("mrm_") else f"mrm_{node}"
