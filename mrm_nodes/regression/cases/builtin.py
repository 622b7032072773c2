"""The default suite: image cases, as data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

from mrm_nodes.regression.truth.material import NODES, Value
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS, Environment
from mrm_nodes.render.scene import (
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    Light,
    PointLight,
    SpotLight,
)

ALPHAS: tuple[tuple[float, float], ...] = (
    (0.007, 0.007),
    (0.05, 0.05),
    (0.25, 0.25),
    (0.6, 0.6),
    (0.3, 0.08),
)
WEIGHTS = (0.0, 0.5, 1.0)
OTHER_PAIRS = (("ggx", "vcavity"), ("beckmann", "smith"), ("beckmann", "vcavity"))
IMAGE_LIGHT_PAIRS = (*OTHER_PAIRS, ("phong", "vcavity"))
MAPS = ("sky", "studio", "white")
FIGURE_5 = (0.0, 45.0, 90.0)
"""Degrees between light and view in Figure 5 of the MRM paper."""

MATERIAL: dict[str, dict[str, Value]] = {
    "mrm_conductor_bsdf": {},
    "mrm_dielectric_bsdf": {"ior": 1.7, "tint": (1.0, 0.9, 0.6)},
    "mrm_generalized_schlick_bsdf": {
        "color0": (0.85, 0.55, 0.2),
        "color82": (0.7, 0.9, 1.0),
        "color90": (1.0, 1.0, 1.0),
    },
}
"""What each node is made of where a case does not say otherwise."""

FRONT = Camera(position=(0.0, 0.0, 3.0), fov=42.0)
ABOVE = Framing(direction=(0.4, 0.5, 1.0), fov=30.0)
AROUND: tuple[Light, ...] = (
    DirectionalLight(direction=(-0.08, -0.05, -1.0), intensity=1.0),
    DirectionalLight(direction=(-0.9, -0.8, -0.7), color=(0.3, 0.5, 1.0), intensity=2.0),
)
"""One light a few degrees from the view, for retro lobes, and one from the side, for forward lobes."""


@dataclass(frozen=True)
class MapLight:
    """Image light of a case: a built-in map, and how the host samples it."""

    map: str
    """Name of a built-in environment."""
    rotation: float = 0.0
    """Degrees about +y."""
    samples: int = 64
    """Directions for each lobe, where the host samples."""
    filtered: bool = True
    """Whether samples read the mip level of their solid angle."""
    method: Literal["fis", "prefilter"] = "fis"
    """How the host evaluates its light: by samples, or by one look-up at a level for alpha."""

    def load(self) -> Environment:
        """The map and its use, as the renderer takes them."""
        built_in = BUILT_IN_ENVIRONMENTS[self.map]()
        return replace(built_in, rotation=self.rotation, samples=self.samples, filtered=self.filtered)


@dataclass(frozen=True)
class ImageCase:
    """One image to render and compare.

    Cases whose `structure` is equal differ in uniform values only and share one shader.
    """

    name: str
    node: str
    inputs: Mapping[str, Value] = field(default_factory=dict)
    """Values that differ from the node's defaults."""
    patterns: Mapping[str, str] = field(default_factory=dict)
    """By input, the graph of patterns.mtlx that drives it."""
    base: tuple[float, float, float] | None = None
    """Colour of a diffuse base under the node, or none."""
    mesh: str = "sphere"
    """A built-in mesh, or `floor`: the plane that faces +y, the pole of every map."""
    camera: Camera | Framing = FRONT
    lights: tuple[Light, ...] = AROUND
    environment: MapLight | None = None
    """Image light, beside the lights."""
    mirrored: bool = False
    """Whether it is compared with the other lobe in the map turned by half a turn, in place of the evaluator:
    [MRM] eq. 3, for a mesh whose normals are all +y."""
    size: tuple[int, int] = (128, 128)
    """Width and height."""
    target: str = "glsl"
    layering: Literal["materialx", "exact"] = "materialx"
    """As that of a `MaterialCase`, where there is a base."""

    @property
    def kind(self) -> str:
        """Images are judged as such."""
        return "image"

    @property
    def method(self) -> Literal["fis", "prefilter"]:
        """How its shader evaluates image light."""
        return "fis" if self.environment is None else self.environment.method

    @property
    def structure(self) -> tuple[Any, ...]:
        """What makes this case's shader another one."""
        return (
            self.target,
            self.node,
            tuple(sorted(self.patterns.items())),
            self.base is not None,
            self.method,
        )

    def describe(self) -> dict[str, Any]:
        """What it is, for the report."""
        return {
            "inputs": dict(self.inputs),
            "patterns": dict(self.patterns),
            "base": self.base,
            "mesh": self.mesh,
            "mirrored": self.mirrored,
            "camera": repr(self.camera),
            "lights": [repr(light) for light in self.lights],
            "environment": None if self.environment is None else repr(self.environment),
            "size": list(self.size),
            **({} if self.layering == "materialx" else {"layering": self.layering}),
        }

    def files(self) -> tuple[Path, ...]:
        """None of the user's."""
        return ()

    def moved(self, root: Path) -> Self:
        """Itself: it has no files."""
        return self


