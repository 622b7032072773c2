"""A light sweep: retroreflection is understood when the light moves.

Writes sweep.webp, which moves, and prints how bright the cone is as the light goes from the camera to 60 degrees aside:
the collars of sheeting fall to nothing within a few degrees, the orange plastic hardly changes.
"""

import math

from PIL import Image

import mrm_nodes

frames, exposure = [], 0.0
for degrees in (0, 1, 2, 4, 8, 16, 30, 45, 60):
    angle = math.radians(degrees)
    light = f"point:{3 * math.sin(angle)},0,{3 * math.cos(angle)}"
    look = {"exposure": exposure or "auto", "background": "black"}
    rendered = mrm_nodes.render("traffic_cone", "baluster", "0,0,3", light, samples=9, **look)
    exposure = rendered.picture.exposure  # that of the first frame, which is the brightest
    frames.append(Image.fromarray(rendered.picture.codes()))
    print(
        f"{degrees:>3} degrees: mean {rendered.image[rendered.mask].mean():.3f}, most {rendered.image.max():.2f}"
    )

frames[0].save("sweep.webp", save_all=True, append_images=frames[1:] + frames[-2:0:-1], duration=150, loop=0)
