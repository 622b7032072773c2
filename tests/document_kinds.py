"""Documents of every kind that MaterialX's own examples and test suite have, small and written here."""

from __future__ import annotations

from pathlib import Path

from sweep import picture, write_picture

_HEAD = '<?xml version="1.0"{encoding}?>\n<materialx version="{version}"{attributes}>\n{body}\n</materialx>\n'


def _document(body: str, version: str = "1.39", attributes: str = "", encoding: str = "") -> str:
    return _HEAD.format(body=body, version=version, attributes=attributes, encoding=encoding)


def _material(surface: str) -> str:
    return f"""{surface}
  <surfacematerial name="kind" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="shaded" />
  </surfacematerial>"""


def _surface(node: str, inputs: str = "") -> str:
    return _material(f'  <{node} name="shaded" type="surfaceshader">{inputs}</{node}>')


def _image_graph(file: str, more: str = "", kind: str = "color3", name: str = "image") -> str:
    return f"""  <nodegraph name="graph">
    <{name} name="picture" type="{kind}">
      <input name="file" type="filename" {file} />{more}
    </{name}>
    <output name="out" type="{kind}" nodename="picture" />
  </nodegraph>"""


_BY_GRAPH = '<input name="base_color" type="color3" nodegraph="graph" output="out" />'
_CODED = 'value="color.png" colorspace="srgb_texture"'

