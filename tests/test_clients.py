"""Other people's software takes the node library: each MaterialX, its own tools and renderer, the next version."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import MaterialX as mx
import MaterialX.PyMaterialXGenGlsl as mx_gen_glsl
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import numpy as np
import pytest

import mrm_nodes
from mrm_nodes import compilers, doctor, library, shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.host import Host, read_host
from mrm_nodes.regression.cases.cloud import Cloud, attributes_of, run_cloud
from mrm_nodes.regression.truth import material, reference_image
from mrm_nodes.render.renderer import shared_renderer

# ---- MaterialX 1.39.6, whose energy compensation takes a FresnelData: its rules put into a copy of the libraries


def make_newer(libraries: Path) -> None:
    """Give a copy of MaterialX's `libraries` the energy compensation of 1.39.6."""
    pbrlib = libraries / "pbrlib" / "genglsl"
    microfacet = pbrlib / "lib" / "mx_microfacet_specular.glsl"
    text = microfacet.read_text()
    overload = r"^\w+ mx_ggx_energy_compensation\([^)]*\)\n\{.*?^\}\n"
    text, removed = re.subn(overload, "", text, flags=re.MULTILINE | re.DOTALL)
    assert removed == 2
    microfacet.write_text(
        text
        + """
vec3 mx_ggx_energy_compensation(float NdotV, float alpha, FresnelData fd)
{
    vec3 atNormal = mx_compute_fresnel(1.0, fd);
    vec3 atGrazing = vec3(1.0);
    if (fd.model == FRESNEL_MODEL_SCHLICK && !fd.airy)
    {
        atGrazing = fd.F90;
    }
    float white = mx_ggx_dir_albedo(NdotV, alpha, 1.0, 1.0);
    return vec3(1.0) + (atNormal + (atGrazing - atNormal) / 21.0) * (1.0 - white) / white;
}
"""
    )
    for closure in pbrlib.glob("mx_*_bsdf.glsl"):
        source = closure.read_text()
        closure.write_text(
            re.sub(
                r"mx_ggx_energy_compensation\((\w+), (\w+), F\)",
                r"mx_ggx_energy_compensation(\1, \2, fd)",
                source,
            )
        )


@pytest.fixture
def newer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A MaterialX whose `libraries` folder follows the rules of 1.39.6."""
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    make_newer(libraries)
    with monkeypatch.context() as patched:
        patched.setattr(mx, "getDefaultDataSearchPath", lambda: mx.FileSearchPath(str(tmp_path)))
        _forget()
        yield libraries
    _forget()


def _forget() -> None:
    for cached in (library._own_host, library._library, material.inputs_of):
        cached.cache_clear()


def beside(node: str) -> mx.Document:
    """Our node and MaterialX's own of the same stem in one graph."""
    doc = mx.createDocument()
    doc.setDataLibrary(library.shared_library())
    lobes = [doc.addNode(name, name, "BSDF") for name in (node, node.removeprefix("mrm_"))]
    compilers.add_up(doc, lobes, "material")
    return doc


def test_the_rules_are_read_from_the_folder_not_from_the_version(newer: Path) -> None:
    assert read_host(newer).compensation == "materialx-1.39.6"
    assert library.host().compensation == "materialx-1.39.6"


@pytest.mark.client("its `libraries` with the rules of MaterialX 1.39.6")
@pytest.mark.parametrize("target", ["essl", "vulkan", "wgsl", "msl", "slang"])
@pytest.mark.parametrize("node", material.NODES)
def test_beside_the_next_materialx_our_nodes_compile(newer: Path, node: str, target: str) -> None:
    if target not in shadergen.supported_targets():
        pytest.skip("no such target")
    check = compilers.check_material(beside(node), target)
    if check.status == "unchecked":
        pytest.skip(check.complaints[0])
    if check.status == "upstream":
        pytest.xfail(f"upstream: {check.complaints[0]}")
    assert check.status == "compiled", check


