"""A first material: a metal foil that sends half of the light back to where it came from.

Writes foil.mtlx and two pictures at one exposure: foil-camera.png with the light at the camera, in which the whole ball
is bright, and foil-aside.png with the light 40 degrees aside, where only the mirror-like half is left.
"""

import math
from pathlib import Path

import mrm_nodes

Path("foil.mtlx").write_text("""<?xml version="1.0"?>
<materialx version="1.39">
  <mrm_conductor_bsdf name="foil_bsdf" type="BSDF">
    <input name="ior" type="color3" value="0.20, 0.92, 1.10" />
    <input name="extinction" type="color3" value="3.91, 2.45, 2.14" />
    <input name="roughness" type="vector2" value="0.16, 0.16" />
    <input name="retroreflectivity" type="float" value="0.5" />
  </mrm_conductor_bsdf>
  <surface name="foil_surface" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="foil_bsdf" />
  </surface>
  <surfacematerial name="foil" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="foil_surface" />
  </surfacematerial>
</materialx>
""")

aside = math.radians(40.0)
lights = {"camera": "camera", "aside": f"directional:{-math.sin(aside)},0,{-math.cos(aside)}"}
exposure = "auto"
for name, light in lights.items():
    rendered = mrm_nodes.render("foil.mtlx", lights=light, samples=9, exposure=exposure, background="black")
    rendered.save(f"foil-{name}.png")
    print(f"foil-{name}.png: {rendered.picture.summary()}")
    exposure = rendered.picture.exposure  # the same in both, or they cannot be compared
