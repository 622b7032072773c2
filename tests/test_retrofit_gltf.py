"""glTF with KHR_materials_retroreflection becomes MaterialX, and glTF again, with nothing lost."""

from __future__ import annotations

import base64
import copy
import json
import struct
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
import pytest
from click.testing import CliRunner

import mrm_nodes
from mrm_nodes.cli import cli
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render import write_png
from mrm_nodes.surfaces.convert import convert

pytestmark = pytest.mark.filterwarnings("ignore:.*VENDOR_thing is left out")

TEXTURE = {"index": 0, "texCoord": 0}
CONE: dict[str, Any] = {
    "asset": {"version": "2.0", "generator": "a test", "extras": {"author": "somebody"}},
    "extensionsUsed": ["KHR_materials_retroreflection", "KHR_materials_specular", "VENDOR_thing"],
    "images": [{"uri": "mask%20one.png"}],
    "samplers": [{"magFilter": 9728, "wrapS": 33071}],
    "textures": [{"source": 0, "sampler": 0}],
    "materials": [
        {
            "name": "Cone",
            "doubleSided": True,
            "extras": {"note": "kept"},
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.9, 0.2, 0.0, 1.0],
                "baseColorTexture": {
                    "index": 0,
                    "extensions": {"KHR_texture_transform": {"scale": [2, 3], "rotation": 0.5}},
                },
                "metallicFactor": 0,
                "roughnessFactor": 0.3499999940395355,
                "metallicRoughnessTexture": TEXTURE,
            },
            "normalTexture": {"index": 0, "scale": 0.5},
            "occlusionTexture": {"index": 0, "strength": 0.7},
            "emissiveFactor": [0.1, 0.0, 0.2],
            "extensions": {
                "KHR_materials_retroreflection": {
                    "retroreflectionFactor": 0.8,
                    "retroreflectionTexture": TEXTURE,
                },
                "KHR_materials_specular": {"specularColorFactor": [4.0, 4.0, 4.0]},
                "KHR_materials_clearcoat": {"clearcoatFactor": 0.5, "clearcoatRoughnessTexture": TEXTURE},
                "KHR_materials_iridescence": {
                    "iridescenceFactor": 0.3,
                    "iridescenceThicknessTexture": TEXTURE,
                },
                "KHR_materials_sheen": {"sheenColorFactor": [0.2, 0.1, 0.0], "sheenRoughnessFactor": 0.4},
                "KHR_materials_transmission": {"transmissionFactor": 0.1},
                "KHR_materials_volume": {"thicknessFactor": 0.1, "attenuationColor": [0.5, 0.6, 0.7]},
                "VENDOR_thing": {"anything": [1, 2, {"three": None}]},
            },
        },
        {"name": "Cone", "alphaMode": "MASK", "alphaCutoff": 0.25},
        {"extensions": {"KHR_materials_retroreflection": {}}},
    ],
    "meshes": [{"primitives": [{"attributes": {}, "material": 0}]}],
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    mask = np.zeros((4, 4, 3), np.float32)
    mask[:, 2:] = 1.0
    write_png(tmp_path / "mask one.png", mask)
    (tmp_path / "cone.gltf").write_text(json.dumps(CONE))
    return tmp_path


def write(folder: Path, change: Any = None) -> Path:
    content = copy.deepcopy(CONE)
    if change is not None:
        change(content)
    path = folder / "changed.gltf"
    path.write_text(json.dumps(content))
    return path


def test_every_material_becomes_a_surface_that_generates(folder: Path) -> None:
    names = convert(folder / "cone.gltf", folder / "cone.mtlx")
    assert names == ["Cone", "Cone2", "material2"]
    document = read_document(folder / "cone.mtlx")
    assert document.validate() == (True, "")
    assert [node.getName() for node in document.getNodes("mrm_gltf_pbr")] == [f"{n}_shader" for n in names]
    for name in names:
        assert mrm_nodes.generate_shader(folder / "cone.mtlx", element=name).pixel


def test_the_weight_is_the_factor_times_the_red_channel(folder: Path) -> None:
    convert(folder / "cone.gltf", folder / "cone.mtlx")
    document = read_document(folder / "cone.mtlx")
    scaled = document.getNode("Cone_shader").getInput("retroreflection").getConnectedNode()
    assert (scaled.getCategory(), scaled.getInput("in2").getValue()) == ("multiply", pytest.approx(0.8))
    channel = scaled.getConnectedNode("in1")
    assert (channel.getCategory(), channel.getInput("index").getValue()) == ("extract", 0)
    image = channel.getConnectedNode("in")
    assert image.getInput("file").getValueString() == "mask one.png"
    assert not image.getInput("file").hasColorSpace()  # the mask is linear
    assert image.getInput("uaddressmode").getValueString() == "clamp"
    assert document.getNode("material2_shader").getInput("retroreflection") is None


