"""A disk that is full, at each change that a command makes in turn: nothing is half there, and the next try is whole.

MRM_FAULTS=200 or more tries each change; fewer are so many of them, chosen by MRM_FAULTS_SEED.
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

from mrm_nodes.library import own_libraries
from mrm_nodes.regression.cases.baseline import LOG, Store
from mrm_nodes.regression.run.journal import Past, read

COUNT = int(os.environ.get("MRM_FAULTS", "0"))
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
name = "physics-{tape/retroreflectivity}"
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
    from mrm_nodes.regression.cases import baseline
    from mrm_nodes.regression.cases.pictures import write_pictures
    from mrm_nodes.regression.run import runner as run
    from mrm_nodes.regression.run.pool import Judged
    from mrm_nodes.regression.verdict.outcome import outcome_of
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


def attempts(disk: Machine, template: Path, try_at: Callable[[int, bool, Path], Ended], few: int = 1) -> int:
    """Have each change in turn be the one at which the disk is full, for a moment or from then on; return how many
    there are.

    few: how many are tried where not all are.
    """
    for left in disk.root.iterdir():
        shutil.rmtree(left)

    def attempt(at: int, stays: bool) -> Ended:
        folder = disk.root / f"{at}-{stays}"
        shutil.copytree(template, folder)
        ended = try_at(at, stays, folder)
        shutil.rmtree(folder)
        return ended

    changes = attempt(0, False).changes
    each = [(at, stays) for at in range(1, changes + 1) for stays in (False, True)]
    chosen = each if COUNT >= 200 else Random(SEED).sample(each, min(max(few, COUNT), len(each)))
    for at, stays in chosen:
        attempt(at, stays)
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
    "suite init": ["suite", "init", "fresh"],
    "install": ["install", "libraries"],
}


@pytest.mark.parametrize("command", PLAIN)
def test_a_command_that_writes_files_leaves_each_as_it_was_or_whole(
    disk: Machine, template: Path, command: str
):
    (template / "old.png").write_text("old")
    if command == "install":
        shutil.copytree(own_libraries(), template / "libraries")
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
        assert again.status == 0 or "fresh/suite.toml: exists" in again.err, again.err
        assert contents(folder) == complete
        return ended

    assert attempts(disk, template, try_at) >= 3


HERE = "test_full_disk:judged_here"
CACHED = ["--cache", "cache", "--junit", "junit.xml"]


def results(folder: Path) -> tuple[object, dict[str, bytes]]:
    """What a report says, and its pictures."""
    pictures = {name: data for name, data in contents(folder).items() if name.startswith("cases/")}
    return without_time(folder / "report.json"), pictures


def check_report(folder: Path, whole: object) -> None:
    """What a run that failed left: no report, or one that says that it is partial, or the whole one; no temporary."""
    report = folder / "report.json"
    if report.exists():
        partial = json.loads(report.read_text())["environment"].get("partial")
        assert partial or results(folder) == whole
    left = {name for name in contents(folder) if name.split("/")[0].startswith(".")}
    assert left <= {".lock"}
    for name in ("journal", ".unfinished"):
        assert name == "journal" or not (folder / name).exists()
    assert read(folder) is None or isinstance(read(folder), Past)


IN_FULL = pytest.mark.skipif(not COUNT, reason="whole runs are for make faults")


@pytest.mark.parametrize("workers", [False, pytest.param(True, marks=IN_FULL)], ids=["alone", "with workers"])
def test_a_run_is_whole_after_resume(disk: Machine, template: Path, workers: bool):
    how = "cli" if workers else HERE
    expected: list[object] = []
    status: list[int] = []

    def try_at(at: int, stays: bool, folder: Path) -> Ended:
        ended = disk.run([*REGRESS, *CACHED], at, stays, how, folder)
        if not at:
            assert ended.status < 2, ended.err
            expected.append(results(folder / "report"))
            status.append(ended.status)
            return ended
        if ended.status != status[0]:
            check_told(ended, folder)
        else:
            assert results(folder / "report") == expected[0]
        check_report(folder / "report", expected[0])
        again = disk.run([*REGRESS, *CACHED, "--resume"], how=how, folder=folder)
        assert again.status == status[0], again.err
        assert results(folder / "report") == expected[0]
        from_cache = disk.run([*REGRESS[:-1], "another", *CACHED], how=how, folder=folder)
        assert from_cache.status == status[0], from_cache.err
        assert results(folder / "another") == expected[0]
        return ended

    assert attempts(disk, template, try_at, few=1 if workers else 3) > 50


def test_a_merge_is_whole_when_it_is_done_again(disk: Machine, template: Path):
    for part in (1, 2):
        ended = disk.run([*REGRESS[:-1], f"part{part}", "--shard", f"{part}/2"], how=HERE, folder=template)
    before = contents(template)
    merge = ["merge", "-o", "report", "part1", "part2"]
    expected: list[object] = []

    def try_at(at: int, stays: bool, folder: Path) -> Ended:
        ended = disk.run(merge, at, stays, HERE, folder)
        check_told(ended, folder)
        if ended.status == 0:
            expected.append(results(folder / "report"))
            assert expected[-1] == expected[0]
        else:
            check_report(folder / "report", expected[0])
            assert disk.run(merge, how=HERE, folder=folder).status == 0
            assert results(folder / "report") == expected[0]
        assert {name: data for name, data in contents(folder).items() if name in before} == before
        return ended

    assert attempts(disk, template, try_at) > 10
    assert ended.status == 0


def test_an_acceptance_leaves_the_old_image_or_the_new_one(disk: Machine, template: Path):
    assert disk.run(REGRESS, how=HERE, folder=template).status == 0
    store = Store(template / "baselines")
    store.accept("stored", template / "report/cases/egl/physics-0/render.exr", {"inputs": "old"}, "old")
    old, accept = store.read("stored"), ["baseline", "accept", "stored", "--reason", "new"]
    expected: list[object] = []

    def try_at(at: int, stays: bool, folder: Path) -> Ended:
        ended = disk.run(accept, at, stays, folder=folder)
        check_told(ended, folder)
        store = Store(folder / "baselines")
        found = store.read("stored")
        if not at:
            expected.append(found)
        is_new = bool((found == expected[0]).all())
        assert is_new or (found == old).all()
        assert is_new or ended.status == 2
        assert (store.provenance("stored")["inputs"] == "old") != is_new
        assert disk.run(accept, folder=folder).status == 0
        assert (store.read("stored") == expected[0]).all()
        assert [each["why"] for each in store.decisions()][-1] == "new"
        assert {path.name for path in store.folder.iterdir()} == {"stored.exr", "stored.json", LOG}
        return ended

    assert attempts(disk, template, try_at) > 10


@IN_FULL
def test_the_plugin_fails_its_tests_in_a_line_and_the_next_session_is_whole(disk: Machine, template: Path):
    accept = [
        "-q",
        "-p",
        "no:cacheprovider",
        "--mrm-report",
        "pictures",
        "--mrm-backend",
        "egl",
        "--mrm-accept",
    ]

    def try_at(at: int, stays: bool, folder: Path) -> Ended:
        ended = disk.run(accept, at, stays, "pytest", folder)
        if ended.status:
            assert "No space left on device" in ended.out, ended.out
            assert "INTERNALERROR" not in ended.out + ended.err
            assert "Traceback" not in ended.out + ended.err
        assert at or not ended.status, ended.out
        again = disk.run(accept, how="pytest", folder=folder)
        assert again.status == 0, again.out
        compared = disk.run(accept[:-1], how="pytest", folder=folder)
        assert "1 pass" in compared.out and compared.status == 0, compared.out
        left = [name for name in contents(folder) if "unfinished" in name or "outcomes/" in name]
        assert not left
        return ended

    assert attempts(disk, template, try_at) > 10