def test_a_checkout_loaded_by_its_folder_compiles_there_with_the_former_rule(
    newer: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """GLSL cannot ask which functions there are; `install` and `library_path` can, and doctor says so."""
    path = mx.FileSearchPath(str(newer.parent))
    path.append(mx.FilePath(str(library.root_path())))
    shader = generated_by_materialx(path, ["libraries", "mtlx/mrm"], "libraries")
    assert "#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 0" in shader.pixel
    assert compilers.check_shader(shader).status in ("compiled", "unchecked")
    doctor.examine()
    assert "loaded by its folder" in " ".join(capsys.readouterr().out.split())


def test_installed_into_the_next_materialx_they_follow_its_rule(newer: Path) -> None:
    library.install(newer)
    host_include = newer / "mrm" / library.HOST_INCLUDE
    assert "#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 1" in host_include.read_text()


def test_an_explicit_folder_is_followed_too(tmp_path: Path) -> None:
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    make_newer(libraries)
    doc = mx.createDocument()
    doc.setDataLibrary(library.shared_library(libraries))
    compilers.add_up(doc, [doc.addNode("mrm_conductor_bsdf", "bsdf", "BSDF")], "material")
    source = shadergen.generate_shader(doc, "glsl", libraries=libraries).pixel
    assert "#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 1" in source
    own = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "glsl").pixel
    assert "#define MRM_COMPENSATION_BY_AVERAGE_FRESNEL 0" in own


