"""One's own suite in CI: a material is compared with physics on every change, and the job fails where it is wrong.

Writes materials/sheeting.mtlx and suite.toml, runs the suite, and leaves a report to look at in report/index.html and
results.xml for the CI system. Ends with the status of the run: 0 all well, 1 a comparison failed, 2 a request at fault.
"""

import sys
from pathlib import Path

from mrm_nodes.cli import main

Path("materials").mkdir(exist_ok=True)
Path("materials/sheeting.mtlx").write_text("""<?xml version="1.0"?>
<materialx version="1.39">
  <mrm_generalized_schlick_bsdf name="beads" type="BSDF">
    <input name="color0" type="color3" value="0.19, 0.19, 0.19" />
    <input name="roughness" type="vector2" value="0.2, 0.2" />
    <input name="retroreflectivity" type="float" value="0.7" />
  </mrm_generalized_schlick_bsdf>
  <surface name="lit" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="beads" />
  </surface>
  <surfacematerial name="sheeting" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="lit" />
  </surfacematerial>
</materialx>
""")
Path("suite.toml").write_text("""title = "Sheeting"

[defaults]
size = 64
light = ["camera", "directional:-0.9,-0.8,-0.7"]

[[case]]
material = "materials/*.mtlx"
name = "{material}-{beads/retroreflectivity}"
[case.matrix]
"input:beads/retroreflectivity" = [0, 0.5, 1]
""")
try:
    main(["regress", "--suite", "suite.toml", "--jobs", "1", "--junit", "results.xml"])
except SystemExit as ended:
    print(f"status {ended.code}: look at report/index.html")
    sys.exit(ended.code)
