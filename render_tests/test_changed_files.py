"""A file that changed is looked at again, however a document names it: with the cache, and on a cluster."""

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from mrm_nodes import cli
from mrm_nodes.regression.run.cluster import Cluster
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.render.images import write_png

SHOWN = """<materialx version="1.39">
<nodedef name="ND_dimmed" node="dimmed">
  <input name="in" type="color3" value="0, 0, 0" /><output name="out" type="color3" />
</nodedef>
<implementation name="IM_dimmed" nodedef="ND_dimmed" target="genglsl" file="glsl/dimmed.glsl" function="dimmed" />
<image name="i" type="color3"><input name="file" type="filename" value="NAME" /></image>
<dimmed name="d" type="color3"><input name="in" type="color3" nodename="i" /></dimmed>
<surface_unlit name="s" type="surfaceshader">
  <input name="emission_color" type="color3" nodename="d" />
</surface_unlit>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""
DIMMED = '// #include "by.glsl"\nvoid dimmed(vec3 i, out vec3 o) { o = i * BY; }\n'


def verdicts(folder, backend):
    """Of a run with the cache."""
    report = folder.parent / "report"
    with pytest.raises(SystemExit):
        cli.main(["regress", "--suite", str(folder), "-o", str(report), "--backend", backend, "--jobs", "1"])
    cases = json.loads((report / "report.json").read_text())["cases"]
    assert len(cases) == 2, cases
    return {case["verdict"] for case in cases}


def test_both_spellings_fail_once_the_file_changed_and_pass_once_it_is_as_before(
    working_backend, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = tmp_path / "suite"
    for name in ("tex", "glsl"):
        (folder / name).mkdir(parents=True)
    for name, file in (("slash", "tex/a.png"), ("backslash", "tex\\a.png")):
        (folder / f"{name}.mtlx").write_text(SHOWN.replace("NAME", file))
    picture, source = folder / "tex/a.png", folder / "glsl/by.glsl"
    write_png(picture, np.full((8, 8, 3), 0.5))
    (folder / "glsl/dimmed.glsl").write_text(DIMMED)
    source.write_text("#define BY 0.5\n")
    assert verdicts(folder, working_backend) == {"error"}
    accept = ["baseline", "accept", "*", "--reason", "seen", "--report", str(tmp_path / "report")]
    with pytest.raises(SystemExit) as ended:
        cli.main([*accept, "--suite", str(folder)])
    assert ended.value.code == 0
    assert verdicts(folder, working_backend) == {"pass"}
    for file, change in ((picture, None), (source, "#define BY 0.6\n")):
        before = file.read_bytes()
        if change is None:
            write_png(picture, np.full((8, 8, 3), 0.9))
        else:
            source.write_text(change)
        assert verdicts(folder, working_backend) == {"fail"}
        with ThreadPoolExecutor(1) as pool:
            report = run_suite(
                suites.suite(str(folder)), tmp_path / "far", working_backend, cluster=Cluster(pool)
            )
        assert {case["verdict"] for case in report["cases"]} == {"fail"}, json.dumps(
            report["cases"], indent=1
        )
        file.write_bytes(before)
        assert verdicts(folder, working_backend) == {"pass"}
