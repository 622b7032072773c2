"""The evaluator in a fit: measured values in, parameters out.

Makes a goniometer's readings from a tape that is known, with 3 % of noise, and finds its width and its reflectance
again with SciPy. Writes fit.csv with the readings and the fit; prints what was found.
"""

import numpy as np
from scipy.optimize import least_squares

from mrm_nodes import reference as ref

rng = np.random.default_rng(4)
entrance = np.radians([5.0, 20.0, 40.0])[:, None]  # the light, from the normal
observation = np.radians(np.linspace(0.5, 12.0, 24))  # between light and receiver
light = np.stack([np.sin(entrance), 0 * entrance, np.cos(entrance)], axis=-1)
seen = entrance - observation
view = np.stack([np.sin(seen), 0 * seen, np.cos(seen)], axis=-1)


def model(parameters):
    """f in 1/sr of a sheet with these: alpha, and the reflectance at normal incidence."""
    alpha, f0 = np.exp(parameters)
    return ref.GeneralizedSchlick(f0, alpha=alpha, retroreflectivity=1.0).eval(view, light)[..., 0]


truth = np.log([0.053, 0.19])
measured = model(truth) * (1.0 + 0.03 * rng.normal(size=(3, 24)))
found = least_squares(lambda each: np.log(model(each) / measured).ravel(), np.log([0.2, 0.5]))
deviation = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * 2 * found.cost / (measured.size - 2))
for name, known, value, spread in zip(
    ("alpha", "F0"), np.exp(truth), np.exp(found.x), deviation, strict=True
):
    print(f"{name}: {value:.4f} ± {value * spread:.4f}, was {known:g}")

angles = np.broadcast_arrays(np.degrees(entrance), np.degrees(observation))
columns = np.stack([*angles, measured, model(found.x)], axis=-1).reshape(-1, 4)
np.savetxt("fit.csv", columns, "%.6g", ",", header="entrance,observation,measured,fitted", comments="")
