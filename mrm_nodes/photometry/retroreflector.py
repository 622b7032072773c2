"""The layered retroreflector: beads or prisms that send light back, on a coloured film, below a clear top.

One description, two forms: a closure of the evaluator, and a MaterialX document of our nodes. Measured sheeting
loses its return as it is turned away, which no Fresnel factor of one dielectric does: the reflectance falls with a
power of |n.v|, and the lobe may widen with another. In the document a small graph drives both.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from xml.sax.saxutils import quoteattr

import MaterialX as mx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes import reference as ref
from mrm_nodes.errors import MrmError
from mrm_nodes.library import host, shared_library

Array = NDArray[np.float64]

SMALLESTFACING = 1e-3
"""What |n.v| is raised to before a lobe is widened by it."""
WIDEST = 1.0
"""The largest alpha of MaterialX's nodes."""


@dataclass(frozen=True)
class ClearTop:
    """What lies on top: a forward lobe with Schlick's reflectance from `f0` to `f90`, GGX of width `alpha`."""

    alpha: ArrayLike
    f0: ArrayLike
    f90: ArrayLike = 1.0


@dataclass(frozen=True)
class SecondWidth:
    """A share of the return that comes back in a lobe of another width."""

    alpha: ArrayLike
    share: ArrayLike


@dataclass(frozen=True)
class Retroreflector(ref.Closure):
    """A retroreflective lobe, and what lies below and above it; a part that is None is absent.

    `eval(v, l)` is f in 1/sr without the cosine, shape (..., 3), in a frame whose normal is +z. Colours are numbers or
    (..., 3), linear Rec.709; but for a document, every parameter may be an array that broadcasts with the directions.
    The parts lie on each other as MaterialX's `layer` has it, with the energy compensation of the installed one, so
    that the document shows what is evaluated here. A power of |n.v| is not reciprocal: f(v, l) / f(l, v) is
    (n.v / n.l)^falloff, which is near 1 about the retroreflected direction.

    Raises:
        ValueError: from `eval`, for values that make no sense; it names them.
    """

    alpha: ArrayLike
    """Width of the retroreflective lobe, as MaterialX's `roughness`."""
    f0: ArrayLike
    """Its reflectance for a light along the normal."""
    falloff: ArrayLike | None = None
    """Power of |n.v| that its reflectance is multiplied by."""
    widening: ArrayLike | None = None
    """Power of 1 / |n.v| that its width is multiplied by, up to a width of 1."""
    film: ArrayLike | None = None
    """Reflectance of the matt film below, in [0, 1]."""
    top: ClearTop | None = None
    second: SecondWidth | None = None
    f82: ArrayLike = 1.0
    """Tint of Schlick's reflectance at 82 degrees."""
    f90: ArrayLike | None = None
    """Reflectance at grazing angles; None: `f0`, the same at all."""
    exponent: ArrayLike = 5.0
    """Of Schlick's reflectance."""
    retroreflectivity: ArrayLike = 1.0
    """Share of the lobe that comes back; the rest is mirrored."""
    cover: ArrayLike | None = None
    """Share of the surface that has the lobe, bare (exposed beads); the rest is film below its top. None: the lobe lies
    all over the film, and below the top."""
    distribution: str = "ggx"
    reciprocal: bool = False
    """Whether the falloff is a power of v'.h, the cosine of the Fresnel term, which is |n.v| where the light goes
    straight back: the lobe is then as reciprocal as without a falloff. No node has it, and no document."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741  the field's own name
        return self._closure(v, l).eval(v, l)

    def throughput(self, v: ArrayLike, l: ArrayLike | None = None) -> Array:  # noqa: E741
        return self._closure(v, l).throughput(v, l)

    def exact_throughput(self, v: ArrayLike, weight: ArrayLike = 1.0) -> Array:
        return self._closure(v, None).exact_throughput(v, weight)

    def _closure(self, v: ArrayLike, l: ArrayLike | None) -> ref.Closure:  # noqa: E741
        """The parts, as they are for each view, and light where it matters."""
        facing = np.abs(np.asarray(v, np.float64)[..., 2])
        kept = self._kept(v, l)
        retro = ref.Leaf(self._lobe(self.alpha, facing, kept))
        below: ref.Closure = retro
        if self.second is not None:
            other = ref.Leaf(self._lobe(self.second.alpha, facing, kept))
            below = ref.Mix(other, retro, self.second.share)
        film = None if self.film is None else ref.Leaf(ref.Lambert(self.film))
        top = None
        if self.top is not None:
            lobe = ref.GeneralizedSchlick(
                self.top.f0,
                color90=self.top.f90,
                alpha=np.asarray(self.top.alpha, np.float64)[..., np.newaxis],
                energy_compensation=host().compensation,
            )
            top = ref.Leaf(lobe)
        if self.cover is None:
            return _layered(top, below, film)
        if top is None and film is None:
            raise ValueError("cover must be None where there is neither a film nor a top beside it")
        return ref.Mix(below, _layered(top, film), self.cover)

    def _kept(self, v: ArrayLike, l: ArrayLike | None) -> ArrayLike:  # noqa: E741
        """What the falloff leaves of the reflectance, (..., 1)."""
        if self.falloff is None:
            return 1.0
        view = np.asarray(v, np.float64)
        cosine = np.abs(view[..., 2])
        if self.reciprocal and l is not None:
            # The Fresnel term's own: v'.h = cos of half the angle between l and v', the view mirrored at the normal.
            across = np.sum(view * (-1.0, -1.0, 1.0) * np.asarray(l, np.float64), axis=-1)
            cosine = np.sqrt(np.maximum(1.0 + across, 0.0) / 2.0)
        return np.asarray((cosine ** np.asarray(self.falloff))[..., np.newaxis])

    def _lobe(self, alpha: ArrayLike, facing: Array, kept: ArrayLike) -> ref.GeneralizedSchlick:
        width = np.asarray(alpha, np.float64)
        if self.widening is not None:
            grown = np.maximum(facing, SMALLESTFACING) ** -np.asarray(self.widening, np.float64)
            width = np.minimum(width * grown, WIDEST)
        f90 = self.f0 if self.f90 is None else self.f90
        return ref.GeneralizedSchlick(
            np.asarray(self.f0) * kept,
            self.f82,
            np.asarray(f90) * kept,
            self.exponent,
            alpha=width[..., np.newaxis],
            retroreflectivity=self.retroreflectivity,
            distribution=self.distribution,
            energy_compensation=host().compensation,
        )

    def markup(self, name: str = "retroreflector", doc: str = "") -> str:
        """The same as the text of a MaterialX document of our nodes, with one material of this name.

        doc: what it is, for people.

        Raises:
            MrmError: a parameter is an array, or makes no sense.
        """
        for part in (self, self.top, self.second):
            for each in () if part is None else fields(part):
                value = getattr(part, each.name)
                if not isinstance(value, str | ClearTop | SecondWidth | None) and np.shape(value) not in _ONE:
                    raise MrmError(
                        f"{each.name} has shape {np.shape(value)}: a document takes a number or a colour"
                    )
        if self.reciprocal:
            raise MrmError("no node has a reciprocal falloff: a document takes a power of |n.v|")
        try:
            self.eval((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
        except ValueError as error:
            raise MrmError(str(error)) from None
        return _markup(self, mx.createValidName(name), doc)

    def document(self, name: str = "retroreflector", doc: str = "") -> mx.Document:
        """`markup` as a document, with MaterialX's standard libraries and ours beside it.

        Raises:
            MrmError: as `markup`.
        """
        document = mx.createDocument()
        mx.readFromXmlString(document, self.markup(name, doc))
        document.setDataLibrary(shared_library())
        return document


_ONE = ((), (1,), (3,))


def _layered(*parts: ref.Closure | None) -> ref.Closure:
    """Those that are there, the first on top."""
    first, *others = (part for part in parts if part is not None)
    return ref.Layer(first, _layered(*others)) if others else first


def _markup(bsdf: Retroreflector, name: str, doc: str) -> str:
    top = beads = f"{name}_beads"
    parts = [_lobe_markup(bsdf, name, beads, bsdf.alpha, "roughness")]
    if bsdf.second is not None:
        other, top = f"{name}_second_beads", f"{name}_two_widths"
        parts += [
            _lobe_markup(bsdf, name, other, bsdf.second.alpha, "second_roughness"),
            _node("mix", top, _port("fg", other), _port("bg", beads), _number("mix", bsdf.second.share)),
        ]
    film, clear, below = f"{name}_film", f"{name}_clear_top", top
    if bsdf.film is not None:
        parts.append(_node("oren_nayar_diffuse_bsdf", film, _color("color", bsdf.film)))
        if bsdf.cover is None:
            below, top = top, f"{name}_beads_on_film"
            parts.append(_node("layer", top, _port("top", below), _port("base", film)))
    if bsdf.top is not None:
        colors = _color("color0", bsdf.top.f0), _color("color90", bsdf.top.f90)
        parts.append(_node("mrm_generalized_schlick_bsdf", clear, *colors, _roughness(bsdf.top.alpha)))
        if bsdf.cover is None:
            below, top = top, f"{name}_top_on_beads"
            parts.append(_node("layer", top, _port("top", clear), _port("base", below)))
    if bsdf.cover is not None:
        beside = film if bsdf.top is None else clear
        if bsdf.film is not None and bsdf.top is not None:
            beside = f"{name}_top_on_film"
            parts.append(_node("layer", beside, _port("top", clear), _port("base", film)))
        below, top = top, f"{name}_beads_beside_film"
        parts.append(_node("mix", top, _port("fg", below), _port("bg", beside), _number("mix", bsdf.cover)))
    shown = f" doc={quoteattr(doc)}" if doc else ""
    return f"""<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">{_graph(bsdf, name)}
{"".join(parts)}  <surface name="{name}_surface" type="surfaceshader">
{_port("bsdf", top)}  </surface>
  <surfacematerial name="{name}" type="material"{shown}>
    <input name="surfaceshader" type="surfaceshader" nodename="{name}_surface" />
  </surfacematerial>
