"""Every node in every target, through the target's real compiler; and that each compiler can say no."""

from __future__ import annotations

import itertools
import os
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import MaterialX as mx
import pytest

from mrm_nodes import cli, compilers, doctor, library, limits, shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression import targets
from mrm_nodes.regression.truth.material import NODES, document, inputs_of

TARGETS = shadergen.supported_targets()
#: A node without the choice reflects.
MODES = [
    (node, mode)
    for node in NODES
    for mode in (inputs_of(node)["scatter_mode"].choices if "scatter_mode" in inputs_of(node) else ("R",))
]
GLSL_FAMILY = [target for target in TARGETS if target not in ("osl", "mdl")]

#: Targets whose compilers must be here, as in continuous integration.
REQUIRED = [target for target in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(",") if target]


def compiles(doc: mx.Document, target: str, *, is_large: bool = False, **options: Any) -> None:
    """Fail where a material does not compile but does with MaterialX's own nodes in place of ours.

    Where it does not with those either the test is an expected failure; where there is no compiler it is skipped
    once the shader is generated, unless that compiler is required. A driver inlines every lobe of a large shader,
    for minutes: glslang takes its place.
    """
    shader = shadergen.generate_shader(doc, target, **options)
    check = compilers.check_shader(
        replace(shader, target="essl") if is_large and target == "glsl" else shader
    )
    if check.status == "failed" and (theirs := compilers.upstream_complaints(doc, target, **options)):
        pytest.xfail(f"upstream: {theirs[0]}")
    if check.status == "unchecked":
        assert target not in REQUIRED, check
        pytest.skip(f"generated; {check.compiler} {check.complaints[0]}")
    if check.status == "generated":
        pytest.skip(f"generated; no compiler of {target} is known here")
    assert check.status == "compiled", check


def every_configuration(node: str, mode: str) -> mx.Document:
    """One surface that adds up every distribution, masking, film and kind of transmission of a node."""
    doc = mx.createDocument()
    doc.setDataLibrary(library.shared_library())
    choices: dict[str, tuple[Any, ...]] = {
        name: each.choices
        for name, each in inputs_of(node).items()
        if each.choices and name != "scatter_mode"
    }
    choices["thinfilm_thickness"] = (0.0, 400.0)
    if "retro_transmission" in inputs_of(node) and "T" in mode:
        choices["retro_transmission"] = (False, True)
    lobes = []
    for values in itertools.product(*choices.values()):
        lobe = doc.addNode(node, f"lobe{len(lobes)}", "BSDF")
        lobe.setInputValue("retroreflectivity", 0.5)
        if "scatter_mode" in inputs_of(node):
            lobe.setInputValue("scatter_mode", mode, "string")
        for name, value in zip(choices, values, strict=True):
            lobe.setInputValue(name, value, inputs_of(node)[name].type)
        lobes.append(lobe)
    compilers.add_up(doc, lobes, "material")
    return doc


def test_the_product_is_complete() -> None:
    """Every choice that a node's definition offers, with a film and without."""
    built = set()
    for node, mode in MODES:
        doc = every_configuration(node, mode)
        for lobe in doc.getNodes(node):
            distribution, masking, film = (
                lobe.getInputValue(name) for name in ("distribution", "masking", "thinfilm_thickness")
            )
            built.add((node, mode, distribution, masking, film > 0))
    lobes = {("ggx", "smith"), ("ggx", "vcavity"), ("beckmann", "smith"), ("beckmann", "vcavity")}
    lobes |= {("phong", "smith"), ("phong", "vcavity")}
    modes = [("mrm_conductor_bsdf", "R")]
    modes += itertools.product(("mrm_dielectric_bsdf", "mrm_generalized_schlick_bsdf"), ("R", "T", "RT"))
    assert built == {(*mode, *lobe, film) for mode in modes for lobe in lobes for film in (False, True)}


def test_the_targets_are_those_of_this_materialx() -> None:
    assert {"glsl", "essl", "vulkan", "msl", "osl", "mdl"} <= set(TARGETS)


