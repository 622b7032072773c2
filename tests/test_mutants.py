"""The instrument of `make mutants`: what a mutant is, and that a suite kills what it should and nothing else."""

from __future__ import annotations

import pytest
from mutants import Suite, chosen, functions, mutants

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.render import probe_backends

TEXT = """float mrm_made(vec3 V, float x)
{
    // The sum is a - b.
    float a = -x * 2.0 + V.z;
    if (a < 0.5)
    {
        a = sqrt(a);
    }
    return min(a, x);
}
"""


def test_every_operator_constant_and_term_has_mutants():
    (name,) = functions(f"uniform int u;\n\n{TEXT}\nvoid main() {{}}\n")
    made = {each.name.partition(": ")[2] for each in mutants(name, TEXT)}
    assert made >= {
        "float a =[- -> nothing]x * 2.0 + V.z;",
        "float a = -x[* -> /]2.0 + V.z;",
        "float a = -x[* 2.0 -> nothing]+ V.z;",
        "float a = -x *[2.0 -> 2.02]+ V.z;",
        "float a = -x *[2.0 -> (2.0 + 1.0e-3)]+ V.z;",
        "float a = -x * 2.0[+ -> -]V.z;",
        "float a = -x * 2.0[+ V.z -> nothing];",
        "float a = -x * 2.0 +[V -> L].z;",
        "float a = -x * 2.0 +[nothing -> -]V.z;",
        "float a = -x * 2.0 + V.[z -> x];",
        "if (a[< -> >]0.5)",
        "if ([a < 0.5 -> true])",
        "[a = sqrt(a); -> nothing]",
        "a =[sqrt(a) -> (a)];",
        "return[min -> max](a, x);",
    }
    assert not [each for each in made if "The sum" in each]
    assert all(each.applied(TEXT) != TEXT for each in mutants(name, TEXT))


def test_a_choice_is_the_same_for_a_seed_and_takes_every_function_in_turn():
    population = {name: list(mutants(name, TEXT)) for name in ("one", "two")}
    some = chosen(population, 6, seed=3)
    assert some == chosen(population, 6, seed=3) != chosen(population, 6, seed=4)
    assert [each.function for each in some] == ["one", "two"] * 3


def test_what_is_not_compiled_has_no_mutants(suite: Suite):
    """Of another release of MaterialX, or of another method of image light."""
    found = suite.mutants()
    assert {"mrm_reflection", "mrm_environment_radiance", "enumerations"} < set(found)
    assert not {"mrm_f0", "mrm_f90"} & set(found)
    texts = [each.before[each.start : each.end + 20] for each in found["mrm_energy_compensation"]]
    assert texts and not [each for each in texts if "21.0" in each]


@pytest.fixture(scope="module")
def suite(gl: None, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    backend = next(probe.backend for probe in probe_backends() if probe.works)
    cloud = Cloud("mrm_conductor_bsdf", "beckmann", configurations=4000)
    return Suite(backend, [cloud], tmp_path_factory.mktemp("mutants"))


@pytest.mark.parametrize(
    ("function", "start", "is_killed"),
    [
        ("mrm_smith", "float t = 1.0 / (1.0 +[0.3275911 -> 0.330867011]", True),
        # What no input changes any longer.
        ("mrm_conductor_bsdf", "[bsdf.response = response * weight; -> nothing]", True),
        ("mrm_reflection", "float VdotH = min(0.5 * size,[1.0 -> 1.01]", False),
    ],
)
def test_a_suite_fails_what_it_notices_and_nothing_else(
    suite: Suite, function: str, start: str, is_killed: bool
):
    (mutant,) = (each for each in suite.mutants()[function] if each.name.startswith(f"{function}: {start}"))
    assert (suite.killer(mutant, quickly=True) is not None) == is_killed


def test_what_does_not_compile_is_no_mutant(suite: Suite):
    (mutant,) = (each for each in suite.mutants()["mrm_is_vcavity"] if "MRM_VCAVITY[|| -> &&]" in each.name)
    broken = type(mutant)(**{**vars(mutant), "replacement": "&& &&"})
    with pytest.raises(MrmError, match="compile"):
        suite.killer(broken)
