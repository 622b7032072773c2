"""What the evaluator's objects show of themselves is the call that makes them."""

import numpy as np
import pytest

import mrm_nodes.reference as ref

V, L = np.array([0.6, 0.0, 0.8]), np.array([-0.28, 0.0, 0.96])


@pytest.mark.parametrize(
    "call",
    [
        "Conductor(ior=(0.2, 0.9, 1.5), extinction=(3.0, 2.5, 2.0), alpha=0.3)",
        "Conductor(ior=1.5, extinction=0.0, alpha=(0.1, 0.2), distribution='phong', masking='vcavity')",
        "Dielectric(ior=1.33, alpha=0.25, tint=(0.5, 0.6, 0.7), scatter_mode='RT', retro_transmission=True)",
        "Dielectric(ior=1.5, alpha=0.1, retroreflectivity=0.5, thinfilm_thickness=500.0, thinfilm_ior=1.3)",
        "GeneralizedSchlick(color0=0.04, color82=0.9, color90=0.8, exponent=3.0, alpha=0.5)",
        "GeneralizedSchlick(color0=1.0)",
        "GeneralizedSchlick(color0=0.5, correlation='separable', energy_compensation='turquin')",
        "Conductor(ior=1.5, extinction=1.0, alpha=0.3, slope_correlation=0.5, mean_slope=(0.1, -0.2))",
    ],
)
def test_a_lobe_shows_the_call_that_makes_it(call: str):
    lobe = eval(call, vars(ref))
    assert repr(lobe) == call
    np.testing.assert_array_equal(eval(repr(lobe), vars(ref)).eval(V, L), lobe.eval(V, L))


@pytest.mark.parametrize(
    "call", ["GGX(ax=0.1)", "Beckmann(ax=0.1, ay=0.3, slope_correlation=0.5)", "Phong(ax=0.2)"]
)
def test_so_does_a_distribution(call: str):
    assert repr(eval(call, vars(ref))) == call


def test_of_many_values_their_number_is_shown():
    lobe = ref.Conductor(
        1.5, [2.0, 2.1, 2.2], np.linspace(0.1, 0.5, 200)[:, None], np.linspace(0, 1, 600).reshape(3, 200)
    )
    expected = "Conductor(ior=1.5, extinction=(2.0, 2.1, 2.2), alpha=<200 values>, retroreflectivity=<3 x 200 values>)"
    assert repr(lobe) == expected
    layered = repr(ref.Layer(ref.Leaf(lobe), ref.Leaf(ref.Lambert(0.5))))
    assert expected in layered
