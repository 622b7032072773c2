"""Documents and glTF as other programs write them: retrofit finishes the job, or says in one line what keeps it."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
import pytest
from click.testing import CliRunner

from mrm_nodes import shadergen
from mrm_nodes.cli import cli
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render import write_png
from mrm_nodes.surfaces.convert import convert

WEIGHT = "specular_retroreflectivity"
#: MaterialX's elements die with their document.
ALIVE: list[mx.Document] = []
HEAD = '<?xml version="1.0"?>\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the program runs, with an image."""
    monkeypatch.chdir(tmp_path)
    mask = np.zeros((4, 4, 3), np.float32)
    mask[:, 2:] = 1.0
    write_png(tmp_path / "mask.png", mask)
    return tmp_path


def write(nodes: str, name: str = "in.mtlx", **attributes: str) -> Path:
    given = "".join(f' {key}="{value}"' for key, value in {"version": "1.39", **attributes}.items())
    path = Path(name)
    path.write_text(f"{HEAD}<materialx{given}>\n{nodes}\n</materialx>\n")
    return path


def material(shader: str, name: str = "material1", more: str = "") -> str:
    return (
        f'<surfacematerial name="{name}" type="material"><input name="surfaceshader" type="surfaceshader" '
        f'nodename="{shader}" {more}/></surfacematerial>'
    )


SIGN = '<standard_surface name="sign" type="surfaceshader" />' + material("sign")
HALF = '<constant name="half" type="float"><input name="value" type="float" value="0.5" /></constant>'
RED = '<constant name="red" type="color3" />'
SPLIT = '<separate2 name="split" type="multioutput" />'
BANDS = f'<nodegraph name="bands">{HALF}{RED}<output name="share" type="float" nodename="half" />'
BANDS += '<output name="tint" type="color3" nodename="red" /></nodegraph>'


def retrofitted(path: Path, output: str = "out.mtlx", **options: Any) -> mx.Document:
    convert(path, output, **options)
    for target in ("glsl", "osl"):
        document = read_document(output, allow_external=True)
        names = [node.getName() for node in document.getMaterialNodes()]
        assert shadergen.generate_shader(output, target, names[0], allow_external=True).pixel
    ALIVE[:] = [document]
    return document


def weight_of(document: mx.Document, shader: str = "sign", name: str = WEIGHT) -> mx.Input:
    return document.getDescendant(shader).getInput(name)


# ---- the weight is a number, a node, or an image


def test_the_weight_is_a_node(folder: Path) -> None:
    weight = weight_of(retrofitted(write(HALF + SIGN), weights={WEIGHT: "half"}))
    assert weight.getConnectedNode().getName() == "half"


def test_the_weight_is_an_output_of_a_graph(folder: Path) -> None:
    weight = weight_of(retrofitted(write(BANDS + SIGN), weights={WEIGHT: "bands/share"}))
    assert (weight.getNodeGraphString(), weight.getOutputString()) == ("bands", "share")


def test_the_weight_is_an_output_of_a_node(folder: Path) -> None:
    weight = weight_of(retrofitted(write(SPLIT + SIGN), weights={WEIGHT: "split/outy"}))
    assert (weight.getNodeName(), weight.getOutputString()) == ("split", "outy")


def test_the_weight_is_an_image_named_relative_to_the_output_and_not_decoded(folder: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "mask.png").rename(folder / "deep" / "mask one.png")
    for output, name in (("out.mtlx", "deep/mask one.png"), ("deep/out.mtlx", "mask one.png")):
        weight = weight_of(retrofitted(write(SIGN), output, weights={WEIGHT: "deep/mask one.png"}))
        image = weight.getConnectedNode()
        assert (image.getCategory(), image.getType()) == ("image", "float")
        assert image.getInput("file").getValueString() == name
        assert image.getInput("file").getColorSpace() == "none"


def test_the_weight_is_a_set_of_tiles(folder: Path) -> None:
    (folder / "mask.png").rename(folder / "mask.1001.png")
    weight = weight_of(retrofitted(write(SIGN), weights={WEIGHT: "mask.<UDIM>.png"}))
    assert weight.getConnectedNode().getInput("file").getValueString() == "mask.<UDIM>.png"


