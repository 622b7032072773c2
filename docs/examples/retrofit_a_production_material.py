"""A material of a production, moved over: an OpenPBR document becomes retroreflective, and nothing else in it changes.

Writes jacket.mtlx, as a look-dev department would have it, retro.mtlx, and retro.png with the light at the camera.
Prints the lines that changed: comments, order and layout stay as they were.
"""

import difflib
from pathlib import Path

import mrm_nodes
from mrm_nodes.surfaces.convert import convert

Path("jacket.mtlx").write_text("""<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <!-- Piping of the jacket; approved in March. -->
  <open_pbr_surface name="piping" type="surfaceshader">
    <input name="base_color" type="color3" value="0.22, 0.23, 0.25" />
    <input name="specular_roughness" type="float" value="0.15" />
    <input name="coat_weight" type="float" value="0.2" />
  </open_pbr_surface>
  <surfacematerial name="jacket" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="piping" />
  </surfacematerial>
</materialx>
""")

changed = convert("jacket.mtlx", "retro.mtlx", {"specular_retroreflectivity": 0.8})
print(f"changed: {', '.join(changed)}")
before, after = (Path(name).read_text().splitlines() for name in ("jacket.mtlx", "retro.mtlx"))
print("\n".join(line for line in difflib.ndiff(before, after) if line[0] in "+-"))

mrm_nodes.render("retro.mtlx", lights="camera", samples=9, background="black").save("retro.png")
