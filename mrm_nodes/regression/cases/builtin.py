"""The default suite: materials of one node, as data.

Their documents are small and always the same; they are written when a suite asks for its cases.
"""

from __future__ import annotations

import atexit
import functools
import itertools
import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import MaterialX as mx

from mrm_nodes.files import write_text
from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase, Method
from mrm_nodes.regression.truth.closure import DIFFUSE_NODE
from mrm_nodes.regression.truth.material import BSDF, NODES, PAIRS, Value, document
from mrm_nodes.render.environment import Environment, find_environment
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
_, *IMAGE_LIGHT_PAIRS = PAIRS
OTHER_PAIRS = IMAGE_LIGHT_PAIRS[:-1]
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
BASE = (0.8, 0.2, 0.1)
"""Colour of the diffuse base that some lie over."""

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
    method: Method = "fis"
    """How the host evaluates its light: by samples, or by one look-up at a level for alpha."""

    @property
    def options(self) -> tuple[tuple[str, float], ...]:
        """Those of `find_environment`."""
        return (("rotation", self.rotation), ("samples", self.samples), ("filtered", self.filtered))

    def load(self) -> Environment:
        """The map and its use, as the renderer takes them."""
        return find_environment(self.map, **dict(self.options))


def default_suite() -> list[MaterialCase]:
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
    patterns: tuple[tuple[str, str], ...] = (),
    over_diffuse: bool = False,
    **others: Any,
) -> MaterialCase:
    """A case of one node, over a diffuse base or alone; patterns: inputs and the graphs that drive them."""
    root = own_folder()
    values = {**MATERIAL[node], "roughness": alpha, **inputs}
    name = _document(root, node, patterns, over_diffuse)
    common: dict[str, Any] = {
        "camera": FRONT,
        "lights": AROUND,
        "size": (128, 128),
        "truth": "physics",
        "reason": "the evaluator knows all of its lobes",
        **others,
    }
    return MaterialCase(
        name=f"{_short(node)}-{what}",
        root=root,
        material=name,
        element=node,
        inputs={f"{BSDF}/{each}": value for each, value in values.items() if each not in dict(patterns)},
        depends=(name,),
        **common,
    )


