"""A texture on the weight: retroreflective stripes on cloth, painted into an image.

Writes stripes.png, which is the weight from 0 to 1, vest.mtlx, and vest-day.png and vest-torch.png: by day the cloth is
seen all over, in the beam of a torch at the eye the stripes alone.
"""

from pathlib import Path

import numpy as np

import mrm_nodes
from mrm_nodes.render import write_png

v, u = np.mgrid[0:256, 0:512] / [[[256]], [[512]]]
weight = (abs((4 * v) % 1 - 0.5) < 0.12) | (abs((2 * u) % 1 - 0.5) < 0.03)
write_png("stripes.png", np.repeat(weight[..., None], 3, axis=-1).astype(np.float32))

Path("vest.mtlx").write_text("""<?xml version="1.0"?>
<materialx version="1.39">
  <image name="stripes" type="float">
    <input name="file" type="filename" value="stripes.png" />
  </image>
  <mrm_open_pbr_surface name="cloth" type="surfaceshader">
    <input name="base_color" type="color3" value="0.75, 0.85, 0.05" />
    <input name="specular_roughness" type="float" value="0.25" />
    <input name="specular_retroreflectivity" type="float" nodename="stripes" />
  </mrm_open_pbr_surface>
  <surfacematerial name="vest" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="cloth" />
  </surfacematerial>
</materialx>
""")

day = mrm_nodes.render("vest.mtlx", mesh="baluster", environment="sky", samples=9)
torch = mrm_nodes.render("vest.mtlx", mesh="baluster", lights="camera", samples=9, background="black")
for name, rendered in {"day": day, "torch": torch}.items():
    rendered.save(f"vest-{name}.png")
    print(f"vest-{name}.png: {rendered.picture.summary()}")
