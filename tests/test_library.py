"""The node library: loaded beside MaterialX's own, and installed where other programs find it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest

import mrm_nodes
from mrm_nodes import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.library import (
    HOST_INCLUDE,
    INSTALL_MARK,
    INSTALL_NAME,
    install,
    materials_path,
    root_path,
    shared_library,
    uninstall,
)
from mrm_nodes.reference.albedo_fit import COEFFICIENTS
from mrm_nodes.reference.fit_albedo import as_glsl

NODES = ["mrm_conductor_bsdf", "mrm_dielectric_bsdf", "mrm_generalized_schlick_bsdf"]
MATERIALX_LIBRARIES = Path(mx.getDefaultDataSearchPath().asString()) / "libraries"

each_node = pytest.mark.parametrize("node", NODES)


@pytest.fixture
def libraries(tmp_path: Path) -> Path:
    """A copy of MaterialX's `libraries` folder."""
    return Path(shutil.copytree(MATERIALX_LIBRARIES, tmp_path / "libraries"))


def generateshader(material: Path, output: Path, *options: str) -> str:
    """Run MaterialX's own tool and return what it printed."""
    output.mkdir()
    command = [sys.executable, "-m", "MaterialX._scripts.generateshader", *options]
    done = subprocess.run(
        [*command, "--outputPath", str(output), str(material)], capture_output=True, text=True, timeout=60
    )
    return done.stdout + done.stderr