@pytest.mark.parametrize("container", ["gltf", "glb"])
def test_there_and_back_is_what_it_was(folder: Path, container: str) -> None:
    source = folder / f"cone.{container}"
    if container == "glb":
        write_glb(source, CONE, b"geometry")
    convert(source, folder / "cone.mtlx")
    back = folder / f"back.{container}"
    assert convert(folder / "cone.mtlx", back) == []
    if container == "glb":
        assert back.read_bytes()[-8:] == b"geometry"
        length = struct.unpack_from("<I", back.read_bytes(), 12)[0]
        assert json.loads(back.read_bytes()[20 : 20 + length]) == CONE
    else:
        assert json.loads(back.read_text()) == CONE


def write_glb(path: Path, content: dict[str, Any], binary: bytes) -> None:
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def test_a_number_changed_in_materialx_is_the_only_one_that_changes_in_gltf(folder: Path) -> None:
    convert(folder / "cone.gltf", folder / "cone.mtlx")
    text = (folder / "cone.mtlx").read_text().replace('value="0.8"', 'value="0.25"')
    shader = '<mrm_gltf_pbr name="Cone2_shader" type="surfaceshader">'
    assert shader in text
    added = '<input name="retroreflection" type="float" value="1" />'
    added += '<input name="base_color" type="color3" value="1, 0, 0" />'
    (folder / "cone.mtlx").write_text(text.replace(shader, shader + added))
    assert convert(folder / "cone.mtlx", folder / "back.gltf") == ["Cone", "Cone2"]
    expected = copy.deepcopy(CONE)
    expected["materials"][0]["extensions"]["KHR_materials_retroreflection"]["retroreflectionFactor"] = 0.25
    expected["materials"][1] |= {
        "extensions": {"KHR_materials_retroreflection": {"retroreflectionFactor": 1.0}},
        "pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.0, 0.0, 1.0]},
    }
    assert json.loads((folder / "back.gltf").read_text()) == expected


def test_images_inside_the_gltf_are_written_beside_the_document(folder: Path) -> None:
    png = (folder / "mask one.png").read_bytes()

    def embed(content: dict[str, Any]) -> None:
        content["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(png).decode()}]

    convert(write(folder, embed), folder / "cone.mtlx")
    assert (folder / "cone_image0.png").read_bytes() == png


def test_the_command_goes_both_ways(folder: Path) -> None:
    run = CliRunner().invoke
    outcome = run(
        cli,
        ["retrofit", str(folder / "cone.gltf"), "-o", str(folder / "a.mtlx"), "--set", "retroreflection=1"],
    )
    assert outcome.exit_code == 0, outcome.output
    outcome = run(cli, ["retrofit", str(folder / "a.mtlx"), "-o", str(folder / "b.gltf")])
    assert outcome.exit_code == 0, outcome.output
    assert outcome.output == f"{folder / 'b.gltf'}: Cone, Cone2, material2\n"
    materials = json.loads((folder / "b.gltf").read_text())["materials"]
    assert all(retro({"materials": [material]})["retroreflectionFactor"] == 1.0 for material in materials)
    assert materials[0]["pbrMetallicRoughness"] == CONE["materials"][0]["pbrMetallicRoughness"]


def retro(content: dict[str, Any]) -> dict[str, Any]:
    return content["materials"][0]["extensions"]["KHR_materials_retroreflection"]


BAD = {
    "factor": (lambda c: retro(c).update(retroreflectionFactor=1.5), "material 0: retroreflectionFactor 1.5 is not"),
    "factor type": (lambda c: retro(c).update(retroreflectionFactor="1"), "retroreflectionFactor '1' is not a number"),
    "property": (lambda c: retro(c).update(retroreflectivity=1.0), "has no retroreflectivity"),
    "object": (lambda c: c["materials"][0]["extensions"].update(KHR_materials_sheen=1), "sheen is not an object"),
    "texture": (lambda c: retro(c).update(retroreflectionTexture={"index": 7}), "there is no texture 7"),
    "file": (lambda c: c["images"][0].update(uri="no_such.png"), r"there is no texture .*no_such\.png"),
    "index": (lambda c: retro(c).update(retroreflectionTexture={"index": "a"}), "there is no texture a"),
    "info": (lambda c: retro(c).update(retroreflectionTexture=5), "there is no texture None"),
    "item": (lambda c: c["textures"].__setitem__(0, 3), "material 0: not laid out as glTF 2.0 says"),
    "uri": (lambda c: c["images"].__setitem__(0, {"uri": 5}), "material 0: not laid out as glTF 2.0 says"),
    "part": (lambda c: c["materials"][1].update(pbrMetallicRoughness=[1]), "material 1: not laid out"),
    "primitives": (lambda c: c.update(meshes=[{"primitives": 3}]), "not laid out as glTF 2.0 says"),
    "material": (lambda c: c["materials"].append(5), "material 3: is not an object"),
    "asset": (lambda c: c.update(asset=[]), "not glTF 2"),
    "required": (
        lambda c: c.update(extensionsRequired=["VENDOR_thing"], materials=c["materials"][:1]),
        "material 0: requires VENDOR_thing",
    ),
    "unlit": (
        lambda c: c.update(materials=[{"extensions": {"KHR_materials_unlit": {}}}] * 2),
        "material 0: KHR_materials_unlit is not metallic-roughness",
    ),
    "none": (lambda c: c.pop("materials"), "has no materials"),
    "version": (lambda c: c["asset"].update(version="1.0"), "not glTF 2"),
    "alpha": (lambda c: c["materials"][1].update(alphaMode="GLASS"), "alphaMode 'GLASS' is not one of"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), BAD.values(), ids=BAD)
def test_a_broken_gltf_leaves_no_trace(folder: Path, change: Any, message: str) -> None:
    source = write(folder, change)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(MrmError, match=message):
        convert(source, folder / "out.mtlx")
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


def test_an_extension_that_may_be_ignored_is_named(folder: Path) -> None:
    with pytest.warns(MrmWarning, match="material 0: VENDOR_thing is left out"):
        convert(folder / "cone.gltf", folder / "cone.mtlx")


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"glTF", b"glTF\2\0\0\0\xff\0\0\0\xff\0\0\0JSON{}"])
def test_a_file_that_is_no_gltf_is_refused(folder: Path, content: bytes) -> None:
    (folder / "bad.glb").write_bytes(content)
    with pytest.raises(MrmError, match=r"bad\.glb: (not glTF|a \.glb that is cut short)"):
        convert(folder / "bad.glb", folder / "out.mtlx")


