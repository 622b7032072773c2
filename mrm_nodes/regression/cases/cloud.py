"""The configuration cloud: random inputs and directions, each evaluated by the real generated shader.

Every varying input of the node becomes a vertex attribute, so one draw of points evaluates as many
configurations as it has points. A draw has one directional light, or light from all around; view, normal and tangent
are free for each point, through its position, and so is every pair of directions in the shading frame.
"""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.regression.cases.builtin import MapLight
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.reference_image import evaluator, shading_frame
from mrm_nodes.regression.verdict.compare import (
    FLOOR,
    Bounds,
    Figures,
    Verdict,
    compare,
    decided,
    quantile,
    relative_error,
    share_of_usual,
)
from mrm_nodes.regression.verdict.outcome import Outcome, timed
from mrm_nodes.render.arithmetic import measure
from mrm_nodes.render.scene import Camera, DirectionalLight

Array = NDArray[np.float64]

CHUNK = 1 << 16
"""Configurations a draw: bounds the memory, and each draw has its own light."""
DECADES = ((1e-4, 1e-3), (1e-3, 1e-2), (1e-2, 1e-1), (1e-1, 1.0))
"""Of the smaller alpha; configurations are spread evenly over them."""
GRAZING = 1e-5
"""The smallest cosine of a view or a light with the surface: half of the views, and of the lights that do not come
from the lobe, are spread evenly over the decades from here to 1."""
MAP_ALPHAS, MAP_ANGLES = 24, 18
"""Cells of a cloud's maps: six to each decade of alpha, and each five degrees."""
MOST_USED = 1e9
"""What a map says of an error that is not finite, or larger."""
WORST_KEPT = 8
GEOMETRY = ("normal", "tangent")
INPUT = "input "
"""Before the names of inputs, among the arrays of a cloud's points."""

LOBE, SPHERE, SAME = 0, 1, 2
"""Where a light comes from: drawn from the lobe, from anywhere, from the viewer's own direction."""
LIGHT_SHARES = (0.5, 0.4, 0.1)


@dataclass(frozen=True)
class Cloud:
    """One cloud: a node with one distribution and one masking."""

    node: str
    distribution: str = "ggx"
    masking: str = "smith"
    configurations: int = 250_000
    seed: int = 0
    environment: MapLight | None = None
    """Light from all around, in place of a light."""
    scatter_mode: str = "R"
    """Of a node that may transmit; one with `retro_transmission` has it where it does."""

    @property
    def kind(self) -> str:
        """Clouds are judged as such."""
        return "cloud"

    @property
    def target(self) -> str:
        """Other targets have clouds too; see `targets`."""
        return "glsl"

    @property
    def structure(self) -> tuple[str, str, str]:
        """Clouds whose structure is equal share one shader."""
        return ("cloud", self.node, self.method)

    @property
    def method(self) -> Literal["fis", "prefilter"]:
        """How its shader evaluates image light."""
        return "fis" if self.environment is None else self.environment.method

    @property
    def choices(self) -> dict[str, Any]:
        """The values that all of its configurations have."""
        values = {"distribution": self.distribution, "masking": self.masking}
        if self.scatter_mode == "R":
            return values
        turned = {"retro_transmission": True} if self.node == "mrm_dielectric_bsdf" else {}
        return {**values, "scatter_mode": self.scatter_mode, **turned}

    @property
    def name(self) -> str:
        short = self.node.removeprefix("mrm_").removesuffix("_bsdf")
        mode = "" if self.scatter_mode == "R" else f"-{self.scatter_mode}"
        around = self.environment
        where = "" if around is None else f"-in-{around.map}{'-prefilter' * (self.method == 'prefilter')}"
        return f"cloud-{short}-{self.distribution}-{self.masking}{mode}{where}"

    def describe(self) -> dict[str, Any]:
        """What it is, for the report."""
        return {
            "distribution": self.distribution,
            "masking": self.masking,
            "configurations": self.configurations,
            "seed": self.seed,
            "scatter_mode": self.scatter_mode,
            "environment": None if self.environment is None else repr(self.environment),
        }

    def files(self) -> tuple[Path, ...]:
        """None of the user's."""
        return ()

    def moved(self, root: Path) -> Self:
        """Itself: it has no files."""
        return self


