"""The textured cases: an image on colour, roughness, `retroreflectivity` and the normal, of nodes and whole surfaces.

Documents and images are small and always the same; they are written when a suite asks for its cases.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.files import write_text
from mrm_nodes.regression.cases.builtin import ABOVE, AROUND, WEIGHTS, own_folder
from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase
from mrm_nodes.render.images import write_png

Array = NDArray[np.float64]

IMAGED = ("color", "roughness", "retroreflectivity", "normal")
"""What an image drives."""


@dataclass(frozen=True)
class _Subject:
    """A node that is textured, and what its inputs are called."""

    node: str
    type: str
    """`BSDF` or `surfaceshader`."""
    names: Mapping[str, str]
    """By what an image may drive, the input and its type."""
    color: str
    """Its colour, where no image drives it."""
    values: str = ""
    """Elements of other inputs."""
    base: bool = False
    """Whether a diffuse base lies under it."""


def _bsdf(node: str, name: str, color: str, values: str = "", base: bool = True) -> _Subject:
    names = {
        "color": f"{name} color3",
        "roughness": "roughness vector2",
        "retroreflectivity": "retroreflectivity float",
        "normal": "normal vector3",
    }
    return _Subject(node, "BSDF", names, color, values, base)


def _surface(node: str, roughness: str, retro: str, normal: str, values: str) -> _Subject:
    names = {
        "color": "base_color color3",
        "roughness": f"{roughness} float",
        "retroreflectivity": f"{retro} float",
        "normal": f"{normal} vector3",
    }
    return _Subject(node, "surfaceshader", names, "0.8, 0.3, 0.1", values)


def _value(name: str, kind: str, value: str) -> str:
    return f'<input name="{name}" type="{kind}" value="{value}" />'


_HALF_METAL = _value("metalness", "float", "0.5")
SUBJECTS = {
    "conductor": _bsdf("mrm_conductor_bsdf", "ior", "0.3, 0.9, 1.1", base=False),
    "dielectric": _bsdf("mrm_dielectric_bsdf", "tint", "1, 0.9, 0.6", _value("ior", "float", "1.7")),
    "schlick": _bsdf("mrm_generalized_schlick_bsdf", "color0", "0.3, 0.2, 0.1"),
    "open_pbr": _surface(
        "mrm_open_pbr_surface",
        "specular_roughness",
        "specular_retroreflectivity",
        "geometry_normal",
        _value("base_metalness", "float", "0.5"),
    ),
    "gltf": _surface(
        "mrm_gltf_pbr", "roughness", "retroreflection", "normal", _value("metallic", "float", "0.5")
    ),
    "standard": _surface(
        "mrm_standard_surface", "specular_roughness", "specular_retroreflectivity", "normal", _HALF_METAL
    ),
}
"""By the first part of a case's name."""


def textured_cases(folder: Path | None = None) -> list[MaterialCase]:
    """Each node with an image on each kind of input, each surface with all of them at once: for every run.

    folder: where documents and images are written; by default one that this process removes at its end.
    """
    root = folder or own_folder()
    nodes = [_case(root, name, (imaged,)) for name in _of_type("BSDF") for imaged in IMAGED]
    return [*nodes, *(_case(root, name, IMAGED) for name in _of_type("surfaceshader"))]


def more_textured_cases(folder: Path | None = None) -> list[MaterialCase]:
    """Each surface with an image on each kind of input: the suite `full` has them beside the others."""
    root = folder or own_folder()
    return [_case(root, name, (imaged,)) for name in _of_type("surfaceshader") for imaged in IMAGED]


def surrounded_cases(folder: Path | None = None) -> list[MaterialCase]:
    """Image light on each node with a normal map, and on each surface with an image on every input: for every run."""
    root = folder or own_folder()
    sky = EnvironmentMap("sky", (("rotation", 30.0),))
    cases = [_case(root, name, ("normal",)) for name in _of_type("BSDF")]
    cases += [_case(root, name, IMAGED) for name in _of_type("surfaceshader")]
    return [_within(case, sky, "") for case in cases]


