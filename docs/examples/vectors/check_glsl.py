"""Compares a conductor in GLSL, mrm.glsl, with the test vectors: each point is a pixel of a headless draw.

python check_glsl.py vectors.json says what is wrong, and ends in status 1 where something is.
"""

import json
import sys
from pathlib import Path

import moderngl
import numpy as np

from mrm_nodes.render import get_context

VERTEX = """#version 400
void main() { gl_Position = vec4(vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0), 0.0, 1.0); }"""
PIXEL = """
uniform sampler2D points_v, points_l;
uniform vec3 ior, extinction;
uniform vec2 alpha;
uniform float retroreflectivity;
out vec4 result;
void main() {
    ivec2 at = ivec2(gl_FragCoord.xy);
    vec3 v = texelFetch(points_v, at, 0).xyz, l = texelFetch(points_l, at, 0).xyz;
    result = mrm(ior, extinction, alpha, retroreflectivity, v, l);
}"""


def draw(context, parameters, v, light):
    """eval and pdf of `mrm` for directions (n, 3), as (n, 4) in float32."""
    source = Path(__file__).with_name("mrm.glsl").read_text()
    program = context.ctx.program(vertex_shader=VERTEX, fragment_shader=f"#version 400\n{source}{PIXEL}")
    size = (len(v), 1)
    textures = {
        name: context.ctx.texture(size, 3, np.asarray(values, "f4").tobytes(), dtype="f4")
        for name, values in (("points_v", v), ("points_l", light))
    }
    for name in ("ior", "extinction", "alpha", "retroreflectivity"):
        if name in program:  # a compiler leaves out what is not used
            program[name] = parameters[name]
    target = context.ctx.framebuffer([context.ctx.texture(size, 4, dtype="f4")])
    target.use()
    context.bind(textures, program)
    context.ctx.vertex_array(program, []).render(moderngl.TRIANGLES, vertices=3)
    return np.frombuffer(target.read(components=4, dtype="f4"), "f4").reshape(-1, 4)


points = wrong = 0
context = get_context(sys.argv[2] if len(sys.argv) > 2 else "auto")
for case in json.loads(Path(sys.argv[1]).read_text())["cases"]:
    p = case["parameters"]
    is_covered = p.get("distribution") == "ggx" and p["masking"] == "smith" and not p["energy_compensation"]
    if case["lobe"] != "Conductor" or not is_covered:
        continue
    v, light = ([point[name] for point in case["points"]] for name in ("v", "l"))
    found = context.run(lambda p=p, v=v, light=light: draw(context, p, v, light))
    expected = np.array([[*point["eval"], point["pdf"]] for point in case["points"]])
    tolerance = 5e-6 / min(p["alpha"])  # of float32; relative, and to 1e-4 where less is expected
    good = (np.abs(found - expected) <= tolerance * np.maximum(expected, 1e-4)).all(axis=1)
    points += len(good)
    wrong += np.count_nonzero(~good)
    for row in np.flatnonzero(~good):
        print(f"{case['name']}: eval and pdf {found[row]} are not {expected[row]}")
print(f"{points - wrong} of {points} points agree")
sys.exit(1 if wrong or not points else 0)
