"""A disk that is full or may not be written: one clear line, and nothing that was done is lost."""

import shutil
import subprocess
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.render.images import write_exr

CASES = [case for case in default_suite() if case.name.startswith("conductor-ggx-smith")]


@contextmanager
def mounted(folder, *options):
    """A small file system of its own."""
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("file systems cannot be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_disk_that_fills_up_ends_the_run_and_what_is_done_stays(working_backend, tmp_path):
    with mounted(tmp_path / "disk", "size=2m") as disk:
        ballast = disk / "ballast"
        ballast.write_bytes(bytes(700_000))
        with pytest.raises(
            MrmError, match="No space left on device; what is done is kept: go on with --resume"
        ):
            run_suite(CASES, disk / "report", working_backend, 2)
        done = len(list((disk / "report" / "cases").glob("*/*")))
        assert 0 < done < len(CASES)
        subprocess.run(["mount", "-o", "remount,size=20m", str(disk)], check=True)
        report = run_suite(CASES, disk / "report", working_backend, 2, resume=True)
        assert report["summary"]["passed"] == len(CASES)
        assert 0 < report["environment"]["resumed"] <= done


def test_a_disk_is_full_though_the_file_that_failed_is_gone_and_left_its_room(
    working_backend, tmp_path, monkeypatch
):
    image = np.random.default_rng(1).random((300, 400, 3), np.float32)
    with mounted(tmp_path / "disk", "size=1m") as disk:
        with pytest.raises(MrmError, match=r"a\.exr: cannot be written: No space left on device"):
            write_exr(disk / "a.exr", image)
        assert list(disk.iterdir()) == []
        monkeypatch.setattr("mrm_nodes.regression.run.runner._ROOM", 0)
        cases = [replace(case, size=(512, 512)) for case in CASES[:2]]
        with pytest.raises(MrmError, match="No space left on device; what is done is kept"):
            run_suite(cases, disk / "report", working_backend)


def test_a_cache_on_a_full_disk_costs_a_warning(working_backend, tmp_path):
    with mounted(tmp_path / "disk", "size=100k") as disk:
        with pytest.warns(match="results are not cached: No space left on device"):
            report = run_suite(CASES[:3], tmp_path / "report", working_backend, cache=Cache(disk / "cache"))
        assert report["summary"]["passed"] == 3


def test_a_folder_that_may_not_be_written_is_said_at_once(tmp_path):
    with mounted(tmp_path / "disk", "size=1m", "ro") as disk:
        with pytest.raises(
            MrmError, match="cannot be written: Read-only file system; choose another with -o"
        ):
            run_suite(CASES, disk / "report")
        with pytest.raises(
            MrmError, match="cannot be written: Read-only file system; choose another with -o"
        ):
            run_suite(CASES, disk)