</materialx>
"""


def _lobe_markup(bsdf: Retroreflector, name: str, lobe: str, alpha: ArrayLike, width: str) -> str:
    f90 = bsdf.f0 if bsdf.f90 is None else bsdf.f90
    inputs = [_color("color0", bsdf.f0), _color("color90", f90)]
    if bsdf.falloff is not None:
        grazing = "reflectance" if bsdf.f90 is None else "grazing"
        inputs = [
            _driven("color0", "color3", name, "reflectance"),
            _driven("color90", "color3", name, grazing),
        ]
    if np.any(np.asarray(bsdf.f82) != 1.0):
        inputs.append(_color("color82", bsdf.f82))
    if bsdf.f90 is not None and bsdf.exponent != 5.0:
        inputs.append(_number("exponent", bsdf.exponent))
    inputs.append(
        _roughness(alpha) if bsdf.widening is None else _driven("roughness", "vector2", name, width)
    )
    inputs.append(_number("retroreflectivity", bsdf.retroreflectivity))
    if bsdf.distribution != "ggx":
        inputs.append(f'    <input name="distribution" type="string" value="{bsdf.distribution}" />\n')
    return _node("mrm_generalized_schlick_bsdf", lobe, *inputs)


FACING = """
    <!-- How much the surface faces the viewer: |n.v|. -->
    <normal name="normal" type="vector3">
      <input name="space" type="string" value="world" />
    </normal>
    <viewdirection name="view" type="vector3">
      <input name="space" type="string" value="world" />
    </viewdirection>
    <dotproduct name="cosine" type="float">
      <input name="in1" type="vector3" nodename="normal" />
      <input name="in2" type="vector3" nodename="view" />
    </dotproduct>
    <absval name="facing" type="float">
      <input name="in" type="float" nodename="cosine" />
    </absval>
