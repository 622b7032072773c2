"""The instrument of the surfaces' tests: random parameters and points, and what the base specular should be."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import MaterialX as mx
import numpy as np
from numpy.typing import ArrayLike, NDArray

import mrm_nodes
from mrm_nodes import library
from mrm_nodes import reference as ref
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.renderer import shared_renderer
from mrm_nodes.render.scene import DirectionalLight
from mrm_nodes.shadergen import Shader
from mrm_nodes.surfaces import Surface, known_surfaces

Array = NDArray[np.float64]
Values = dict[str, Any]

#: Compiling a whole surface takes seconds: by default a few stand for all; MRM_SURFACE_TESTS=all runs all.
EVERYTHING = os.environ.get("MRM_SURFACE_TESTS") == "all"

#: Nothing comes from around; one sample, because MaterialX 1.39.3 divides by their number.
BLACK = Environment(np.zeros((2, 4, 3), np.float32), samples=1)

EYE = np.array([0.0, 0.0, 4.0])

#: Ranges of the inputs that are not shares from 0 to 1, by a part of the input's name.
_RANGES = {
    "roughness": (0.03, 1.0),  # alpha from 0.001: below, versions clamp differently
    "ior": (1.1, 2.2),
    "abbe": (20.0, 60.0),
    "thin_film_thickness": (0.05, 1.0),
    "iridescence_thickness": (50.0, 800.0),
    "emiss": (0.0, 0.2),
    "attenuation_distance": (0.1, 2.0),
}
#: Inputs that switch a whole lobe: often fully off, or fully on.
_SWITCHES = re.compile(r"weight|metal|^(coat|sheen|transmission|subsurface|clearcoat|iridescence)$")


@functools.cache
def shader_of(node: str) -> Shader:
    """The GLSL of a surface alone, every input a uniform, with room for one light."""
    document = mx.createDocument()
    shader = document.addNode(node, "shader", "surfaceshader")
    document.addMaterialNode("material", shader)
    return mrm_nodes.generate_shader(document, max_lights=1)


#: MaterialX's lines in its three microfacet nodes, and what they are with our departures: a half vector and half angle
#: that keep their digits, and Fresnel within [0, 1].
_FRESNEL = {
    r"vec3 H = normalize\(L \+ V\);": """
        vec3 S = L + V;
        vec3 A = L - V;
        vec3 sum = vec3(dot(S, X), dot(S, Y), dot(S, N));
        vec3 difference = vec3(dot(A, X), dot(A, Y), dot(A, N));
        sum -= difference * (dot(sum, difference) / max(dot(difference, difference), 1.0));""",
    r"float VdotH = clamp\(dot\(V, H\), M_FLOAT_EPS, 1\.0\);": """
        float VdotH = clamp(0.5 * length(sum), M_FLOAT_EPS, 1.0);""",
    r"vec3 Ht = vec3\(dot\(H, X\), dot\(H, Y\), dot\(H, N\)\);": """
        vec3 Ht = sum / max(length(sum), 2.0 * M_FLOAT_EPS);""",
    r"vec3\s+F = mx_compute_fresnel\(VdotH, fd\);": """
        vec3 F = clamp(mx_compute_fresnel(VdotH, fd), 0.0, 1.0);""",
}
#: And Smith's masking with the roughness that each direction sees (Heitz 2014, eq. 72, 80, 86, 99).
_MASKING = {
    r"float G = mx_ggx_smith_G2\(NdotL, NdotV, avgAlpha\);": """
        vec2 slopeV = safeAlpha * vec2(dot(V, X), dot(V, Y)) / NdotV;
        vec2 slopeL = safeAlpha * vec2(dot(L, X), dot(L, Y)) / NdotL;
        float G = 2.0 / (sqrt(1.0 + dot(slopeV, slopeV)) + sqrt(1.0 + dot(slopeL, slopeL)));""",
}


def with_our_departures(shader: Shader, anisotropic: bool = False) -> Shader:
    """The shader with the README's departures in MaterialX's own lobes too, so that nothing else differs."""
    departures = _FRESNEL | _MASKING if anisotropic else _FRESNEL

    def departed(node: re.Match[str]) -> str:
        text = node[0]
        for line, departure in departures.items():
            text, count = re.subn(line, departure, text)
            assert count == 1, line
        indirect = "mx_compute_fresnel(NdotV, fd)"
        return text.replace(f"= {indirect};", f"= clamp({indirect}, 0.0, 1.0);")

    node = r"^void mx_(conductor|dielectric|generalized_schlick)_bsdf\(.*?^}"
    pixel, count = re.subn(node, departed, shader.pixel, flags=re.MULTILINE | re.DOTALL)
    assert count >= 1
    return replace(shader, name=f"{shader.name}_with_our_departures", pixel=pixel)


def random_values(node: str, rng: np.random.Generator, anisotropic: bool = False) -> Values:
    """A value for every input of a surface that shapes its lobes; geometry and opacity stay as they are."""
    values: Values = {}
    for one in _inputs(node):
        name, kind = one.getName(), one.getType()
        if kind not in ("float", "color3") or "alpha" in name or "opacity" in name:
            continue
        is_base = not name.startswith(("coat", "transmission", "subsurface"))
        if "anisotropy" in name and is_base and not anisotropic:
            continue
        low, high = next((span for part, span in _RANGES.items() if part in name.lower()), (0.0, 1.0))
        value = rng.uniform(low, high, 3) if kind == "color3" else rng.uniform(low, high)
        if node.endswith("standard_surface") and name == "thin_film_thickness":
            value = rng.choice([0.0, rng.uniform(50.0, 800.0)])
        elif kind == "float" and _SWITCHES.search(name):
            value = rng.choice([0.0, value, 1.0], p=[0.4, 0.4, 0.2])
        values[name] = value
    return values


@functools.cache
def _inputs(node: str) -> list[mx.Input]:
    versions = library.shared_library().getMatchingNodeDefs(node)
    return next(one for one in versions if one.getDefaultVersion()).getActiveInputs()


def has_film(values: Mapping[str, Any]) -> bool:
    """Whether a thin film lies on the base."""
    thickness = values.get("thin_film_weight", values.get("iridescence", values.get("thin_film_thickness")))
    return thickness is not None and thickness > 0.0


def roughness_of(values: Mapping[str, Any]) -> float:
    """The perceptual roughness of the base specular."""
    return float(values.get("specular_roughness", values.get("roughness", 0.5)))


@dataclass(frozen=True)
class Points:
    """Points with their own normals and tangents under one light; v and l in each one's shading frame."""

    attributes: dict[str, Array]
    light: DirectionalLight
    v: Array
    l: Array  # noqa: E741  the field's own name

    @property
    def half_cosine(self) -> Array:
        """Cosine of the angle between each direction and their half vector."""
        return 0.5 * np.linalg.norm(self.v + self.l, axis=-1)

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Where the light is above the shading horizon and the view is not on it."""
        return (self.l[:, 2] > 1e-3) & (self.v[:, 2] > 1e-3)


def random_points(rng: np.random.Generator, n: int, alpha: float) -> Points:
    """n points: a third on the mirror-like lobe of width alpha, a third on the retro lobe, a third anywhere."""
    to_light = _unit(rng.normal(size=3))
    position = rng.normal(size=(n, 3))
    near = EYE + rng.uniform(-6.0, -1.0, (n, 1)) * to_light + alpha * rng.normal(size=(n, 3))
    kind = rng.integers(3, size=(n, 1))
    position = _float32(np.where(kind == 1, near, position))
    half = _unit(_unit(EYE - position) + to_light)
    normal = np.where(
        kind == 0, _unit(half + alpha * rng.normal(size=(n, 3))), _unit(rng.normal(size=(n, 3)))
    )
    return _points(rng, to_light, position, normal)


def opposite_points(rng: np.random.Generator, n: int, alpha: float) -> Points:
    """n points on the mirror-like lobe, seen from nearly where its light goes."""
    to_light = _unit(rng.normal(size=3))
    away = to_light + 0.1 * rng.normal(size=(n, 3))
    position = _float32(EYE + rng.uniform(1.0, 6.0, (n, 1)) * away)
    half = _unit(_unit(EYE - position) + to_light)
    return _points(rng, to_light, position, half + alpha * rng.uniform(-1.0, 1.0, (n, 3)))


def _points(rng: np.random.Generator, to_light: Array, position: Array, normal: Array) -> Points:
    normal = _float32(_unit(normal))
    tangent = _float32(np.cross(normal, _unit(rng.normal(size=position.shape))))
    light = DirectionalLight((-to_light[0], -to_light[1], -to_light[2]))

    view = _unit(EYE - position)
    z = _unit(normal)
    z = np.where(_dot(z, view) < 0, -z, z)
    x = _unit(tangent - _dot(tangent, z) * z)
    frame = np.stack([x, np.cross(z, x), z], axis=-2)
    attributes = {
        "position": position,
        "normal": normal,
        "tangent": tangent,
        "bitangent": np.cross(normal, tangent),
        "texcoord_0": rng.random((len(position), 2)),
    }
    v = np.einsum("nij,nj->ni", frame, view)
    l = np.einsum("nij,j->ni", frame, -_float32(light.direction))  # noqa: E741  the field's own name
    return Points(attributes, light, _unit(v), _unit(l))


def _float32(values: Any) -> Array:
    """The values as the shader gets them."""
    return np.asarray(values, np.float32).astype(np.float64)


def draw(shader: Shader, points: Points, values: Mapping[str, Any]) -> Array:
    """What the shader makes of the points, (n, 3); values by the surface's inputs, unknown ones left out."""
    known = {one.getName() for one in shader.document.getNode("shader").getNodeDef().getActiveInputs()}
    uniforms = {
        f"shader/{name}": np.asarray(value, np.float64).tolist()
        for name, value in values.items()
        if name in known
    }
    declared = {name for name in points.attributes if f"i_{name}" in shader.vertex} | {"position"}
    attributes = {name: points.attributes[name] for name in points.attributes if name in declared}
    drawn = shared_renderer().draw_points(shader, attributes, EYE, [points.light], uniforms, BLACK)
    return drawn["image"].astype(np.float64)


