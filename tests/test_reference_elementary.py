"""The evaluator's own elementary functions against SciPy, and against exact arithmetic."""

import mpmath
import numpy as np
import pytest
from numba import njit
from scipy import special

from mrm_nodes.reference.elementary import (
    exponential,
    gaussian_excess,
    inverse_error_function,
    logarithm,
    scaled_error_complement,
    sine_cosine,
)


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


def test_the_logarithm_is_exact_to_rounding():
    rng = np.random.default_rng(0)
    for x in [*10.0 ** rng.uniform(-300.0, 300.0, 500), *rng.uniform(0.5, 2.0, 500), 1.0, 2.0**-1022]:
        assert logarithm(x) == pytest.approx(float(mpmath.log(x)), rel=3e-16, abs=1e-300)


def test_the_sine_and_cosine_of_turns_are_exact_to_rounding():
    turns = np.concatenate([np.random.default_rng(0).uniform(-3.0, 3.0, 1000), np.arange(-16, 17) / 8.0])
    with mpmath.workdps(30):
        for x in turns:
            angle = 2 * mpmath.pi * mpmath.mpf(x)
            assert sine_cosine(x) == pytest.approx((mpmath.sin(angle), mpmath.cos(angle)), rel=0, abs=2.5e-16)


def test_the_complement_of_the_error_function_is_exact_to_rounding():
    for a in [0.0, *np.geomspace(1e-10, 26.9, 1000)]:
        exact = mpmath.exp(mpmath.mpf(a) ** 2) * mpmath.erfc(a)
        assert scaled_error_complement(a) == pytest.approx(float(exact), rel=1e-15)


def test_the_inverse_of_the_error_function_is_exact_to_rounding():
    """Where 1 - y is known to rounding only, the complement's inverse is what is exact."""
    for y in np.random.default_rng(0).uniform(-1.0, 1.0, 300):
        assert inverse_error_function(y) == pytest.approx(float(mpmath.erfinv(y)), rel=0, abs=5e-16)
    with mpmath.workdps(40):
        for y in 1.0 - 2.0 ** -np.arange(2.0, 53.0):
            x = mpmath.mpf(inverse_error_function(y))
            newton = (mpmath.erfc(x) - (1 - mpmath.mpf(y))) * mpmath.exp(x * x) * mpmath.sqrt(mpmath.pi) / 2
            assert abs(newton) <= 4e-16 * x
            assert inverse_error_function(-y) == -inverse_error_function(y)