@dataclass(frozen=True)
class CloudResult:
    """What a cloud showed: the whole, and by decade of alpha."""

    verdict: Verdict
    figures: Figures
    bounds: dict[str, float]
    decades: list[dict[str, Any]]
    worst: list[dict[str, Any]]
    """The configurations that used most of their bounds, the worst first, to be looked at on their own."""
    maps: list[dict[str, Any]]
    """The largest share of its bound in each cell of alpha and an angle to the normal: see `_maps`."""
    counts: dict[str, int] = field(default_factory=dict)
    render_seconds: float = 0.0


def random_inputs(node: str, rng: np.random.Generator, n: int) -> dict[str, Array]:
    """Random values of every varying input of a node, `(n,)`, `(n, 2)` or `(n, 3)`, rounded to float32.

    The smaller alpha is spread evenly over the decades; half of the lobes are anisotropic, up to 100 to 1, a quarter
    have a thin film, a third each are purely forward and purely retro; every tenth exponent is 0, and every tenth
    extinction.
    """
    decade = rng.integers(len(DECADES), size=n)
    low, high = np.log10(DECADES).T
    alpha = 10 ** rng.uniform(low[decade], high[decade])
    other = np.where(rng.random(n) < 0.5, alpha, np.minimum(alpha * 100 ** rng.random(n), 1.0))
    turned = rng.random(n) < 0.5
    kind = rng.integers(3, size=n)
    film = rng.random(n) < 0.25
    ranges = {
        "tint": (0.0, 1.0),
        "color0": (0.0, 1.0),
        "color82": (0.0, 1.0),
        "color90": (0.0, 1.0),
        "exponent": (0.0, 10.0),
        "extinction": (0.0, 6.0),
        "ior": (0.1, 4.0) if node == "mrm_conductor_bsdf" else (0.3, 3.0),
    }
    values: dict[str, Array] = {
        "weight": np.where(rng.random(n) < 0.5, 1.0, rng.random(n)),
        "roughness": np.where(turned[:, None], np.stack([other, alpha], -1), np.stack([alpha, other], -1)),
        "retroreflectivity": np.choose(kind, [np.zeros(n), np.ones(n), rng.random(n)]),
        "thinfilm_thickness": np.where(film, rng.uniform(50.0, 1000.0, n), 0.0),
        "thinfilm_ior": rng.uniform(1.0, 2.0, n),
    }
    for name, spec in material.inputs_of(node).items():
        if spec.varying and name in ranges:
            values[name] = rng.uniform(*ranges[name], size=(n, 3) if spec.type == "color3" else n)
        if name in ("exponent", "extinction"):
            values[name] = np.where(rng.random(values[name].shape) < 0.1, 0.0, values[name])
    return {name: material.as_float32(value) for name, value in values.items()}


