"""The page on suites holds a suite that is sound."""

from __future__ import annotations

import re
from pathlib import Path

from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SETTINGS, CaseTable

PAGE = (Path(__file__).parents[1] / "docs" / "suites.md").read_text(encoding="utf-8")
SIGN = """<materialx version="1.39">
<mrm_conductor_bsdf name="beads" type="BSDF" />
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="beads" /></surface>
<surfacematerial name="stop" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""


def test_the_example_makes_the_cases_that_it_says(tmp_path: Path):
    (example,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "signs").mkdir()
    (tmp_path / "meshes").mkdir()
    (tmp_path / "signs" / "stop.mtlx").write_text(SIGN)
    (tmp_path / "meshes" / "post.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "suite.toml").write_text(example)
    cases = {case.name: case for case in load(tmp_path / "suite.toml").cases}
    meshes, weights = ("sphere", "post"), ("0", "0.5", "1")
    assert set(cases) == {"stop", "stop-at-dusk"} | {f"stop-{m}-{w}" for m in meshes for w in weights}
    assert cases["stop-post-1"].tolerance.max_rel == 1e-3
    assert len(cases["stop"].lights) == 2


def test_every_key_has_its_row():
    rows = "\n".join(line.split("|")[1] for line in PAGE.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`(\w+)`", rows)) == {*SETTINGS, *CaseTable.model_fields}
