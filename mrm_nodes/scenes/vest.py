"""A safety vest on a tailor's dummy, by day and in the beam of a torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.render import Camera, DirectionalLight, PointLight
from mrm_nodes.scenes import shapes, textures
from mrm_nodes.scenes.compose import Lamp, Room, Rows, Scene, Thing, dome
from mrm_nodes.scenes.surface import open_pbr
from mrm_nodes.scenes.textures import mix, step
from mrm_nodes.shadergen import Shader

Array = NDArray[np.float64]


def vest_shader(size: int = 1536) -> Shader:
    """A hi-vis vest on a tailor's dummy: silver tape between orange borders on fluorescent cloth."""
    s = (np.arange(size) + 0.5)[None, :] / size * np.ones((size, 1))
    t = (1.0 - (np.arange(size) + 0.5) / size)[:, None] * np.ones((1, size))
    x, y, z = np.moveaxis(shapes.torso(s, t), -1, 0)
    side = np.abs(x)

    # The vest ends in a V at the neck, at the arms and at the hem.
    slope = np.where(z > 0.0, (y - 0.10) / 0.245, (y - 0.30) / 0.06)
    neck = np.where(y > 0.10, 0.098 * np.clip(slope, 0.0, 1.0) - side, -1.0)
    neck = np.where((z <= 0.0) & (y < 0.30), -1.0, neck)
    arm = 1.0 - np.hypot((side - 0.222) / 0.050, (y - 0.150) / 0.128)
    trim = np.maximum(step(neck, -0.011, -0.009), step(arm, -0.20, -0.17))
    bare = np.maximum(step(neck, 0.0, 0.002), step(arm, 0.0, 0.02))
    hem = step(y, -0.455, -0.458)

    # Two tapes around the body, one over each shoulder.
    def tape(distance: Array) -> tuple[Array, Array]:
        return step(distance, 0.0375, 0.0365), step(distance, 0.0255, 0.0248)

    bands = [tape(np.abs(y + 0.315)), tape(np.abs(y + 0.135))]
    upright = tape(np.where(y > -0.135, np.abs(side - 0.118 + 0.05 * np.clip(y - 0.2, 0.0, 1.0)), 1.0))
    border = np.maximum.reduce([bands[0][0], bands[1][0], upright[0]])
    silver = np.maximum.reduce([bands[0][1], bands[1][1], upright[1] * (1.0 - bands[1][0])])

    weave = np.sin(2.0 * np.pi * 190.0 * t) * np.sin(2.0 * np.pi * 260.0 * s)
    mesh_holes = step(np.abs(np.sin(np.pi * 150.0 * s) * np.sin(np.pi * 110.0 * t)), 0.90, 0.97)
    creases = textures.noise((size, size), (120.0, 30.0), 31)
    cloth = (
        np.array([0.62, 0.94, 0.022]) * (0.95 + 0.03 * weave + 0.015 * creases - 0.25 * mesh_holes)[..., None]
    )
    orange = np.array([0.98, 0.20, 0.012]) * (0.96 + 0.04 * weave)[..., None]
    diamonds = np.abs(np.sin(np.pi * (110.0 * s + 80.0 * t))) * np.abs(np.sin(np.pi * (110.0 * s - 80.0 * t)))
    embossed = step(diamonds, 0.02, 0.12)
    grain = np.clip(textures.noise((size, size), 1.2, 32), -1.5, 1.5)
    strength = (0.45 + 0.55 * embossed) * (0.9 + 0.08 * grain + 0.05 * np.clip(creases, -1.5, 1.0))
    color = mix(border, cloth, orange)
    color = mix(silver, color, (0.40, 0.41, 0.42))
    color *= (1.0 - 0.25 * silver * (1.0 - embossed))[..., None]
    stitches = np.maximum.reduce(
        [
            step(np.abs(d), 0.0012, 0.0006)
            for d in (
                np.abs(y + 0.315) - 0.0345,
                np.abs(y + 0.135) - 0.0345,
            )
        ]
    ) * step(np.sin(2.0 * np.pi * 210.0 * s), -0.1, 0.1)
    color = mix(0.6 * stitches, color, (0.9, 0.9, 0.8))
    zipper = step(side, 0.0070, 0.0060) * (z > 0.0) * (y < 0.10)
    teeth = step(side, 0.0030, 0.0022) * step(np.sin(2.0 * np.pi * y / 0.007), -0.2, 0.2)
    color = mix(zipper, color, (0.055, 0.06, 0.06))
    color = mix(zipper * teeth, color, (0.34, 0.34, 0.33))
    color = mix(np.maximum(trim, hem), color, (0.05, 0.055, 0.06))
    linen = np.array([0.44, 0.36, 0.27]) * (0.93 + 0.05 * weave)[..., None]
    color = mix(bare, color, linen)
    covered = (1.0 - np.maximum.reduce([trim, bare, hem])) * (1.0 - zipper)
    silver = silver * covered
    return open_pbr(
        base_color=np.clip(color, 0.0, 1.0),
        specular_retroreflectivity=silver * np.clip(strength, 0.0, 1.0),
        specular_roughness=0.62 - 0.32 * silver,
        base_metalness=0.16 * silver,
        base_diffuse_roughness=0.4,
        fuzz_weight=0.25 * (1.0 - silver),
        fuzz_color=(0.7, 0.8, 0.5),
    )


def scene() -> Rows:
    """By day, and by night in the beam of a torch beside the camera."""
    dummy = Thing(shapes.patch("dummy", shapes.torso, 512, 420), vest_shader())
    cap = shapes.turned(
        "cap",
        [
            [(0.0585, 0.447), *shapes.arc((0.048, 0.462), 0.0125, -40, 90, 8)],
            [(0.048, 0.4745), (0.016, 0.478), (0.014, 0.50), *shapes.arc((0.0, 0.522), 0.024, -55, 90, 14)],
        ],
    )
    pole = shapes.turned("pole", [[(0.016, -1.3), (0.016, -0.40)]], 48)
    under = shapes.turned("under", [[(0.001, -0.452), (0.17, -0.452)]], 64)
    wood = open_pbr(
        base_color=(0.30, 0.15, 0.06), specular_roughness=0.35, coat_weight=0.6, coat_roughness=0.15
    )
    steel = open_pbr(base_color=(0.5, 0.5, 0.52), base_metalness=1.0, specular_roughness=0.35)
    wall = open_pbr(base_color=(0.36, 0.38, 0.41), specular_roughness=0.8)
    back = shapes.moved(shapes.plate("wall", 8.0, 6.0, 0.1), (0.0, 0.0, -0.9))
    dark = open_pbr(base_color=(0.03, 0.03, 0.03), specular_roughness=0.8)
    things = [dummy, Thing(cap, wood), Thing(pole, steel), Thing(under, dark), Thing(back, wall)]
    camera = Camera((0.62, 0.10, 1.75), (0.01, 0.015, 0.0), fov=31.5)
    room = Room((0.0, 0.0, -0.2), 1.1)
    window = Lamp(DirectionalLight((0.70, -0.42, -0.62), (1.0, 0.96, 0.9), 2.3), 0.16, 16)
    day = Scene(things, camera, [window, *dome(0.6, 7, (0.86, 0.92, 1.0))], exposure=0.4, room=room)
    torch = Lamp(PointLight((0.74, 0.20, 1.72), (1.0, 0.96, 0.9), 0.24, decay_rate=0.0), 0.015, 8)
    night = Scene(things, camera, [torch, *dome(0.012, 3, (0.5, 0.65, 1.0))], exposure=1.4, room=room)
    return [[(day, (420, 460)), (night, (420, 460))]]
