"""Environment light: a map lights a material, and is seen behind it.

Writes dusk.exr, a small map of one's own with a low sun, and two pictures: sheeting under it, dusk-0.png with the sun
ahead and dusk-180.png with the sun behind the camera, where the sheeting sends it back to us.
"""

import numpy as np

import mrm_nodes
from mrm_nodes.render import write_exr
from mrm_nodes.render.environment import load_environment

# Latitude and longitude of each texel; the middle of the map is +z, towards the camera.
up, around = np.mgrid[0:128, 0:256] + 0.5
up, around = np.pi * (0.5 - up / 128), 2 * np.pi * (around / 256 - 0.5)
sky = (
    np.where(up[..., None] > 0, [0.25, 0.3, 0.5], [0.08, 0.07, 0.06]) + 0.4 * np.exp(-8 * abs(up))[..., None]
)
sun = np.exp((np.cos(up - 0.2) * np.cos(around) - 1) * 300)[..., None] * [90.0, 55.0, 25.0]
write_exr("dusk.exr", (sky + sun).astype(np.float32))

for rotation in (0, 180):
    around = load_environment("dusk.exr", rotation=rotation, samples=64)
    rendered = mrm_nodes.render("chevron_sign", "plane", "0.6,0.3,3:fov=50", environment=around, samples=4)
    rendered.save(f"dusk-{rotation}.png")
    print(f"dusk-{rotation}.png: {rendered.picture.summary()}")
