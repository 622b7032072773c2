"""Random documents of ordinary materials, written the ways that other programs write them, and lights to see them by.

All of it comes from a seed and a number alone, so that a fault is found again by them.
"""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.render.mesh import BUILT_IN
from mrm_nodes.render.scene import CameraLight, DirectionalLight, Framing, Light, PointLight, SpotLight
from mrm_nodes.surfaces.convert import convert

LIGHTS = ("directional", "point", "spot", "camera", "image")
MESHES = tuple(BUILT_IN)
KINDS = ("node", "layers", "open_pbr", "gltf", "standard", "retrofit")


@dataclass
class _Writer:
    """What a document has so far, and the choice of how a value is written."""

    rng: random.Random
    driven: float
    """The share of values that a graph drives."""
    graphs: list[str] = field(default_factory=list)
    nodes: list[str] = field(default_factory=list)
    interface: list[str] | None = None
    """Inputs of the graph that closures are written in; None where they stand in the document."""
    count: int = 0

    def name(self, stem: str) -> str:
        self.count += 1
        return f"{stem}_{self.count}"

    def number(self, low: float, high: float) -> float:
        return round(self.rng.uniform(low, high), 4)

    def alpha(self) -> float:
        """A microfacet width: of a perceptual roughness from 0.15 to 1."""
        return round(self.number(0.15, 1.0) ** 2, 5)

    def color(self, low: float = 0.0, high: float = 1.0) -> tuple[float, ...]:
        return tuple(self.number(low, high) for _ in range(3))

    def value(self, name: str, kind: str, value: float | bool | str | Sequence[float]) -> str:
        """An input with a value: written down, in sRGB, through the interface, by a constant or by a pattern."""
        text = value if isinstance(value, str) else _text(value)
        if kind in ("string", "boolean", "integer"):
            return f'<input name="{name}" type="{kind}" value="{text}" />'
        if self.rng.random() < self.driven:
            return self._pattern(name, kind, value)
        way = self.rng.random()
        if self.interface is not None and way < 0.5:
            outer = self.name(name)
            self.interface.append(f'<input name="{outer}" type="{kind}" value="{text}" />')
            return f'<input name="{name}" type="{kind}" interfacename="{outer}" />'
        if way < 0.6:
            node = self.name("constant")
            self.nodes.append(
                f'<constant name="{node}" type="{kind}"><input name="value" type="{kind}" value="{text}" /></constant>'
            )
            return f'<input name="{name}" type="{kind}" nodename="{node}" />'
        space = ' colorspace="srgb_texture"' if kind == "color3" and way > 0.9 else ""
        return f'<input name="{name}" type="{kind}" value="{text}"{space} />'

    def _pattern(self, name: str, kind: str, value: object) -> str:
        """An input that varies around its value: a ramp, a checkerboard, noise or a wave, in a graph of its own."""
        numbers = np.ravel(np.asarray(value, float))
        other = numbers * self.rng.uniform(0.5, 0.95)
        first, second = _text(numbers), _text(other)
        graph, scale = self.name("graph"), self.rng.choice((2, 3, 5))
        way = self.rng.choice(("ramp", "noise", "checker", "wave"))
        amount = {
            "ramp": '<extract name="amount" type="float"><input name="in" type="vector2" nodename="uv" /></extract>',
            "noise": '<noise2d name="raw" type="float"><input name="texcoord" type="vector2" nodename="scaled" />'
            '<input name="amplitude" type="float" value="0.5" /><input name="pivot" type="float" value="0.5" />'
            "</noise2d>"
            '<clamp name="amount" type="float"><input name="in" type="float" nodename="raw" /></clamp>',
            "checker": '<checkerboard name="raw" type="color3">'
            '<input name="texcoord" type="vector2" nodename="scaled" /></checkerboard>'
            '<extract name="amount" type="float"><input name="in" type="color3" nodename="raw" /></extract>',
            "wave": '<extract name="u" type="float"><input name="in" type="vector2" nodename="scaled" /></extract>'
            '<sin name="sine" type="float"><input name="in" type="float" nodename="u" /></sin>'
            '<remap name="amount" type="float"><input name="in" type="float" nodename="sine" />'
            '<input name="inlow" type="float" value="-1" /></remap>',
        }[way]
        self.graphs.append(
            f"""<nodegraph name="{graph}">
    <input name="scale" type="float" value="{scale}" />
    <texcoord name="uv" type="vector2" />
    <multiply name="scaled" type="vector2"><input name="in1" type="vector2" nodename="uv" />
      <input name="in2" type="float" interfacename="scale" /></multiply>
    {amount}
    <mix name="mixed" type="{kind}"><input name="fg" type="{kind}" value="{first}" />
      <input name="bg" type="{kind}" value="{second}" /><input name="mix" type="float" nodename="amount" /></mix>
    <output name="out" type="{kind}" nodename="mixed" />
  </nodegraph>"""
        )
        if self.interface is not None:
            outer = self.name(name)
            self.interface.append(f'<input name="{outer}" type="{kind}" nodegraph="{graph}" output="out" />')
            return f'<input name="{name}" type="{kind}" interfacename="{outer}" />'
        return f'<input name="{name}" type="{kind}" nodegraph="{graph}" output="out" />'

    def normal(self, name: str = "normal") -> str:
        """A normal map, made of a ramp."""
        graph = self.name("graph")
        low, high = (_text((self.number(0.35, 0.65), self.number(0.35, 0.65), 0.95)) for _ in range(2))
        self.graphs.append(
            f"""<nodegraph name="{graph}">
    <ramplr name="ramp" type="vector3"><input name="valuel" type="vector3" value="{low}" />
      <input name="valuer" type="vector3" value="{high}" /></ramplr>
    <normalmap name="mapped" type="vector3"><input name="in" type="vector3" nodename="ramp" /></normalmap>
    <output name="out" type="vector3" nodename="mapped" />
  </nodegraph>"""
        )
        if self.interface is None:
            return f'<input name="{name}" type="vector3" nodegraph="{graph}" output="out" />'
        outer = self.name(name)
        self.interface.append(f'<input name="{outer}" type="vector3" nodegraph="{graph}" output="out" />')
        return f'<input name="{name}" type="vector3" interfacename="{outer}" />'

    def some(self, share: float, make: Callable[[], str]) -> str:
        """An input that is given in a share of the documents, and left as it comes in the others."""
        return make() if self.rng.random() < share else ""

    def node(self, category: str, kind: str, *inputs: str) -> str:
        """Write a node; return its name."""
        name = self.name(category)
        self.nodes.append(f'<{category} name="{name}" type="{kind}">{"".join(inputs)}</{category}>')
        return name


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return ", ".join(f"{float(each):.6g}" for each in np.ravel(np.asarray(value, float)))