@dataclass(frozen=True)
class BaseSpecular:
    """The evaluator's BSDF of a base specular, the same lobe with a Fresnel factor of 1, and the smaller alpha."""

    bsdf: Any
    white: Any
    alpha: float


def base_specular(surface: Surface, values: Mapping[str, Any], weight: ArrayLike) -> BaseSpecular:
    """What a surface is whose only lobe is its base specular: metal or dielectric, with a film or without.

    The graphs' own arithmetic (MaterialX's pbrlib and bxdf) in float64.
    """
    v = {name: np.asarray(value, np.float32).astype(np.float64) for name, value in values.items()}
    make, arguments, alpha = _PARAMETERS[surface.node](v)
    alpha = np.clip(alpha, 1e-8, 1.0)  # as MaterialX's nodes do
    lobe = {
        "alpha": alpha,
        "retroreflectivity": _float32(weight),
        "energy_compensation": library.host().compensation,
    }
    white = ref.GeneralizedSchlick(np.ones(3), **lobe)
    return BaseSpecular(make(**arguments, **lobe), white, float(min(alpha)))


def _open_pbr(v: Values) -> tuple[Any, Values, tuple[float, float]]:
    across = 1.0 - v.get("specular_roughness_anisotropy", 0.0)
    along = v["specular_roughness"] ** 2 * np.sqrt(2.0 / (1.0 + across**2))
    film = {
        "thinfilm_thickness": v["thin_film_weight"] * v["thin_film_thickness"] * 1e3,
        "thinfilm_ior": v["thin_film_ior"],
    }
    alpha = (along, across * along)
    if v["base_metalness"] == 1.0:
        # Until 1.39.4, the graph has the tint times the weight; the weight is 1 here.
        colors = {"color0": v["base_color"] * v["base_weight"], "color82": v["specular_color"]}
        return ref.GeneralizedSchlick, colors | film, alpha
    f0 = v["specular_weight"] * ((v["specular_ior"] - 1.0) / (v["specular_ior"] + 1.0)) ** 2
    ior = (1.0 + np.sqrt(f0)) / (1.0 - np.sqrt(f0))
    return ref.Dielectric, {"ior": ior, "tint": v["specular_color"]} | film, alpha


