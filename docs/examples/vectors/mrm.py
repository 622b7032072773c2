from math import erf, exp, hypot, log1p, pi, sqrt

import numpy as np

# D(m) pi ax ay of m = (x, y, z): s is (x/ax)^2 + (y/ay)^2, t is x^2 + y^2 (Heitz 2014, eqs. 85 and 82; Blinn)
D = dict(ggx=lambda s, t, z: 1 / (s + z**2) ** 2,
         beckmann=lambda s, t, z: exp(-s / z**2) / z**4,
         phong=lambda s, t, z: exp((1 - s / max(t, 1e-300)) * log1p(t / z**2)))
# Smith's Lambda of a = cot(theta) / alpha along the direction (eqs. 86 and 83)
LAMBDA = dict(ggx=lambda a: (sqrt(1 + 1 / a**2) - 1) / 2,
              beckmann=lambda a: (erf(a) - 1) / 2 + exp(-a * a) / (2 * a * sqrt(pi)))

def fresnel(p, c):  # RGB, of the cosine between v and m
    if "color0" in p:  # Schlick's curve, less a tint that is strongest near the cosine 1/7
        f0, f82, f90, e = (np.array(p[name]) for name in ("color0", "color82", "color90", "exponent"))
        tint = (f0 + (f90 - f0) * (6 / 7) ** e) * (1 - f82) * 7 * (7 / 6) ** 6
        return np.clip(f0 + (f90 - f0) * (1 - c) ** e - tint * c * (1 - c) ** 6, 0, 1)
    n2 = (np.array(p["ior"]) + 1j * np.array(p.get("extinction", 0))) ** 2 * np.ones(3)
    g = np.sqrt(n2 - 1 + c * c)
    return (abs((c - g) / (c + g)) ** 2 + abs((n2 * c - g) / (n2 * c + g)) ** 2) / 2

def forward(p, v, l):  # f in 1/sr without the cosine, and pdf per steradian; v and l above the surface
    (ax, ay), c = p["alpha"], np.linalg.norm(v + l) / 2
    x, y, z = (v + l) / (2 * c)  # the half vector; c is its cosine with either
    d = D[p["distribution"]]((x / ax) ** 2 + (y / ay) ** 2, x * x + y * y, z) / (pi * ax * ay)
    if p["masking"] == "smith":
        a, b = (LAMBDA[p["distribution"]](w[2] / max(hypot(ax * w[0], ay * w[1]), 1e-300)) for w in (v, l))
        g1, g2 = 1 / (1 + a), 1 / (1 + a + b)
    else:
        g1, g2 = (min(1, 2 * z * cosine / c) for cosine in (v[2], min(v[2], l[2])))
    f = fresnel(p, c)
    return f * d * g2 / (4 * v[2] * l[2]), d * g1 / (4 * v[2]) * (f.mean() if p.get("scatter_mode") == "RT" else 1)

def mrm(p, v, l):  # the rule: the same lobe seen from v' = 2 (n.v) n - v, blended by the weight
    n, r = np.array([0, 0, 1]), p["retroreflectivity"]
    return [(1 - r) * one + r * turned for one, turned in zip(forward(p, v, l), forward(p, 2 * (n @ v) * n - v, l))]