def _lobe(w: _Writer) -> str:
    """A microfacet lobe: one of the three nodes, or of MaterialX's own, and its inputs; return its name."""
    kind = w.rng.choice(("conductor", "dielectric", "generalized_schlick"))
    ours = w.rng.random() < 0.75
    alpha = w.alpha()
    other = min(1.0, alpha * w.rng.choice((1.0, 1.0, 2.0, 5.0))) if ours else alpha
    inputs = [w.value("roughness", "vector2", (alpha, other))]
    inputs.append(w.some(0.3, lambda: w.value("weight", "float", w.number(0.2, 1.0))))
    inputs.append(w.some(0.15, w.normal))
    if w.rng.random() < 0.2:
        inputs.append(w.value("thinfilm_thickness", "float", w.number(100, 800)))
        inputs.append(w.value("thinfilm_ior", "float", w.number(1.1, 1.8)))
    if ours:
        inputs.append(w.value("retroreflectivity", "float", w.rng.choice((0.0, 1.0, w.number(0.1, 0.9)))))
        inputs.append(
            w.some(0.4, lambda: w.value("distribution", "string", w.rng.choice(("ggx", "beckmann", "phong"))))
        )
        inputs.append(w.some(0.4, lambda: w.value("masking", "string", w.rng.choice(("smith", "vcavity")))))
    else:
        inputs.append(w.some(0.5, lambda: w.value("retroreflective", "boolean", True)))
    if kind == "conductor":
        inputs.append(w.some(0.7, lambda: w.value("ior", "color3", w.color(0.2, 3.0))))
        inputs.append(w.some(0.7, lambda: w.value("extinction", "color3", w.color(0.0, 6.0))))
    elif kind == "dielectric":
        inputs.append(w.some(0.8, lambda: w.value("ior", "float", w.number(1.05, 2.4))))
        inputs.append(w.some(0.4, lambda: w.value("tint", "color3", w.color(0.3))))
    else:
        inputs.append(w.some(0.9, lambda: w.value("color0", "color3", w.color(0.02))))
        inputs.append(w.some(0.4, lambda: w.value("color82", "color3", w.color(0.5))))
        inputs.append(w.some(0.3, lambda: w.value("color90", "color3", w.color(0.7))))
        inputs.append(w.some(0.4, lambda: w.value("exponent", "float", w.number(2.0, 8.0))))
    if kind != "conductor":
        inputs.append(w.some(0.15, lambda: w.value("scatter_mode", "string", "RT")))
    return w.node(f"{'mrm_' if ours else ''}{kind}_bsdf", "BSDF", *inputs)


