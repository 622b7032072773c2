"""Photometry of a class: which material is a sign of class RA2, and does a material of ours pass?

Writes sign.mtlx, the least material that has all minima of RA2 in yellow, and prints what it has in each geometry of
the standard; then what the class says of tape with a lobe that is too wide.
"""

from pathlib import Path

from mrm_nodes import photometry
from mrm_nodes import reference as ref

design = photometry.material_for("RA2", "yellow", margin=0.05)
Path("sign.mtlx").write_text(design.bsdf.markup("sign", "Made for class RA2, yellow, with 5 % to spare."))
print(f"sign.mtlx: {design.retro_class.title}, {design.colour}")
for row in design.rows:
    asked = row.requirement
    print(
        f"  {asked.geometry:<16} at least {asked.minimum:>5g}, has {row.value:6.1f} cd/(lx m²), {row.margin:+.0%}"
    )

tape = ref.GeneralizedSchlick(0.19, color90=0.19, alpha=0.053, retroreflectivity=1.0)
print("the tape of the MRM paper, in the same class:")
for row in photometry.check(tape, "RA2", "yellow"):
    verdict = "passes" if row.passes else "is too dark"
    print(
        f"  {row.requirement.geometry:<16} at least {row.requirement.minimum:>5g}, has {row.value:6.2f}: {verdict}"
    )
