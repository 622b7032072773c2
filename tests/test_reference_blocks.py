"""Arrays reach a kernel in one piece, in strides, or as what is left of a block: the numbers are the same."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mrm_nodes.reference import Conductor, Dielectric, GeneralizedSchlick
from mrm_nodes.reference.block import BLOCK
from mrm_nodes.reference.bsdf import Lobe

Array = NDArray[np.float64]

COUNT = 7 * BLOCK + 5

LOBES: dict[str, Callable[[Array, str], Lobe]] = {
    "conductor": lambda w, c: Conductor((0.2, 0.9, 1.1), (3.9, 2.4, 2.1), (0.3, 0.1), w, correlation=c),
    "dielectric": lambda w, c: Dielectric(1.5, 0.2, retroreflectivity=w, tint=(1.0, 0.5, 0.2), correlation=c),
    "film": lambda w, c: Dielectric(1.5, 0.2, retroreflectivity=w, thinfilm_thickness=400.0, correlation=c),
    "schlick": lambda w, c: GeneralizedSchlick(
        (0.9, 0.4, 0.1), 0.8, alpha=0.3, retroreflectivity=w, correlation=c
    ),
}


def directions(rng: np.random.Generator) -> Array:
    d = rng.normal(size=(COUNT, 3))
    return d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("correlation", ["height", "separable"])
@pytest.mark.parametrize("weight", ["0", "0.3", "1", "varies"])
@pytest.mark.parametrize("name", LOBES)
def test_strides_make_no_difference(name: str, weight: str, correlation: str) -> None:
    rng = np.random.default_rng(5)
    v, l = directions(rng), directions(rng)  # noqa: E741
    share = rng.choice([0.0, 0.3, 1.0], COUNT) if weight == "varies" else np.asarray(float(weight))
    lobe = LOBES[name](share, correlation)
    value = lobe.eval(v, l)
    assert (value > 0.0).any()
    strided = np.repeat(v, 2, axis=1)[:, ::2]
    assert not strided.flags.c_contiguous
    np.testing.assert_allclose(lobe.eval(strided, l), value, rtol=1e-13)


@pytest.mark.parametrize("count", [1, BLOCK])
@pytest.mark.parametrize("cosine", [5e-324, 2.3e-308, 1e-160, 1e-77, 1e-59])
@pytest.mark.parametrize("name", LOBES)
def test_directions_along_the_surface_have_a_finite_value(name: str, cosine: float, count: int) -> None:
    v = np.tile([1.0, 0.0, cosine], (count, 1))
    for correlation in ("height", "separable"):
        for l in ([1.0, 0.0, cosine], [-1.0, 0.0, cosine], [0.0, 1.0, cosine], [-1.0, 0.0, -cosine]):  # noqa: E741
            value = LOBES[name](np.asarray(0.3), correlation).eval(v, np.tile(l, (count, 1)))
            assert np.isfinite(value).all()
            assert (value >= 0.0).all()


@pytest.mark.parametrize("what", ["alpha", "retroreflectivity", "ior", "tint", "thinfilm_thickness"])
def test_one_parameter_that_varies_is_each_configuration_s_own(what: str) -> None:
    rng = np.random.default_rng(6)
    v, l = directions(rng), directions(rng)  # noqa: E741
    values = {
        "alpha": rng.uniform(0.1, 0.5, (COUNT, 2)),
        "retroreflectivity": rng.random(COUNT),
        "ior": rng.uniform(1.2, 2.0, COUNT),
        "tint": rng.random((COUNT, 3)),
        "thinfilm_thickness": rng.uniform(0.0, 600.0, COUNT),
    }[what]
    fixed: dict[str, Any] = {"ior": 1.5, "alpha": 0.2}
    together = Dielectric(**(fixed | {what: values})).eval(v, l)
    lit = np.flatnonzero(together[:, 0] > 0.0)
    for k in lit[[0, len(lit) // 2, -1]]:
        alone = Dielectric(**(fixed | {what: values[k]})).eval(v[k], l[k])
        np.testing.assert_allclose(together[k], alone, rtol=1e-13)
