"""Test vectors against another implementation: here ten lines of GGX, as a renderer might have them.

The rule of MRM is that the view is turned about the normal: v' = 2 (n.v) n - v. Writes vectors.json with the command
line, and compares every isotropic GGX conductor with Smith's masking in it. Prints the worst error.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

PLAIN = {"distribution": "ggx", "masking": "smith", "correlation": "height", "energy_compensation": None}
PLAIN |= {"thinfilm_thickness": 0.0, "slope_correlation": 0.0, "mean_slope": [0.0, 0.0]}


def ggx_conductor(p, v, light):
    """f in 1/sr without the cosine."""
    alpha, h = p["alpha"][0], (v + light) / np.linalg.norm(v + light)
    d = alpha**2 / (np.pi * ((h[2] * alpha) ** 2 + h[0] ** 2 + h[1] ** 2) ** 2)
    root = [np.sqrt(1.0 + alpha**2 * (1.0 / w[2] ** 2 - 1.0)) for w in (v, light)]
    c, index = v @ h, np.array(p["ior"]) + 1j * np.array(p["extinction"])
    g = np.sqrt(index**2 - 1.0 + c**2)
    fresnel = (abs((c - g) / (c + g)) ** 2 + abs((index**2 * c - g) / (index**2 * c + g)) ** 2) / 2
    return fresnel * d * 2.0 / (sum(root) * 4.0 * v[2] * light[2])


subprocess.run([sys.executable, "-m", "mrm_nodes", "vectors", "-o", "vectors.json"], check=True)
count, worst = 0, 0.0
for case in json.loads(Path("vectors.json").read_text())["cases"]:
    p = case["parameters"]
    if (
        any(p.get(name) != value for name, value in PLAIN.items())
        or "extinction" not in p
        or len(set(p["alpha"])) > 1
    ):
        continue
    for point in case["points"]:
        v, light, r = np.array(point["v"]), np.array(point["l"]), p["retroreflectivity"]
        if min(v[2], light[2]) > 0.0:
            turned = v * [-1.0, -1.0, 1.0]
            mine = (1.0 - r) * ggx_conductor(p, v, light) + r * ggx_conductor(p, turned, light)
            count, worst = (
                count + 1,
                max(worst, np.max(abs(mine - point["eval"]) / np.maximum(point["eval"], 1e-4))),
            )
print(f"{count} points, at most {worst:.1e} off")
sys.exit(0 if count and worst < 1e-9 else 1)