def more_surrounded_cases(folder: Path | None = None) -> list[MaterialCase]:
    """Image light on each surface at each weight: the suite `full` has them beside the others."""
    root, found = folder or own_folder(), []
    for name, weight in itertools.product(_of_type("surfaceshader"), WEIGHTS):
        path = f"shaded/{SUBJECTS[name].names['retroreflectivity'].split()[0]}"
        case = replace(_case(root, name, ("color",)), inputs={path: weight})
        found.append(_within(case, EnvironmentMap("studio"), f"-retro{weight:g}"))
    return found


_CLEAR: Mapping[str, Mapping[str, float | tuple[float, ...]]] = {
    "open_pbr": {
        "transmission_weight": 0.7,
        "transmission_depth": 0.5,
        "transmission_color": (0.9, 0.6, 0.3),
        "base_metalness": 0.2,
    },
    "gltf": {"transmission": 0.7, "metallic": 0.2},
    "standard": {"transmission": 0.7, "transmission_color": (0.9, 0.6, 0.3), "metalness": 0.2},
}
"""By surface, what makes it let light through."""


def transmitting_cases(folder: Path | None = None) -> list[MaterialCase]:
    """What is seen through each surface in image light, alone and beside its other lobes, with every weight of the
    retro lobe: the suite `full` has them beside the others."""
    root, found = folder or own_folder(), []
    for name, weight in itertools.product(_CLEAR, WEIGHTS):
        retro = SUBJECTS[name].names["retroreflectivity"].split()[0]
        whole = next(iter(_CLEAR[name]))
        found.append(_clear(root, name, ((retro, weight),), f"-retro{weight:g}"))
        found.append(_clear(root, name, ((retro, weight), (whole, 1.0)), f"-glass-retro{weight:g}"))
    return found


def _clear(root: Path, name: str, values: tuple[tuple[str, float], ...], what: str) -> MaterialCase:
    case = _case(root, name, ("color",))
    given = {**_CLEAR[name], **dict(values)}
    case = replace(case, inputs={f"shaded/{each}": value for each, value in given.items()})
    return _within(case, EnvironmentMap("sky", (("rotation", 30.0),)), f"-through{what}")


def _within(case: MaterialCase, light: EnvironmentMap, what: str) -> MaterialCase:
    """A case with light from around in place of its lights."""
    name = f"{case.name}-in-{light.name}{what}"
    return replace(case, name=name, lights=(), environment=light, size=(64, 64))


def _of_type(kind: str) -> list[str]:
    return [name for name, subject in SUBJECTS.items() if subject.type == kind]


@functools.cache
def _case(root: Path, short: str, imaged: tuple[str, ...]) -> MaterialCase:
    name = f"{short}-image-on-{imaged[0] if len(imaged) == 1 else 'all'}"
    subject = SUBJECTS[short]
    images = {each: f"{name}-{each}.png" for each in imaged}
    for each, image in images.items():
        write_png(root / image, _linear(picture(each, list(SUBJECTS).index(short))))
    write_text(root / f"{name}.mtlx", _document(subject, images))
    return MaterialCase(
        name=name,
        root=root,
        material=f"{name}.mtlx",
        element=subject.node,
        truth="physics",
        reason="the evaluator knows all of its lobes",
        camera=ABOVE,
        lights=AROUND,
        size=(128, 128),
        depends=(f"{name}.mtlx", *images.values()),
    )


def picture(imaged: str, variant: int, size: int = 16) -> Array:
    """The pixels `(size, size, 3)` of an image, 0 to 1 as its file has them; each variant is another image."""
    v, u = np.meshgrid(*[(np.arange(size) + 0.5) / size] * 2, indexing="ij")
    turn = 2.0 * np.pi * variant / len(SUBJECTS)
    wave = 0.5 + 0.5 * np.sin(2.0 * np.pi * (2.0 * u + v) + turn)
    other = 0.5 + 0.5 * np.cos(2.0 * np.pi * (u - 2.0 * v) + turn)
    if imaged == "color":
        return np.stack([0.3 + 0.6 * wave, 0.8 - 0.5 * other, 0.4 + 0.4 * wave * other], axis=-1)
    if imaged == "normal":
        lean = np.stack([0.5 * (wave - 0.5), 0.5 * (other - 0.5), np.ones_like(u)], axis=-1)
        normal: Array = 0.5 + 0.5 * lean / np.linalg.norm(lean, axis=-1, keepdims=True)
        return normal
    low, high = (0.5, 0.9) if imaged == "roughness" else (0.0, 1.0)
    return np.repeat((low + (high - low) * wave)[..., None], 3, axis=-1)


