"""Compares an implementation in Python, here mrm.py, with the test vectors.

python check.py vectors.json says what is wrong, and ends in status 1 where something is.
"""

import json
import sys
from pathlib import Path

import numpy as np
from mrm import mrm

TOLERANCE = 1e-14  # relative to what is expected, or to FLOOR where that is less
FLOOR = 1e-4


def is_covered(parameters):
    """mrm.py has every distribution and masking; the rest of the model keeps these."""
    rest = {"correlation": "height", "energy_compensation": None, "thinfilm_thickness": 0.0}
    rest |= {"slope_correlation": 0.0, "mean_slope": [0.0, 0.0]}
    return all(parameters[name] == value for name, value in rest.items())


points = wrong = 0
for case in json.loads(Path(sys.argv[1]).read_text())["cases"]:
    if not is_covered(case["parameters"]):
        continue
    for point in case["points"]:
        v, light = np.array(point["v"]), np.array(point["l"])
        if min(v[2], light[2]) <= 0.0:  # mrm.py reflects, and from outside
            continue
        points += 1
        f, pdf = mrm(case["parameters"], v, light)
        found, expected = np.append(f, pdf), np.append(point["eval"], point["pdf"])
        if not np.all(np.abs(found - expected) <= TOLERANCE * np.maximum(expected, FLOOR)):
            wrong += 1
            print(f"{case['name']}: eval and pdf {found} are not {expected}")
print(f"{points - wrong} of {points} points agree")
sys.exit(1 if wrong or not points else 0)
