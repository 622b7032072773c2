"""The evaluator against exact arithmetic: the papers' equations once more, in numbers of 50 digits.

Float64 too has a last digit, and what it costs depends on the angle and on how narrow the lobe is. `allowed` is that
cost as a formula, the one of docs/how-we-know.md.
"""

import math

import mpmath
import numpy as np
import pytest
from mpmath import mpf

from mrm_nodes import reference as ref

EPSILON = 2.0**-52

PAIRS = [
    ("ggx", "smith"),
    ("ggx", "vcavity"),
    ("beckmann", "smith"),
    ("beckmann", "vcavity"),
    ("phong", "vcavity"),
]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def normalised(w):
    w = [mpf(float(x)) for x in w]
    length = mpmath.sqrt(dot(w, w))
    return [x / length for x in w]


def normals(name, m, ax, ay):
    """D(m), and the squared norm of its slope: Heitz's eqs. 82 and 85, Ashikhmin and Shirley's Phong."""
    q = (m[0] / m[2] / ax) ** 2 + (m[1] / m[2] / ay) ** 2
    if name == "ggx":
        return 1 / (mpmath.pi * ax * ay * (1 + q) ** 2 * m[2] ** 4), q
    if name == "beckmann":
        return mpmath.exp(-q) / (mpmath.pi * ax * ay * m[2] ** 4), q
    across = m[0] ** 2 + m[1] ** 2
    power = ((2 / ax**2 - 2) * m[0] ** 2 + (2 / ay**2 - 2) * m[1] ** 2) / across
    return m[2] ** power / (mpmath.pi * ax * ay), q


def hidden(name, w, ax, ay):
    """Λ: Heitz's eqs. 83 and 86."""
    a = abs(w[2]) / mpmath.sqrt((ax * w[0]) ** 2 + (ay * w[1]) ** 2)
    if name == "ggx":
        return (mpmath.sqrt(1 + 1 / a**2) - 1) / 2
    return (mpmath.erf(a) - 1) / 2 + mpmath.exp(-a * a) / (2 * a * mpmath.sqrt(mpmath.pi))


def exact(name, masking, v, l, alpha, index):  # noqa: E741
    """f(v, l) of a lobe with F = 1 on one side, of a dielectric across, and `allowed` there."""
    ax, ay = (mpf(float(a)) for a in alpha)
    v, l, n = normalised(v), normalised(l), mpf(float(index))  # noqa: E741
    across = l[2] < 0
    s = [-(x + n * y) if across else x + y for x, y in zip(v, l, strict=True)]
    length = mpmath.sqrt(dot(s, s))
    m = [(x if s[2] > 0 else -x) / length for x in s]
    vh, lh = dot(v, m), abs(dot(l, m))
    d, q = normals(name, m, ax, ay)
    if masking == "smith":
        a, b = 1 + hidden(name, v, ax, ay), 1 + hidden(name, l, ax, ay)
        g = mpmath.beta(a, b) if across else 1 / (a + b - 1)
        many, one_of_two = float(a + b), 1.0
    else:
        seen = [min(mpf(1), 2 * m[2] * abs(w[2]) / wh) for w, wh in ((v, vh), (l, lh))]
        g = max(mpf(0), sum(seen) - 1) if across else min(seen)
        many, one_of_two = 1.0, float(g) if across else 1.0
    if g == 0:
        return mpf(0), 0.0
    if across:
        inside = mpmath.sqrt(n * n - 1 + vh * vh)
        lost = ((vh - inside) / (vh + inside)) ** 2 + ((n * n * vh - inside) / (n * n * vh + inside)) ** 2
        value = (1 - lost / 2) * d * g * vh * lh / (v[2] * abs(l[2]) * length**2)
    else:
        value = d * g / (4 * v[2] * l[2])
    lever = float(mpmath.sqrt(1 - vh * vh) / length)
    tangent = float(mpmath.sqrt(1 - m[2] ** 2) / m[2])
    return value, allowed(
        name, float(min(ax, ay)), float(q), tangent, float(vh), float(lh), lever, many, one_of_two
    )


def allowed(name, alpha, q, tangent, vh, lh, lever, many=1.0, share=1.0):
    """The relative error that a value may have.

    q: the squared norm of the half vector's slope over alpha, the smaller one. tangent: of the half vector's angle to
    the normal. vh, lh: its cosines with both directions. lever: the sine of either with it, times that side's index,
    over the length of the sum that it was normalised from, by which an error in a direction's length turns it. many:
    2 + Λ(v) + Λ(l), in a Beta function's logarithms. share: a V-cavity's G2 across, 1 less than a sum.
    """
    turned = 2.0 * math.sqrt(q) * (1.0 + tangent**2) / alpha
    steep = 2.0 * turned / (1.0 + q) if name == "ggx" else turned
    fallen = 0.0 if name == "ggx" else q
    cosines = (1.0 + lever) * (tangent + 2.0 / vh + 2.0 / lh) / share
    return 4.0 * EPSILON * (10.0 + fallen + lever * steep + cosines + many * math.log(many + 2.0))


