"""Three traffic cones, by day and in the beam of a torch."""

from __future__ import annotations

import numpy as np

from mrm_nodes.render import Camera, DirectionalLight, PointLight
from mrm_nodes.scenes import shapes, textures
from mrm_nodes.scenes.compose import Lamp, Room, Rows, Scene, Thing, dome
from mrm_nodes.scenes.surface import open_pbr
from mrm_nodes.scenes.textures import mix, step
from mrm_nodes.shadergen import Shader


def cone_shader() -> Shader:
    """Orange PVC with two collars of sheeting; v is the height over 0.708 m."""
    height, width = 1024, 1024
    v = (1.0 - (np.arange(height) + 0.5) / height)[:, None] * np.ones(width)
    y = v * 0.708
    edge = 0.0015 * textures.noise((height, width), 20.0, 11) * 0.3
    collar = np.maximum(
        step(y + edge, 0.285, 0.287) * step(y + edge, 0.405, 0.403),
        step(y + edge, 0.485, 0.487) * step(y + edge, 0.585, 0.583),
    )
    scuffs = step(
        textures.noise((height, width), (30.0, 6.0), 12) + textures.noise((height, width), 4.0, 13), 2.1, 3.4
    )
    dirt = step(textures.noise((height, width), (50.0, 70.0), 14) * 0.07 + 0.16 - y, 0.0, 0.16) * 0.55
    cells = textures.sheeting(height, width, 16)
    orange = (
        np.array([0.86, 0.105, 0.006]) * (1.0 + 0.04 * textures.noise((height, width), 60.0, 15))[..., None]
    )
    color = mix(collar, orange, (0.62, 0.63, 0.63))
    color = mix(collar * (1.0 - step(cells, 0.4, 0.6)), color, (0.42, 0.43, 0.43))
    color = mix(np.clip(0.75 * scuffs + dirt, 0.0, 1.0), color, (0.10, 0.085, 0.07))
    return open_pbr(
        base_color=np.clip(color, 0.0, 1.0),
        specular_retroreflectivity=collar * cells * (1.0 - 0.9 * scuffs) * (1.0 - 0.6 * dirt),
        specular_roughness=0.36 - 0.06 * collar + 0.2 * scuffs,
        base_metalness=0.10 * collar,
        specular_color=(1.0, 1.0, 1.0),
    )


def cones() -> list[Thing]:
    """Three cones on asphalt, one of them knocked over."""
    skin = cone_shader()
    rubber = open_pbr(base_color=(0.024, 0.023, 0.022), specular_roughness=0.55)
    color, rough = textures.asphalt()
    street = open_pbr(tiles=(1.6, 1.6), base_color=color, specular_roughness=rough)
    things = [Thing(shapes.ground("street", (-9.0, 9.0), (-14.0, 3.0)), street)]
    foot = shapes.slab("foot", 0.42, 0.034, 0.05, 0.012)
    body = shapes.moved(shapes.cone_body(), (0.0, 0.030, 0.0))
    for to, turn, tilt in (
        ((-0.28, 0.0, 0.0), 20.0, 0.0),
        ((0.62, 0.0, -0.95), -31.0, 0.0),
        ((0.12, 0.19, -0.10), -38.0, -101.0),
    ):
        things += [
            Thing(shapes.moved(body, to, turn, tilt), skin),
            Thing(shapes.moved(foot, to, turn, tilt), rubber),
        ]
    return things


def scene() -> Rows:
    """By day, and by night in the beam of a torch beside the camera."""
    things = cones()
    camera = Camera((0.35, 0.62, 2.45), (0.13, 0.325, -0.15), fov=30.0)
    room = Room((0.1, 0.3, -0.3), 1.6)
    sun = Lamp(DirectionalLight((0.62, -0.72, -0.42), (1.0, 0.93, 0.82), 3.6), 0.02, 8, 1024)
    day = Scene(things, camera, [sun, *dome(0.55)], ((0.5, 0.55, 0.6), (0.35, 0.5, 0.8)), 0.5, room=room)
    torch = Lamp(PointLight((0.50, 0.76, 2.48), (1.0, 0.96, 0.9), 0.30, decay_rate=0.0), 0.02, 8, 1024)
    night = Scene(
        things,
        camera,
        [torch, *dome(0.02, 4, (0.5, 0.65, 1.0))],
        ((0.006, 0.008, 0.014), (0.002, 0.003, 0.006)),
        2.1,
        room=room,
    )
    return [[(day, (420, 440)), (night, (420, 440))]]


def torch() -> Rows:
    """By night, in the beam of one torch at one exposure: beside the eye, and an arm's length to its left."""
    things = cones()
    camera = Camera((0.35, 0.62, 2.45), (0.13, 0.325, -0.15), fov=30.0)
    room = Room((0.1, 0.3, -0.3), 1.6)
    row = []
    for place in ((0.37, 0.68, 2.45), (-0.85, 0.68, 2.30)):
        lamp = Lamp(PointLight(place, (1.0, 0.96, 0.9), 0.30, decay_rate=0.0), 0.02, 8, 1024)
        night = Scene(
            things,
            camera,
            [lamp, *dome(0.02, 4, (0.5, 0.65, 1.0))],
            ((0.006, 0.008, 0.014), (0.002, 0.003, 0.006)),
            2.1,
            room=room,
        )
        row.append((night, (420, 440)))
    return [row]
