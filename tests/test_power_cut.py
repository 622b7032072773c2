"""The power goes at any moment, and what was not synced is lost in part: a run goes on, its cache is sound, and
baselines are the old ones or the new.

MRM_FAULTS=200 has every moment; without it they are a sample.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from random import Random

import numpy as np
import pytest
from faulty_disk import contents, machine, without_time
from power_cut import Volume, lay_out, ways
from test_run import EGL, NO_OSMESA, Copy, Judges

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.baseline import LOG, Store
from mrm_nodes.regression.run import runner as run
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.runner import merge, run_suite
from mrm_nodes.render.images import write_exr

SEED = int(os.environ.get("MRM_FAULTS_SEED", "1"))
MOMENTS = None if os.environ.get("MRM_FAULTS") else 2


def tasks_of(folder: Path) -> list[Copy]:
    return [Copy(each, folder / f"{each}.mtlx") for each in "abc"]


def run_twice(tasks: str, root: str) -> None:
    """What the log is made of: a run, and another after a material was edited; then the shards of a third, merged."""
    _without_workers()
    folder, edited = Path(root), Path(tasks, "b.mtlx")
    for text in ("before", "after"):
        edited.write_text(text)
        run_suite(tasks_of(Path(tasks)), folder / "report", cache=Cache(folder / "cache"))
    for part in (1, 2):
        run_suite(
            tasks_of(Path(tasks)), folder / f"part{part}", shard=(part, 2), cache=Cache(folder / "cache")
        )
    merge([folder / "part1", folder / "part2"], folder / "merged")


def _without_workers() -> None:
    run.run_locally = Judges()
    run.probe_backends = lambda *_: [EGL, NO_OSMESA]


def accept_in_turn(images: str, root: str) -> None:
    store = Store(Path(root) / "baselines")
    for number in (1, 2, 3):
        store.accept("a", Path(images) / f"{number}.exr", {"inputs": str(number)}, str(number))


def results(report: Path) -> object:
    pictures = {name: data for name, data in contents(report).items() if name.startswith("cases/")}
    return without_time(report / "report.json"), pictures


def moments(volume: Volume, random: Random) -> list[int]:
    every = range(1, len(volume.changes) + 1)
    return list(every) if MOMENTS is None else random.sample(every, min(MOMENTS, len(every)))


@pytest.mark.filterwarnings("ignore::mrm_nodes.errors.MrmWarning")
def test_a_run_goes_on_after_a_power_cut_and_its_cache_is_sound(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(run, "run_locally", Judges())
    monkeypatch.setattr(run, "probe_backends", lambda *_: [EGL, NO_OSMESA])
    (materials := tmp_path / "materials").mkdir()
    for task in tasks_of(materials):
        task.file.write_text(f"contents of {task.name}")
    root, log = tmp_path / "disk", tmp_path / "log"
    with machine(root, log) as disk:
        volume = Volume(root, log)
        ended = disk.run([materials, root], how="test_power_cut:run_twice")
        assert ended.status == 0, ended.err
    volume.read_log()
    tasks = tasks_of(materials)
    run_suite(tasks, tmp_path / "whole")
    expected = results(tmp_path / "whole")
    random = Random(SEED)
    seen = set()
    for moment in moments(volume, random):
        for number, keep in enumerate(ways(random)):
            there = tmp_path / "there"
            lay_out(volume.after_a_cut(moment, keep), there)
            report = there / "report"
            try:
                told = run_suite(tasks, report, resume=True)
            except MrmError as error:
                # It was the run before the edit, whose journal is there.
                assert "the suite changed since: egl b changed; run without it" in str(error), (
                    moment,
                    number,
                )
                told = run_suite(tasks, report)
            assert results(report) == expected, (moment, number)
            assert {path.name for path in report.iterdir()} == {
                ".lock", "cases", "index.html", "journal", "report.json"
            }, (moment, number)  # fmt: skip
            run_suite(tasks, there / "from the cache", cache=Cache(there / "cache"))
            assert results(there / "from the cache") == expected, (moment, number)
            seen.add((told["environment"].get("resumed", 0), (there / "cache").exists()))
            parts = [there / "part1", there / "part2"]
            for part, place in enumerate(parts, 1):
                run_suite(tasks, place, shard=(part, 2), resume=True)
            merge(parts, there / "merged")
            assert results(there / "merged") == expected, (moment, number)
            shutil.rmtree(there)
    assert MOMENTS is not None or {resumed for resumed, _ in seen} >= {0, 1, 2, 3}


def test_baselines_are_the_old_ones_or_the_new_after_a_power_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    for number in (1, 2, 3):
        write_exr(tmp_path / f"{number}.exr", np.full((2, 2, 3), float(number)))
    root, log = tmp_path / "disk", tmp_path / "log"
    with machine(root, log) as disk:
        volume = Volume(root, log)
        ended = disk.run([tmp_path, root], how="test_power_cut:accept_in_turn")
        assert ended.status == 0, ended.err
    volume.read_log()
    random = Random(SEED)
    done = set()
    monkeypatch.setattr(os, "fsync", lambda file: None)  # here it only takes time
    for moment in moments(volume, random):
        for keep in ways(random):
            lay_out(volume.after_a_cut(moment, keep), there := tmp_path / "there")
            store = Store(there / "baselines")
            value = float(store.read("a")[0, 0, 0]) if store.standing("a") else 0.0
            if value:
                assert store.provenance("a")["inputs"] == f"{value:g}"
            done.add(value)
            store.accept("a", tmp_path / "3.exr", {"inputs": "new"}, "new")
            assert (store.read("a") == 3.0).all() and store.provenance("a")["inputs"] == "new"
            assert {path.name for path in store.folder.iterdir()} == {"a.exr", "a.json", LOG}
            shutil.rmtree(there)
    assert MOMENTS is not None or done == {0.0, 1.0, 2.0, 3.0}
    # Once it has returned, an acceptance stays.
    lay_out(volume.after_a_cut(len(volume.changes), lambda kind: False), tmp_path / "at last")
    assert (Store(tmp_path / "at last" / "baselines").read("a") == 3.0).all()