def test_a_target_that_a_newer_materialx_adds_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "PyMaterialXGenNew.py").write_text(
        "from MaterialX.PyMaterialXGenGlsl import GlslShaderGenerator as NewShaderGenerator\n"
    )
    monkeypatch.setattr(mx, "__path__", [*mx.__path__, str(tmp_path)])
    shadergen._generators.cache_clear()
    try:
        assert "new" in shadergen.supported_targets()
        assert compilers.check_material(document(NODES[0]), "new").status == "generated"
    finally:
        shadergen._generators.cache_clear()


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("node", "mode"), MODES)
def test_every_configuration_compiles_with_its_values_folded(node: str, mode: str, target: str) -> None:
    compiles(every_configuration(node, mode), target, is_large=True, interface="reduced")


@pytest.mark.client("generates and compiles: {target}")
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("node", NODES)
def test_a_node_compiles_with_every_input_a_uniform(node: str, target: str) -> None:
    compiles(document(node), target, interface="complete")


@pytest.mark.parametrize("target", TARGETS)
def test_a_graph_with_several_of_our_nodes_and_materialx_own_compiles(target: str) -> None:
    compiles(mixed_graph(), target, is_large=True)


@pytest.mark.parametrize("target", GLSL_FAMILY)
def test_prefiltered_environment_light_compiles(target: str) -> None:
    compiles(mixed_graph(), target, is_large=True, environment="prefilter")


def mixed_graph() -> mx.Document:
    """Ours mixed with, layered over, added to and multiplied beside MaterialX's own; normal map, turned tangent."""
    doc = mx.createDocument()
    mx.readFromXmlString(
        doc,
        """<?xml version="1.0"?>
        <materialx version="1.39">
          <texcoord name="uv" type="vector2" />
          <dotproduct name="share" type="float">
            <input name="in1" type="vector2" nodename="uv" /><input name="in2" type="vector2" nodename="uv" />
          </dotproduct>
          <convert name="colour" type="vector3"><input name="in" type="vector2" nodename="uv" /></convert>
          <normalmap name="bumps" type="vector3"><input name="in" type="vector3" nodename="colour" /></normalmap>
          <tangent name="along" type="vector3"><input name="space" type="string" value="world" /></tangent>
          <rotate3d name="turned" type="vector3">
            <input name="in" type="vector3" nodename="along" />
            <input name="amount" type="float" value="30" />
            <input name="axis" type="vector3" nodename="bumps" />
          </rotate3d>
          <mrm_conductor_bsdf name="ours" type="BSDF">
            <input name="retroreflectivity" type="float" nodename="share" />
            <input name="normal" type="vector3" nodename="bumps" />
            <input name="tangent" type="vector3" nodename="turned" />
          </mrm_conductor_bsdf>
          <mrm_dielectric_bsdf name="coat" type="BSDF">
            <input name="retroreflectivity" type="float" nodename="share" />
            <input name="distribution" type="string" value="beckmann" />
          </mrm_dielectric_bsdf>
          <mrm_generalized_schlick_bsdf name="tint" type="BSDF">
            <input name="retroreflectivity" type="float" value="1" />
          </mrm_generalized_schlick_bsdf>
          <conductor_bsdf name="theirs" type="BSDF" />
          <oren_nayar_diffuse_bsdf name="cloth" type="BSDF" />
          <sheen_bsdf name="fuzz" type="BSDF" />
          <mix name="mixed" type="BSDF">
            <input name="fg" type="BSDF" nodename="ours" /><input name="bg" type="BSDF" nodename="theirs" />
            <input name="mix" type="float" value="0.5" />
          </mix>
          <layer name="coated" type="BSDF">
            <input name="top" type="BSDF" nodename="coat" /><input name="base" type="BSDF" nodename="cloth" />
          </layer>
          <multiply name="dimmed" type="BSDF">
            <input name="in1" type="BSDF" nodename="tint" /><input name="in2" type="float" value="0.25" />
          </multiply>
          <layer name="fuzzy" type="BSDF">
            <input name="top" type="BSDF" nodename="fuzz" /><input name="base" type="BSDF" nodename="coated" />
          </layer>
          <add name="both" type="BSDF">
            <input name="in1" type="BSDF" nodename="mixed" /><input name="in2" type="BSDF" nodename="fuzzy" />
          </add>
          <add name="all" type="BSDF">
            <input name="in1" type="BSDF" nodename="both" /><input name="in2" type="BSDF" nodename="dimmed" />
          </add>
          <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="all" /></surface>
          <surfacematerial name="material" type="material">
            <input name="surfaceshader" type="surfaceshader" nodename="surface" />
          </surfacematerial>
        </materialx>""",
    )
    doc.setDataLibrary(library.shared_library())
    return doc


# ---- faults of MaterialX's own


