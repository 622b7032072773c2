"""A road with worn paint, cones, delineators and signs, by day and at night as its driver sees it."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.render import Camera, DirectionalLight, Mesh, SpotLight
from mrm_nodes.scenes import shapes, textures
from mrm_nodes.scenes.compose import Lamp, Room, Rows, Scene, Thing, dome
from mrm_nodes.scenes.cone import cone_shader
from mrm_nodes.scenes.surface import open_pbr
from mrm_nodes.scenes.textures import mix, step
from mrm_nodes.shadergen import Shader

Array = NDArray[np.float64]


def road_things() -> list[Thing]:
    """A lane closure at night: worn lines, cones, delineators, a chevron sign and a speed limit."""
    color, rough = textures.asphalt()
    things = [
        Thing(
            shapes.ground("road", (-4.6, 4.6), (-95.0, 2.5), turn=0.5),
            open_pbr(base_color=color * 0.75, specular_roughness=rough),
            False,
        ),
        Thing(shapes.ground("verge", (-60.0, 60.0), (-95.0, 2.5), -0.03, 0.4), grass(), False),
    ]
    cover, beads = textures.paint(1024, 256, 41, 0.45)
    line = open_pbr(
        base_color=mix(cover, color[:1024, :256] * 0.75, (0.66, 0.65, 0.60)),
        specular_retroreflectivity=cover * beads * 0.9,
        specular_roughness=0.62 - 0.27 * cover,
    )
    things += [Thing(mesh, line, False) for mesh in line_meshes()]

    skin, rubber = cone_shader(), open_pbr(base_color=(0.024, 0.023, 0.022), specular_roughness=0.55)
    foot, body = (
        shapes.slab("foot", 0.42, 0.034, 0.05, 0.012),
        shapes.moved(shapes.cone_body(), (0.0, 0.03, 0.0)),
    )
    for k in range(6):
        to = (0.55 + 0.50 * k, 0.0, -8.0 - 4.2 * k)
        things += [
            Thing(shapes.moved(m, to, 17.0 * k), shader) for m, shader in ((body, skin), (foot, rubber))
        ]

    steel = open_pbr(base_color=(0.42, 0.43, 0.44), base_metalness=1.0, specular_roughness=0.45)
    post = shapes.turned("post", [[(0.035, 0.0), (0.035, 3.1)]], 32)
    chevron, limit = _chevron(), _speed_limit()
    for x, z, width, height, y, shader, corner in (
        (5.3, -27.0, 1.5, 0.75, 1.55, chevron, 0.06),
        (4.9, -15.5, 0.75, 0.75, 2.25, limit, 0.374),
        (-5.4, -42.0, 1.5, 0.75, 1.55, chevron, 0.06),
    ):
        face = shapes.moved(
            shapes.plate("sign", width, height, corner), (x, y, z + 0.05), -8.0 if x > 0 else 8.0
        )
        things += [
            Thing(face, shader),
            Thing(shapes.moved(post, (x, 0.0, z), scale=0.99 * (y + height / 2) / 3.1), steel),
        ]
    pole = shapes.turned(
        "delineator", [[(0.055, 0.0), (0.050, 0.98)], shapes.arc((0.0, 0.98), 0.050, 0, 90, 8)], 32
    )
    for z in np.arange(-10.0, -90.0, -12.5):
        things += [Thing(shapes.moved(pole, (x, 0.0, z)), _delineator()) for x in (-4.9, 4.3 + 0.9)]
    return things


def line_meshes() -> list[Mesh]:
    """The lines on the road: a broken one in the middle, and one at each edge."""
    strips = [(0.0, (z - 3.0, z)) for z in np.arange(0.0, -93.0, -9.0)]
    strips += [(x, (z - 6.0, z)) for x in (-3.75, 3.75) for z in np.arange(2.0, -90.0, -6.0)]
    meshes = []
    for x, along in strips:
        mesh = shapes.ground("line", (x - 0.075, x + 0.075), along, 0.004)
        texcoords = (mesh.texcoords - mesh.texcoords.min(axis=0)) / np.array([0.15, 2.4])
        meshes.append(Mesh("line", mesh.positions, mesh.normals, mesh.tangents, texcoords, mesh.indices))
    return meshes


def grass() -> Shader:
    """Grass, light and dark: a rough OpenPBR surface with a texture of 1024 × 1024 texels."""
    blades = textures.noise((1024, 1024), (3.0, 1.2), 51) + textures.noise((1024, 1024), 40.0, 52)
    return open_pbr(
        base_color=np.clip(0.55 + 0.22 * blades, 0.1, 1.3)[..., None] * np.array([0.105, 0.130, 0.036]),
        specular_roughness=0.75,
    )


@functools.cache
def _delineator() -> Shader:
    """White plastic with a dark sleeve and a strip of sheeting in it; v is the height."""
    v = (1.0 - (np.arange(512) + 0.5) / 512)[:, None] * np.ones(256)
    sleeve = step(v, 0.66, 0.665) * step(v, 0.90, 0.895)
    strip = step(v, 0.70, 0.705) * step(v, 0.86, 0.855)
    color = mix(strip, mix(sleeve, np.full((512, 256, 3), 0.62), (0.02, 0.02, 0.02)), (0.55, 0.55, 0.55))
    return open_pbr(
        base_color=color,
        specular_retroreflectivity=strip * textures.sheeting(512, 256, 8),
        specular_roughness=0.5 - 0.2 * strip,
        base_metalness=0.2 * strip,
    )


def _sheet(color: Array, strength: Array) -> Shader:
    """A sign: sheeting whose colour tints what returns, too: ink lies over the beads."""
    return open_pbr(
        base_color=color,
        specular_color=np.clip(1.3 * color, 0.0, 1.0),
        specular_retroreflectivity=strength,
        specular_roughness=0.38,
        base_metalness=0.3 * strength,
    )


def _chevron() -> Shader:
    height, width = 512, 1024
    x, y = np.meshgrid((np.arange(width) + 0.5) / height, (np.arange(height) + 0.5) / height)
    phase = (x + np.abs(y - 0.5)) / 0.5 % 1.0
    red = step(phase, 0.0, 0.012) * step(phase, 0.5, 0.488)
    edge = np.minimum(np.minimum(x, 2.0 - x), np.minimum(y, 1.0 - y))
    color = mix(red, (0.75, 0.75, 0.74), (0.55, 0.012, 0.012))
    color = mix(step(edge, 0.028, 0.022), color, (0.75, 0.75, 0.74))
    return _sheet(color, textures.sheeting(height, width, 10) * (0.95 - 0.25 * red))


def _speed_limit() -> Shader:
    size = 768
    x, y = np.meshgrid((np.arange(size) + 0.5) / size * 2 - 1, 1 - (np.arange(size) + 0.5) / size * 2)
    r = np.hypot(x, y)
    ring = step(r, 0.735, 0.745) * step(r, 0.965, 0.955)
    stroke = 0.062
    five = np.minimum.reduce(
        [
            textures.segment_distance(x, y, a, b)
            for a, b in (((-0.10, 0.34), (-0.42, 0.34)), ((-0.42, 0.34), (-0.44, 0.05)))
        ]
    )
    bowl = np.abs(np.hypot((x + 0.29) / 0.95, y + 0.125) - 0.215)
    angle = np.degrees(np.arctan2(y + 0.125, x + 0.29))
    bowl = np.where((angle < 128.0) & (angle > -150.0), bowl, 1.0)
    zero = np.abs(np.hypot((x - 0.30) / 0.66, y) - 0.34) * np.where(np.abs(y) > 0.25, 1.0, 0.8)
    digits = step(np.minimum.reduce([five, bowl, zero]), stroke + 0.006, stroke - 0.006)
    color = mix(ring, (0.75, 0.75, 0.74), (0.55, 0.012, 0.012))
    color = mix(digits, color, (0.01, 0.01, 0.01))
    return _sheet(color, textures.sheeting(size, size, 12) * (0.95 - 0.25 * ring) * (1.0 - digits))


def scene() -> Rows:
    """A drive by night: what the driver sees with the headlights on, and the same road at dusk without them."""
    things = road_things()
    camera = Camera((-1.5, 1.25, 2.2), (0.35, 1.20, -14.0), fov=22.0)
    room = Room((0.0, 0.0, -20.0), 26.0)
    sky = ((0.020, 0.026, 0.042), (0.004, 0.006, 0.014))
    aim = (0.03, -0.030, -1.0)
    beams = [
        Lamp(
            SpotLight(
                (x, 0.66, 0.9),
                aim,
                (1.0, 0.93, 0.82),
                6.5,
                0.55,
                math.cos(math.radians(9)),
                math.cos(math.radians(26)),
            ),
            0.05,
            4,
            2048,
        )
        for x in (-2.35, -1.05)
    ]
    night = Scene(things, camera, [*beams, *dome(0.006, 3, (0.5, 0.65, 1.0))], sky, 1.6, room=room)
    sun = Lamp(DirectionalLight((0.55, -0.50, -0.67), (1.0, 0.93, 0.82), 2.6), 0.01, 4, 2048)
    day = Scene(
        things, camera, [sun, *dome(0.5, 5)], ((0.70, 0.77, 0.86), (0.30, 0.47, 0.76)), 0.6, room=room
    )
    return [[(day, (846, 300))], [(night, (846, 300))]]