def default_suite() -> list[ImageCase]:
    """The image cases that prove the three nodes, each with a name of its own."""
    return [
        *_grid(),
        *_pairs(),
        *_figure_5(),
        *_exact_retro(),
        *_patterns(),
        *_thin_films(),
        *_inputs(),
        *_layers(),
        *_lights(),
        *_image_lights(),
    ]


def _short(node: str) -> str:
    return {"mrm_generalized_schlick_bsdf": "schlick"}.get(
        node, node.removeprefix("mrm_").removesuffix("_bsdf")
    )


def _width(alpha: tuple[float, float]) -> str:
    return f"a{alpha[0]:g}" if alpha[0] == alpha[1] else f"a{alpha[0]:g}x{alpha[1]:g}"


def _case(
    node: str,
    what: str,
    inputs: Mapping[str, Value],
    alpha: tuple[float, float] = (0.25, 0.25),
    **others: Any,
) -> ImageCase:
    values = {**MATERIAL[node], "roughness": alpha, **inputs}
    return ImageCase(name=f"{_short(node)}-{what}", node=node, inputs=values, **others)


def _grid() -> Iterator[ImageCase]:
    """Every node at every width and weight: GGX with Smith."""
    for node, alpha, weight in itertools.product(NODES, ALPHAS, WEIGHTS):
        yield _case(node, f"ggx-smith-{_width(alpha)}-retro{weight:g}", {"retroreflectivity": weight}, alpha)


def _pairs() -> Iterator[ImageCase]:
    """The other pairs of distribution and masking, both lobes at once."""
    for node, (distribution, masking), alpha in itertools.product(
        NODES, OTHER_PAIRS, (ALPHAS[1], ALPHAS[2], ALPHAS[4])
    ):
        values: dict[str, Value] = {
            "distribution": distribution,
            "masking": masking,
            "retroreflectivity": 0.5,
        }
        yield _case(node, f"{distribution}-{masking}-{_width(alpha)}-retro0.5", values, alpha)


def _figure_5() -> Iterator[ImageCase]:
    """Figure 5 of the paper: one fixed light, the camera 0, 45 and 90 degrees from it, forward and retro."""
    light = DirectionalLight(direction=(0.0, -0.3, -1.0), intensity=3.0)
    _, y, z = (-c for c in light.direction)
    for weight, degrees in itertools.product((0.0, 1.0), FIGURE_5):
        turn = math.radians(degrees)
        # The camera goes round the light in the plane of the light and the x axis.
        camera = Framing(direction=(math.sin(turn), y * math.cos(turn), z * math.cos(turn)), fov=30.0)
        yield _case(
            "mrm_conductor_bsdf",
            f"figure5-{degrees:g}deg-retro{weight:g}",
            {"retroreflectivity": weight},
            mesh="baluster",
            camera=camera,
            lights=(light,),
            size=(192, 192),
        )