UPSTREAM_FAULTS = {
    "SPECULAR_ENVIRONMENT_NONE": (document(NODES[0]), "u_refractionTwoSided", {"environment": "none"}),
    "geompropvalue in ESSL": (document(NODES[0], attributes=["weight"]), "redefinition", {}),
}


@pytest.mark.parametrize("fault", UPSTREAM_FAULTS)
def test_a_fault_that_materialx_own_nodes_have_too_is_called_upstream(fault: str) -> None:
    doc, complaint, options = UPSTREAM_FAULTS[fault]
    check = compilers.check_material(doc, "essl", **options)
    if check.status == "unchecked":
        pytest.skip(check.complaints[0])
    upstream = compilers.upstream_complaints(doc, "essl", **options)
    if not upstream:
        assert check.status == "compiled", "MaterialX has mended this, we have not"
        return
    assert check.status == "upstream"
    assert complaint in check.complaints[0]
    assert complaint in upstream[0]


def test_the_table_of_targets_says_upstream_where_materialx_own_node_fails_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuses(what: str) -> compilers.Compiler:
        return compilers.Compiler(
            "any", "", lambda: True, lambda shader: ["no"] if what in shader.pixel else []
        )

    monkeypatch.setitem(compilers.COMPILERS, "essl", refuses("void main"))
    monkeypatch.setitem(compilers.COMPILERS, "msl", refuses("mrm_microfacet("))
    monkeypatch.setattr(targets, "_RUNNERS", {})
    compiled_by = {row.target: row.compiled_by for row in targets.table(configurations=1)}
    assert compiled_by["essl"] == "upstream"
    assert compiled_by["msl"] == "failed"


# ---- the compilers can say no


@pytest.mark.parametrize("target", [target for target in compilers.COMPILERS if target in TARGETS])
def test_a_compiler_rejects_a_name_that_does_not_exist(target: str) -> None:
    compiles(document(NODES[0]), target)
    shader = shadergen.generate_shader(document(NODES[0]), target)
    spoilt = re.sub(r"\bfloat weight\b", "float wieght", shader.pixel)
    check = compilers.check_shader(replace(shader, pixel=spoilt))
    assert check.status == "failed"
    assert "weight" in " ".join(check.complaints)


