"""The evaluator's own exponential and Gaussian integral against SciPy."""

import numpy as np
from numba import njit
from scipy import special

from mrm_nodes.reference.elementary import exponential, gaussian_excess


@njit(error_model="numpy")
def exponentials(x, out):
    for i in range(x.size):
        out[i] = exponential(x[i])


@njit(error_model="numpy")
def excesses(x, out):
    for i in range(x.size):
        out[i] = gaussian_excess(x[i])


def asked(function, x):
    out = np.empty_like(x)
    function(x, out)
    return out


def test_the_exponential_is_that_of_scipy():
    x = np.concatenate([np.linspace(-707.0, 700.0, 200_001), -np.geomspace(1e-20, 1.0, 1000), [0.0]])
    np.testing.assert_allclose(asked(exponentials, x), np.exp(x), rtol=1e-15)
    assert not asked(exponentials, np.array([-709.0, -1e300, -np.inf])).any()


def test_the_gaussian_integral_is_that_of_scipy():
    """The projected area of Beckmann over its stretched sine, a (1 + erf a) / 2 + e^(-a²) / (2 sqrt π)."""
    a = np.concatenate([np.linspace(0.0, 30.0, 200_001), np.geomspace(1e-20, 1e3, 1000), [0.0]])
    area = 0.5 * a * special.erfc(-a) + np.exp(-a * a) / (2.0 * np.sqrt(np.pi))
    np.testing.assert_allclose(a + asked(excesses, a), area, rtol=1e-15)
    assert asked(excesses, np.array([1e300])) == 0.0