"""
"""The nodes of a graph that give |n.v|, as `facing`."""


def _graph(bsdf: Retroreflector, name: str) -> str:
    """What the reflectance and the width are for each view; text, for people to read and change."""
    inputs, nodes = [], []
    if bsdf.falloff is not None:
        inputs.append(_interface("falloff", "float", digits(bsdf.falloff), "Falloff", _DOCS["falloff"]))
        nodes.append(
            """
    <!-- The return is lost as the surface is turned away. -->
    <power name="kept" type="float">
      <input name="in1" type="float" nodename="facing" />
      <input name="in2" type="float" interfacename="falloff" />
    </power>
"""
        )
        colors = {"reflectance": bsdf.f0, "grazing": bsdf.f90}
        for output, color in colors.items():
            if color is None:
                continue
            label, about = f"{output.capitalize()} Color", _DOCS[output]
            inputs.append(_interface(f"{output}_color", "color3", digits(color, 3), label, about))
            nodes.append(
                f"""    <multiply name="kept_{output}" type="color3">
      <input name="in1" type="color3" interfacename="{output}_color" />
      <input name="in2" type="float" nodename="kept" />
    </multiply>
    <output name="{output}" type="color3" nodename="kept_{output}" />
"""
            )
    if bsdf.widening is not None:
        inputs.append(_interface("widening", "float", digits(bsdf.widening), "Widening", _DOCS["widening"]))
        nodes.append(
            f"""
    <!-- And the lobe widens; no view is quite edge on, and no lobe wider than alpha 1. -->
    <max name="not_edge_on" type="float">
      <input name="in1" type="float" nodename="facing" />
      <input name="in2" type="float" value="{SMALLESTFACING}" />
    </max>
    <power name="narrowing" type="float">
      <input name="in1" type="float" nodename="not_edge_on" />
      <input name="in2" type="float" interfacename="widening" />
    </power>