def _diffuse(w: _Writer) -> str:
    return w.node(
        "oren_nayar_diffuse_bsdf",
        "BSDF",
        w.value("color", "color3", w.color(0.05, 0.95)),
        w.some(0.5, lambda: w.value("roughness", "float", w.number(0.0, 1.0))),
        w.some(0.3, lambda: w.value("energy_compensation", "boolean", True)),
    )


def _coat(w: _Writer) -> str:
    """A lobe that lets light through to what lies below."""
    alpha = w.rng.choice((0.0, w.alpha(), w.alpha()))
    node = w.rng.choice(("mrm_dielectric_bsdf", "dielectric_bsdf", "mrm_generalized_schlick_bsdf"))
    # As it comes a Schlick lobe is white, and lets nothing through.
    is_schlick = node == "mrm_generalized_schlick_bsdf"
    return w.node(
        node,
        "BSDF",
        w.value("color0", "color3", w.color(0.02, 0.3)) if is_schlick else "",
        f'<input name="roughness" type="vector2" value="{alpha}, {alpha}" />',
        w.some(0.3, lambda: w.value("weight", "float", w.number(0.3, 1.0))),
    )


def _tree(w: _Writer, depth: int) -> str:
    """Lobes that are layered, mixed, added and multiplied; return the name of the last node."""
    if depth == 0:
        return w.rng.choice((_lobe, _lobe, _diffuse))(w)

    def part(name: str, node: str) -> str:
        return f'<input name="{name}" type="BSDF" nodename="{node}" />'

    way = w.rng.choice(("layer", "layer", "mix", "add", "multiply"))
    if way == "layer":
        return w.node("layer", "BSDF", part("top", _coat(w)), part("base", _tree(w, depth - 1)))
    first = _tree(w, depth - 1)
    if way == "multiply":
        kind = w.rng.choice(("float", "color3"))
        return w.node(
            "multiply",
            "BSDF",
            part("in1", first),
            w.value("in2", kind, w.number(0.2, 1.0) if kind == "float" else w.color(0.2)),
        )
    second = _tree(w, depth - 1)
    if way == "add":
        return w.node("add", "BSDF", part("in1", first), part("in2", second))
    return w.node(
        "mix", "BSDF", part("fg", first), part("bg", second), w.value("mix", "float", w.number(0.1, 0.9))
    )