def _exact_retro() -> Iterator[ImageCase]:
    """The light at the camera: the back-vector is the normal at every pixel."""
    for node, alpha in itertools.product(NODES, (ALPHAS[0], ALPHAS[4])):
        values = {"retroreflectivity": 1.0}
        yield _case(node, f"camera-light-{_width(alpha)}-retro1", values, alpha, lights=(CameraLight(),))


def _patterns() -> Iterator[ImageCase]:
    """Inputs that a graph drives from pixel to pixel."""
    for node in NODES:
        stripes = {"retroreflectivity": "stripes"}
        yield _case(node, "stripes-on-retroreflectivity", {}, patterns=stripes, mesh="baluster", camera=ABOVE)
    conductor, dielectric, schlick = NODES
    half = {"retroreflectivity": 0.5}
    yield _case(conductor, "noise-on-retroreflectivity", {}, patterns={"retroreflectivity": "noise"})
    yield _case(conductor, "wear-on-roughness", half, patterns={"roughness": "wear"})
    yield _case(dielectric, "checker-on-tint", half, patterns={"tint": "checker"})
    yield _case(
        schlick, "checker-on-color0", half, patterns={"color0": "checker", "retroreflectivity": "stripes"}
    )


def _thin_films() -> Iterator[ImageCase]:
    """A thin film on the facets, seen in both lobes."""
    for node, thickness in itertools.product(NODES, (150.0, 550.0)):
        values = {"thinfilm_thickness": thickness, "thinfilm_ior": 1.33, "retroreflectivity": 0.5}
        yield _case(node, f"film{thickness:g}nm", values, (0.3, 0.3))


def _inputs() -> Iterator[ImageCase]:
    """The inputs that are left: weight, scatter modes, extreme Fresnel colours, values that are clamped."""
    conductor, dielectric, schlick = NODES
    half = {"retroreflectivity": 0.5}
    for node in NODES:
        yield _case(node, "weight0.3", {**half, "weight": 0.3})
    for node, mode in itertools.product((dielectric, schlick), ("T", "RT")):
        # What only transmits is black here, of which nobody would notice that it is missing: the base below is seen.
        below = (0.8, 0.2, 0.1) if mode == "T" else None
        yield _case(node, f"scatter-{mode}", {**half, "scatter_mode": mode}, base=below)
    yield _case(dielectric, "weight0", {**half, "weight": 0.0}, base=(0.8, 0.2, 0.1))
    yield _case(schlick, "color82-black", {**half, "color82": (0.0, 0.0, 0.0)})
    bright = {"color0": (1.3, 0.6, 1.1), "color82": (1.2, 1.5, 0.4), "color90": (1.4, 1.1, 1.0)}
    yield _case(schlick, "colors-above-1", {**half, **bright})
    yield _case(schlick, "exponent2", {**half, "exponent": 2.0, "color90": (0.2, 0.6, 1.0)})
    yield _case(dielectric, "ior1.1", {**half, "ior": 1.1})
    yield _case(conductor, "roughness-above-1", half, (1.5, 1.2))


def _layers() -> Iterator[ImageCase]:
    """Each node over a diffuse base, which sees what is let through: of a metal nothing."""
    conductor, dielectric, schlick = NODES
    below = (0.8, 0.2, 0.1)
    for weight in WEIGHTS:
        yield _case(dielectric, f"over-diffuse-retro{weight:g}", {"retroreflectivity": weight}, base=below)
    half: dict[str, Value] = {"retroreflectivity": 0.5}
    yield _case(conductor, "over-diffuse", half, base=below)
    yield _case(schlick, "over-diffuse", {**half, "color0": (0.3, 0.2, 0.1)}, base=below)
    # What a layer lets through is the only thing that depends on how an albedo is split between F0 and F90.
    for distribution, masking in (*OTHER_PAIRS, ("phong", "vcavity")):
        pair: dict[str, Value] = {**half, "distribution": distribution, "masking": masking}
        name = f"{distribution}-{masking}-over-diffuse"
        yield _case(dielectric, name, pair, patterns={"roughness": "wear"}, base=below)


