"""Documents that use MaterialX's surfaces move over to ours, every other byte as it was."""

from __future__ import annotations

import shutil
from pathlib import Path

import MaterialX as mx
import pytest
from click.testing import CliRunner

import mrm_nodes
from mrm_nodes.cli import cli, main
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.surfaces.rewrite import retrofit_file, retrofit_text

# Comments, quotes, tabs, odd spacing and a > inside an attribute: what a text search would trip over.
CONE = """\
<?xml version='1.0' encoding="UTF-8"?>
<materialx   version="1.39"
    colorspace="lin_rec709"><!-- <open_pbr_surface name="not this one"/> -->
\t<checkerboard name="bands" type="color3" />
\t<extract name="share" type="float">
\t\t<input name="in" type="color3" nodename="bands"/>
\t</extract>
  <open_pbr_surface
      type='surfaceshader'  name='cone' doc="open_pbr_surface > the rest"
      nodedef="ND_open_pbr_surface_surfaceshader" >
\t\t<input name="base_color" type="color3" nodename="bands"/>  <!-- é ✓ -->
    <input  name="specular_roughness"   type="float" value='0.25'/>

  </open_pbr_surface  >
  <gltf_pbr name="post" type="surfaceshader"/>
  <surfacematerial name="open_pbr_surface" type="material"><input name="surfaceshader" type="surfaceshader" \
nodename="cone" /></surfacematerial>
  <surfacematerial name="m2" type="material"><input name="surfaceshader" type="surfaceshader" \
nodename="post" /></surfacematerial>
</materialx>
<!-- the end -->
"""

BOOLEANS = """\
<?xml version="1.0"?>
<materialx version="1.39">
  <nodegraph name="NG_sheet">
    <input name="is_retro" type="boolean" value="true" />
    <dielectric_bsdf name="beads" type="BSDF" nodedef="ND_dielectric_bsdf">
      <input name="ior" type="float" value="1.9" />
      <input name="retroreflective" type="boolean" value="true" />
    </dielectric_bsdf>
    <conductor_bsdf name="foil" type="BSDF">
      <input name="retroreflective" type="boolean" interfacename="is_retro" />
    </conductor_bsdf>
    <dielectric_bsdf name="coat" type="BSDF">
      <input name="retroreflective" type="boolean" value="false" />
    </dielectric_bsdf>
    <layer name="coated" type="BSDF">
      <input name="top" type="BSDF" nodename="coat" />
      <input name="base" type="BSDF" nodename="foil" />
    </layer>
    <layer name="all" type="BSDF">
      <input name="top" type="BSDF" nodename="beads" />
      <input name="base" type="BSDF" nodename="coated" />
    </layer>
    <output name="out" type="BSDF" nodename="all" />
  </nodegraph>
  <surface name="sheet_surface" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodegraph="NG_sheet" output="out" />
  </surface>
  <surfacematerial name="sheet" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="sheet_surface" />
  </surfacematerial>
</materialx>
"""


@pytest.fixture
def cone(tmp_path: Path) -> Path:
    path = tmp_path / "cone.mtlx"
    path.write_bytes(CONE.encode())
    return path


def test_only_the_tags_of_the_surfaces_change() -> None:
    text, changed = retrofit_text(CONE.encode(), "cone.mtlx")
    expected = CONE.replace("  <open_pbr_surface\n", "  <mrm_open_pbr_surface\n")
    expected = expected.replace("</open_pbr_surface  >", "</mrm_open_pbr_surface  >")
    expected = expected.replace('"ND_open_pbr_surface_', '"ND_mrm_open_pbr_surface_')
    expected = expected.replace("<gltf_pbr ", "<mrm_gltf_pbr ")
    assert text.decode() == expected
    assert changed == ["cone", "post"]