def test_an_image_takes_no_prefix_of_the_document(folder: Path) -> None:
    weight = weight_of(retrofitted(write(SIGN, fileprefix="tex/"), weights={WEIGHT: "mask.png"}))
    assert weight.getConnectedNode().getInput("file").getResolvedValueString() == "mask.png"


def test_several_surfaces_share_one_image_and_each_graph_has_its_own(folder: Path) -> None:
    inner = '<open_pbr_surface name="inner" type="surfaceshader" />'
    graph = (
        f'<nodegraph name="NG">{inner}<output name="out" type="surfaceshader" nodename="inner" /></nodegraph>'
    )
    other = '<standard_surface name="post" type="surfaceshader" />' + material("post", "material2")
    document = retrofitted(write(SIGN + graph + other), weights={WEIGHT: "mask.png"})
    assert len(document.getNodes("image")) == len(document.getNodeGraph("NG").getNodes("image")) == 1
    assert weight_of(document, "NG/inner").getConnectedNode().getCategory() == "image"


def test_a_surface_in_a_graph_gets_a_node_from_outside(folder: Path) -> None:
    graph = '<nodegraph name="NG"><gltf_pbr name="inner" type="surfaceshader" />'
    graph += '<output name="out" type="surfaceshader" nodename="inner" /></nodegraph>'
    top = material("", more='nodegraph="NG" output="out"').replace('nodename="" ', "")
    document = retrofitted(write(HALF + graph + top), weights={"retroreflection": "half"})
    weight = weight_of(document, "NG/inner", "retroreflection")
    assert weight.getInterfaceName() == "retroreflection"
    assert weight.getInterfaceInput().getConnectedNode().getName() == "half"


def test_an_input_of_the_graph_can_be_the_weight(folder: Path) -> None:
    graph = '<nodegraph name="NG"><input name="amount" type="float" value="0.3" />'
    graph += '<gltf_pbr name="inner" type="surfaceshader" />'
    graph += '<output name="out" type="surfaceshader" nodename="inner" /></nodegraph>'
    top = material("", more='nodegraph="NG" output="out"').replace('nodename="" ', "")
    document = retrofitted(write(graph + top), weights={"retroreflection": "amount"})
    assert weight_of(document, "NG/inner", "retroreflection").getInterfaceName() == "amount"


def test_a_name_that_is_both_is_the_node_and_that_is_said(folder: Path) -> None:
    (folder / "mask.png").rename(folder / "half")
    path = write(HALF + SIGN)
    with pytest.warns(
        MrmWarning, match=r"is a node and a file; the node is taken: write \./half for the file"
    ):
        assert weight_of(retrofitted(path, weights={WEIGHT: "half"})).getNodeName() == "half"
    image = weight_of(retrofitted(path, weights={WEIGHT: "./half"})).getConnectedNode()
    assert image.getInput("file").getValueString() == "half"


WRONG = {
    "colour": ("red", "red is a color3; a weight is a float"),
    "output": ("bands/shar", "bands has no output shar; did you mean share?"),
    "outputs": ("bands", "bands has several outputs: write bands/share or bands/tint"),
    "neither": ("haff", "there is no such file, and no such node beside sign; did you mean half?"),
    "surface itself": ("sign", "sign is a surfaceshader; a weight is a float"),
    "no image": ("in.mtlx", "in.mtlx"),
    "folder": ("./", "there is no such file"),
    "decimal comma": ("0,5", "there is no such file, and no such node"),
}


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG)
def test_what_is_no_weight_is_refused_in_one_line(folder: Path, text: str, message: str) -> None:
    write(HALF + RED + BANDS + SIGN)
    outcome = CliRunner().invoke(cli, ["retrofit", "in.mtlx", "-o", "out.mtlx", "--set", f"{WEIGHT}={text}"])
    assert isinstance(outcome.exception, MrmError)
    assert str(outcome.exception).startswith(f"--set {WEIGHT}={text}: ")
    assert message in str(outcome.exception)
    assert not (folder / "out.mtlx").exists()