_SHARES = {
    "open_pbr_surface": {
        "base_weight": "0.5 1", "base_diffuse_roughness": "0 1", "base_metalness": "0 1", "specular_weight": "0.3 1",
        "specular_roughness": "0.15 1", "specular_ior": "1.2 2", "specular_roughness_anisotropy": "0 0.7",
        "coat_weight": "0 1", "coat_roughness": "0 0.6", "coat_ior": "1.3 1.8", "coat_darkening": "0 1",
        "thin_film_weight": "0 1", "thin_film_thickness": "0.2 0.8", "thin_film_ior": "1.2 1.8",
    },
    "gltf_pbr": {
        "metallic": "0 1", "roughness": "0.15 1", "specular": "0.3 1", "ior": "1.2 2", "iridescence": "0 1",
        "iridescence_ior": "1.2 1.8", "iridescence_thickness": "100 700", "clearcoat": "0 1",
        "clearcoat_roughness": "0 0.6", "anisotropy_strength": "0 0.7", "occlusion": "0.5 1",
    },
    "standard_surface": {
        "base": "0.5 1", "diffuse_roughness": "0 1", "metalness": "0 1", "specular": "0.3 1",
        "specular_roughness": "0.15 1", "specular_IOR": "1.2 2", "specular_anisotropy": "0 0.7",
        "specular_rotation": "0 1", "coat": "0 1", "coat_roughness": "0 0.6", "coat_IOR": "1.3 1.8",
        "coat_affect_color": "0 1", "coat_affect_roughness": "0 1", "thin_film_thickness": "100 700",
        "thin_film_IOR": "1.2 1.8",
    },
}  # fmt: skip
"""Of MaterialX's surfaces, the inputs that the evaluator knows, and their ordinary values."""
_COLORS = {
    "open_pbr_surface": ("base_color", "specular_color", "coat_color"),
    "gltf_pbr": ("base_color", "specular_color"),
    "standard_surface": ("base_color", "specular_color", "coat_color"),
}
_WEIGHTS = {
    "open_pbr_surface": "specular_retroreflectivity",
    "gltf_pbr": "retroreflection",
    "standard_surface": "specular_retroreflectivity",
}
_ANISOTROPIC = re.compile("anisotropy")


def _surface(w: _Writer, node: str, ours: bool) -> str:
    inputs = [w.value(_COLORS[node][0], "color3", w.color(0.05, 0.95))]
    inputs += [
        w.some(0.4, lambda name=name: w.value(name, "color3", w.color(0.2))) for name in _COLORS[node][1:]
    ]
    for name, limits in _SHARES[node].items():
        low, high = map(float, limits.split())
        # A switch is often at one of its ends.
        value = (
            w.rng.choice((low, high, w.number(low, high)))
            if low == 0.0 and high == 1.0
            else w.number(low, high)
        )
        inputs.append(w.some(0.5, lambda name=name, value=value: w.value(name, "float", value)))
    inputs.append(
        w.some(0.15, lambda: w.normal("geometry_normal" if node == "open_pbr_surface" else "normal"))
    )
    if ours:
        inputs.append(w.value(_WEIGHTS[node], "float", w.rng.choice((0.0, 1.0, w.number(0.1, 0.9)))))
    return w.node(f"{'mrm_' if ours else ''}{node}", "surfaceshader", *inputs)


def document(rng: random.Random, kind: str) -> str:
    """A document with one material named `m`. kind: one of KINDS."""
    w = _Writer(rng, driven=rng.choice((0.0, 0.0, 0.3)))
    names = {"open_pbr": "open_pbr_surface", "gltf": "gltf_pbr", "standard": "standard_surface"}
    graphed = rng.random() < 0.4
    if graphed:
        w.interface = []
    if kind in names:
        last, is_surface = _surface(w, names[kind], True), True
    elif kind == "retrofit":
        last, is_surface = _surface(w, rng.choice(list(_SHARES)), False), True
    else:
        last, is_surface = _tree(w, 0 if kind == "node" else rng.choice((1, 1, 2, 3))), False
    if not is_surface and (not graphed or rng.random() < 0.5):
        last = w.node("surface", "surfaceshader", f'<input name="bsdf" type="BSDF" nodename="{last}" />')
        is_surface = True
    if rng.random() < 0.3:
        # Nothing says that a node stands before those that use it.
        rng.shuffle(w.nodes)
    nodes = "\n  ".join(w.nodes)
    if graphed:
        made = "surfaceshader" if is_surface else "BSDF"
        nodes = f"""<nodegraph name="look">
  {"".join(w.interface or ())}
  {nodes}
  <output name="shaded" type="{made}" nodename="{last}" />
</nodegraph>"""
        reference = 'nodegraph="look" output="shaded"'
    else:
        made, reference = "surfaceshader", f'nodename="{last}"'
    if made == "BSDF":
        nodes += f'\n  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" {reference} /></surface>'
        reference = 'nodename="s"'
    space = rng.choice(("", ' colorspace="lin_rec709"'))
    parts = [
        *w.graphs,
        nodes,
        f"""<surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" {reference} />
  </surfacematerial>""",
    ]
    if rng.random() < 0.2:
        parts.reverse()
    inner = "\n  ".join(parts)
    return f'<?xml version="1.0"?>\n<materialx version="1.39"{space}>\n  {inner}\n</materialx>\n'