def files_below(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- loading


def test_the_library_folder_holds_what_a_client_loads_and_nothing_else():
    files = list(mrm_nodes.library_path().iterdir())
    assert files
    assert all(file.suffix == ".mtlx" for file in files)
    assert materials_path() not in mrm_nodes.library_path().parents


@each_node
def test_each_node_is_defined_bound_to_glsl_and_has_a_graph_for_the_rest(node: str):
    document = mrm_nodes.load_library()
    definition = document.getNodeDef(f"ND_{node}")
    fused = definition.getImplementation("genglsl")
    portable = definition.getImplementation("genmdl")
    assert isinstance(fused, mx.Implementation) and fused.getFile().endswith(f"{node}.glsl")
    assert isinstance(portable, mx.NodeGraph)


@pytest.mark.parametrize("target", ["essl", "genmsl", "genslang"])
@each_node
def test_targets_that_inherit_genglsl_take_the_fused_code(node: str, target: str):
    document = mrm_nodes.load_library()
    if document.getTargetDef(target) is None:
        pytest.skip(f"this MaterialX has no target {target}")
    assert isinstance(document.getNodeDef(f"ND_{node}").getImplementation(target), mx.Implementation)


@each_node
def test_every_input_of_materialx_s_own_node_keeps_its_name_type_and_default(node: str):
    document = mrm_nodes.load_library()
    ours, own = (document.getNodeDef(f"ND_{name}") for name in (node, node.removeprefix("mrm_")))
    for theirs in own.getActiveInputs():
        if theirs.getName() != "retroreflective":
            each = ours.getInput(theirs.getName())
            assert each is not None, theirs.getName()
            assert each.getType() == theirs.getType()
            assert each.getValue() == theirs.getValue()
            assert each.getAttribute("defaultgeomprop") == theirs.getAttribute("defaultgeomprop")


@each_node
def test_retroreflectivity_is_a_varying_float_that_is_off_by_default(node: str):
    document = mrm_nodes.load_library()
    weight = document.getNodeDef(f"ND_{node}").getInput("retroreflectivity")
    assert (weight.getType(), weight.getValue(), weight.getIsUniform()) == ("float", 0.0, False)


@pytest.mark.client("loads, and is valid")
def test_the_loaded_library_is_valid():
    assert mrm_nodes.load_library().validate() == (True, "")


def test_it_loads_into_a_document_that_is_already_there():
    document = mx.createDocument()
    document.addNode("constant", "kept", "float")
    assert mrm_nodes.load_library(document) is document
    assert document.getNode("kept") is not None
    assert document.getNodeDef("ND_mrm_conductor_bsdf") is not None


def test_a_document_of_one_s_own_is_not_the_one_that_the_process_shares():
    mrm_nodes.load_library().removeNodeDef("ND_mrm_conductor_bsdf")
    assert shared_library().getNodeDef("ND_mrm_conductor_bsdf") is not None
    assert mrm_nodes.load_library().getNodeDef("ND_mrm_conductor_bsdf") is not None


def test_loading_without_surfaces_leaves_only_the_nodes():
    names = {definition.getName() for definition in mrm_nodes.load_library(surfaces=False).getNodeDefs()}
    assert {f"ND_{node}" for node in NODES} <= names
    assert {name for name in names if "mrm" in name} == {f"ND_{node}" for node in NODES}


def test_the_search_path_finds_the_source_of_both_libraries():
    path = mrm_nodes.search_path()
    assert path.find("libraries/pbrlib/genglsl/mx_conductor_bsdf.glsl").exists()
    assert path.find("glsl/mrm_conductor_bsdf.glsl").exists()


# --- installing


def test_install_writes_the_nodes_with_their_glsl_and_lists_what_it_wrote(libraries: Path):
    written = install(libraries)
    target = libraries / INSTALL_NAME
    assert all(file.is_file() and target in file.parents for file in written)
    assert {file.name for file in written} >= {"mrm_defs.mtlx", *(f"{node}.glsl" for node in NODES)}
    assert set(files_below(target)) == {str(file.relative_to(target)) for file in written} | {INSTALL_MARK}


@pytest.mark.parametrize("method", ["fis", "prefilter"])
def test_installed_for_a_method_of_image_light_the_nodes_know_it(libraries: Path, method: str):
    with pytest.raises(SystemExit) as ended:
        cli.main(["install", str(libraries), "--environment", method])
    assert ended.value.code == 0
    include = (libraries / INSTALL_NAME / HOST_INCLUDE).read_text()
    assert f"#define MRM_ENVIRONMENT MRM_ENVIRONMENT_{method.upper()}\n" in include


def test_install_changes_nothing_else(libraries: Path):
    before = files_below(libraries)
    install(libraries)
    after = files_below(libraries)
    assert {name: content for name, content in after.items() if not name.startswith("mrm/")} == before
    assert sorted(path.name for path in libraries.iterdir() if path.name.startswith(".")) == []


def test_what_was_installed_is_as_readable_as_its_neighbours(libraries: Path):
    libraries.chmod(0o755)
    install(libraries)
    assert (libraries / INSTALL_NAME).stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("target", ["glsl", "essl", "vulkan", "msl", "osl", "mdl"])
def test_after_install_materialx_s_own_tool_generates_the_nodes(libraries: Path, tmp_path: Path, target: str):
    """The tool always loads its own libraries; of the copy it is told of the folder of our nodes alone."""
    install(libraries)
    output = tmp_path / "out"
    options = ("--path", str(libraries.parent), "--library", f"libraries/{INSTALL_NAME}", "--target", target)
    printed = generateshader(materials_path() / "traffic_cone.mtlx", output, *options)
    sources = [file.read_text() for file in output.iterdir()]
    assert sources, printed
    if target in ("glsl", "essl", "vulkan", "msl"):
        assert any("mrm_microfacet(" in source for source in sources)


def test_before_install_the_tool_does_not_know_them(tmp_path: Path):
    """So the test above proves something."""
    output = tmp_path / "out"
    generateshader(materials_path() / "traffic_cone.mtlx", output)
    assert not any("mrm_microfacet(" in file.read_text() for file in output.iterdir())


def test_a_second_install_replaces_the_first_as_a_whole(libraries: Path):
    first = install(libraries)
    content = files_below(libraries)
    assert install(libraries) == first
    assert files_below(libraries) == content


def test_uninstall_leaves_the_folder_as_it_was(libraries: Path):
    before = files_below(libraries)
    install(libraries)
    removed, kept = uninstall(libraries)
    assert removed and not kept
    assert files_below(libraries) == before
    assert not (libraries / INSTALL_NAME).exists()


# --- what install refuses, and leaves as it was


def assert_refused(libraries: Path, reason: str) -> None:
    before = files_below(libraries) if libraries.is_dir() else {}
    with pytest.raises(MrmError, match=reason) as refusal:
        install(libraries)
    assert "\n" not in str(refusal.value)
    assert str(libraries) in str(refusal.value)
    assert (files_below(libraries) if libraries.is_dir() else {}) == before
    if libraries.is_dir():
        assert not list(libraries.glob(".mrm-*"))


def test_install_refuses_a_folder_that_is_not_there(tmp_path: Path):
    assert_refused(tmp_path / "libraries", "no such folder")
    assert not (tmp_path / "libraries").exists()


def test_install_refuses_a_file(tmp_path: Path):
    (tmp_path / "libraries").write_text("not a folder")
    with pytest.raises(MrmError, match="no such folder"):
        install(tmp_path / "libraries")
    assert (tmp_path / "libraries").read_text() == "not a folder"


def test_install_refuses_a_folder_that_is_no_libraries_folder(tmp_path: Path):
    folder = tmp_path / "libraries"
    folder.mkdir()
    (folder / "kept.txt").write_text("mine")
    assert_refused(folder, "not a MaterialX")


def test_install_refuses_an_mrm_that_somebody_else_made(libraries: Path):
    (libraries / INSTALL_NAME).mkdir()
    (libraries / INSTALL_NAME / "theirs.mtlx").write_text("theirs")
    assert_refused(libraries, "not written by mrm-nodes")


def test_install_refuses_a_file_named_mrm(libraries: Path):
    (libraries / INSTALL_NAME).write_text("theirs")
    assert_refused(libraries, "not written by mrm-nodes")


def test_install_does_not_follow_a_link_named_mrm(libraries: Path, tmp_path: Path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / INSTALL_MARK).write_text("")
    (libraries / INSTALL_NAME).symlink_to(elsewhere)
    assert_refused(libraries, "not written by mrm-nodes")
    assert (elsewhere / INSTALL_MARK).is_file()


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may write anywhere")
def test_install_refuses_a_folder_that_cannot_be_written(libraries: Path):
    libraries.chmod(0o555)
    try:
        assert_refused(libraries, "cannot be written")
    finally:
        libraries.chmod(0o755)


def test_install_says_why_it_cannot_write(libraries: Path, monkeypatch: pytest.MonkeyPatch):
    def denied(*args: object, **kwargs: object) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "mkdtemp", denied)
    assert_refused(libraries, r"cannot be written \(Permission denied\)")