def test_a_graph_that_implements_a_definition_sees_only_its_own_nodes(folder: Path) -> None:
    nodes = '<nodedef name="ND_a" node="a"><output name="out" type="surfaceshader" /></nodedef>'
    nodes += '<nodegraph name="NG_a" nodedef="ND_a"><gltf_pbr name="inner" type="surfaceshader" />'
    nodes += '<output name="out" type="surfaceshader" nodename="inner" /></nodegraph>'
    nodes += '<a name="shader1" type="surfaceshader" />' + material("shader1")
    with pytest.raises(MrmError, match="NG_a/inner is in a graph that implements a definition"):
        convert(write(HALF + nodes), "out.mtlx", {"retroreflection": "half"})
    document = retrofitted(write(nodes), weights={"retroreflection": 0.5})
    assert weight_of(document, "NG_a/inner", "retroreflection").getValue() == 0.5


def test_the_command_hints_at_a_weight_where_none_was_set(folder: Path) -> None:
    write(SIGN)
    arguments = ["retrofit", "in.mtlx", "-o", "out.mtlx"]
    hint = f"hint: every weight is 0, which changes nothing yet: --set {WEIGHT}=0.8\n"
    assert CliRunner().invoke(cli, arguments).stderr == hint
    assert CliRunner().invoke(cli, [*arguments, "--set", f"{WEIGHT}=0.5"]).stderr == ""
    assert CliRunner().invoke(cli, [*arguments, "--set", f"{WEIGHT}=mask.png"]).stderr == ""


# ---- files outside


def test_images_outside_are_read_only_where_that_is_allowed(folder: Path) -> None:
    (folder / "deep").mkdir()
    image = '<image name="picture" type="color3"><input name="file" type="filename" value="../mask.png" /></image>'
    path = write(image + SIGN, "deep/in.mtlx")
    arguments = ["retrofit", str(path), "-o", "deep/out.mtlx"]
    outcome = CliRunner().invoke(cli, arguments)
    assert "--allow-external lets a material read it" in str(outcome.exception)
    assert not (folder / "deep" / "out.mtlx").exists()
    assert CliRunner().invoke(cli, [*arguments, "--allow-external"]).exit_code == 0


def test_a_weight_outside_of_the_outputs_folder_is_refused_too(folder: Path) -> None:
    (folder / "deep").mkdir()
    path = write(SIGN, "deep/in.mtlx")
    with pytest.raises(MrmError, match=r"\.\./mask.png is .* outside of .*--allow-external"):
        convert(path, "deep/out.mtlx", {WEIGHT: "mask.png"})
    document = retrofitted(path, "deep/out.mtlx", weights={WEIGHT: "mask.png"}, allow_external=True)
    assert weight_of(document).getConnectedNode().getInput("file").getValueString() == "../mask.png"


# ---- names


def test_names_that_begin_with_a_digit_become_names_that_compile(folder: Path) -> None:
    nodes = '<nodegraph name="9NG"><input name="1in" type="float" value="0.25" />'
    nodes += '<absval name="2a" type="float"><input name="in" type="float" interfacename="1in" /></absval>'
    nodes += '<output name="3out" type="float" nodename="2a" /></nodegraph>'
    nodes += '<standard_surface name="01_shader" type="surfaceshader">'
    nodes += '<input name="base" type="float" nodegraph="9NG" output="3out" /></standard_surface>'
    nodes += '<constant name="n01_shader" type="float" /><constant name="4" type="float" />'
    path = write(nodes + material("01_shader", "01_Default") + '<look name="L"><materialassign name="m" '
                 'material="01_Default" geom="/" /></look>')  # fmt: skip
    with pytest.warns(MrmWarning, match="01_shader is named n01_shader2 now"):
        document = retrofitted(path, weights={WEIGHT: "4"})
    shader = document.getNode("n01_shader2")
    assert shader.getInput("base").getConnectedNode().getNamePath() == "n9NG/n2a"
    assert document.getDescendant("n9NG/n2a").getInput("in").getInterfaceInput().getValue() == 0.25
    assert shader.getInput(WEIGHT).getNodeName() == "n4"
    assert document.getNode("n01_Default").getConnectedNode("surfaceshader") == shader
    assert document.getLook("L").getMaterialAssigns()[0].getMaterial() == "n01_Default"


