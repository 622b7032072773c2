"""Finished materials, meshes and environments are taken by name, wherever a document is."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import mrm_nodes
from mrm_nodes import photometry, shipped
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.render import BUILT_IN, read_image
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS
from mrm_nodes.surfaces.convert import convert

Run = Callable[..., tuple[int, str, str]]
CONE = shipped.materials()["traffic_cone"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_what_is_taken_by_name_is_listed_with_a_line_each(run: Run, folder: Path):
    status, out, err = run("materials")
    assert (status, err) == (0, "")
    lines = [line.split(maxsplit=1) for line in out.splitlines() if line.startswith("  ")]
    assert [name for name, _ in lines] == [*shipped.materials(), *BUILT_IN, *BUILT_IN_ENVIRONMENTS]
    assert all(len(about) > 10 and about.endswith(".") for _, about in lines)
    assert str(shipped.materials_path()) in out
    assert run("materials", "traffic_cone")[1] == f"{CONE}\n"


def test_a_name_is_the_file(folder: Path):
    assert mrm_nodes.generate_shader("traffic_cone").pixel == mrm_nodes.generate_shader(CONE).pixel
    assert photometry.read_sheet("traffic_cone").where == str(CONE)
    with pytest.raises(MrmError, match=r"traffic_cone\.mtlx"):
        convert("traffic_cone", "mine.mtlx")
    assert not any(folder.iterdir())


def test_commands_take_names(run: Run, gl: None, folder: Path):
    small = ("--size", "12x12", "--samples", "1")
    assert run("render", "traffic_cone", "-o", "name.exr", "--mesh", "baluster", *small)[0] == 0
    assert run("render", CONE, "-o", "file.exr", "--mesh", "baluster", *small)[0] == 0
    assert (read_image(folder / "name.exr") == read_image(folder / "file.exr")).all()
    assert read_image(folder / "name.exr")[..., :3].max() > 0.1
    assert (mrm_nodes.render("traffic_cone", lights="camera", size=(8, 8)).image > 0.1).any()
    status, out, _ = run("photometry", "yellow_tape", "--geometry", "0.2,-4", "--uv", "0.5,0.5")
    assert status == 0
    assert "0.2°, -4°" in out


def test_a_file_wins_and_that_is_said_unless_it_is_named_with_a_folder(run: Run, folder: Path):
    shutil.copy(shipped.materials()["road_paint"], folder / "traffic_cone")
    status, out, err = run("generate", "traffic_cone", "--target", "wgsl", "-o", "out")
    assert status == 0
    assert "road_paint" in out
    assert err.startswith("warning: traffic_cone: the file is taken, not the finished material /")
    assert err.count("\n") == 1
    for named in ("./traffic_cone", str(folder / "traffic_cone")):
        status, out, err = run("generate", named, "--target", "wgsl", "-o", "out")
        assert (status, err) == (0, "")
        assert "road_paint" in out
    with pytest.warns(MrmWarning, match="the file is taken"):
        assert "road_paint" in mrm_nodes.generate_shader("traffic_cone").pixel


def test_a_folder_of_that_name_is_no_file(folder: Path):
    Path("traffic_cone").mkdir()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert shipped.material_file("traffic_cone") == CONE


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("trafic_cone", "trafic_cone: no such file; did you mean traffic_cone?"),
        ("Traffic-Cone", "Traffic-Cone: no such file; did you mean traffic_cone?"),
        ("traffic_cone.mtlx", "the material that comes with mrm-nodes is named traffic_cone, without an ending"),
        ("vset.mtlx", "vset.mtlx: no such file; did you mean vest.mtlx?"),
        ("sub/tope.mtlx", "sub/tope.mtlx: no such file; did you mean sub/tape.mtlx or sub/tape.glb?"),
        ("granite", "granite: no such file, nor a material that comes with mrm-nodes; known: chevron_sign, hi_vis"),
        ("xx.mtlx", "xx.mtlx: no such file"),
        (".", ".: is a folder; name vest.mtlx"),
        ("sub", "sub: is a folder; name sub/tape.glb or sub/tape.mtlx"),
        ("empty", "empty: is a folder; name a document"),
        ("a\0b", "no such file"),
        ("x" * 5000, "no such file"),
        ("", "no such file"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["render", "generate", "photometry", "retrofit"])
def test_what_is_neither_is_one_line(run: Run, folder: Path, command: str, name: str, said: str):
    for each in ("vest.mtlx", "sub/tape.mtlx", "sub/tape.glb", "sub/notes.txt", "empty/notes.txt"):
        (folder / each).parent.mkdir(exist_ok=True)
        (folder / each).touch()
    before = sorted(folder.rglob("*"))
    output = {"generate": ["-o", "out"], "photometry": []}.get(command, ["-o", "out.mtlx"])
    if command == "render":
        output = ["-o", "out.png"]
    status, out, err = run(command, name, *output)
    assert (status, out) == (2, "")
    assert err.startswith("mrm-nodes: ")
    assert said in err
    assert err.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


def test_completion_has_the_names(monkeypatch: pytest.MonkeyPatch, folder: Path, run: Run):
    monkeypatch.setenv("_MRM_NODES_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", "mrm-nodes render tra")
    monkeypatch.setenv("COMP_CWORD", "2")
    _, out, _ = run()
    assert out.splitlines() == ["file,tra", "plain,traffic_cone"]
    assert os.environ["COMP_CWORD"] == "2"
