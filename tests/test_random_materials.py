"""Random ordinary materials, as documents of many forms, under every kind of light: each is what physics says.

MRM_RANDOM says how many: 2 by default, and 300 in `make random`. The seed is the time; each failure says it, and
MRM_SEED makes the same materials again.
"""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_materials import write_case

from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.cases import material_case
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.verdict.compare import NOTICED
from mrm_nodes.render import probe_backends

COUNT = int(os.environ.get("MRM_RANDOM", "2"))
SEED = int(os.environ.get("MRM_SEED") or time.time())
ENOUGH = 100
"""Cases of which a share of 2 % says something."""


@pytest.fixture(scope="module", params=["egl", "osmesa"])
def worker(request: pytest.FixtureRequest, gl: None) -> Worker:
    probe = next(each for each in probe_backends() if each.backend == request.param)
    if not probe.works:
        is_required = probe.backend in os.environ.get("MRM_REQUIRE_BACKENDS", "").split(",")
        (pytest.fail if is_required else pytest.skip)(f"{probe.backend}: {probe.reason}")
    return Worker(request.param)


def test_each_is_what_physics_says(worker: Worker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    seen = np.zeros(2)
    own = material_case.compare

    def compare(image: Any, reference: Any, bounds: Any) -> Any:
        lit = reference > 0
        undecided = np.broadcast_to(bounds.p999_rel, reference.shape) > NOTICED
        seen[:] += (np.sum(lit & undecided), np.sum(lit))
        return own(image, reference, bounds)

    monkeypatch.setattr(material_case, "compare", compare)
    # A few of them are divided between the backends; many are drawn by each.
    # Fewer than there are kinds: other ones with each seed.
    few = range(SEED % 30 + (worker.backend == "osmesa"), SEED % 30 + COUNT, 2)
    numbers = range(COUNT) if COUNT >= ENOUGH else few
    undecided = []
    wrong = []
    for number in numbers:
        with warnings.catch_warnings():
            # Of a roughness of 0, which MaterialX raises.
            warnings.simplefilter("ignore", MrmWarning)
            case = write_case(tmp_path, SEED, number)
            outcome = worker.run(case, tmp_path / "report")
        said = f"{case.name}: {outcome.verdict}: {case.reason}: {outcome.message}: {outcome.figures}"
        if outcome.verdict == "undecided" and outcome.message:
            undecided.append(said)
        elif outcome.verdict != "pass" or outcome.truth != "physics":
            wrong.append(said)
    again = f"MRM_SEED={SEED} MRM_RANDOM={COUNT}"
    assert not wrong, f"{again}: {len(wrong)} of {len(numbers)}:\n" + "\n".join(wrong)
    if COUNT >= ENOUGH:
        told = f"{again}: undecided {len(undecided)} of {len(numbers)}, {seen[0]:.0f} of {seen[1]:.0f} lit values"
        assert len(undecided) <= 0.02 * len(numbers) and seen[0] <= 0.05 * seen[1], f"{told}:\n" + "\n".join(
            undecided
        )
        print(told, *undecided, sep="\n")