def random_directions(bsdf: Any, rng: np.random.Generator, n: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """View and light `(n, 3)` in the shading frame, and where each light comes from.

    The view's cosine is even over (0, 1] in one half, over its decades from `GRAZING` in the other; lights lie on both
    sides of the horizon.
    """
    v = _grazing(rng, _on_sphere(rng, n))
    v[:, 2] = np.abs(v[:, 2])
    kind = rng.choice(3, size=n, p=LIGHT_SHARES)
    drawn = np.asarray(bsdf.sample(v, rng.random((n, 3))).l)
    drawn = np.where(np.isfinite(drawn).all(-1, keepdims=True), drawn, v)
    light = np.where((kind == LOBE)[:, None], drawn, _grazing(rng, _on_sphere(rng, n)))
    light = _at_height(light, np.copysign(np.maximum(np.abs(light[:, 2]), GRAZING), light[:, 2]))
    return v, np.where((kind == SAME)[:, None], v, light), kind


def place(
    v: Array, light: Array, to_light: Array, eye: Array, rng: np.random.Generator
) -> dict[str, NDArray[np.float32]]:
    """Position, normal and tangent, `(n, 3)` float32, that see viewer and light along `v` and `light`.

    to_light: the direction that the draw's light comes from, `(3,)`. Half of the normals point away from the
    viewer, and tangents lean out of the surface, as meshes have them.
    """
    n = len(v)
    across = _perpendicular(v - np.sum(v * light, -1, keepdims=True) * light, light, rng)
    local = np.stack([light, across, np.cross(light, across)], -2)
    world_light = np.broadcast_to(to_light, (n, 3))
    around = _perpendicular(np.zeros((n, 3)), world_light, rng)
    world = np.stack([world_light, around, np.cross(world_light, around)], -1)
    to_world = world @ local

    distance = 2.0 ** rng.integers(-1, 3, size=(n, 1))
    view = np.einsum("nij,nj->ni", to_world, v)
    same = np.all(v == light, axis=-1, keepdims=True)
    normal, tangent = to_world[:, :, 2], to_world[:, :, 0]
    tangent = tangent + rng.uniform(-0.5, 0.5, (n, 1)) * normal
    normal = np.where(rng.random((n, 1)) < 0.5, normal, -normal)
    position = eye - distance * np.where(same, to_light, view)
    placed = {"position": position, "normal": normal, "tangent": tangent}
    return {name: value.astype(np.float32) for name, value in placed.items()}


def run_cloud(cloud: Cloud, renderer: Any, shader: Any) -> CloudResult:
    """Evaluate a cloud with the node's shader and with the evaluator, and compare.

    shader: of `material.document(node, attributes=attributes_of(node))`; renderer: a `Renderer`.
    """
    parts = list(_chunks(cloud, renderer, shader))
    render_seconds = sum(float(part.pop("render_seconds")[0]) for part in parts)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return replace(_judge(joined), render_seconds=render_seconds)


def attributes_of(node: str) -> tuple[str, ...]:
    """The inputs of a node that a cloud varies from point to point."""
    return tuple(
        name for name, spec in material.inputs_of(node).items() if spec.varying and name not in GEOMETRY
    )


def _chunks(cloud: Cloud, renderer: Any, shader: Any) -> Iterator[dict[str, NDArray[Any]]]:
    from mrm_nodes.regression.truth.image_sum import Surroundings
    from mrm_nodes.regression.truth.physics import shade_node, surround_node

    rng = np.random.default_rng([cloud.seed, zlib.crc32(cloud.name.encode())])
    fixed = material.complete(cloud.node, cloud.choices)
    uniforms = material.uniform_values(cloud.node, cloud.choices)
    environment = None if cloud.environment is None else cloud.environment.load()
    around = None
    if environment is not None:
        around = Surroundings(environment, measure(renderer.backend), cloud.method)
    for start in range(0, cloud.configurations, CHUNK):
        n = min(CHUNK, cloud.configurations - start)
        inputs = random_inputs(cloud.node, rng, n)
        values: Mapping[str, Any] = {**fixed, **inputs}
        bsdf = evaluator(cloud.node, values)
        v, light, kind = random_directions(bsdf, rng, n)
        to_light = material.as_float32(_on_sphere(rng, 1)[0])
        eye = material.as_float32(rng.uniform(-1, 1, 3) * rng.integers(2))
        lamp = DirectionalLight(direction=tuple(-to_light), color=(1.0, 1.0, 1.0), intensity=1.0)
        lit = {"lights": [lamp]} if environment is None else {"environment": environment}
        start_of_draw = time.perf_counter()
        drawn = renderer.draw_points(
            shader,
            {
                **place(v, light, to_light, eye, rng),
                **{name: inputs[name] for name in attributes_of(cloud.node)},
            },
            camera_position=tuple(eye),
            uniforms=uniforms,
            **lit,
        )
        render_seconds = time.perf_counter() - start_of_draw
        view, frame = shading_frame(drawn["position"], drawn["normal"], drawn["tangent"], eye)
        if around is None:
            lights = [lamp.data(Camera(position=tuple(eye), target=tuple(eye + 1.0)))]
            position = drawn["position"].astype(np.float64)
            reference, bounds = shade_node(cloud.node, values, view, frame, position, lights)
        else:
            reference, bounds = surround_node(cloud.node, values, view, frame, around)
        film = inputs["thinfilm_thickness"] > 0
        alpha = np.min(inputs["roughness"], axis=-1)
        yield {
            "render_seconds": np.array([render_seconds]),
            "alpha": alpha,
            "film": film,
            "kind": kind,
            "image": drawn["image"],
            "reference": reference,
            "max_bound": np.broadcast_to(bounds.max_rel, reference.shape).astype(np.float32),
            "p999_bound": np.broadcast_to(bounds.p999_rel, reference.shape).astype(np.float32),
            **{f"{INPUT}{name}": value.astype(np.float32) for name, value in inputs.items()},
            "view": np.einsum("nij,nj->ni", frame, view),
            "light": np.einsum("nij,j->ni", frame, to_light),
        }


def _judge(points: dict[str, NDArray[Any]]) -> CloudResult:
    """The verdict over all points, figures by decade of alpha with and without film, and the worst point."""
    bounds = Bounds(points["max_bound"], points["p999_bound"])
    verdict, figures = compare(points["image"], points["reference"], bounds)
    error = decided(relative_error(points["image"], points["reference"]), points["max_bound"])
    used = np.maximum(error / points["max_bound"], 0)
    used[~np.isfinite(used)] = np.inf
    worst = np.argsort(-used.max(-1), kind="stable")[:WORST_KEPT]
    # The second bound is owed in every decade, not only by all together.
    share = max(figures.used, *(_share_of_percentile(points, error, low, high) for low, high in DECADES))
    if share > 1:
        verdict = "fail"
    return CloudResult(
        verdict=verdict,
        figures=replace(figures, used=share),
        bounds=bounds.loosest(),
        decades=list(_by_decade(points, error)),
        worst=[_configuration(points, used, int(index)) for index in worst],
        maps=list(_maps(points, used.max(-1))),
        counts={
            "lobe": int(np.sum(points["kind"] == LOBE)),
            "sphere": int(np.sum(points["kind"] == SPHERE)),
            "same": int(np.sum(points["kind"] == SAME)),
            "below_horizon": int(np.sum(points["light"][:, 2] <= 0)),
            "above_floor": int(np.sum((points["reference"] > FLOOR).any(-1))),
        },
    )


@dataclass(frozen=True)
class Decade:
    """What the configurations of one decade showed, of the smaller alpha or of a cosine."""

    configurations: int = 0
    not_finite: int = 0
    over: int = 0
    """Configurations with a value over its bound."""
    most: float = 0.0
    """The largest share of its bound."""
    unusual: int = 0
    """Configurations with a value over the bound that 99.9 % of the values keep."""

    def joined(self, other: Decade) -> Decade:
        """Of both."""
        return Decade(
            self.configurations + other.configurations,
            self.not_finite + other.not_finite,
            self.over + other.over,
            max(self.most, other.most),
            self.unusual + other.unusual,
        )


COSINES = tuple((10.0**power, 10.0 ** (power + 1)) for power in range(-5, 0))


def tally(cloud: Cloud, renderer: Any, shader: Any) -> dict[tuple[str, float], Decade]:
    """A cloud of any size, by decade of `alpha`, `n.v` and `n.l` (lights above the horizon), each by its lower end; in
    bounded memory. Arguments as of `run_cloud`.
    """
    found: dict[tuple[str, float], Decade] = {}
    for points in _chunks(cloud, renderer, shader):
        finite = np.isfinite(points["image"]).all(-1)
        error = np.where(finite[:, None], relative_error(points["image"], points["reference"]), np.inf)
        used, usual = (
            (decided(error, bound) / bound).max(-1) for bound in (points["max_bound"], points["p999_bound"])
        )
        for axis, value, decades in (
            ("alpha", points["alpha"], DECADES),
            ("n.v", points["view"][:, 2], COSINES),
            ("n.l", points["light"][:, 2], COSINES),
        ):
            # The directions are float32's: a cosine of 1e-5 may be a little less.
            which = np.searchsorted([low for low, _ in decades[1:]], value, side="right")
            for index, (low, _) in enumerate(decades):
                inside = (which == index) & (value > 0.9 * decades[0][0])
                part = Decade(
                    int(inside.sum()),
                    int((~finite[inside]).sum()),
                    int((used[inside] > 1).sum()),
                    float(used[inside].max(initial=0.0)),
                    int((usual[inside] > 1).sum()),
                )
                found[axis, low] = found.get((axis, low), Decade()).joined(part)
    return found


def _configuration(points: dict[str, NDArray[Any]], used: Array, index: int) -> dict[str, Any]:
    """One configuration: what it used of its bound, its inputs, directions and values."""
    return {
        "used": float(used[index].max()),
        "inputs": {
            name.removeprefix(INPUT): values[index].tolist()
            for name, values in points.items()
            if name.startswith(INPUT)
        },
        **{name: points[name][index].tolist() for name in ("view", "light", "image", "reference")},
    }


def _maps(points: dict[str, NDArray[Any]], used: Array) -> Iterator[dict[str, Any]]:
    """The largest share of its bound in each cell, without and with a thin film, by the view's angle and the light's.

    `used` of each is a list of MAP_ANGLES rows from 0 to 90 degrees (lights below the horizon are in the last), each
    of MAP_ALPHAS cells over the decades of the smaller alpha, to two digits; None where no configuration lies.
    """
    low, high = np.log10(DECADES[0][0]), np.log10(DECADES[-1][1])
    column = np.floor((np.log10(points["alpha"]) - low) / (high - low) * MAP_ALPHAS)
    for film in (False, True):
        for angle in ("view", "light"):
            degrees = np.degrees(np.arccos(np.clip(points[angle][:, 2], -1.0, 1.0)))
            row = np.floor(degrees / 90.0 * MAP_ANGLES)
            cell = np.clip(row, 0, MAP_ANGLES - 1) * MAP_ALPHAS + np.clip(column, 0, MAP_ALPHAS - 1)
            inside = points["film"] == film
            most = np.full(MAP_ANGLES * MAP_ALPHAS, -1.0)
            np.maximum.at(most, cell[inside].astype(int), np.minimum(used[inside], MOST_USED))
            cells = [None if each < 0 else float(f"{each:.1e}") for each in most]
            rows = [cells[start : start + MAP_ALPHAS] for start in range(0, len(cells), MAP_ALPHAS)]
            yield {"angle": angle, "film": film, "used": rows}


def _share_of_percentile(points: dict[str, NDArray[Any]], error: Array, low: float, high: float) -> float:
    """The share of the second bound that one decade used."""
    inside = (points["alpha"] >= low) & (points["alpha"] < high)
    if not inside.any():
        return 0.0
    return share_of_usual(error[inside], points["reference"][inside], points["p999_bound"][inside])


def _by_decade(points: dict[str, NDArray[Any]], error: Array) -> Iterator[dict[str, Any]]:
    for low, high in DECADES:
        for film in (False, True):
            inside = (points["alpha"] >= low) & (points["alpha"] < high) & (points["film"] == film)
            if not inside.any():
                continue
            values = error[inside]
            yield {
                "alpha": [low, high],
                "film": film,
                "configurations": int(inside.sum()),
                "max_rel": float(values.max()),
                "p999_rel": quantile(values, 0.999),
                "max_used": float((values / points["max_bound"][inside]).max()),
                "p999_used": share_of_usual(
                    values, points["reference"][inside], points["p999_bound"][inside]
                ),
            }


def _grazing(rng: np.random.Generator, direction: Array) -> Array:
    """Directions of which every other has a cosine that is spread over the decades from `GRAZING`."""
    n = len(direction)
    cosine = GRAZING ** rng.random(n)
    cosine = np.where(rng.random(n) < 0.5, np.copysign(cosine, direction[:, 2]), direction[:, 2])
    return _at_height(direction, np.copysign(np.maximum(np.abs(cosine), GRAZING), cosine))


def _at_height(direction: Array, z: Array) -> Array:
    """Directions `(n, 3)` turned to another cosine with the normal; the normal itself stays."""
    across = np.linalg.norm(direction[:, :2], axis=-1, keepdims=True)
    turned = direction[:, :2] * np.sqrt(1.0 - z * z)[:, None] / np.maximum(across, 1e-300)
    return np.where(across > 0, np.concatenate([turned, z[:, None]], -1), direction)


def _on_sphere(rng: np.random.Generator, n: int) -> Array:
    z = rng.uniform(-1, 1, n)
    phi = rng.uniform(0, 2 * np.pi, n)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(phi), radius * np.sin(phi), z], -1)