def test_a_weight_is_added_in_the_layout_of_its_neighbours() -> None:
    weights = {"specular_retroreflectivity": 0.8, "retroreflection": 1.0}
    text = retrofit_text(CONE.encode(), "cone.mtlx", weights)[0].decode()
    plain = retrofit_text(CONE.encode(), "cone.mtlx")[0].decode()
    open_pbr = '\n    <input name="specular_retroreflectivity" type="float" value="0.8" />'
    gltf = '>\n    <input name="retroreflection" type="float" value="1" />\n  </mrm_gltf_pbr>'
    assert "value='0.25'/>" + open_pbr in text
    assert 'type="surfaceshader"' + gltf in text
    assert text.replace(open_pbr, "").replace(gltf, "/>") == plain


def test_line_ends_are_kept() -> None:
    text = retrofit_text(CONE.replace("\n", "\r\n").encode(), "cone.mtlx", {"retroreflection": 0.5})[0]
    assert text.count(b"\n") == text.count(b"\r\n")


def test_a_weight_that_a_newer_document_has_is_kept_and_can_be_set() -> None:
    draft = CONE.replace(
        "    <input  name=",
        '    <input name="specular_retroreflectivity" type="float" nodename="share"/>\n    <input  name=',
    )
    kept = retrofit_text(draft.encode(), "cone.mtlx")[0].decode()
    assert 'name="specular_retroreflectivity" type="float" nodename="share"/>' in kept
    replaced = retrofit_text(draft.encode(), "cone.mtlx", {"specular_retroreflectivity": 0.5})[0].decode()
    assert replaced.count("specular_retroreflectivity") == 1
    assert '"specular_retroreflectivity" type="float" value="0.5" />' in replaced


@pytest.mark.skipif(mx.getVersionIntegers() < (1, 39, 5), reason="this MaterialX has no retroreflective")
def test_the_boolean_becomes_weight_one(tmp_path: Path) -> None:
    source, target = tmp_path / "in.mtlx", tmp_path / "out.mtlx"
    source.write_text(BOOLEANS)
    assert retrofit_file(source, target) == ["beads", "foil"]
    text = target.read_text()
    assert '<mrm_dielectric_bsdf name="beads" type="BSDF" nodedef="ND_mrm_dielectric_bsdf">' in text
    assert text.count('<input name="retroreflectivity" type="float" value="1.0" />') == 1
    assert '<input name="in" type="boolean" interfacename="is_retro" />' in text
    assert '<input name="retroreflectivity" type="float" nodename="foil_retroreflectivity" />' in text
    assert '<dielectric_bsdf name="coat"' in text  # forward before, forward now
    assert mrm_nodes.generate_shader(target).pixel


def test_the_result_generates_what_the_original_did(cone: Path, tmp_path: Path) -> None:
    result = tmp_path / "retro.mtlx"
    retrofit_file(cone, result, {"specular_retroreflectivity": 0.8})
    assert cone.read_bytes() == CONE.encode()
    assert (
        "mrm_generalized_schlick_bsdf(" in mrm_nodes.generate_shader(result, element="open_pbr_surface").pixel
    )


def test_the_command_says_what_it_changed(cone: Path, tmp_path: Path) -> None:
    result = tmp_path / "retro.mtlx"
    arguments = ["retrofit", str(cone), "-o", str(result), "--set", "specular_retroreflectivity=0.8"]
    outcome = CliRunner().invoke(cli, arguments)
    assert outcome.exit_code == 0, outcome.output
    assert outcome.output == f"{result}: cone, post\n"
    assert b'"specular_retroreflectivity" type="float" value="0.8"' in result.read_bytes()


def test_textures_that_stay_behind_are_pointed_out(cone: Path, tmp_path: Path) -> None:
    cone.write_text(textured("stripes.png"))
    (tmp_path / "stripes.png").write_bytes(b"")
    (tmp_path / "elsewhere").mkdir()
    with pytest.warns(MrmWarning, match="textures are named relative to"):
        retrofit_file(cone, tmp_path / "elsewhere" / "cone.mtlx")