DRIVER = "what drives base_color is not a texture times a factor as it was"


def test_textures_changed_added_and_taken_out_in_materialx_go_back(folder: Path) -> None:
    write_png(folder / "new.png", np.ones((2, 2, 3), np.float32))
    convert(folder / "cone.gltf", folder / "cone.mtlx")
    document = read_document(folder / "cone.mtlx")
    retro, color, plain = (
        document.getNode(node).getInput(name)
        for node, name in (
            ("Cone_shader", "retroreflection"),
            ("Cone_shader", "base_color"),
            ("Cone2_shader", "alpha_cutoff"),
        )
    )
    image = retro.getConnectedNode().getConnectedNode("in1").getConnectedNode("in")
    image.getInput("file").setValueString("new.png")
    color.removeAttribute("nodename")
    color.setValueString("0.5, 0.25, 1")
    added = document.addNode("gltf_image", "added", "vector3")
    added.addInput("file", "filename").setValueString("new.png")
    channel = document.addNode("extract", "added_channel", "float")
    channel.addInput("in", "vector3").setConnectedNode(added)
    channel.addInput("index", "integer").setValueString("0")
    plain.getParent().addInput("retroreflection", "float").setConnectedNode(channel)
    mx.writeToXmlFile(document, str(folder / "cone.mtlx"))

    assert convert(folder / "cone.mtlx", folder / "back.gltf") == ["Cone", "Cone2"]
    expected = copy.deepcopy(CONE)
    expected["images"].append({"uri": "new.png"})
    expected["textures"] += [{"source": 1, "sampler": 0}, {"source": 1}]
    cone, second, _ = expected["materials"]
    retro_extension = cone["extensions"]["KHR_materials_retroreflection"]
    retro_extension["retroreflectionTexture"] = TEXTURE | {"index": 1}
    cone["pbrMetallicRoughness"]["baseColorFactor"] = [0.5, 0.25, 1.0, 1.0]
    del cone["pbrMetallicRoughness"]["baseColorTexture"]
    second["extensions"] = {
        "KHR_materials_retroreflection": {
            "retroreflectionFactor": 1.0,
            "retroreflectionTexture": {"index": 2},
        }
    }
    assert json.loads((folder / "back.gltf").read_text()) == expected


def colored(content: dict[str, Any]) -> None:
    primitives = content["meshes"][0]["primitives"]
    primitives[0]["attributes"] = {"COLOR_0": 0}
    primitives.append({"attributes": {"COLOR_0": 1}, "material": 1})


