"""Against Mitsuba 3's rough conductor and dielectric, which no one here wrote.

`MRM_REQUIRE_MITSUBA=1` makes a Mitsuba that is missing or does not run a failure.
"""

import os

import numpy as np
import pytest

from mrm_nodes import reference as ref

REQUIRED = os.environ.get("MRM_REQUIRE_MITSUBA", "0") not in ("", "0")
try:
    import mitsuba
except ImportError:
    if REQUIRED:
        raise
    pytest.skip("Mitsuba is not installed: pip install 'mitsuba>=3.5.2,<3.6'", allow_module_level=True)

COUNT = 20_000
#: One call each in the scalar variant, which needs no LLVM.
SCALAR_COUNT = 400


@pytest.fixture(scope="module")
def mi():
    for variant in ("llvm_ad_rgb", "scalar_rgb"):
        if variant not in mitsuba.variants():
            continue
        try:
            mitsuba.set_variant(variant)
            if variant == "llvm_ad_rgb":
                import drjit

                drjit.eval(mitsuba.Float(1.0) + 1.0)
        except (ImportError, RuntimeError):
            continue
        return mitsuba
    message = f"no variant of Mitsuba {mitsuba.__version__} works here"
    pytest.fail(message) if REQUIRED else pytest.skip(message)


def directions(seed, sides):
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(COUNT, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[:, 2] = np.maximum(np.abs(d[:, 2]), 0.02) * rng.choice(sides, COUNT)
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    # Both sides get what float32 holds.
    return d.astype(np.float32).astype(np.float64)


def ask(mi, plugin, v, l):  # noqa: E741
    """f |cos| and pdf of a Mitsuba BSDF, as arrays."""
    bsdf = mi.load_dict(plugin)
    context = mi.BSDFContext()
    values, densities = [], []
    if mi.variant().startswith("scalar"):
        for one, other in zip(v[:SCALAR_COUNT], l[:SCALAR_COUNT], strict=True):
            si = mi.SurfaceInteraction3f()
            si.wi = mi.Vector3f(*one)
            values.append(np.array(bsdf.eval(context, si, mi.Vector3f(*other))))
            densities.append(bsdf.pdf(context, si, mi.Vector3f(*other)))
        return np.array(values), np.array(densities)
    import drjit

    si = drjit.zeros(mi.SurfaceInteraction3f, len(v))
    si.wi = mi.Vector3f(*(mi.Float(v[:, k].astype(np.float32)) for k in range(3)))
    wo = mi.Vector3f(*(mi.Float(l[:, k].astype(np.float32)) for k in range(3)))
    value = bsdf.eval(context, si, wo)
    return np.stack([np.array(value[k]) for k in range(3)], axis=-1), np.array(bsdf.pdf(context, si, wo))


def unit(d):
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


def agree(ours, theirs, scale):
    """To float32: relative where the value matters, and few outliers where their arithmetic cancels."""
    error = np.abs(ours - theirs) / np.maximum(np.abs(ours), scale)
    assert np.quantile(error, 0.99) < 3e-4
    assert error.max() < 3e-2


@pytest.mark.parametrize("alpha", [(0.1, 0.1), (0.5, 0.2), (1.0, 1.0)])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_rough_conductor(mi, distribution, alpha):
    ior, extinction = (0.2, 0.92, 1.1), (3.9, 2.45, 2.14)
    v, l = directions(1, (1,)), directions(2, (1,))  # noqa: E741
    plugin = {
        "type": "roughconductor", "distribution": distribution, "alpha_u": alpha[0], "alpha_v": alpha[1],
        "eta": {"type": "srgb", "color": list(ior), "unbounded": True},
        "k": {"type": "srgb", "color": list(extinction), "unbounded": True},
    }  # fmt: skip
    values, densities = ask(mi, plugin, v, l)
    v, l = unit(v[: len(values)]), unit(l[: len(values)])  # noqa: E741
    name = "ggx" if distribution == "ggx" else "beckmann-rational"
    lobe = ref.Conductor(ior, extinction, alpha, distribution=name, correlation="separable")
    agree(lobe.eval(v, l) * l[:, 2:], values, 1e-3)
    agree(lobe.pdf(v, l), densities, 1e-3)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_rough_dielectric(mi, distribution):
    """Both lobes, from both sides; Mitsuba's radiance BTDF is 001's eq. 2."""
    v, l = directions(3, (1, -1)), directions(4, (1, -1))  # noqa: E741
    plugin = {
        "type": "roughdielectric",
        "distribution": distribution,
        "alpha": 0.3,
        "int_ior": 1.5,
        "ext_ior": 1.0,
    }
    values, densities = ask(mi, plugin, v, l)
    v, l = unit(v[: len(values)]), unit(l[: len(values)])  # noqa: E741
    name = "ggx" if distribution == "ggx" else "beckmann-rational"
    lobe = ref.Dielectric(1.5, 0.3, scatter_mode="RT", distribution=name, correlation="separable")
    agree(lobe.eval(v, l) * np.abs(l[:, 2:]), values, 1e-2)
    agree(lobe.pdf(v, l), densities, 1e-2)