@pytest.mark.parametrize("name", ["float", "material"])
def test_a_node_named_like_an_element_of_the_library_is_found(folder: Path, name: str) -> None:
    path = write(HALF.replace("half", name) + SIGN)
    with pytest.warns(MrmWarning, match=f"{name} is named {name}2 now"):
        document = retrofitted(path, weights={WEIGHT: name})
    assert weight_of(document).getConnectedNode().getName() == f"{name}2"


# ---- documents


def test_a_document_of_shader_references_is_retrofitted(folder: Path) -> None:
    nodes = """<material name="M"><shaderref name="sr" node="standard_surface">
      <bindinput name="base" type="float" value="0.5" /></shaderref></material>"""
    document = retrofitted(write(nodes, version="1.36"), weights={WEIGHT: 0.8})
    (shader,) = document.getNodes("mrm_standard_surface")
    assert shader.getInput(WEIGHT).getValue() == pytest.approx(0.8)
    assert shader.getInput("base").getValue() == 0.5
    with pytest.raises(MrmError, match="a <shaderref> takes a number or an output of a graph"):
        convert(write(nodes + HALF, version="1.36"), "out.mtlx", {WEIGHT: "half"})


def test_materials_that_share_a_surface_go_on_sharing_it(folder: Path) -> None:
    document = retrofitted(write(SIGN + material("sign", "material2")), weights={WEIGHT: 0.5})
    assert [node.getConnectedNode("surfaceshader").getName() for node in document.getMaterialNodes()] == [
        "sign"
    ] * 2


def test_definitions_and_versions_that_are_named_follow(folder: Path) -> None:
    nodes = '<standard_surface name="sign" type="surfaceshader" nodedef="ND_standard_surface_surfaceshader_100" />'
    nodes += '<standard_surface name="post" type="surfaceshader" version="1.0.1" />'
    document = retrofitted(write(nodes + material("sign") + material("post", "m2")), weights={WEIGHT: 0.5})
    assert document.getNode("sign").getNodeDef().getName() == "ND_mrm_standard_surface_surfaceshader_100"
    assert document.getNode("post").getNodeDef().getVersionString() == "1.0.1"


def test_a_namespace_stays(folder: Path) -> None:
    document = retrofitted(write(SIGN, namespace="studio"), weights={WEIGHT: 0.5})
    assert weight_of(document).getValue() == 0.5
    assert document.getNamespace() == "studio"


def test_a_document_that_defines_the_surface_itself_is_refused(folder: Path) -> None:
    own = (
        '<nodedef name="ND_own" node="standard_surface"><output name="out" type="surfaceshader" /></nodedef>'
    )
    with pytest.raises(MrmError, match="defines a node standard_surface itself; rename it first"):
        convert(write(own + SIGN), "out.mtlx")


@pytest.mark.parametrize("encoding", ["iso-8859-1", "windows-1252", "utf-16"])
def test_the_encoding_of_a_document_stays(folder: Path, encoding: str) -> None:
    text = f'<?xml version="1.0" encoding="{encoding}"?>\n<materialx version="1.39" doc="Größe">{SIGN}</materialx>'
    (folder / "in.mtlx").write_bytes(text.encode(encoding))
    convert("in.mtlx", "out.mtlx")
    assert (folder / "out.mtlx").read_bytes().decode(encoding) == text.replace("<standard_", "<mrm_standard_")


def test_surfaces_in_a_document_that_is_included_are_named(folder: Path) -> None:
    write(SIGN, "signs.mtlx")
    (folder / "all.mtlx").write_text(
        f'{HEAD}<materialx version="1.39" xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="signs.mtlx" />'
        '<look name="L"><materialassign name="m" material="material1" geom="/" /></look></materialx>'
    )
    with pytest.raises(
        MrmError, match=r"retrofit signs\.mtlx, which it includes, and include what comes out"
    ):
        convert("all.mtlx", "out.mtlx")
    text = (
        Path("all.mtlx").read_text().replace("<look ", '<gltf_pbr name="post" type="surfaceshader" /><look ')
    )
    Path("both.mtlx").write_text(text)
    with pytest.warns(
        MrmWarning, match="the surfaces in signs.mtlx, which it includes, stay as they are; retrofit it"
    ):
        assert convert("both.mtlx", "out.mtlx") == ["post"]
    convert("signs.mtlx", "retro.mtlx", {WEIGHT: 0.5})
    Path("all.mtlx").write_text(Path("all.mtlx").read_text().replace("signs.mtlx", "retro.mtlx"))
    assert read_document("all.mtlx").getNode("sign").getCategory() == "mrm_standard_surface"