def _lights() -> Iterator[ImageCase]:
    """Point and spot lights, several lights, a plane from both sides."""
    point = PointLight(position=(0.4, 0.5, 2.0), intensity=4.0)
    spot = SpotLight(
        position=(0.5, 0.6, 2.5),
        direction=(-0.5, -0.6, -2.5),
        intensity=6.0,
        # The plane stays inside: at the cone's edge one would see the rounding of the light's own falloff.
        inner_angle=math.cos(math.radians(5.0)),
        outer_angle=math.cos(math.radians(60.0)),
    )
    half = {"retroreflectivity": 0.5}
    tilted = Camera(position=(0.3, 1.4, 2.2), fov=45.0)
    for node in NODES:
        yield _case(node, "point-light", half, lights=(point,))
        yield _case(node, "spot-light-on-plane", half, mesh="plane", camera=tilted, lights=(spot,))
    four = (*AROUND, point, CameraLight(color=(0.2, 0.4, 0.2)))
    yield _case(NODES[0], "four-lights", half, mesh="baluster", camera=ABOVE, lights=four)
    behind = Camera(position=(0.3, -1.2, 2.0), fov=45.0)
    yield _case(NODES[0], "plane-from-behind", half, mesh="plane", camera=behind, lights=AROUND)


def _lit(node: str, what: str, inputs: Mapping[str, Value], light: MapLight, **others: Any) -> ImageCase:
    """A case in image light."""
    options = {"lights": (), "environment": light, "size": (64, 64), **others}
    return _case(node, what, inputs, **options)


def _image_lights() -> Iterator[ImageCase]:
    """Image light: every map, both methods, every pair of distribution and masking, a film, a base, the mirror, and
    what is seen through each node that transmits."""
    conductor, dielectric, schlick = NODES
    for name, node, weight in itertools.product(MAPS, NODES, WEIGHTS):
        values: dict[str, Value] = {"retroreflectivity": weight}
        # In a map that is the same all around, samples have nothing to find.
        light = MapLight(name, rotation=30.0, samples=16 if name == "white" else 64)
        yield _lit(node, f"in-{name}-retro{weight:g}", values, light)
    for node, weight in itertools.product(NODES, WEIGHTS):
        values = {"retroreflectivity": weight}
        light = MapLight("sky", rotation=30.0, method="prefilter")
        yield _lit(node, f"in-sky-prefilter-retro{weight:g}", values, light)
    half: dict[str, Value] = {"retroreflectivity": 0.5}
    for (distribution, masking), (node, alpha) in itertools.product(
        IMAGE_LIGHT_PAIRS, zip(NODES, (ALPHAS[2], ALPHAS[1], ALPHAS[4]), strict=True)
    ):
        pair: dict[str, Value] = {**half, "distribution": distribution, "masking": masking}
        what = f"in-studio-{distribution}-{masking}-{_width(alpha)}"
        yield _lit(node, what, pair, MapLight("studio", samples=32), alpha=alpha)
    for node, alpha in itertools.product(NODES, (ALPHAS[0], ALPHAS[3], ALPHAS[4])):
        yield _lit(
            node, f"in-sky-{_width(alpha)}", half, MapLight("sky", rotation=75.0, samples=32), alpha=alpha
        )
    sharp = MapLight("studio", samples=256, filtered=False)
    yield _lit(conductor, "in-studio-unfiltered", half, sharp)
    film: dict[str, Value] = {"thinfilm_thickness": 550.0, "thinfilm_ior": 1.33}
    for node in NODES:
        yield _lit(
            node, "film550nm-in-studio", {**half, **film}, MapLight("studio", samples=32), alpha=(0.3, 0.3)
        )
    yield _lit(dielectric, "over-diffuse-in-sky", half, MapLight("sky"), base=(0.8, 0.2, 0.1))
    yield _lit(schlick, "in-sky-and-lights", half, MapLight("sky"), lights=AROUND)
    above = Camera(position=(0.5, 2.0, 1.0), fov=45.0)
    for node in NODES:
        values = {"retroreflectivity": 1.0}
        options = {"mesh": "floor", "camera": above, "mirrored": True, "alpha": (0.3, 0.1)}
        yield _lit(node, "mirror-in-sky", values, MapLight("sky", rotation=30.0), **options)
    sky = MapLight("sky", rotation=30.0)
    through: dict[str, Value] = {**half, "retro_transmission": True}
    yield _lit(dielectric, "through-in-sky", {**through, "scatter_mode": "RT"}, sky)
    yield _lit(schlick, "through-in-sky", {**CLEAR, **half, "scatter_mode": "T"}, sky)
    prefiltered = replace(sky, method="prefilter")
    # Clamped, here too.
    beyond: dict[str, Value] = {**through, "retroreflectivity": 1.3, "scatter_mode": "T"}
    yield _lit(dielectric, "through-in-sky-prefilter", beyond, prefiltered)
    yield _lit(schlick, "through-in-sky-prefilter", {**CLEAR, **half, "scatter_mode": "RT"}, prefiltered)


