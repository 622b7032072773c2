"""The default suite has what the nodes must be proven on."""

import re

import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.reference import checks
from mrm_nodes.regression.cases.builtin import ALPHAS, default_suite
from mrm_nodes.regression.cases.material_case import read
from mrm_nodes.regression.suites.selection import choose, clouds, suite
from mrm_nodes.regression.truth import material
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS
from mrm_nodes.render.scene import CameraLight, DirectionalLight, PointLight, SpotLight
from mrm_nodes.shadergen import generate_shader

SUITE = default_suite()
ONE_OF_EACH = list({case.material: case for case in SUITE}.values())
"""A case of every document."""


def given(case):
    """The values of a case by the names of its node's inputs."""
    return {name.removeprefix("bsdf/"): value for name, value in case.inputs.items()}


def test_there_are_at_least_eighty_cases_with_names_of_their_own():
    names = [case.name for case in SUITE]
    assert len(names) >= 80
    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+", name) for name in names)


@pytest.mark.parametrize("node", material.NODES)
def test_each_node_is_shown_at_every_width_and_weight(node):
    seen = {
        (case.inputs.get("bsdf/roughness"), case.inputs.get("bsdf/retroreflectivity"))
        for case in SUITE
        if case.node == node
    }
    assert {(alpha, weight) for alpha in ALPHAS for weight in (0.0, 0.5, 1.0)} <= seen


@pytest.mark.parametrize("node", material.NODES)
def test_each_node_is_shown_with_every_pair_and_a_pattern(node):
    values = [material.complete(case.node, given(case)) for case in SUITE if case.node == node]
    pairs = {(value["distribution"], value["masking"]) for value in values}
    assert {("ggx", "smith"), ("ggx", "vcavity"), ("beckmann", "smith"), ("beckmann", "vcavity")} <= pairs
    assert any("-on-retroreflectivity" in case.material for case in SUITE if case.node == node)


def test_every_mesh_and_every_kind_of_light_is_used():
    assert {case.mesh for case in SUITE} == {"sphere", "plane", "baluster"}
    lights = {type(light) for case in SUITE for light in case.lights}
    assert lights == {CameraLight, DirectionalLight, PointLight, SpotLight}


@pytest.mark.parametrize("node", material.NODES)
def test_each_node_is_shown_in_every_map_at_every_weight_and_mirrored(node):
    lit = [case for case in SUITE if case.node == node and case.environment is not None]
    seen = {(case.environment.name, case.inputs["bsdf/retroreflectivity"]) for case in lit}
    assert {(name, weight) for name in BUILT_IN_ENVIRONMENTS for weight in (0.0, 0.5, 1.0)} <= seen
    assert any(case.truth == "mirror" for case in lit)
    pairs = {(case.inputs.get("bsdf/distribution"), case.inputs.get("bsdf/masking")) for case in lit}
    assert {("ggx", "vcavity"), ("beckmann", "smith"), ("beckmann", "vcavity"), ("phong", "vcavity")} <= pairs
    prefiltered = {case.inputs["bsdf/retroreflectivity"] for case in lit if case.method == "prefilter"}
    assert prefiltered >= {0.0, 0.5, 1.0}
    assert {case.size for case in lit} == {(64, 64)}


def test_no_two_of_all_cases_have_one_name():
    names = [task.name for task in suite("full")]
    assert len(set(names)) == len(names) >= 500


def test_the_pairs_of_the_nodes_are_those_of_the_evaluator():
    assert set(material.PAIRS) == set(checks.PAIRS)
    choices = material.inputs_of(material.NODES[0])
    assert {name for name, _ in material.PAIRS} == set(choices["distribution"].choices)
    assert {name for _, name in material.PAIRS} == set(choices["masking"].choices)


def test_a_case_of_image_light_reads_the_map_itself():
    options = [dict(case.environment.options) for case in SUITE if case.environment is not None]
    assert any(each["filtered"] is False for each in options)


def test_every_case_has_inputs_that_its_node_knows():
    for case in SUITE:
        material.complete(case.node, given(case))


def test_cases_share_few_documents():
    assert len({case.material for case in SUITE}) <= 14


@pytest.mark.parametrize("case", ONE_OF_EACH, ids=lambda case: case.material)
def test_every_document_generates(case):
    document = read(case)
    assert document.validate()[0]
    assert case.node in generate_shader(document, element=case.element).pixel


def test_the_clouds_have_a_million_configurations_of_each_node():
    made = clouds()
    for node in material.NODES:
        assert sum(cloud.configurations for cloud in made if cloud.node == node) >= 1_000_000


def test_a_filter_is_a_part_of_the_name_or_a_pattern():
    tasks = suite()
    assert {task.name for task in choose(tasks, "figure5")} == {c.name for c in SUITE if "figure5" in c.name}
    assert [task.name for task in choose(tasks, "dielectric-weight0")] == [
        "dielectric-weight0.3",
        "dielectric-weight0",
    ]
    assert all(task.name.startswith("cloud-") for task in choose(tasks, "cloud-*"))


def test_a_filter_that_matches_nothing_is_an_error():
    with pytest.raises(MrmError, match=r"no case matches nothing-like-it; names are like cloud-"):
        choose(suite(), "nothing-like-it")


def test_an_unknown_suite_is_an_error():
    with pytest.raises(MrmError, match="unknown suite nightly"):
        suite("nightly")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"shininess": 1.0}, "has no input shininess; it has weight"),
        ({"distribution": "blinn"}, "unknown value blinn; it is one of ggx, beckmann, phong"),
        ({"ior": 1.5}, "1.5 is no color3"),
    ],
)
def test_an_input_that_a_node_does_not_have_is_an_error(values, message):
    with pytest.raises(MrmError, match=message):
        material.complete("mrm_conductor_bsdf", values)


def test_an_unknown_pattern_is_an_error():
    with pytest.raises(MrmError, match="unknown pattern plaid; known: stripes"):
        material.document("mrm_conductor_bsdf", {"weight": "plaid"})