# ---- our inputs on MaterialX's own nodes


OWN = {
    "open_pbr_surface": ("surfaceshader", WEIGHT),
    "standard_surface": ("surfaceshader", WEIGHT),
    "gltf_pbr": ("surfaceshader", "retroreflection"),
}


@pytest.mark.parametrize("command", ["render", "generate", "regress"])
@pytest.mark.parametrize("category", OWN)
@pytest.mark.parametrize("names_definition", [False, True])
def test_our_input_on_materialx_own_surface_names_our_node(
    folder: Path, category: str, command: str, names_definition: bool
) -> None:
    kind, name = OWN[category]
    definition = {
        "open_pbr_surface": "ND_open_pbr_surface_surfaceshader",
        "gltf_pbr": "ND_gltf_pbr_surfaceshader",
    }
    definition["standard_surface"] = "ND_standard_surface_surfaceshader"
    more = f'nodedef="{definition[category]}"' if names_definition else ""
    socket = f'<input name="{name}" type="float" value="0.5" />'
    shader = f'<{category} name="sign" type="{kind}" {more}>{socket}</{category}>'
    write(shader + material("sign"))
    arguments = {
        "render": ["render", "in.mtlx", "-o", "out.png"],
        "generate": ["generate", "in.mtlx", "--target", "glsl", "-o", "out"],
        "regress": ["regress", "--suite", ".", "-o", "report", "--no-cache"],
    }
    outcome = CliRunner().invoke(cli, arguments[command])
    said = f"{outcome.output} {outcome.exception}"
    assert f"{category} has no input {name}: use mrm_{category}, or mrm-nodes retrofit" in " ".join(
        said.split()
    )
    document = retrofitted(Path("in.mtlx"))
    assert weight_of(document, "sign", name).getValue() == 0.5


def test_our_input_on_materialx_own_bsdf_names_our_node_and_retrofit_makes_it_so(folder: Path) -> None:
    bsdf = (
        '<conductor_bsdf name="foil" type="BSDF"><input name="retroreflectivity" type="float" value="0.5" />'
    )
    nodes = (
        f'{bsdf}</conductor_bsdf><surface name="sign" type="surfaceshader"><input name="bsdf" type="BSDF" '
    )
    path = write(nodes + 'nodename="foil" /></surface>' + material("sign"))
    with pytest.raises(
        MrmError, match="conductor_bsdf has no input retroreflectivity: use mrm_conductor_bsdf"
    ):
        shadergen.generate_shader(path, "glsl")
    assert retrofitted(path).getNode("foil").getCategory() == "mrm_conductor_bsdf"


# ---- glTF


def gltf(folder: Path, *materials: dict[str, Any], **content: Any) -> Path:
    path = folder / "in.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "materials": materials, **content}))
    return path


UNLIT = {"name": "sky", "extensions": {"KHR_materials_unlit": {}}}


def test_one_unlit_material_does_not_stop_the_others(folder: Path) -> None:
    path = gltf(folder, {"name": "cone"}, UNLIT, {"name": "post"}, extensionsRequired=["KHR_materials_unlit"])
    with pytest.warns(MrmWarning, match="material 1: KHR_materials_unlit .*; the material is left out"):
        assert convert(path, "out.mtlx") == ["cone", "post"]
    document = read_document("out.mtlx")
    assert [node.getAttribute("gltf_material") for node in document.getMaterialNodes()] == ["0", "2"]
    shader = document.getNode("cone_shader")
    shader.addInput("retroreflection", "float").setValue(0.5)
    document.setDataLibrary(None)
    mx.writeToXmlFile(document, "changed.mtlx")
    with pytest.warns(MrmWarning, match="left out"):
        assert convert("changed.mtlx", "back.gltf") == ["cone"]
    assert json.loads(Path("back.gltf").read_text())["materials"][1] == UNLIT