@pytest.fixture
def plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Plant a function body in a copy of our GLSL, and return a document that is generated from there."""
    for part in ("mtlx", "glsl"):
        shutil.copytree(library.root_path() / part, tmp_path / part)

    def planted(body: str) -> mx.Document:
        source = tmp_path / "glsl" / "lib" / "mrm_microfacet.glsl"
        source.write_text(f"{source.read_text()}\nvoid mrm_planted(float x)\n{{\n    {body}\n}}\n")
        # A host with other rules has a copy of what was there before.
        _forget_libraries()
        return document(NODES[0])

    monkeypatch.setattr(library, "root_path", lambda: tmp_path)
    yield planted
    monkeypatch.undo()
    _forget_libraries()


def _forget_libraries() -> None:
    library._library.cache_clear()
    library._root_for.cache_clear()


@pytest.mark.parametrize(
    ("target", "body"),
    [
        ("msl", "float y = inversesqrt(x);"),
        ("msl", "float y = mod(x, 2.0);"),
        ("msl", "vec3 y =vec3(x);"),
        ("msl", "MrmLobe lobe = MrmLobe(vec2(x), 0, 0);"),
        ("msl", "float y[2] = float[2](x, x);"),
        ("msl", "float half = x;"),
        ("msl", "float kernel = x;"),
        ("msl", "bvec3 y = lessThan(vec3(x), vec3(1.0));"),
        ("msl", "mat3 m = mat3(x); m = inverse(m);"),
        ("slang", "float y[2] = float[2](x, x);"),
        ("essl", "float y = 1;"),
        ("vulkan", "float y = x % 2.0;"),
        ("wgsl", "float y = mod(x);"),
    ],
)
def test_glsl_that_a_target_does_not_know_fails_there(target: str, body: str, plant: Any) -> None:
    if target not in TARGETS:
        pytest.skip(f"this MaterialX has no {target}")
    compiles(plant("float harmless = x;"), target)
    assert compilers.check_material(plant(body), target).status in ("failed", "not generated")


def test_a_missing_compiler_is_named_with_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    check = compilers.check_material(document(NODES[0]), "essl")
    assert check.status == "unchecked"
    assert not check.is_fault
    assert "apt-get install glslang-tools" in check.complaints[0]


def test_instructions_are_counted_after_optimisation() -> None:
    if not compilers.COMPILERS["vulkan"].is_installed():
        pytest.skip(compilers.COMPILERS["vulkan"].install)
    compiles(document(NODES[0]), "vulkan")
    counts = {
        node: compilers.spirv_instructions(shadergen.generate_shader(document(node), "vulkan"))["pixel"]
        for node in ("mrm_conductor_bsdf", "conductor_bsdf")
    }
    assert 500 < counts["conductor_bsdf"] < counts["mrm_conductor_bsdf"] < 20_000


# ---- targets without fused code


def test_osl_gets_the_forward_lobe_once() -> None:
    source = shadergen.generate_shader(document("mrm_conductor_bsdf"), "osl").pixel
    assert len(re.findall(r"(?<!mrm_)\bconductor_bsdf\(", source)) == 1


def test_mdl_gets_both_lobes_where_materialx_passes_the_switch_on() -> None:
    source = shadergen.generate_shader(document("mrm_conductor_bsdf"), "mdl").pixel
    if "genmdl" in library.host().forward_targets:
        assert source.count("::mx_conductor_bsdf(") == 1
    else:
        assert source.count("mxp_retroreflective:true") == 1
        assert source.count("mxp_retroreflective:false") == 1


@pytest.mark.parametrize("interface", ["complete", "reduced"])
def test_mdl_never_names_a_distribution_that_its_type_does_not_have(interface: str) -> None:
    source = shadergen.generate_shader(
        every_configuration("mrm_conductor_bsdf", "R"), "mdl", interface=interface
    ).pixel
    assert set(re.findall(r"mx_distribution_type_(\w+)", source)) == {"ggx"}


# ---- what a target leaves out


def ignored(target: str, environment: str = "fis", **values: tuple[Any, str]) -> list[str]:
    doc = document("mrm_dielectric_bsdf")
    for name, (value, kind) in values.items():
        doc.getNode("bsdf").setInputValue(name, value, kind)
    return limits.ignored_inputs(doc, shadergen.generator_target(target), environment)


BECKMANN = {"distribution": ("beckmann", "string")}


def test_osl_ignores_retroreflectivity() -> None:
    assert ignored("osl", retroreflectivity=(0.5, "float")) == [
        "bsdf/retroreflectivity is ignored by genosl: it renders the forward lobe only"
    ]


def test_a_weight_of_zero_is_not_ignored() -> None:
    assert ignored("osl", retroreflectivity=(0.0, "float")) == []


def test_osl_ignores_distribution_masking_and_retro_transmission() -> None:
    values = {"masking": ("vcavity", "string"), "retro_transmission": (True, "boolean"), **BECKMANN}
    assert [message.split()[0] for message in ignored("osl", **values)] == [
        "bsdf/distribution",
        "bsdf/masking",
        "bsdf/retro_transmission",
    ]


def test_prefiltered_environment_light_ignores_the_distribution() -> None:
    (message,) = ignored("glsl", "prefilter", **BECKMANN)
    assert message.startswith("bsdf/distribution is ignored in environment light (prefilter)")


def test_sampled_environment_light_ignores_nothing() -> None:
    assert ignored("glsl", "fis", **BECKMANN) == []


def test_without_environment_light_nothing_is_ignored() -> None:
    assert ignored("glsl", "none", retroreflectivity=(0.5, "float"), **BECKMANN) == []


def test_an_input_that_a_graph_drives_is_named_too() -> None:
    doc = document("mrm_conductor_bsdf", attributes=["retroreflectivity"])
    assert limits.ignored_inputs(doc, "genosl")[0].startswith("bsdf/retroreflectivity is ignored")


def test_inside_a_surface_the_input_of_the_surface_is_named() -> None:
    doc = mx.createDocument()
    doc.setDataLibrary(library.shared_library())
    surface = doc.addNode("mrm_open_pbr_surface", "vest", "surfaceshader")
    weight = next(i for i in surface.getNodeDef().getActiveInputs() if "retroreflectivity" in i.getName())
    surface.setInputValue(weight.getName(), 0.7)
    assert limits.ignored_inputs(doc, "genosl") == [
        f"vest/{weight.getName()} is ignored by genosl: it renders the forward lobe only"
    ]
    assert limits.ignored_inputs(doc, "genglsl") == []


def test_doctor_says_what_compiles_each_target_and_what_the_target_ignores(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(
        compilers.COMPILERS, "essl", replace(compilers.COMPILERS["essl"], is_installed=lambda: False)
    )
    doctor.examine()
    lines = capsys.readouterr().out.splitlines()
    of = {line.split()[0]: (line, after.strip()) for line, after in itertools.pairwise(lines)}
    assert of["glsl"][0] == "glsl      compiled by OpenGL driver"
    assert of["essl"][0] == "essl      unchecked: no glslang; Debian, Ubuntu: apt-get install glslang-tools"
    assert of["osl"][1] == "ignores retroreflectivity, distribution, masking, retro_transmission"
    assert of["prefilter"][0].endswith("ignores distribution, masking")


# ---- bad input


def test_a_node_without_an_implementation_for_the_target_is_named() -> None:
    doc = document(NODES[0])
    definition = doc.addNodeDef("ND_lonely", "float", "lonely")
    lonely = doc.addNodeInstance(definition, "lonely1")
    doc.getNode("bsdf").addInput("weight", "float").setConnectedNode(lonely)
    with pytest.raises(MrmError, match=r"node lonely1: lonely has no implementation for this target"):
        shadergen.generate_shader(doc, "osl")


def test_a_target_that_does_not_exist_is_answered_with_those_that_do() -> None:
    with pytest.raises(MrmError, match=r"unknown target vulkn; did you mean vulkan\?"):
        shadergen.generator_target("vulkn")


# ---- the command line


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Any:
    """Run `mrm-nodes generate` on a retroreflective material: exit status, stdout, stderr."""
    material = tmp_path / "material.mtlx"
    doc = document(NODES[0])
    doc.getNode("bsdf").setInputValue("retroreflectivity", 0.5)
    mx.writeToXmlFile(doc, str(material))

    def run(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main(["generate", str(material), *arguments])
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return run


def test_strict_stops_at_what_the_target_ignores_and_writes_nothing(command: Any, tmp_path: Path) -> None:
    status, out, err = command("--target", "osl", "-o", str(tmp_path / "out"), "--strict")
    assert status == 2
    assert "bsdf/retroreflectivity is ignored by genosl: it renders the forward lobe only" in err
    assert err.count("\n") == 1
    assert not out
    assert not (tmp_path / "out").exists()


def test_without_strict_it_is_a_warning(command: Any, tmp_path: Path) -> None:
    status, out, err = command("--target", "osl", "-o", str(tmp_path / "out"))
    assert status == 0
    assert "warning: " in err
    assert "forward lobe only" in err
    assert Path(out.strip()).is_file()


def test_strict_lets_pass_what_nothing_ignores(command: Any, tmp_path: Path) -> None:
    assert command("--target", "essl", "-o", str(tmp_path / "out"), "--strict")[0] == 0


def test_check_prints_a_row_for_every_target(command: Any) -> None:
    status, out, _ = command("--check")
    assert status == 0
    rows = [[cell.strip() for cell in line.split("│")[1:3]] for line in out.splitlines() if "│" in line]
    # A complaint may take several lines: those after the first name no target.
    assert [target for target, _ in rows if target] == TARGETS
    assert {result for target, result in rows if target} <= {"compiled", "generated", "unchecked", "upstream"}


def test_check_of_a_shader_that_does_not_compile_is_exit_status_1(
    command: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = replace(
        compilers.COMPILERS["essl"],
        is_installed=lambda: True,
        complaints=lambda shader: ["ERROR: no"] if "mrm_microfacet" in shader.pixel else [],
    )
    monkeypatch.setitem(compilers.COMPILERS, "essl", broken)
    status, out, _ = command("--target", "essl", "--check")
    assert status == 1
    assert "failed" in out
    assert "ERROR: no" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--target", "glls", "--check"], "unknown target glls; did you mean glsl"),
        (["--target", "glsl"], "name a folder for the shader's files with -o, or say --check"),
        (["--check", "--libraries", "nowhere"], "nowhere: no such folder"),
        (["--check", "--environment", "sky"], "unknown --environment sky; known: fis, none, prefilter"),
    ],
)
def test_a_wrong_request_is_exit_status_2_and_one_line(
    command: Any, arguments: list[str], message: str
) -> None:
    status, _, err = command(*arguments)
    assert status == 2
    assert message in err
    assert "Traceback" not in err