@functools.cache
def own_folder() -> Path:
    """Where the documents of our own cases are written; this process removes it at its end."""
    folder = Path(tempfile.mkdtemp(prefix="mrm-suite-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@functools.cache
def _document(root: Path, node: str, patterns: tuple[tuple[str, str], ...], over_diffuse: bool) -> str:
    """Write a material, named as its node, once; return its file's name."""
    driven = "".join(f"-{pattern}-on-{name}" for name, pattern in patterns)
    file = f"{_short(node)}{driven}{'-over-diffuse' * over_diffuse}.mtlx"
    made = document(node, dict(patterns), base=DIFFUSE_NODE if over_diffuse else None, called=node)
    if over_diffuse:
        made.getNode("base").setInputValue("color", mx.Color3(*BASE))
    write_text(root / file, str(mx.writeToXmlString(made)))
    return file


def _grid() -> Iterator[MaterialCase]:
    """Every node at every width and weight: GGX with Smith."""
    for node, alpha, weight in itertools.product(NODES, ALPHAS, WEIGHTS):
        yield _case(node, f"ggx-smith-{_width(alpha)}-retro{weight:g}", {"retroreflectivity": weight}, alpha)


def _pairs() -> Iterator[MaterialCase]:
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


def _figure_5() -> Iterator[MaterialCase]:
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


def _exact_retro() -> Iterator[MaterialCase]:
    """The light at the camera: the back-vector is the normal at every pixel."""
    for node, alpha in itertools.product(NODES, (ALPHAS[0], ALPHAS[4])):
        values = {"retroreflectivity": 1.0}
        yield _case(node, f"camera-light-{_width(alpha)}-retro1", values, alpha, lights=(CameraLight(),))


def _patterns() -> Iterator[MaterialCase]:
    """Inputs that a graph drives from pixel to pixel."""
    for node in NODES:
        stripes = (("retroreflectivity", "stripes"),)
        yield _case(node, "stripes-on-retroreflectivity", {}, patterns=stripes, mesh="baluster", camera=ABOVE)
    conductor, dielectric, schlick = NODES
    half = {"retroreflectivity": 0.5}
    yield _case(conductor, "noise-on-retroreflectivity", {}, patterns=(("retroreflectivity", "noise"),))
    yield _case(conductor, "wear-on-roughness", half, patterns=(("roughness", "wear"),))
    yield _case(dielectric, "checker-on-tint", half, patterns=(("tint", "checker"),))
    both = (("color0", "checker"), ("retroreflectivity", "stripes"))
    yield _case(schlick, "checker-on-color0", half, patterns=both)


def _thin_films() -> Iterator[MaterialCase]:
    """A thin film on the facets, seen in both lobes."""
    for node, thickness in itertools.product(NODES, (150.0, 550.0)):
        values = {"thinfilm_thickness": thickness, "thinfilm_ior": 1.33, "retroreflectivity": 0.5}
        yield _case(node, f"film{thickness:g}nm", values, (0.3, 0.3))


def _inputs() -> Iterator[MaterialCase]:
    """The inputs that are left: weight, scatter modes, extreme Fresnel colours, values that are clamped."""
    conductor, dielectric, schlick = NODES
    half = {"retroreflectivity": 0.5}
    for node in NODES:
        yield _case(node, "weight0.3", {**half, "weight": 0.3})
    for node, mode in itertools.product((dielectric, schlick), ("T", "RT")):
        # What only transmits is black here, of which nobody would notice that it is missing: the base below is seen.
        yield _case(node, f"scatter-{mode}", {**half, "scatter_mode": mode}, over_diffuse=mode == "T")
    yield _case(dielectric, "weight0", {**half, "weight": 0.0}, over_diffuse=True)
    yield _case(schlick, "color82-black", {**half, "color82": (0.0, 0.0, 0.0)})
    bright = {"color0": (1.3, 0.6, 1.1), "color82": (1.2, 1.5, 0.4), "color90": (1.4, 1.1, 1.0)}
    yield _case(schlick, "colors-above-1", {**half, **bright})
    yield _case(schlick, "exponent2", {**half, "exponent": 2.0, "color90": (0.2, 0.6, 1.0)})
    yield _case(dielectric, "ior1.1", {**half, "ior": 1.1})
    yield _case(conductor, "roughness-above-1", half, (1.5, 1.2))


def _layers() -> Iterator[MaterialCase]:
    """Each node over a diffuse base, which sees what is let through: of a metal nothing."""
    conductor, dielectric, schlick = NODES
    for weight in WEIGHTS:
        yield _case(
            dielectric, f"over-diffuse-retro{weight:g}", {"retroreflectivity": weight}, over_diffuse=True
        )
    half: dict[str, Value] = {"retroreflectivity": 0.5}
    yield _case(conductor, "over-diffuse", half, over_diffuse=True)
    yield _case(schlick, "over-diffuse", {**half, "color0": (0.3, 0.2, 0.1)}, over_diffuse=True)
    # What a layer lets through is the only thing that depends on how an albedo is split between F0 and F90.
    for distribution, masking in IMAGE_LIGHT_PAIRS:
        pair: dict[str, Value] = {**half, "distribution": distribution, "masking": masking}
        name = f"{distribution}-{masking}-over-diffuse"
        yield _case(dielectric, name, pair, patterns=(("roughness", "wear"),), over_diffuse=True)


def _lights() -> Iterator[MaterialCase]:
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


def _lit(node: str, what: str, inputs: Mapping[str, Value], light: MapLight, **others: Any) -> MaterialCase:
    """A case in image light."""
    around = EnvironmentMap(light.map, light.options)
    options = {"lights": (), "environment": around, "method": light.method, "size": (64, 64), **others}
    return _case(node, what, inputs, **options)


def _image_lights() -> Iterator[MaterialCase]:
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
    yield _lit(dielectric, "over-diffuse-in-sky", half, MapLight("sky"), over_diffuse=True)
    yield _lit(schlick, "in-sky-and-lights", half, MapLight("sky"), lights=AROUND)
    above = Camera(position=(0.5, 2.0, 1.0), fov=45.0)
    for node in NODES:
        values = {"retroreflectivity": 1.0}
        options = {
            "mesh": "plane",
            "camera": above,
            "alpha": (0.3, 0.1),
            "truth": "mirror",
            "reason": MIRRORED,
        }
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


MIRRORED = "the other lobe shows the same of the map turned by half a turn"

CLEAR: Mapping[str, Value] = {"color0": (0.08, 0.05, 0.03)}
"""A Schlick lobe of which most is let through."""


def more_image_lights() -> list[MaterialCase]:
    """What is seen through the nodes, for the suite `full`: every weight, pair, width and method, a film, a base."""
    found = []
    _, dielectric, schlick = NODES
    sky = MapLight("sky", rotation=30.0)
    methods = {"fis": sky, "prefilter": replace(sky, method="prefilter")}
    for mode, (method, light) in itertools.product(("T", "RT"), methods.items()):
        for weight, (distribution, masking) in itertools.product(WEIGHTS, PAIRS):
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
        what = f"through-{mode}-{method}-over-diffuse"
        found.append(_lit(dielectric, what, {"scatter_mode": mode}, light, over_diffuse=True))
        at_0: dict[str, Value] = {"exponent": 0.0, "color90": (0.1, 0.2, 0.3), "scatter_mode": mode}
        found.append(_lit(schlick, f"through-{mode}-{method}-exponent0", {**at_0, **film}, light))
    return found
