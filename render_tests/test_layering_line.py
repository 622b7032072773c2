"""What MaterialX's rule of layering costs a case is told beside its verdict, and the same by every way to run it."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from mrm_nodes import cli
from mrm_nodes.regression.cases.digests import Inputs, key
from mrm_nodes.regression.report.terminal import layering_line
from mrm_nodes.regression.run.cluster import Cluster
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites import selection as suites

LAYERED = """<materialx version="1.39">
  <mrm_generalized_schlick_bsdf name="coat" type="BSDF">
    <input name="color0" type="color3" value="0.19, 0.19, 0.19" />
    <input name="color82" type="color3" value="0, 0, 0" />
    <input name="roughness" type="vector2" value="0.3, 0.3" />
    <input name="retroreflectivity" type="float" value="0.5" />
  </mrm_generalized_schlick_bsdf>
  <oren_nayar_diffuse_bsdf name="paper" type="BSDF" />
  <layer name="coated" type="BSDF">
    <input name="top" type="BSDF" nodename="coat" />
    <input name="base" type="BSDF" nodename="paper" />
  </layer>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="{shown}" /></surface>
  <surfacematerial name="{shown}_m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" />
  </surfacematerial>
</materialx>"""


SUITE = """
[defaults]
size = 8
[environments]
few = { map = "white", samples = 4 }
[[case]]
material = "coated.mtlx"
[case.matrix]
light = ["directional:-0.2,0,-1", "directional:-0.9,0,-0.3"]
[[case]]
material = "paper.mtlx"
[[case]]
material = "coated.mtlx"
name = "around"
environment = "few"
[[case]]
material = "coated.mtlx"
name = "stored"
truth = "baseline"
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two materials with layers, or without, as a suite."""
    folder = tmp_path_factory.mktemp("layering")
    for shown in ("coated", "paper"):
        (folder / f"{shown}.mtlx").write_text(LAYERED.format(shown=shown))
    (folder / "suite.toml").write_text(SUITE)
    return folder


def run(folder: Path, *more: str) -> tuple[int, dict]:
    """A run's exit status, and its cases by name."""
    with pytest.raises(SystemExit) as ended:
        cli.main(
            ["regress", "-o", str(folder), "--jobs", "1", "--cache", str(folder.parent / "cache"), *more]
        )
    report = json.loads((folder / "report.json").read_text())
    return ended.value.code, {case["name"]: case for case in report["cases"]}


def told(cases: dict) -> dict:
    return {
        name: case["details"]["layering"] for name, case in cases.items() if "layering" in case["details"]
    }


def keys(home: Path, layering: Any) -> dict[str, str]:
    tasks = suites.suite(str(home / "suite.toml"), layering=layering)
    return {task.name: key(task, "egl", Inputs(), "") for task in tasks}


@pytest.fixture(scope="module")
def first(home: Path, working_backend: str, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("first") / "report"
    _, cases = run(
        folder, "--suite", str(home / "suite.toml"), "--layering", "exact", "--backend", working_backend
    )
    return folder, cases


def test_cases_with_layers_tell_it_beside_their_verdict(first):
    _, cases = first
    layered = [name for name in cases if name not in ("paper", "stored")]
    assert sorted(told(cases)) == sorted(layered)
    for name in layered:
        assert cases[name]["verdict"] == "pass" and cases[name]["setup"]["layering"] == "exact"
        assert 0.05 < cases[name]["details"]["layering"]["max_rel"] < 0.6
        assert (
            0.0
            < cases[name]["details"]["layering"]["mean_rel"]
            < cases[name]["details"]["layering"]["max_rel"]
        )
    assert "image_light" in cases["around"]["details"]
    assert "layering" not in cases["paper"]["setup"] and "layering" not in cases["stored"]["setup"]
    line = layering_line(list(cases.values()))
    assert line.startswith("MaterialX's layering differs from the exact rule by at most ")
    assert line.endswith(", in 3 cases with layers")
    assert layering_line([cases["paper"]]) == ""


def test_every_way_to_run_tells_the_same(first, home: Path, working_backend: str, tmp_path: Path):
    folder, cases = first
    suite = ["--suite", str(home / "suite.toml"), "--backend", working_backend]
    _, cached = run(folder.parent / "again", *suite, "--layering", "exact")
    assert told(cached) == told(cases)
    # What has no layers is the same case without the question; what has is another.
    _, plain = run(folder.parent / "plain", *suite, "--filter", "paper")
    assert plain["paper"] == {**cases["paper"], "seconds": plain["paper"]["seconds"]}
    assert keys(home, "exact")["paper"] == keys(home, None)["paper"]
    assert all(keys(home, "exact")[name] != keys(home, None)[name] for name in told(cases))
    parts = []
    for number in (1, 2):
        parts.append(folder.parent / f"part{number}")
        run(parts[-1], *suite, "--layering", "exact", "--shard", f"{number}/2")
    with pytest.raises(SystemExit):
        cli.main(["merge", "-o", str(folder.parent / "merged"), *map(str, parts)])
    merged = json.loads((folder.parent / "merged" / "report.json").read_text())
    assert told({case["name"]: case for case in merged["cases"]}) == told(cases)
    tasks = suites.choose(suites.suite(str(home / "suite.toml"), layering="exact"), "-0.9")
    with ThreadPoolExecutor(1) as pool:
        report = run_suite(tasks, tmp_path / "far", working_backend, cluster=Cluster(pool))
    (far,) = report["cases"]
    assert far["details"] == cases[far["name"]]["details"]


def test_a_run_is_not_resumed_by_another_rule(first, home: Path, working_backend: str, capsys):
    folder, cases = first
    suite = ["--suite", str(home / "suite.toml"), "--backend", working_backend, "--resume"]
    kept = (folder / "report.json").read_bytes()
    status, _ = run(folder, *suite)
    assert status == 2 and (folder / "report.json").read_bytes() == kept
    assert "--resume: the suite changed since" in capsys.readouterr().err
    _, resumed = run(folder, *suite, "--layering", "exact", "--no-cache")
    assert told(resumed) == told(cases)