def lights(rng: random.Random, kind: str, toward: np.ndarray) -> tuple[Light, ...]:
    """Two or three lights that reach what the camera sees: the first near to the camera, where a lobe that looks back
    is bright, the second where the plane, which faces +z, is a mirror. toward: from the mesh's middle to the camera.
    """

    def aside(most: float, axis: np.ndarray) -> np.ndarray:
        """A direction up to so many degrees from another."""
        other = np.array([rng.gauss(0, 1) for _ in range(3)])
        other -= other @ axis * axis
        turn = np.radians(rng.uniform(0.0, most))
        direction: np.ndarray = np.cos(turn) * axis + np.sin(turn) * other / np.linalg.norm(other)
        return direction

    def color() -> tuple[float, ...]:
        return (
            (1.0, 1.0, 1.0)
            if rng.random() < 0.5
            else tuple(round(rng.uniform(0.2, 1.0), 3) for _ in range(3))
        )

    made: list[Light] = []
    for number in range(rng.choice((2, 2, 3))):
        away = aside(60.0 if number == 2 else 12.0, toward * (-1.0, -1.0, 1.0) if number == 1 else toward)
        place = away * rng.uniform(2.0, 5.0)
        others = {"color": color(), "intensity": round(rng.uniform(0.5, 4.0), 3)}
        if kind == "directional" or (kind == "camera" and number):
            made.append(DirectionalLight(tuple(-away), **others))
        elif kind == "point":
            made.append(PointLight(tuple(place), decay_rate=rng.choice((0.0, 1.0, 2.0)), **others))
        elif kind == "spot":
            axis = -place + np.array([rng.uniform(-0.3, 0.3) for _ in range(3)])
            inner = rng.uniform(4.0, 25.0)
            angles = [float(np.cos(np.radians(each))) for each in (inner, inner + rng.uniform(1.0, 15.0))]
            made.append(
                SpotLight(
                    tuple(place), tuple(axis), decay_rate=rng.choice((0.0, 1.0, 2.0)),
                    inner_angle=angles[0], outer_angle=angles[1], **others,
                )
            )  # fmt: skip
        else:
            made.append(CameraLight(**others))
    return tuple(made)


def write_case(folder: Path, seed: int, number: int) -> MaterialCase:
    """Write the material of a number below `folder`, and return the case that it is: small, seen by some light."""
    rng = random.Random(f"{seed}/{number}")
    kind, mesh = KINDS[number % len(KINDS)], rng.choice(MESHES)
    # Every kind under every light, in turn.
    light = LIGHTS[(number + number // len(KINDS)) % len(LIGHTS)]
    home = folder / f"{number}"
    home.mkdir(parents=True)
    if kind == "retrofit":
        text = document(rng, kind)
        (folder / f"{number}.mtlx").write_text(text, encoding="utf-8")
        weight = next(_WEIGHTS[node] for node in _SHARES if f"<{node} " in text)
        convert(
            folder / f"{number}.mtlx", home / "m.mtlx", {weight: rng.choice((1.0, round(rng.random(), 3)))}
        )
    else:
        (home / "m.mtlx").write_text(document(rng, kind), encoding="utf-8")
    (case,) = load(home).cases
    direction = np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.4, 0.6), 1.0])
    toward = direction / np.linalg.norm(direction)
    around = None
    if light == "image":
        around = EnvironmentMap(
            rng.choice(("sky", "studio")), (("rotation", float(rng.randrange(360))), ("samples", 256.0))
        )
    return replace(
        case,
        name=f"{number}-{kind}-{mesh}-{light}",
        mesh=mesh,
        camera=Framing(direction=tuple(direction), fov=rng.uniform(25.0, 50.0)),
        lights=() if around is not None else lights(rng, light, toward),
        environment=around,
        size=(16, 16) if around is not None else (32, 32),
    )