def textured(file: str) -> str:
    image = f'<image name="stripes" type="float"><input name="file" type="filename" value="{file}" /></image>'
    return CONE.replace("\t<checkerboard", f"\t{image}\n\t<checkerboard")


BAD = {
    "no surface": (
        "<materialx version='1.39'><checkerboard name='c' type='color3'/></materialx>",
        "has nothing to retrofit: none of open_pbr_surface, gltf_pbr, standard_surface",
    ),
    "unknown node": (
        CONE.replace("<gltf_pbr ", "<gltf_pbrr "),
        "node post: unknown node gltf_pbrr; did you mean gltf_pbr",
    ),
    "unknown definition": (CONE.replace("ND_open_pbr", "ND_openpbr"), "node cone: "),
    "twice": (retrofit_text(CONE.encode(), "")[0].decode(), "is retrofitted already: cone is a mrm_open_pbr"),
    "taken name": (
        CONE.replace(
            "</materialx>",
            '<nodedef name="ND_mine" node="mrm_open_pbr_surface"><output name="out" type="surfaceshader" />'
            "</nodedef></materialx>",
        ),
        "defines a node mrm_open_pbr_surface itself; rename it first",
    ),
    "broken": (CONE.replace("</materialx>", ""), "not a MaterialX document"),
    "texture": (textured("no_such.png"), "stripes/file: there is no texture no_such.png"),
}

BAD_WEIGHTS = {
    "range": (
        CONE,
        {"specular_retroreflectivity": 1.5},
        "specular_retroreflectivity: 1.5 is not from 0 to 1",
    ),
    "nan": (CONE, {"specular_retroreflectivity": float("nan")}, "nan is not from 0 to 1"),
    "unknown": (
        CONE,
        {"retroreflectivness": 0.5},
        "unknown input retroreflectivness; one that can be set is",
    ),
    "unused": (
        CONE.replace("gltf_pbr", "standard_surface"),
        {"retroreflection": 0.5},
        "no surface in it has an input retroreflection",
    ),
}


@pytest.mark.parametrize(
    ("text", "weights", "message"),
    [(text, {}, message) for text, message in BAD.values()] + list(BAD_WEIGHTS.values()),
    ids=[*BAD, *BAD_WEIGHTS],
)
def test_what_cannot_be_done_leaves_no_trace(tmp_path: Path, text: str, weights: dict, message: str) -> None:
    source, target = tmp_path / "in.mtlx", tmp_path / "out.mtlx"
    source.write_text(text)
    with pytest.raises(MrmError, match=message):
        retrofit_file(source, target, weights)
    assert source.read_text() == text
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_the_command_says_so_in_one_line_with_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    source = tmp_path / "in.mtlx"
    source.write_text(text)
    with pytest.raises(SystemExit) as stopped:
        main(["retrofit", str(source), "-o", str(tmp_path / "out.mtlx")])
    assert stopped.value.code == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert complaint.count("\n") == 1
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize("target", ["cone.mtlx", "no_folder/out.mtlx"])
def test_a_target_that_cannot_be_written_is_refused(cone: Path, tmp_path: Path, target: str) -> None:
    with pytest.raises(MrmError, match=r"is the file to read|cannot be written"):
        retrofit_file(cone, tmp_path / target)
    assert cone.read_bytes() == CONE.encode()


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(MrmError, match=r"no_such\.mtlx: no such file"):
        retrofit_file(tmp_path / "no_such.mtlx", tmp_path / "out.mtlx")


def test_the_materials_that_come_with_the_package_are_left_alone(tmp_path: Path) -> None:
    from mrm_nodes.library import materials_path

    for path in materials_path().glob("*.mtlx"):
        shutil.copy(path, tmp_path)
        with pytest.raises(MrmError, match="retrofitted already"):
            retrofit_file(tmp_path / path.name, tmp_path / "out.mtlx")