def test_the_nodes_agree_with_the_evaluator_under_the_next_rule(
    newer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The Schlick node: its curve has a reflectance at grazing incidence of its own.
    node = "mrm_generalized_schlick_bsdf"
    renderer = shared_renderer()
    shader = shadergen.generate_shader(material.document(node, attributes=attributes_of(node)))

    def used() -> float:
        """How much of its bound the worst of the random configurations takes."""
        decades = run_cloud(Cloud(node, configurations=20_000), renderer, shader).decades
        return max(decade["max_used"] for decade in decades)

    assert used() < 1
    monkeypatch.setattr(reference_image, "host", Host)
    assert used() > 10, "the former rule is another one"


# ---- folders that are not what they should be


def test_a_materialx_that_is_too_old_is_named_with_what_to_install(tmp_path: Path) -> None:
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    (libraries / "pbrlib/genglsl/lib/mx_closure_type.glsl").unlink()
    with pytest.raises(MrmError, match=r"too old .* pip install 'MaterialX>=1.39.3'"):
        library.install(libraries)
    with pytest.raises(MrmError, match="too old"):
        library.load_library(libraries=libraries)


@pytest.mark.parametrize(
    "command", [["generate", "--check"], ["render", "-o", "out.exr"], ["retrofit", "-o", "out.mtlx"]]
)
def test_a_materialx_of_before_1_39_is_one_line(command: list[str]) -> None:
    """Whose documents know no data library."""
    name, *options = command
    arguments = [name, str(library.materials_path() / "traffic_cone.mtlx"), *options]
    older = "import MaterialX; del MaterialX.Document.setDataLibrary"
    code = f"{older}; from mrm_nodes import cli; cli.main({arguments!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2
    assert re.fullmatch(r"mrm-nodes: MaterialX \S+ is too old; install 1\.39\.3 or newer: .*\n", done.stderr)


def test_a_folder_by_another_name_is_refused_where_materialx_would_not_look(tmp_path: Path) -> None:
    renamed = Path(shutil.copytree(library.own_libraries(), tmp_path / "materialx"))
    with pytest.raises(MrmError, match="named `libraries`"):
        library.search_path(renamed)


def test_a_host_without_the_switch_gets_the_forward_lobe_everywhere(tmp_path: Path) -> None:
    """As MaterialX 1.39.3 and 1.39.4: no `retroreflective` to build a blend from."""
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    definitions = libraries / "pbrlib" / "pbrlib_defs.mtlx"
    definitions.write_text(re.sub(r"\n *<input name=\"retroreflective\"[^\n]*", "", definitions.read_text()))
    bindings = libraries / "pbrlib" / "genmdl" / "pbrlib_genmdl_impl.mtlx"
    bindings.write_text(bindings.read_text().replace("mxp_retroreflective:{{retroreflective}}, ", ""))
    loaded = library.load_library(libraries=libraries)
    assert loaded.validate() == (True, "")
    definition = loaded.getNodeDef("ND_mrm_conductor_bsdf")
    for target in ("genosl", "genmdl"):
        graph = definition.getImplementation(target)
        assert [node.getCategory() for node in graph.getNodes()] == ["conductor_bsdf"]
    written = {file.name for file in library.install(libraries)}
    assert "mrm_ng.mtlx" not in written
    assert "mrm_genosl_ng.mtlx" in written


# ---- uninstall


def test_uninstall_keeps_what_somebody_added_or_changed(tmp_path: Path) -> None:
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    library.install(libraries)
    changed = libraries / "mrm" / "glsl" / "mrm_conductor_bsdf.glsl"
    changed.write_text(changed.read_text() + "// mine\n")
    added = libraries / "mrm" / "mtlx" / "notes.txt"
    added.write_text("mine")
    with pytest.raises(MrmError, match=r"mrm_conductor_bsdf\.glsl, mtlx/notes\.txt was added or changed"):
        library.install(libraries)
    removed, kept = library.uninstall(libraries)
    assert kept == [changed, added]
    assert sorted(path for path in (libraries / "mrm").rglob("*") if path.is_file()) == [changed, added]
    assert all(not file.exists() for file in removed)


def test_uninstall_without_an_installation_says_so_and_removes_nothing(tmp_path: Path) -> None:
    theirs = tmp_path / "mrm" / "theirs.mtlx"
    theirs.parent.mkdir()
    theirs.write_text("theirs")
    with pytest.raises(MrmError, match="no installation of mrm-nodes there"):
        library.uninstall(tmp_path)
    assert theirs.read_text() == "theirs"


def test_a_list_of_files_cannot_point_out_of_the_installation(tmp_path: Path) -> None:
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    library.install(libraries)
    outside = libraries / "stdlib" / "stdlib_defs.mtlx"
    mark = libraries / "mrm" / library.INSTALL_MARK
    mark.write_text(mark.read_text() + f"{library._digest(outside)}  ../stdlib/stdlib_defs.mtlx\n")
    library.uninstall(libraries)
    assert outside.is_file()


# ---- programs that load libraries through MaterialX's own interface


def generated_by_materialx(path: mx.FileSearchPath, libraries: list[str], prefix: str) -> shadergen.Shader:
    """The traffic cone in GLSL, with no help of ours: what a search path, its folders and a prefix give."""
    loaded, document = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(libraries, path, loaded)
    mx.readFromXmlFile(document, str(library.materials_path() / "traffic_cone.mtlx"))
    document.setDataLibrary(loaded)
    generator = mx_gen_glsl.GlslShaderGenerator.create()
    context = mx_gen_shader.GenContext(generator)
    context.registerSourceCodeSearchPath(path)
    context.getOptions().libraryPrefix = mx.FilePath(prefix)
    shader = generator.generate("shader", document.getMaterialNodes()[0], context)
    sources = (shader.getSourceCode(stage) for stage in ("vertex", "pixel"))
    return shadergen.Shader("traffic_cone", "glsl", *sources, shader, document, path)


@pytest.mark.client("dropped in: {prefix}")
@pytest.mark.parametrize(
    "prefix",
    ["search path above `libraries`, default prefix", "search path `libraries`, no prefix (as USD's Hydra)"],
)
def test_dropped_in_a_program_that_loads_the_whole_folder_has_them(tmp_path: Path, prefix: str) -> None:
    libraries = Path(shutil.copytree(library.own_libraries(), tmp_path / "libraries"))
    library.install(libraries)
    folders = [folder.name for folder in libraries.iterdir() if folder.is_dir()]
    if "no prefix" in prefix:
        shader = generated_by_materialx(mx.FileSearchPath(str(libraries)), folders, "")
    else:
        names = [f"libraries/{name}" for name in folders]
        shader = generated_by_materialx(mx.FileSearchPath(str(tmp_path)), names, "libraries")
    assert "mrm_microfacet(" in shader.pixel
    assert compilers.check_shader(shader).status == "compiled"


@pytest.mark.client("not dropped in: `mrm_nodes.search_path()`")
def test_not_dropped_in_our_search_path_is_enough() -> None:
    shader = generated_by_materialx(library.search_path(), ["libraries", "mtlx/mrm"], "libraries")
    assert "mrm_microfacet(" in shader.pixel
    assert compilers.check_shader(shader).status == "compiled"


# ---- the renderer here, with this release's nodes


@pytest.mark.client("renders: the evaluator's image")
@pytest.mark.parametrize("node", material.NODES)
def test_the_nodes_agree_with_the_evaluator(node: str) -> None:
    shader = shadergen.generate_shader(material.document(node, attributes=attributes_of(node)))
    assert run_cloud(Cloud(node, configurations=100_000), shared_renderer(), shader).verdict == "pass"


def test_a_material_of_materialx_own_is_no_nan_where_nothing_but_a_lamp_shines() -> None:
    """Its environment function divides by the number of samples, up to 1.39.4."""
    picture = mrm_nodes.render(material.document("conductor_bsdf"), lights=["camera"], size=(32, 32))
    assert np.isfinite(picture.image).all()
    assert picture.image.max() > 0


# ---- MaterialX's own tools, unchanged


@pytest.fixture(scope="module")
def dropped_in(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the MaterialX package with the node library in its `libraries`; returns the folder above it."""
    folder = tmp_path_factory.mktemp("dropped_in")
    shutil.copytree(Path(mx.__file__).parent, folder / "MaterialX")
    library.install(folder / "MaterialX" / "libraries")
    return folder


def run_tool(tool: str, *arguments: str | Path, python_path: Path | None = None) -> str:
    """Run a tool of MaterialX's package and return what it printed."""
    environment = dict(os.environ)
    if python_path is not None:
        environment["PYTHONPATH"] = str(python_path)
    command = [sys.executable, "-m", f"MaterialX._scripts.{tool}", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    return done.stdout + done.stderr


def generates_our_nodes(*options: str | Path, output: Path, python_path: Path | None = None) -> bool:
    """Whether `generateshader` writes GLSL that calls ours."""
    output.mkdir()
    material = library.materials_path() / "traffic_cone.mtlx"
    run_tool("generateshader", *options, "--outputPath", output, material, python_path=python_path)
    return any("mrm_microfacet(" in file.read_text() for file in output.iterdir())


@pytest.mark.client("dropped in: `generateshader`")
def test_dropped_in_generateshader_needs_no_option(dropped_in: Path, tmp_path: Path) -> None:
    assert generates_our_nodes(output=tmp_path / "out", python_path=dropped_in)


@pytest.mark.client("not dropped in: `generateshader --path … --library`")
def test_not_dropped_in_generateshader_takes_our_folder_as_a_library(tmp_path: Path) -> None:
    # The tool looks for sources on --path only, so that MaterialX's own folder is named too.
    checkout, own = library.root_path(), library.own_libraries().parent
    options = ("--path", checkout, "--path", own, "--library", library_name())
    assert generates_our_nodes(*options, output=tmp_path / "out")
    assert not generates_our_nodes(output=tmp_path / "without")


def library_name() -> str:
    return (library.root_path() / "mtlx").relative_to(library.root_path()).as_posix()


@pytest.mark.client("dropped in: `mxdoc`")
def test_dropped_in_mxdoc_documents_every_input(dropped_in: Path) -> None:
    definitions = dropped_in / "MaterialX" / "libraries" / "mrm" / "mtlx" / "mrm" / "mrm_defs.mtlx"
    printed = run_tool("mxdoc", definitions, python_path=dropped_in)
    for node in material.NODES:
        assert f"ND_{node}" in printed
        for name in material.inputs_of(node):
            assert f"| **{name}** |" in printed


@pytest.mark.client("dropped in: `mxvalidate`")
def test_dropped_in_mxvalidate_finds_nothing_wrong(dropped_in: Path, tmp_path: Path) -> None:
    """The tool exits with 0 whatever it finds: what it prints counts."""
    for stem, name, verdict in (("right", "retroreflectivity", "a valid"), ("wrong", "retro", "not a valid")):
        if stem == "wrong" and mx.getVersionIntegers() < (1, 39, 5):
            continue  # which does not look
        doc = material.document(material.NODES[0])
        doc.getNode("bsdf").addInput(name, "float").setValue(0.5)
        mx.writeToXmlFile(doc, str(tmp_path / f"{stem}.mtlx"))
        printed = run_tool("mxvalidate", tmp_path / f"{stem}.mtlx", python_path=dropped_in)
        assert f"is {verdict} MaterialX document" in printed