def _perpendicular(wanted: Array, axis: Array, rng: np.random.Generator) -> Array:
    """Unit vectors perpendicular to `axis`: along `wanted` where that is one, else any."""
    other = rng.normal(size=axis.shape)
    other -= np.sum(other * axis, -1, keepdims=True) * axis
    chosen = np.where(np.linalg.norm(wanted, axis=-1, keepdims=True) > 1e-9, wanted, other)
    # Once more, for what rounding left of the axis in a short vector.
    chosen = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    chosen = chosen - np.sum(chosen * axis, -1, keepdims=True) * axis
    unit: Array = chosen / np.linalg.norm(chosen, axis=-1, keepdims=True)
    return unit


def judge(cloud: Cloud, workshop: Workshop, outcome: Outcome, folder: Path) -> None:
    """Run a cloud and complete its outcome; a cloud has no files."""
    attributes = attributes_of(cloud.node)
    with timed(outcome, "generate"):
        shader = workshop.shader(
            cloud.structure,
            lambda: material.document(cloud.node, attributes=attributes),
            environment=cloud.method,
        )
    start = time.perf_counter()
    result = run_cloud(cloud, workshop.renderer, shader)
    outcome.seconds["reference"] += time.perf_counter() - start - result.render_seconds
    outcome.seconds["render"] += result.render_seconds
    outcome.verdict, outcome.figures, outcome.tolerance = result.verdict, result.figures, result.bounds
    outcome.details = {
        "decades": result.decades,
        "maps": result.maps,
        "worst": result.worst[0],
        "worst_configurations": result.worst,
        "counts": result.counts,
    }