"""
        )
        widths = {"": bsdf.alpha} | ({} if bsdf.second is None else {"second_": bsdf.second.alpha})
        for prefix, alpha in widths.items():
            label = f"{prefix.replace('_', ' ')}alpha".title()
            inputs.append(_interface(f"{prefix}alpha", "float", digits(alpha), label, _DOCS["alpha"]))
            nodes.append(
                f"""    <divide name="{prefix}widened" type="float">
      <input name="in1" type="float" interfacename="{prefix}alpha" />
      <input name="in2" type="float" nodename="narrowing" />
    </divide>
    <min name="{prefix}width" type="float">
      <input name="in1" type="float" nodename="{prefix}widened" />
      <input name="in2" type="float" value="{WIDEST}" />
    </min>
    <convert name="{prefix}widths" type="vector2">
      <input name="in" type="float" nodename="{prefix}width" />
    </convert>
    <output name="{prefix}roughness" type="vector2" nodename="{prefix}widths" />
"""
            )
    if not nodes:
        return ""
    return f"""
  <nodegraph name="NG_{name}">
{"".join(inputs)}{FACING}{"".join(nodes)}  </nodegraph>
"""


_DOCS = {
    "falloff": "How fast the return is lost as the surface is turned away: a power of |n.v|.",
    "reflectance": "Reflectance of the beads with the light along the normal.",
    "grazing": "Their reflectance at grazing angles, before the falloff.",
    "widening": "How fast the lobe widens as the surface is turned away: a power of 1 / |n.v|.",
    "alpha": "Width of the lobe where the surface faces the viewer.",
}


def _interface(port: str, kind: str, value: str, label: str, doc: str) -> str:
    return (
        f'    <input name="{port}" type="{kind}" value="{value}" uimin="{digits(0.0, value.count(",") + 1)}" '
        f'uiname="{label}" doc={quoteattr(doc)} />\n'
    )


def _node(category: str, name: str, *inputs: str) -> str:
    return f'  <{category} name="{name}" type="BSDF">\n{"".join(inputs)}  </{category}>\n'


def _port(port: str, node: str) -> str:
    return f'    <input name="{port}" type="BSDF" nodename="{node}" />\n'


def _driven(port: str, kind: str, name: str, output: str) -> str:
    return f'    <input name="{port}" type="{kind}" nodegraph="NG_{name}" output="{output}" />\n'


def _number(port: str, value: ArrayLike) -> str:
    return f'    <input name="{port}" type="float" value="{digits(value)}" />\n'


def _color(port: str, value: ArrayLike) -> str:
    return f'    <input name="{port}" type="color3" value="{digits(value, 3)}" />\n'


def _roughness(alpha: ArrayLike) -> str:
    return f'    <input name="roughness" type="vector2" value="{digits(alpha, 2)}" />\n'


def digits(value: ArrayLike, count: int = 1) -> str:
    """Numbers as a document has them, with what float32 holds of them."""
    return ", ".join(f"{each:.7g}" for each in np.broadcast_to(np.ravel(value), count))
