"""Very many random configurations of each node once: none that is not finite, none over its bound, in any decade of
alpha and of both cosines. `make decades`, or `MRM_CONFIGURATIONS=100000000 pytest -s render_tests/test_decades.py`.
"""

import os

import pytest

from mrm_nodes.regression.cases.cloud import Cloud, Decade, attributes_of, tally
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.material import PAIRS
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import generate_shader

CONFIGURATIONS = int(os.environ.get("MRM_CONFIGURATIONS", "0"))
SEED = int(os.environ.get("MRM_SEED", "1"))

pytestmark = pytest.mark.skipif(
    CONFIGURATIONS == 0, reason="MRM_CONFIGURATIONS is not set: the suite's clouds are drawn by test_suite"
)


@pytest.mark.parametrize("node", material.NODES)
def test_no_configuration_is_over_its_bound(working_backend, node):
    renderer = Renderer(working_backend)
    document = material.document(node, attributes=attributes_of(node))
    shader = generate_shader(document, element=material.MATERIAL)
    each = -(-CONFIGURATIONS // len(PAIRS))
    found: dict[tuple[str, float], Decade] = {}
    for pair in PAIRS:
        for where, decade in tally(Cloud(node, *pair, each, SEED), renderer, shader).items():
            found[where] = found.get(where, Decade()).joined(decade)
    print(f"\n{node}, {each * len(PAIRS)} configurations, seed {SEED}")
    for (axis, low), decade in found.items():
        beyond = 100 * decade.unusual / max(decade.configurations, 1)
        print(
            f"| {axis} from {low:g} | {decade.configurations} | {decade.not_finite} | {decade.over} "
            f"| {decade.most:.2f} | {beyond:.4f} % |"
        )
    for where, decade in found.items():
        assert (decade.not_finite, decade.over) == (0, 0), where
        assert decade.unusual <= 1e-3 * decade.configurations, where
