"""The textured cases of the suites, each drawn first in a process of its own, on one backend and the other in turn.

That they agree with the evaluator, on both, is what `make regress` and `make regress-full` find out.
"""

import functools
import os
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes.regression.cases.textured import IMAGED, SUBJECTS, more_textured_cases, picture, textured_cases
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites.selection import suite
from mrm_nodes.render.context import BACKENDS

FULL = bool(os.environ.get("MRM_REGRESS_FULL"))
"""Whether every case is drawn in a process of its own, as `make regress-full` asks."""

CASES = textured_cases()
FIRST = {case.name: case for case in [*CASES, *more_textured_cases()]}
if not FULL:
    some = ("dielectric-image-on-color", "conductor-image-on-normal", "standard-image-on-all")
    FIRST = {name: FIRST[name] for name in some}


def test_every_image_is_another_one():
    pictures = [picture(imaged, number) for imaged in IMAGED for number in range(len(SUBJECTS))]
    assert len({each.tobytes() for each in pictures}) == len(pictures)
    assert all(each.min() >= 0.0 and each.max() <= 1.0 and np.ptp(each) > 0.1 for each in pictures)


def test_images_are_written_the_same_every_time(tmp_path):
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        folder.mkdir()
        textured_cases(folder)
    first, second = ({file.name: file.read_bytes() for file in each.iterdir()} for each in folders)
    assert first == second
    assert len(first) == len(CASES) + 12 + 3 * 4


def test_the_suites_have_them():
    default, full = ({task.name for task in suite(name, configurations=0)} for name in ("default", "full"))
    assert {case.name for case in CASES} < default < full
    for subject in SUBJECTS:
        assert {f"{subject}-image-on-{imaged}" for imaged in IMAGED} < full
    for surface in ("open_pbr", "gltf", "standard"):
        assert f"{surface}-image-on-all-in-sky" in default
        assert {
            f"{surface}-image-on-color-in-studio-retro{weight}" for weight in ("0", "0.5", "1")
        } < full - default


@pytest.fixture(scope="module")
def by_two(tmp_path_factory):
    """The cases that are drawn first below, of a backend, all in one run with two jobs: their folder and report."""

    @functools.cache
    def drawn(backend):
        folder = tmp_path_factory.mktemp("two")
        return folder, run_suite(list(FIRST.values()), folder, backend, jobs=2)

    return drawn


@pytest.mark.parametrize(
    ("worker", "name"),
    [
        # In groups, so that each process of a run with two makes the cases of one backend.
        pytest.param(backend, name, marks=pytest.mark.xdist_group(backend))
        for number, backend in enumerate(BACKENDS)
        for name in list(FIRST)[number :: len(BACKENDS)]
    ],
    indirect=["worker"],
)
def test_a_case_drawn_first_in_its_process_is_the_case_drawn_later(
    worker, by_two, name, tmp_path, monkeypatch
):
    """And it is compiled then, where the others' shaders may come from Mesa's cache."""
    backend = worker.backend
    folder, later = by_two(backend)
    monkeypatch.setenv("MESA_SHADER_CACHE_DISABLE", "true")
    report = run_suite([FIRST[name]], tmp_path, backend, jobs=1)
    (alone,) = report["cases"]
    (beside,) = (each for each in later["cases"] if each["name"] == name)
    assert alone["verdict"] == beside["verdict"] == "pass", (alone["message"], beside["message"])
    assert contents(tmp_path, alone) == contents(folder, beside)


def contents(folder: Path, record: dict) -> list[bytes]:
    return [(folder / record["files"][each]).read_bytes() for each in ("render_data", "reference_data")]