def textured(texture: dict[str, Any], image: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    look = {"name": "cone", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    return look, {"textures": [texture], "images": [image, {"uri": "mask.png"}]}


WEBP = "data:application/octet-stream;base64," + base64.b64encode(b"RIFF\x10\0\0\0WEBPVP8 ").decode()
KTX2 = "data:application/octet-stream;base64," + base64.b64encode(b"\xabKTX 20\xbb\r\n\x1a\n").decode()
FORMATS = {
    "webp": ({"extensions": {"EXT_texture_webp": {"source": 0}}}, {"uri": "a.webp"}, "EXT_texture_webp"),
    "basisu": (
        {"extensions": {"KHR_texture_basisu": {"source": 0}}},
        {"uri": "a.ktx2"},
        "KHR_texture_basisu",
    ),
    "avif": ({"extensions": {"EXT_texture_avif": {"source": 0}}}, {"uri": "a.avif"}, "EXT_texture_avif"),
    "dds": ({"extensions": {"MSFT_texture_dds": {"source": 0}}}, {"uri": "a.dds"}, "MSFT_texture_dds"),
    "webp without its extension": ({"source": 0}, {"uri": WEBP}, "EXT_texture_webp"),
    "ktx2 without its extension": ({"source": 0}, {"uri": KTX2}, "KHR_texture_basisu"),
    "declared": ({"source": 0}, {"uri": "mask.png", "mimeType": "image/webp"}, "EXT_texture_webp"),
}


@pytest.mark.parametrize(("texture", "image", "extension"), FORMATS.values(), ids=FORMATS)
def test_an_image_that_materialx_cannot_read_is_named_by_its_extension(
    folder: Path, texture: dict[str, Any], image: dict[str, Any], extension: str
) -> None:
    look, rest = textured(texture, image)
    with pytest.raises(MrmError, match=rf"in\.gltf: material 0: .*{extension}.* convert"):
        convert(gltf(folder, look, **rest), "out.mtlx")
    assert not Path("out.mtlx").exists()
    with pytest.warns(MrmWarning, match=f"material 0: .*{extension}"):
        assert convert(gltf(folder, look, {"name": "post"}, **rest), "out.mtlx") == ["post"]


def test_where_a_texture_has_an_image_of_gltf_too_that_is_taken(folder: Path) -> None:
    look, rest = textured({"source": 1, "extensions": {"EXT_texture_webp": {"source": 0}}}, {"uri": "a.webp"})
    document = retrofitted(gltf(folder, look, **rest))
    assert document.getNode("base_color_image").getInput("file").getValueString() == "mask.png"


def test_names_of_materials_become_names_that_compile(folder: Path) -> None:
    document = retrofitted(gltf(folder, {"name": "01 Default"}, {"name": "01 Default"}, {"name": "float"}))
    assert [node.getName() for node in document.getMaterialNodes()] == [
        "n01_Default",
        "n01_Default2",
        "float2",
    ]


def test_the_weight_of_gltf_is_an_image(folder: Path) -> None:
    document = retrofitted(gltf(folder, {"name": "cone"}), weights={"retroreflection": "mask.png"})
    image = weight_of(document, "cone_shader", "retroreflection").getConnectedNode().getConnectedNode("in")
    assert image.getInput("file").getValueString() == "mask.png"
    assert not image.getInput("file").getColorSpace()
    with pytest.raises(MrmError, match="there is no such file, and glTF has no nodes"):
        convert("in.gltf", "out.mtlx", {"retroreflection": "half"})


def test_a_gltf_reads_files_outside_only_where_that_is_allowed(folder: Path) -> None:
    (folder / "deep").mkdir()
    look, rest = textured({"source": 0}, {"uri": "../mask.png"})
    path = gltf(folder, look, **rest).rename(folder / "deep" / "in.gltf")
    with pytest.raises(MrmError, match="--allow-external lets a material read it"):
        convert(path, "out.mtlx")
    assert convert(path, "out.mtlx", allow_external=True) == ["cone"]
