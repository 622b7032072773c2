"""Acceptances that meet: in two processes, and in the middle of a power cut."""

from __future__ import annotations

import itertools
import json
import multiprocessing
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes import files
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases import baseline
from mrm_nodes.regression.cases.baseline import LOG, Store
from mrm_nodes.render.images import write_exr

ROUNDS = 400


def image(folder: Path, value: float) -> Path:
    path = folder / f"{value:g}.exr"
    write_exr(path, np.full((4, 4, 3), value))
    return path


def accept_in_turns(folder: Path, value: float, barrier: Any, told: Any) -> None:
    """What one of two processes does: each time it sees what is accepted, then accepts its own."""
    store = Store(folder / "baselines")
    for _ in range(ROUNDS):
        barrier.wait()
        seen = store.standing("a")
        barrier.wait()
        try:
            store.accept("a", folder / f"{value:g}.exr", {"inputs": "x"}, f"{value:g}", seen)
            told.put((value, ""))
        except MrmError as error:
            told.put((value, str(error)))


def test_of_two_processes_that_accept_under_one_name_one_wins_each_time(tmp_path: Path):
    for value in (1.0, 2.0):
        image(tmp_path, value)
    context = multiprocessing.get_context("spawn")
    barrier, told = context.Barrier(2, timeout=120), context.Queue()
    processes = [
        context.Process(target=accept_in_turns, args=(tmp_path, value, barrier, told)) for value in (1.0, 2.0)
    ]
    for process in processes:
        process.start()
    results = [told.get(timeout=240) for _ in range(2 * ROUNDS)]
    for process in processes:
        process.join(60)
        assert process.exitcode == 0
    winners = [value for value, complaint in results if not complaint]
    losers = [complaint for _, complaint in results if complaint]
    assert len(winners) == len(losers) == ROUNDS
    assert all("accepted another image meanwhile" in complaint for complaint in losers)
    store = Store(tmp_path / "baselines")
    decisions = list(store.decisions())
    assert len(decisions) == len({each["number"] for each in decisions}) == ROUNDS
    assert sorted(path.name for path in store.folder.iterdir()) == ["a.exr", "a.json", LOG]
    assert (store.read("a") == float(decisions[-1]["why"])).all()


def test_what_was_accepted_after_one_looked_is_not_replaced(tmp_path: Path):
    store = Store(tmp_path / "baselines")
    seen = store.standing("a")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, "first")
    with pytest.raises(MrmError, match=r"^a: .* accepted another image meanwhile \(.* UTC\): look at"):
        store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, "second", seen)
    assert (store.read("a") == 1.0).all()
    assert [each["why"] for each in store.decisions()] == ["first"]


def test_a_store_that_is_held_is_waited_for_and_then_a_clear_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)
    monkeypatch.setattr(baseline, "PATIENCE", 0.05)
    holder = os.open(store.folder / LOG, os.O_RDWR)
    assert files.lock(holder)
    with pytest.raises(
        MrmError, match=r"baselines: somebody else has been accepting there for 0\.05 s; try again"
    ):
        store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, None)
    os.close(holder)
    store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, None)


def test_an_acceptance_that_was_cut_short_before_its_line_is_logged_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = Store(tmp_path / "baselines")
    with monkeypatch.context() as patch:
        patch.setattr(baseline, "_append", lambda *_: stop())
        with pytest.raises(KeyboardInterrupt):
            store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, "first")
    with (store.folder / LOG).open("a") as file:
        file.write('{"what": "acc')
    store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, "second")
    assert [each["why"] for each in store.decisions()] == ["first", "second"]


def stop() -> None:
    raise KeyboardInterrupt


class Disk:
    """A folder as its disk holds it: what is written or renamed counts only from the next fsync on.

    Until then any part of the renames may be there after a power cut, in any combination, and a file that was
    not synced is empty.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.names = {path.name: path.stat().st_ino for path in folder.iterdir()}
        self.contents = {path.stat().st_ino: path.read_bytes() for path in folder.iterdir()}
        self.pending: list[tuple[str | None, str, int]] = []  # old name, new name, file

    def synced(self, path: Path) -> None:
        if path == self.folder:
            for change in self.pending:
                self.names = self.changed(self.names, change)
            self.pending = []
        else:
            self.contents[path.stat().st_ino] = path.read_bytes()

    def renamed(self, old: Path, new: Path) -> None:
        self.pending.append((old.name, new.name, new.stat().st_ino))

    @staticmethod
    def changed(names: dict[str, int], change: tuple[str | None, str, int]) -> dict[str, int]:
        old, new, file = change
        return {name: each for name, each in names.items() if name != old} | {new: file}

    def after_a_power_cut(self) -> Iterator[dict[str, bytes]]:
        """Every state of the folder that there may be."""
        for kept in itertools.product((False, True), repeat=len(self.pending)):
            names = self.names
            for change, keep in zip(self.pending, kept, strict=True):
                names = self.changed(names, change) if keep else names
            yield {name: self.contents.get(file, b"") for name, file in names.items()}


def test_a_power_cut_leaves_the_old_image_or_the_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, "old")
    disk = Disk(store.folder)
    states: list[dict[str, bytes]] = []

    def sync(handle: int) -> None:
        path = Path(f"/proc/self/fd/{handle}").readlink()
        states.extend(disk.after_a_power_cut())
        disk.synced(path)
        states.extend(disk.after_a_power_cut())

    rename = Path.replace

    def replace(old: Path, new: Path) -> Path:
        done = rename(old, new)
        disk.renamed(old, new)
        states.extend(disk.after_a_power_cut())
        return done

    new = image(tmp_path, 2.0)
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", sync)
        patch.setattr(Path, "replace", replace)
        store.accept("a", new, {"inputs": "y"}, "new")
    assert not disk.pending
    seen = set()
    for number, state in enumerate(states):
        there = Store(tmp_path / f"cut{number}")
        there.folder.mkdir()
        for name, contents in state.items():
            (there.folder / name).write_bytes(contents)
        value = float(there.read("a")[0, 0, 0])
        assert there.provenance("a")["accepted"]["why"] == {1.0: "old", 2.0: "new"}[value]
        seen.add(value)
        there.accept("a", new, {"inputs": "z"}, "after")
        assert (there.read("a") == 2.0).all() and there.provenance("a")["inputs"] == "z"
        assert json.loads((there.folder / LOG).read_text().splitlines()[-1])["why"] == "after"
    assert seen == {1.0, 2.0} and len(states) > 8


def test_a_log_that_is_a_link_or_a_pipe_is_refused_before_anything_is_changed(tmp_path: Path):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)
    (tmp_path / "mine").write_text("kept")
    for trap in (lambda path: path.symlink_to(tmp_path / "mine"), os.mkfifo):
        (store.folder / LOG).unlink()
        trap(store.folder / LOG)
        with pytest.raises(MrmError, match="baselines: cannot be written"):
            store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, None)
        assert (store.read("a") == 1.0).all()
    assert (tmp_path / "mine").read_text() == "kept"


@pytest.mark.parametrize("name", ["a.exr", "a.json"])
def test_a_pipe_in_place_of_a_baseline_is_not_waited_for(tmp_path: Path, name: str):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)
    (store.folder / name).unlink()
    os.mkfifo(store.folder / name)
    with pytest.raises(MrmError):
        store.read("a")
    store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, None)
    assert (store.read("a") == 2.0).all()