def _gltf(v: Values) -> tuple[Any, Values, tuple[float, float]]:
    across = np.clip(v["roughness"] ** 2, 1e-5, 1.0)
    along = across + (1.0 - across) * v.get("anisotropy_strength", 0.0) ** 2
    film = {
        "thinfilm_thickness": v["iridescence"] * v["iridescence_thickness"],
        "thinfilm_ior": v["iridescence_ior"],
    }
    if v["metallic"] == 1.0:
        return ref.GeneralizedSchlick, {"color0": v["base_color"]} | film, (along, across)
    f0 = np.minimum(v["specular_color"] * ((1.0 - v["ior"]) / (1.0 + v["ior"])) ** 2, 1.0)
    colors = {"color0": f0 * v["specular"], "color90": np.ones(3) * v["specular"]}
    return ref.GeneralizedSchlick, colors | film, (along, across)


def _standard(v: Values) -> tuple[Any, Values, tuple[float, float]]:
    aspect = np.sqrt(1.0 - np.minimum(v.get("specular_anisotropy", 0.0), 0.98))
    square = v["specular_roughness"] ** 2
    film = {"thinfilm_thickness": v["thin_film_thickness"], "thinfilm_ior": v["thin_film_IOR"]}
    alpha = (np.minimum(square / aspect, 1.0), square * aspect)
    if v["metalness"] == 1.0:
        n, k = _artistic_ior(v["base_color"] * v["base"], v["specular_color"] * v["specular"])
        return ref.Conductor, {"ior": n, "extinction": k} | film, alpha
    return ref.Dielectric, {"ior": v["specular_IOR"], "tint": v["specular_color"]} | film, alpha