def test_vertex_colours_multiply_the_base_colour_and_the_alpha_and_go_back(folder: Path) -> None:
    convert(write(folder, colored), folder / "cone.mtlx")
    document = read_document(folder / "cone.mtlx")
    assert document.validate() == (True, "")
    for name in ("Cone", "Cone2"):
        product = document.getNode(f"{name}_shader").getInput("base_color").getConnectedNode()
        assert product.getConnectedNode("in2").getConnectedNode("in").getCategory() == "geomcolor"
        assert mrm_nodes.generate_shader(folder / "cone.mtlx", element=name).pixel
    alpha = document.getNode("Cone2_shader").getInput("alpha").getConnectedNode()
    assert alpha.getConnectedNode("in").getCategory() == "geomcolor"
    text = (folder / "cone.mtlx").read_text()
    assert convert(folder / "cone.mtlx", folder / "back.gltf") == []
    (folder / "cone.mtlx").write_text(text.replace('value="1, 1, 1"', 'value="0.5, 1, 1"'))
    assert convert(folder / "cone.mtlx", folder / "back.gltf") == ["Cone2"]
    back = json.loads((folder / "back.gltf").read_text())
    assert back["materials"][1]["pbrMetallicRoughness"]["baseColorFactor"] == [0.5, 1.0, 1.0, 1.0]


def test_meshes_without_the_vertex_colours_of_their_material_are_pointed_out(folder: Path) -> None:
    def half_colored(content: dict[str, Any]) -> None:
        colored(content)
        content["meshes"][0]["primitives"][1]["material"] = 0
        del content["meshes"][0]["primitives"][1]["attributes"]["COLOR_0"]

    with pytest.warns(MrmWarning, match="some of its meshes have no vertex colours"):
        convert(write(folder, half_colored), folder / "cone.mtlx")


@pytest.mark.filterwarnings("ignore:.*has no anisotropy")
def test_an_anisotropy_texture_gives_strength_and_direction_and_goes_back(folder: Path) -> None:
    def brushed(content: dict[str, Any]) -> None:
        content["materials"][2]["extensions"]["KHR_materials_anisotropy"] = {
            "anisotropyStrength": 0.5,
            "anisotropyRotation": 0.25,
            "anisotropyTexture": {"index": 0},
        }

    convert(write(folder, brushed), folder / "cone.mtlx")
    document = read_document(folder / "cone.mtlx")
    shader = document.getNode("material2_shader")
    if shader.getInput("anisotropy_strength") is None:
        pytest.skip("this MaterialX has no anisotropy in gltf_pbr")
    (image,) = document.getNodes("gltf_anisotropy_image")
    assert image.getInput("anisotropy_strength").getValue() == 0.5
    for name in ("anisotropy_strength", "anisotropy_rotation"):
        assert shader.getInput(name).getOutputString() == f"{name}_out"
    assert mrm_nodes.generate_shader(folder / "cone.mtlx", element="material2").pixel
    assert convert(folder / "cone.mtlx", folder / "back.gltf") == []
    text = (folder / "cone.mtlx").read_text()
    (folder / "cone.mtlx").write_text(text.replace('value="0.25"', 'value="0.75"'))
    assert convert(folder / "cone.mtlx", folder / "back.gltf") == ["Cone2", "material2"]
    back = json.loads((folder / "back.gltf").read_text())
    rotation = back["materials"][2]["extensions"]["KHR_materials_anisotropy"]["anisotropyRotation"]
    assert rotation == 0.75


def test_what_cannot_go_back_is_refused(folder: Path) -> None:
    convert(folder / "cone.gltf", folder / "cone.mtlx")
    text = (folder / "cone.mtlx").read_text()
    for change, message in (
        (("mask one.png", "other.png"), r"Cone: base_color: there is no texture .*other\.png"),
        (('name="scale" type="vector2" value="2, 3"', 'name="scale" type="vector2" value="2, 4"'), DRIVER),
        (("gltf_image", "image"), "what drives .* is not a texture times a factor"),
        (('gltf_source="cone.gltf"', 'gltf_source="gone.gltf"'), r"gone\.gltf: cannot be read"),
        (('gltf_source="cone.gltf"', ""), "was not made from a glTF"),
    ):
        (folder / "cone.mtlx").write_text(text.replace(*change))
        with pytest.raises(MrmError, match=message):
            convert(folder / "cone.mtlx", folder / "back.gltf")
    (folder / "cone.mtlx").write_text(text)
    for target in ("cone.gltf", "back.glb", "sub/back.gltf"):
        with pytest.raises(MrmError):
            convert(folder / "cone.mtlx", folder / target)
    assert json.loads((folder / "cone.gltf").read_text()) == CONE
    assert not (folder / "back.gltf").exists()