KINDS = {
    "examples/standard": _document(
        _surface("standard_surface", '<input name="metalness" type="float" value="1" />')
    ),
    "examples/open_pbr": _document(
        _surface("open_pbr_surface", '<input name="coat_weight" type="float" value="1" />')
    ),
    "examples/gltf": _document(_surface("gltf_pbr", '<input name="roughness" type="float" value="0.4" />')),
    "examples/preview": _document(
        _surface("UsdPreviewSurface", '<input name="diffuseColor" type="color3" value="0.6, 0.3, 0.1" />')
    ),
    "examples/disney": _document(_surface("disney_principled")),
    "examples/textured": _document(
        _image_graph(_CODED) + _surface("standard_surface", _BY_GRAPH),
        attributes=' colorspace="lin_rec709" fileprefix="../Images/"',
    ),
    "examples/clamped": _document(
        _image_graph(
            _CODED,
            '<input name="texcoord" type="vector2" nodename="placed" />'
            '<input name="uaddressmode" type="string" value="clamp" />'
            '<input name="vaddressmode" type="string" value="mirror" />',
        ).replace(
            '<nodegraph name="graph">',
            '<nodegraph name="graph"><texcoord name="uv" type="vector2" />'
            '<place2d name="placed" type="vector2"><input name="texcoord" type="vector2" nodename="uv" />'
            '<input name="scale" type="vector2" value="0.4, 0.4" /></place2d>',
        )
        + _surface("standard_surface", _BY_GRAPH),
        attributes=' fileprefix="../Images/"',
    ),
    "examples/look": _document(
        '  <xi:include href="textured.mtlx" />\n  <look name="look">'
        '<materialassign name="assigned" material="kind" geom="/" /></look>',
        attributes=' xmlns:xi="http://www.w3.org/2001/XInclude"',
    ),
    "suite/bsdf": _document(
        """  <nodegraph name="graph">
    <conductor_bsdf name="metal" type="BSDF" />
    <surface name="shaded" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="metal" /></surface>
    <output name="out" type="surfaceshader" nodename="shaded" />
  </nodegraph>"""
    ),
    "suite/normalmap": _document(
        _image_graph('value="resources/Images/normal.png"', kind="vector3")
        + '<normalmap name="mapped" type="vector3">'
        '<input name="in" type="vector3" nodegraph="graph" output="out" /></normalmap>'
        + _surface("standard_surface", '<input name="normal" type="vector3" nodename="mapped" />')
    ),
    "suite/outputs": _document(
        """  <nodegraph name="graph">
    <position name="point" type="vector3" />
    <dotproduct name="length" type="float">
      <input name="in1" type="vector3" nodename="point" /><input name="in2" type="vector3" nodename="point" />
    </dotproduct>
    <ifgreater name="is_far" type="integer">
      <input name="value1" type="float" nodename="length" /><input name="value2" type="float" value="0.99" />
      <input name="in1" type="integer" value="1" /><input name="in2" type="integer" value="0" />
    </ifgreater>
    <combine2 name="two" type="vector2">
      <input name="in1" type="float" nodename="length" /><input name="in2" type="float" value="0.25" />
    </combine2>
    <output name="vector" type="vector3" nodename="point" />
    <output name="number" type="float" nodename="length" />
    <output name="whole" type="integer" nodename="is_far" />
    <output name="pair" type="vector2" nodename="two" />
  </nodegraph>"""
    ),
    "suite/struct": _document(
        """  <typedef name="pair"><member name="first" type="float" value="0.1" />
    <member name="second" type="float" value="0.2" /></typedef>
  <nodedef name="ND_second" node="second">
    <input name="in" type="pair" value="{0.1;0.2}" /><output name="out" type="float" value="0.0" />
  </nodedef>"""
        + "".join(
            f'<implementation name="IM_{target}" nodedef="ND_second" target="{target}"'
            ' sourcecode="{{in}}.second" />'
            for target in ("genglsl", "genmsl", "genosl", "genmdl", "genslang")
        )
        + '<second name="taken" type="float"><input name="in" type="pair" value="{0.3;0.7}" /></second>'
        + _surface("surface_unlit", '<input name="emission" type="float" nodename="taken" />')
    ),
    "suite/frame": _document(
        """  <nodegraph name="graph">
    <frame name="number" type="float" />
    <multiply name="scaled" type="float">
      <input name="in1" type="float" nodename="number" /><input name="in2" type="float" value="0.3" />
    </multiply>
    <output name="out" type="float" nodename="scaled" />
  </nodegraph>"""
    ),
    "suite/definition": _document(
        """  <nodedef name="ND_halved" node="halved">
    <input name="in" type="color3" value="0.8, 0.4, 0.2" /><output name="out" type="color3" />
  </nodedef>
  <nodegraph name="NG_halved" nodedef="ND_halved">
    <multiply name="half" type="color3">
      <input name="in1" type="color3" interfacename="in" /><input name="in2" type="float" value="0.5" />
    </multiply>
    <output name="out" type="color3" nodename="half" />
  </nodegraph>
  <halved name="own" type="color3" />"""
        + _surface("standard_surface", '<input name="base_color" type="color3" nodename="own" />')
    ),
    "suite/tokens": _document(
        _image_graph('value="resources/Images/[what].png"').replace(
            '<nodegraph name="graph">',
            '<nodegraph name="graph"><token name="what" type="string" value="color" />',
        )
        + _surface("standard_surface", _BY_GRAPH)
    ),
    "suite/unnamed": _document(
        _image_graph('value=""', '<input name="default" type="color3" value="0.1, 0.6, 0.3" />')
        + _surface("standard_surface", _BY_GRAPH)
    ),
    "suite/tiled": _document(
        _image_graph('value="resources/Images/color.png"', name="tiledimage")
        + _surface("standard_surface", _BY_GRAPH)
    ),
    "suite/set": _document(
        _image_graph('value="resources/Images/set.&lt;UDIM&gt;.png"')
        + _surface("standard_surface", _BY_GRAPH)
    ),
    "suite/unit": _document(
        """  <constant name="length" type="float">
    <input name="value" type="float" value="50" unittype="distance" unit="centimeter" />
  </constant>"""
        + _surface("standard_surface", '<input name="base" type="float" nodename="length" />')
    ),
    "suite/encoded": _document(
        _surface("standard_surface", '<input name="base_color" type="color3" value="0.2, 0.1, 0.4" />'),
        attributes=' colorspace="srgb_texture"',
    ),
    "suite/upgraded": _document(
        """  <standard_surface name="shaded" type="surfaceshader">
    <input name="base_color" type="color3" value="0.5, 0.2, 0.1" />
    <input name="subsurface" type="float" value="0.5" />
  </standard_surface>
  <surfacematerial name="kind" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="shaded" />
  </surfacematerial>""",
        version="1.38",
    ),
    "suite/letters": _document(
        "  <!-- größer, 反射 -->\n" + _surface("standard_surface", " <!-- é -->"),
        encoding=' encoding="utf-8"',
    ),
    "suite/hair": _document(
        _material(
            """  <chiang_hair_bsdf name="strands" type="BSDF" />
  <surface name="shaded" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="strands" /></surface>"""
        )
    ),
    "suite/unlit": _document(
        _surface("surface_unlit", '<input name="emission_color" type="color3" value="0.3, 0.5, 0.1" />')
    ),
    "suite/displaced": _document(
        """  <displacement name="raised" type="displacementshader">
    <input name="displacement" type="float" value="0.1" />
  </displacement>"""
        + _surface("standard_surface").replace(
            "</surfacematerial>",
            '  <input name="displacementshader" type="displacementshader" nodename="raised" />\n  </surfacematerial>',
        )
    ),
    "suite/lights": _document(
        """  <directional_light name="lamp" type="lightshader">
    <input name="direction" type="vector3" value="0, -1, 0" />
  </directional_light>"""
    ),
}
"""By a name below `Materials`."""

NOTHING_TO_DRAW = ("suite/lights",)


def write(folder: Path) -> list[Path]:
    """Write all of them, and their pictures, and return them. The pictures lie in `Images`, beside `Materials`."""
    for name, text in KINDS.items():
        file = folder / "Materials" / f"{name}.mtlx"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    for name in ("color.png", "normal.png", "set.1001.png", "set.1002.png"):
        for place in (folder / "Images", folder / "Materials" / "Images"):
            write_picture(place / name, picture(name))
    return sorted(folder.rglob("*.mtlx"))