CLEAR: Mapping[str, Value] = {"color0": (0.08, 0.05, 0.03)}
"""A Schlick lobe of which most is let through."""


def more_image_lights() -> list[ImageCase]:
    """What is seen through the nodes, for the suite `full`: every weight, pair, width and method, a film, a base."""
    found = []
    _, dielectric, schlick = NODES
    sky = MapLight("sky", rotation=30.0)
    pairs = (("ggx", "smith"), *IMAGE_LIGHT_PAIRS)
    methods = {"fis": sky, "prefilter": replace(sky, method="prefilter")}
    for mode, (method, light) in itertools.product(("T", "RT"), methods.items()):
        for weight, (distribution, masking) in itertools.product(WEIGHTS, pairs):
            values: dict[str, Value] = {"scatter_mode": mode, "retroreflectivity": weight}
            values |= {"distribution": distribution, "masking": masking}
            what = f"through-{mode}-{method}-{distribution}-{masking}-retro{weight:g}"
            found.append(_lit(dielectric, what, {**values, "retro_transmission": True}, light))
            if weight == 0.5:
                found.append(_lit(schlick, what, {**CLEAR, **values}, light))
        for node, alpha in itertools.product((dielectric, schlick), ALPHAS):
            values = {"scatter_mode": mode} if node == dielectric else {**CLEAR, "scatter_mode": mode}
            what = f"through-{mode}-{method}-{_width(alpha)}"
            found.append(_lit(node, what, values, replace(light, map="studio"), alpha=alpha))
            film: dict[str, Value] = {"thinfilm_thickness": 550.0, "thinfilm_ior": 1.33}
            found.append(_lit(node, f"{what}-film", {**values, **film}, light, alpha=alpha))
        for index in (0.3, 0.7, 1.0, 1.1, 3.0):
            values = {"scatter_mode": mode, "ior": index}
            found.append(_lit(dielectric, f"through-{mode}-{method}-ior{index:g}", values, light))
        below = (0.8, 0.2, 0.1)
        found.append(
            _lit(
                dielectric, f"through-{mode}-{method}-over-diffuse", {"scatter_mode": mode}, light, base=below
            )
        )
        at_0: dict[str, Value] = {"exponent": 0.0, "color90": (0.1, 0.2, 0.3), "scatter_mode": mode}
        found.append(_lit(schlick, f"through-{mode}-{method}-exponent0", {**at_0, **film}, light))
    return found