def test_a_full_disk_leaves_the_earlier_installation(libraries: Path, monkeypatch: pytest.MonkeyPatch):
    install(libraries)
    before = files_below(libraries)

    def full(*args: object, **kwargs: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(shutil, "copytree", full)
    monkeypatch.setattr(shutil, "copy2", full)
    monkeypatch.setattr(Path, "write_text", full)
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(MrmError, match="No space left on device"):
        install(libraries)
    monkeypatch.undo()
    assert files_below(libraries) == before


# --- the numbers that stand in two languages


def test_the_fitted_coefficients_are_the_evaluator_s_and_the_host_s():
    """Two witnesses of one fit: the evaluator follows its coefficients, and they are no formula to derive again."""
    ours = (root_path() / "glsl/lib/mrm_microfacet.glsl").read_text()
    pairs = [("phong", "vcavity"), ("ggx", "vcavity"), ("beckmann", "smith"), ("beckmann", "vcavity")]
    written = re.findall(r"^            r = vec4.*?;", ours, re.MULTILINE | re.DOTALL)
    assert written == [as_glsl(COEFFICIENTS[pair]) for pair in pairs]
    # The host's own nodes have this one.
    host = (MATERIALX_LIBRARIES / "pbrlib/genglsl/lib/mx_microfacet_specular.glsl").read_text()
    rows = re.findall(r"vec4\(([^()]*)\)", host.partition("mx_ggx_dir_albedo_analytic")[2])[:9]
    fitted = np.array([[float(number) for number in row.split(",")] for row in rows])
    np.testing.assert_array_equal(fitted, COEFFICIENTS["ggx", "smith"])
    assert set(COEFFICIENTS) == {*pairs, ("ggx", "smith")}
