"""The cache and a run without it come to the same: every verdict, every figure, every file."""

import contextlib
import json
import os
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import pytest

from mrm_nodes.errors import MrmWarning
from mrm_nodes.library import materials_path
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SuiteError

CASES = Path(__file__).parents[1] / ".." / "shared" / "cases"
"""Small documents as other programs write them, where they lie beside the checkout."""

FULL = bool(os.environ.get("MRM_REGRESS_FULL"))
"""Whether the default suite is run, as `make regress-full` asks, and not the others."""


def default_tasks(tmp_path):
    return [*suites.clouds(20_000), *small(default_suite())]


def finished(tmp_path):
    shutil.copytree(materials_path(), tmp_path / "materials")
    return small(load(tmp_path / "materials").cases)


def given(tmp_path):
    if not CASES.is_dir():
        pytest.skip(f"no {CASES}")
    shutil.copytree(CASES, tmp_path / "cases")
    cases = []
    for number, file in enumerate(sorted((tmp_path / "cases").rglob("*.mtlx"))):
        suite = file.with_name("suite.toml")
        suite.write_text(
            f"[[case]]\nmaterial = {json.dumps(file.name)}\nname = 'case-{number}-{{element}}'\n"
        )
        with contextlib.suppress(SuiteError), warnings.catch_warnings():
            warnings.simplefilter("ignore", MrmWarning)
            cases += load(suite).cases
    return small(cases)


def small(cases):
    return [replace(case, size=(32, 32)) for case in cases]


SUITES = (
    {"the default suite": default_tasks}
    if FULL
    else {"the finished materials": finished, "the case files": given}
)


def results(report):
    """All that a report says of its cases, but for the time that they took."""
    return {case["name"]: {**case, "seconds": None} for case in report["cases"]}


def contents(folder):
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.joinpath("cases").rglob("*"))
        if file.is_file()
    }


@pytest.mark.parametrize("name", SUITES)
@pytest.mark.filterwarnings("ignore::mrm_nodes.errors.MrmWarning")
def test_the_cache_agrees_with_a_run_without_it(working_backend, tmp_path, name):
    tasks = SUITES[name](tmp_path)
    cache = Cache(tmp_path / "cache")
    without = run_suite(tasks, tmp_path / "without", working_backend, 2)
    filling = run_suite(tasks, tmp_path / "filling", working_backend, 2, cache=cache)
    filled = run_suite(tasks, tmp_path / "filled", working_backend, 2, cache=cache)
    verdicts = [case["verdict"] for case in without["cases"]]
    assert verdicts.count("pass") > 0
    assert filling["environment"]["cached"] == 0
    assert filled["environment"]["cached"] == len(verdicts) - verdicts.count("error")
    assert results(without) == results(filling) == results(filled)
    assert contents(tmp_path / "without") == contents(tmp_path / "filling") == contents(tmp_path / "filled")
