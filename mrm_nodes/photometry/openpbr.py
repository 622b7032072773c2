"""The material of a class as an OpenPBR surface, as far as that carries it."""

from __future__ import annotations

import math
from xml.sax.saxutils import quoteattr

import MaterialX as mx
import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.library import load_library
from mrm_nodes.photometry.classes import UNITS, Row, check
from mrm_nodes.photometry.design import Design
from mrm_nodes.photometry.retroreflector import FACING, digits
from mrm_nodes.photometry.sheet import sheet_of

Array = NDArray[np.float64]

_HIGHEST = 0.9
"""Reflectance of the highest index that is tried: 37."""


def open_pbr_surface(design: Design, name: str, doc: str = "") -> tuple[str, list[Row], list[str]]:
    """A document with one `mrm_open_pbr_surface` for a class: its text, its values, and what it does not carry.

    Its reflectance is chosen anew, so that no value is below its minimum: it is that of a dielectric, which rises with
    the angle of entrance where the nodes' own falls by the falloff alone.

    doc: what it is, for people.

    Raises:
        MrmError: no such surface is in the class; OpenGL is needed and not there.
    """
    asked = design.rows[0].requirement
    lost = []
    if design.bsdf.top is not None:
        lost.append("the highlight of the clear top")
    if asked.quantity == "R_A":
        lost.append("a reflectance that falls by the falloff alone: it is a dielectric's")
        x = float(np.max(design.bsdf.f0))
    elif asked.quantity == "Q_d":
        lost.append("a reflectance of the beads that is the same at all angles: it is a dielectric's")
        x = 0.1
    else:
        lost.append("the reflectance of the beads: a dielectric's, of which a share is retroreflective")
        x = 0.1
    for _ in range(30):
        text = _markup(design, mx.createValidName(name), x, doc)
        document = mx.createDocument()
        mx.readFromXmlString(document, text)
        document.setDataLibrary(load_library())
        rows = check(sheet_of(document, name).at(), design.retro_class.name, design.colour)
        least = min((1.0 + row.margin) / (1.0 + design.margin) for row in rows)
        if 1.0 <= least <= 1.0 + 1e-4:
            break
        x *= (1.0 + 3e-5) / least
        if x > (_HIGHEST if asked.quantity == "R_A" else 1.0):
            raise MrmError(
                f"{design.retro_class.name}: no OpenPBR surface of this kind has {asked.minimum:g} "
                f"{UNITS[asked.quantity]}"
            )
    if not all(row.passes and row.margin >= design.margin for row in rows):
        raise MrmError(
            f"no OpenPBR surface of this kind is {design.retro_class.name}, {design.colour}, "
            f"with a margin of {design.margin:g}"
        )
    return text, rows, lost


def _markup(design: Design, name: str, x: float, doc: str) -> str:
    bsdf, quantity = design.bsdf, design.rows[0].requirement.quantity
    film = np.broadcast_to(np.asarray(0.0 if bsdf.film is None else bsdf.film), 3)
    inputs = {
        "base_color": ("color3", digits(film / film.max() * x if quantity == "Q_d" else film, 3)),
        "specular_roughness": ("float", digits(math.sqrt(float(np.asarray(bsdf.alpha))))),
    }
    graph = ""
    if quantity == "R_A":
        f0 = np.broadcast_to(np.asarray(bsdf.f0, np.float64), 3)
        root = math.sqrt(x)
        inputs["specular_color"] = ("color3", digits(f0 / f0.max(), 3))
        inputs["specular_ior"] = ("float", digits((1.0 + root) / (1.0 - root)))
        inputs["specular_retroreflectivity"] = ("float", "1")
        graph = _GRAPH.format(
            name=name,
            facing=FACING,
            falloff=digits(0.0 if bsdf.falloff is None else bsdf.falloff),
        )
    elif quantity == "R_L":
        inputs["specular_retroreflectivity"] = ("float", digits(x))
    else:
        inputs["specular_retroreflectivity"] = ("float", "1")
    ports = [
        f'    <input name="{port}" type="{kind}" value="{value}" />\n'
        for port, (kind, value) in inputs.items()
    ]
    if graph:
        ports.append(
            f'    <input name="specular_weight" type="float" nodegraph="NG_{name}" output="kept" />\n'
        )
    shown = f" doc={quoteattr(doc)}" if doc else ""
    return f"""<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
{graph}  <mrm_open_pbr_surface name="{name}_surface" type="surfaceshader">
{"".join(ports)}  </mrm_open_pbr_surface>
  <surfacematerial name="{name}" type="material"{shown}>
    <input name="surfaceshader" type="surfaceshader" nodename="{name}_surface" />
  </surfacematerial>
</materialx>
"""


_GRAPH = """  <nodegraph name="NG_{name}">
    <input name="falloff" type="float" value="{falloff}" uimin="0" uiname="Falloff" doc="A power of |n.v|." />
{facing}
    <!-- The return is lost as the surface is turned away. -->
    <power name="kept_share" type="float">
      <input name="in1" type="float" nodename="facing" />
      <input name="in2" type="float" interfacename="falloff" />
    </power>
    <output name="kept" type="float" nodename="kept_share" />
  </nodegraph>
"""