def hard_points(rng, count, transmitted):
    """Views down to a cosine of 1e-5, alphas from 1e-6, axes up to 100:1, half vectors within three widths of the
    normal, indices as near to 1 as 1e-4."""
    alpha = 10.0 ** rng.uniform(-6.0, 0.0, (count, 1)) * np.where(
        rng.random((count, 2)) < 0.5, 1.0, 10.0 ** rng.uniform(-2.0, 0.0, (count, 2))
    )
    alpha = np.maximum(alpha, 1e-6)
    cosine, azimuth = 10.0 ** rng.uniform(-5.0, 0.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    sine = np.sqrt(1.0 - cosine**2)
    v = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine], axis=-1)
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    slope, azimuth = 10.0 ** rng.uniform(-1.5, 0.5, count), rng.uniform(0.0, 2.0 * np.pi, count)
    m = np.stack([slope * np.cos(azimuth), slope * np.sin(azimuth), np.ones(count)], axis=-1)
    m[:, :2] *= alpha
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    index = np.where(rng.random(count) < 0.5, rng.uniform(1.05, 3.0, count), rng.uniform(0.3, 0.95, count))
    near_1 = 1.0 + 10.0 ** rng.uniform(-4.0, -1.0, count) * rng.choice([-1.0, 1.0], count)
    index = np.where(rng.random(count) < 0.3, near_1, index)
    vh = (v * m).sum(axis=-1)
    squared = 1.0 - (1.0 - vh**2) / index**2
    inside = np.sqrt(np.maximum(squared, 0.0))
    if transmitted:
        l = (vh / index - inside)[:, None] * m - v / index[:, None]  # noqa: E741
        lit = (squared > 0.0) & (vh > 0.0) & (l[:, 2] < -1e-5)
    else:
        l = 2.0 * vh[:, None] * m - v  # noqa: E741
        lit = (vh > 0.0) & (l[:, 2] > 1e-5)
    l = l / np.linalg.norm(l, axis=-1, keepdims=True)  # noqa: E741
    return v[lit], l[lit], alpha[lit], index[lit]


def used(found, at, name, masking):
    """How much of what is allowed each value uses."""
    shares = []
    with mpmath.workdps(50):
        for value, *point in zip(found, *at, strict=True):
            right, most = exact(name, masking, *point)
            if right > mpf("1e-300"):
                shares.append(float(abs(mpf(float(value)) / right - 1)) / most)
    return np.array(shares)


@pytest.mark.parametrize("turn", [1.0, -1.0], ids=["forward", "retro"])
@pytest.mark.parametrize(("name", "masking"), PAIRS)
def test_reflection_is_as_exact_as_its_formula_says(name, masking, turn):
    v, l, alpha, index = hard_points(np.random.default_rng(3), 120, transmitted=False)  # noqa: E741
    names = {"distribution": name, "masking": masking, "retroreflectivity": float(turn < 0.0)}
    found = ref.GeneralizedSchlick(color0=1.0, alpha=alpha, **names).eval(v * [turn, turn, 1.0], l)[:, 0]
    shares = used(found, (v, l, alpha, index), name, masking)
    assert len(shares) > 90
    assert shares.max() <= 1.0


@pytest.mark.parametrize(("name", "masking"), PAIRS)
def test_transmission_is_as_exact_as_its_formula_says(name, masking):
    v, l, alpha, index = hard_points(np.random.default_rng(4), 300, transmitted=True)  # noqa: E741
    lobe = ref.Dielectric(index, alpha, distribution=name, masking=masking, scatter_mode="T")
    shares = used(lobe.eval(v, l)[:, 0], (v, l, alpha, index), name, masking)
    assert len(shares) > 90
    assert shares.max() <= 1.0


def test_the_usual_way_to_write_it_is_not():
    """GGX of an angle that an arc cosine gives, as textbooks have it, uses a thousand times what is allowed."""
    v, l, alpha, index = hard_points(np.random.default_rng(3), 120, transmitted=False)  # noqa: E741
    alpha[:, 1] = alpha[:, 0]
    h = (v + l) / np.linalg.norm(v + l, axis=-1, keepdims=True)
    tangent = np.tan(np.arccos(np.minimum(h[:, 2], 1.0)))
    textbook = 1.0 / (np.pi * alpha[:, 0] ** 2 * h[:, 2] ** 4 * (1.0 + (tangent / alpha[:, 0]) ** 2) ** 2)
    found = ref.GeneralizedSchlick(color0=1.0, alpha=alpha).eval(v, l)[:, 0] * (
        textbook / ref.GGX(alpha[:, 0]).D(h)
    )
    shares = used(found, (v, l, alpha, index), "ggx", "smith")
    assert (shares > 1.0).mean() > 0.25 and shares.max() > 1e3