_PARAMETERS = {"open_pbr_surface": _open_pbr, "gltf_pbr": _gltf, "standard_surface": _standard}


def _artistic_ior(reflectivity: Array, edge_color: Array) -> tuple[Array, Array]:
    """Index and extinction from the colours of a metal: Gulbrandsen, JCGT 3(4), 2014."""
    r = np.clip(reflectivity, 0.0, 0.99)
    low, high = (1.0 - r) / (1.0 + r), (1.0 + np.sqrt(r)) / (1.0 - np.sqrt(r))
    n = high + (low - high) * edge_color
    k2 = ((n + 1.0) ** 2 * r - (n - 1.0) ** 2) / (1.0 - r)
    return n, np.sqrt(np.maximum(k2, 0.0))


def only_base_specular(surface: Surface, values: Values, metal: bool, film: bool) -> Values:
    """The values with every other lobe off."""
    off = {
        "open_pbr_surface": "transmission_weight subsurface_weight fuzz_weight coat_weight "
        "emission_luminance",
        "gltf_pbr": "transmission sheen_color clearcoat emissive",
        "standard_surface": "transmission subsurface sheen coat emission",
    }[surface.node]
    values = values | dict.fromkeys(off.split(), 0.0)
    values |= {name: np.zeros(3) for name in ("sheen_color", "emissive") if surface.node == "gltf_pbr"}
    if surface.node == "open_pbr_surface":
        values |= {"base_metalness": float(metal), "thin_film_weight": float(film), "specular_weight": 1.0}
        return values if metal else values | {"base_weight": 0.0}
    if surface.node == "gltf_pbr":
        values |= {"metallic": float(metal), "iridescence": float(film), "anisotropy_rotation": 0.0}
        return values if metal else values | {"base_color": np.zeros(3)}
    values |= {"metalness": float(metal), "specular": 1.0}
    values |= {"thin_film_thickness": 420.0 if film else 0.0, "specular_rotation": 0.0}
    return values if metal else values | {"base": 0.0}


def _dot(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1, keepdims=True)


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


#: The inputs that stretch the base specular.
_ANISOTROPY = {
    "open_pbr_surface": "specular_roughness_anisotropy",
    "gltf_pbr": "anisotropy_strength",
    "standard_surface": "specular_anisotropy",
}


def anisotropic_errors(
    surface: Surface, anisotropy: float, roughness: float = 0.5
) -> tuple[float, Array, Array]:
    """How far ours at weight 0 and MaterialX's own are from the evaluator, on a metal: (n,) relative errors each.

    The ratio of the alphas comes first. Points seen or lit at less than 6 degrees are left out: float32 is
    coarser than the difference there.
    """
    rng = np.random.default_rng(17)
    values = only_base_specular(surface, random_values(surface.node, rng), metal=True, film=False)
    values |= {"base": 1.0, "base_weight": 1.0, "base_color": np.full(3, 0.8), "specular_color": np.ones(3)}
    values |= {_ANISOTROPY[surface.node]: anisotropy, surface.input: 0.0}
    values |= {"roughness": roughness, "specular_roughness": roughness}
    points = random_points(rng, 20_000, roughness**2)
    kept = points.lit & (np.minimum(points.v[:, 2], points.l[:, 2]) > 0.1) & (points.half_cosine > 0.1)
    v, l = points.v[kept], points.l[kept]  # noqa: E741  the field's own name
    specular = base_specular(surface, values, 0.0)
    expected = specular.bsdf.eval(v, l) * l[:, 2:]
    ours, own = (
        (np.abs(draw(shader_of(node), points, values)[kept] - expected) / np.maximum(expected, 1e-4)).max(
            axis=-1
        )
        for node in (surface.name, surface.node)
    )
    return _PARAMETERS[surface.node](values)[2][0] / _PARAMETERS[surface.node](values)[2][1], ours, own


def main() -> None:
    """Print how far anisotropic surfaces at weight 0 are from the evaluator, beside MaterialX's own."""
    print("surface           anisotropy  alphas 1 to  ours: at most  MaterialX: median, 99 %, at most")
    for surface in known_surfaces().values():
        for anisotropy in (0.0, 0.25, 0.5, 0.75, 0.9):
            ratio, ours, own = anisotropic_errors(surface, anisotropy)
            figures = f"{np.median(own):>19.1e} {np.quantile(own, 0.99):>7.1e} {own.max():>8.1e}"
            print(f"{surface.node:<17} {anisotropy:>10} {ratio:>12.2f} {ours.max():>14.1e} {figures}")


if __name__ == "__main__":
    main()