def _linear(encoded: Array) -> Array:
    """What `write_png` writes as these values (IEC 61966-2-1)."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def _document(subject: _Subject, images: Mapping[str, str]) -> str:
    """A material named as its node, with images by what they drive."""
    driven = [_driven(each, *subject.names[each].split()) for each in images]
    graphs = [_graph(each, subject.names[each].split()[1], image) for each, image in images.items()]
    values = [*driven, *_rest(subject, images)]
    shader = f"""
  <{subject.node} name="shaded" type="{subject.type}">
    {f"{chr(10)}    ".join(values)}
  </{subject.node}>"""
    if subject.type == "BSDF":
        shader += _surface_of(subject)
    surface = "shaded" if subject.type == "surfaceshader" else "surface"
    return f"""<?xml version="1.0"?>
<materialx version="1.39">{"".join(graphs)}{shader}
  <surfacematerial name="{subject.node}" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="{surface}" />
  </surfacematerial>
</materialx>
"""


def _driven(imaged: str, name: str, kind: str) -> str:
    return f'<input name="{name}" type="{kind}" nodegraph="image_on_{imaged}" output="out" />'


def _rest(subject: _Subject, images: Mapping[str, str]) -> list[str]:
    """Rough enough for the image, and half retroreflective, where no image says otherwise."""
    values = [subject.values] if subject.values else []
    for other, value in (("color", subject.color), ("roughness", "0.4"), ("retroreflectivity", "0.5")):
        if other not in images:
            name, kind = subject.names[other].split()
            values.append(_value(name, kind, f"{value}, {value}" if kind == "vector2" else value))
    return values


def _surface_of(subject: _Subject) -> str:
    """The surface of a BSDF, over a diffuse base or alone."""
    layers = """
  <oren_nayar_diffuse_bsdf name="base" type="BSDF">
    <input name="color" type="color3" value="0.8, 0.3, 0.1" />
  </oren_nayar_diffuse_bsdf>
  <layer name="layered" type="BSDF">
    <input name="top" type="BSDF" nodename="shaded" />
    <input name="base" type="BSDF" nodename="base" />
  </layer>"""
    return f"""{layers if subject.base else ""}
  <surface name="surface" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="{"layered" if subject.base else "shaded"}" />
  </surface>"""


def _graph(imaged: str, kind: str, image: str) -> str:
    """The graph that reads an image and makes of it what an input wants."""
    coded = ' colorspace="srgb_texture"' if imaged == "color" else ""
    read = "vector3" if imaged == "normal" else "color3" if imaged == "color" else "float"
    # MaterialX 1.39.5 gives nodes of one name in two graphs one set of uniforms.
    image_node = last = f"{imaged}_image"
    nodes = f"""
    <image name="{image_node}" type="{read}">
      <input name="file" type="filename" value="{image}"{coded} />
    </image>"""
    if imaged == "normal":
        last = "mapped"
        nodes += f"""
    <normalmap name="mapped" type="vector3">
      <input name="in" type="vector3" nodename="{image_node}" />
    </normalmap>"""
    elif kind == "vector2":
        last = "both"
        nodes += f"""
    <combine2 name="both" type="vector2">
      <input name="in1" type="float" nodename="{image_node}" />
      <input name="in2" type="float" nodename="{image_node}" />
    </combine2>"""
    return f"""
  <nodegraph name="image_on_{imaged}">{nodes}
    <output name="out" type="{kind}" nodename="{last}" />
  </nodegraph>"""
