"""A disk that is full, at each change that a command makes in turn: nothing is half there, and the next try is whole.

MRM_FAULTS=200 has whole runs with their workers at each change too; without it they are a sample.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from random import Random

import numpy as np
import pytest
from faulty_disk import Ended, Machine, contents, machine, without_time

from mrm_nodes.regression.baseline import LOG, Store
from mrm_nodes.regression.journal import Past, read

EVERY = bool(os.environ.get("MRM_FAULTS"))
SEED = int(os.environ.get("MRM_FAULTS_SEED", "1"))

TAPE = """<materialx version="1.39">
  <mrm_conductor_bsdf name="tape" type="BSDF">
    <input name="retroreflectivity" type="float" value="0.5"/></mrm_conductor_bsdf>
  <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="tape"/></surface>
  <surfacematerial name="material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface"/></surfacematerial>
</materialx>
"""
VEST = """<materialx version="1.39">
  <standard_surface name="vest" type="surfaceshader"/>
  <surfacematerial name="material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="vest"/></surfacematerial>
</materialx>
"""
SUITE = """
[defaults]
size = 8
[[case]]
material = "tape.mtlx"
name = "physics-{input:tape/retroreflectivity}"
[case.matrix]
"input:tape/retroreflectivity" = [0, 1]
[[case]]
material = "tape.mtlx"
name = "stored"
truth = "baseline"
"""
TESTS = """
def test_tape(mrm_render, mrm_assert_image):
    mrm_assert_image(mrm_render("tape.mtlx", size=(8, 8)))
"""
REGRESS = ["regress", "--suite", "suite.toml", "--backend", "egl", "-o", "report"]


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    with machine(tmp_path_factory.mktemp("full") / "disk") as it:
        yield it


@pytest.fixture
def template(tmp_path: Path) -> Path:
    folder = tmp_path / "template"
    folder.mkdir()
    for name, text in (
        ("tape.mtlx", TAPE), ("vest.mtlx", VEST), ("suite.toml", SUITE), ("test_tape.py", TESTS)
    ):  # fmt: skip
        (folder / name).write_text(text)
    return folder


def judged_here(*arguments: str) -> int:
    """The command line, with results of which only the files are real, without a worker and OpenGL."""
    from mrm_nodes.cli import main
    from mrm_nodes.regression import baseline, run
    from mrm_nodes.regression.executors import Judged
    from mrm_nodes.regression.outcome import outcome_of
    from mrm_nodes.regression.pictures import write_pictures
    from mrm_nodes.render.context import BackendReport

    def judge(tasks, backend, scratch, *others):  # type: ignore[no-untyped-def]
        for number, task in enumerate(tasks):
            folder = scratch / str(number)
            place = folder / "cases" / backend / task.name
            place.mkdir(parents=True)
            image = np.full((8, 8, 3), sum(map(ord, task.name)), np.float32)
            written = write_pictures(place, image, image, np.ones((8, 8), bool))
            files = {
                what: f"cases/{backend}/{task.name}/{name}" if isinstance(name, str) else name
                for what, name in written.items()
            }
            details = {"inputs": baseline.fingerprint(task)}
            yield Judged(task, outcome_of(task, backend, "pass", files=files, details=details), folder)

    run.run_locally = judge
    run.probe_backends = lambda *_: [BackendReport("egl", True, "Mesa", "llvmpipe", "4.5")]
    main(list(arguments))


def attempts(disk: Machine, template: Path, try_at: Callable[[int, bool, Path], Ended]) -> int:
    """Have each change in turn be the one at which the disk is full, for a moment and from then on; return how many
    there are.
    """
    shutil.copytree(template, whole := disk.root / "whole")
    changes = try_at(0, False, whole).changes
    for at in range(1, changes + 1):
        for stays in (False, True):
            folder = disk.root / f"{at}-{stays}"
            shutil.copytree(template, folder)
            try_at(at, stays, folder)
            shutil.rmtree(folder)
    shutil.rmtree(whole)
    return changes


def check_told(ended: Ended, folder: Path) -> None:
    """One line says which disk is full, and nothing else went wrong."""
    assert "Traceback" not in ended.err, ended.err
    if ended.status:
        assert ended.status == 2, ended.err
        (line,) = [line for line in ended.err.splitlines() if line.startswith("mrm-nodes: ")]
        assert "No space left on device" in line, line


PLAIN: Mapping[str, list[str]] = {
    "render": ["render", "tape.mtlx", "-o", "new/tape.exr", "--size", "8x8"],
    "render, a picture": ["render", "tape.mtlx", "-o", "old.png", "--size", "8x8"],
    "generate": ["generate", "tape.mtlx", "--target", "glsl", "-o", "shaders"],
    "retrofit": ["retrofit", "vest.mtlx", "-o", "retro.mtlx"],
    "suite init": ["suite", "init", "fresh.toml"],
    "install": ["install", "libraries"],
}


@pytest.mark.parametrize("command", PLAIN)
def test_a_command_that_writes_files_leaves_each_as_it_was_or_whole(
    disk: Machine, template: Path, command: str
):
    (template / "old.png").write_text("old")
    (template / "libraries" / "stdlib").mkdir(parents=True)
    (template / "libraries" / "stdlib" / "stdlib_defs.mtlx").write_text("")
    before = contents(template)
    complete: dict[str, bytes] = {}

    def try_at(at: int, stays: bool, folder: Path) -> Ended:
        ended = disk.run(PLAIN[command], at, stays, folder=folder)
        check_told(ended, folder)
        found = contents(folder)
        if not at:
            assert ended.status == 0, ended.err
            complete.update(found)
        assert found.keys() <= complete.keys()
        for name, data in found.items():
            assert data in (before.get(name), complete[name]), (at, stays, name)
        assert ended.status == 2 or found == complete
        again = disk.run(PLAIN[command], folder=folder)
        assert again.status == 0 or command == "suite init", again.err
        assert contents(folder) == complete
        return ended

    assert attempts(disk, template, try_at) >= 4
