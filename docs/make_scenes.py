"""Draws the scenes of the README: `python docs/make_scenes.py [cone vest road figure3 figure5] [--mesh FILE]`.

Every retroreflector in them is an `mrm_open_pbr_surface` whose `specular_retroreflectivity` a texture drives.
Geometry and textures are computed (docs/scenes); with --mesh, the two figures of the paper show your mesh.
Needs Pillow.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray
from scenes import shapes, textures
from scenes.compose import Lamp, Scene, Thing, display, render
from scenes.surface import open_pbr
from scenes.textures import mix, step

from mrm_nodes.render import (
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    Mesh,
    PointLight,
    SpotLight,
    load_mesh,
    write_png,
)

Array = NDArray[np.float64]
Vec3 = tuple[float, float, float]

FOLDER = Path(__file__).parent / "images"
GAP = 6
SKY = (0.62, 0.74, 0.95)


def main() -> None:
    """Draw the scenes that are named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=[], help=f"any of {', '.join(SCENES)}; all by default")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, help="folder of the pictures")
    parser.add_argument("--mesh", help="sphere, plane, baluster, or an .obj or .glb file, for the figures")
    parser.add_argument("--samples", type=int, default=2, help="samples a pixel are the square of this")
    parser.add_argument("--scale", type=float, default=1.0, help="size of the pictures")
    arguments = parser.parse_args()
    unknown = set(arguments.scenes) - set(SCENES)
    if unknown:
        parser.error(f"unknown scene {min(unknown)}; known: {', '.join(SCENES)}")
    arguments.output.mkdir(parents=True, exist_ok=True)
    for name in arguments.scenes or SCENES:
        started = time.perf_counter()
        rows = SCENES[name](arguments.mesh)
        drawn = [[_picture(scene, size, arguments) for scene, size in row] for row in rows]
        path = arguments.output / f"scene-{name}.png"
        write_png(path, _tiled(drawn).astype(np.float32))
        _with_palette(PIL.Image.open(path).convert("RGB")).save(path, optimize=True)
        print(f"{path}: {time.perf_counter() - started:.0f} s", file=sys.stderr)


def _with_palette(picture: PIL.Image.Image) -> PIL.Image.Image:
    """Return a picture of 256 colours, a third of the size; saturated colours count more than grey ones."""
    pixels = np.asarray(picture).reshape(-1, 3)
    saturated = pixels[np.ptp(pixels.astype(int), axis=1) > 60]
    sample = np.concatenate([pixels, *[saturated] * 6])
    palette = PIL.Image.fromarray(sample[None]).quantize(256, kmeans=3)
    return picture.quantize(palette=palette, dither=PIL.Image.Dither.FLOYDSTEINBERG)


def _picture(scene: Scene, size: tuple[int, int], arguments: argparse.Namespace) -> Array:
    pixels = (round(size[0] * arguments.scale), round(size[1] * arguments.scale))
    return display(render(scene, pixels, arguments.samples), scene.exposure)


def _tiled(rows: Sequence[Sequence[Array]]) -> Array:
    """Put pictures side by side and above each other, with white between."""
    bands = []
    for row in rows:
        parts = [row[0]]
        for picture in row[1:]:
            parts += [np.ones((picture.shape[0], GAP, 3)), picture]
        bands.append(np.concatenate(parts, axis=1))
    stacked = [bands[0]]
    for band in bands[1:]:
        stacked += [np.ones((GAP, band.shape[1], 3)), band]
    return np.concatenate(stacked, axis=0)


Rows = list[list[tuple[Scene, tuple[int, int]]]]


def dome(strength: float, count: int = 7, color: Vec3 = SKY) -> list[Lamp]:
    """Return a sky as directional lights, each with its shadow: where they crowd out, it is dark."""
    lamps = []
    for k in range(count):
        up = 0.18 + 0.8 * (k + 0.5) / count
        around = k * math.pi * (3.0 - math.sqrt(5.0))
        across = math.sqrt(1.0 - up * up)
        direction = (-across * math.cos(around), -up, -across * math.sin(around))
        light = DirectionalLight(direction, color, math.pi * strength / count)
        lamps.append(Lamp(light, 0.2, 3, 512))
    return lamps


# --- the traffic cone ---------------------------------------------------------------------------------------


def cone_shader() -> object:
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


def cone_scene(mesh: str | None) -> Rows:
    """By day, and by night in the beam of a torch beside the camera."""
    things = cones()
    camera = Camera((0.35, 0.62, 2.45), (0.13, 0.325, -0.15), fov=30.0)
    room = {"shadow_center": (0.1, 0.3, -0.3), "shadow_radius": 1.6}
    sun = Lamp(DirectionalLight((0.62, -0.72, -0.42), (1.0, 0.93, 0.82), 3.6), 0.02, 8, 1024)
    day = Scene(things, camera, [sun, *dome(0.55)], ((0.5, 0.55, 0.6), (0.35, 0.5, 0.8)), 0.25, **room)
    torch = Lamp(PointLight((0.50, 0.76, 2.48), (1.0, 0.96, 0.9), 0.30, decay_rate=0.0), 0.02, 8, 1024)
    night = Scene(
        things,
        camera,
        [torch, *dome(0.02, 4, (0.5, 0.65, 1.0))],
        ((0.006, 0.008, 0.014), (0.002, 0.003, 0.006)),
        0.9,
        **room,
    )
    return [[(day, (420, 440)), (night, (420, 440))]]


# --- the safety vest ----------------------------------------------------------------------------------------


def vest_shader(size: int = 2048) -> object:
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


def vest_scene(mesh: str | None) -> Rows:
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
    room = {"shadow_center": (0.0, 0.0, -0.2), "shadow_radius": 1.1}
    window = Lamp(DirectionalLight((0.70, -0.42, -0.62), (1.0, 0.96, 0.9), 2.3), 0.16, 16)
    day = Scene(things, camera, [window, *dome(0.6, 7, (0.86, 0.92, 1.0))], exposure=0.15, **room)
    torch = Lamp(PointLight((0.74, 0.20, 1.72), (1.0, 0.96, 0.9), 0.24, decay_rate=0.0), 0.015, 8)
    night = Scene(things, camera, [torch, *dome(0.012, 3, (0.5, 0.65, 1.0))], exposure=0.9, **room)
    return [[(day, (420, 460)), (night, (420, 460))]]


# --- the road -----------------------------------------------------------------------------------------------


def road_things() -> list[Thing]:
    """A lane closure at night: worn lines, cones, delineators, a chevron sign and a speed limit."""
    color, rough = textures.asphalt()
    things = [
        Thing(
            shapes.ground("road", (-4.6, 4.6), (-95.0, 2.5), turn=0.5),
            open_pbr(base_color=color * 0.75, specular_roughness=rough),
            False,
        ),
        Thing(shapes.ground("verge", (-60.0, 60.0), (-95.0, 2.5), -0.03, 0.4), _grass(), False),
    ]
    cover, beads = textures.paint(1024, 256, 41, 0.45)
    line = open_pbr(
        base_color=mix(cover, color[:1024, :256] * 0.75, (0.66, 0.65, 0.60)),
        specular_retroreflectivity=cover * beads * 0.9,
        specular_roughness=0.62 - 0.27 * cover,
    )
    strips = [(x, (z - 3.0, z)) for x in (0.0,) for z in np.arange(0.0, -93.0, -9.0)]
    strips += [(x, (z - 6.0, z)) for x in (-3.75, 3.75) for z in np.arange(2.0, -90.0, -6.0)]
    for x, z in strips:
        mesh = shapes.ground("line", (x - 0.075, x + 0.075), z, 0.004)
        texcoords = (mesh.texcoords - mesh.texcoords.min(axis=0)) / np.array([0.15, 2.4])
        things.append(
            Thing(
                Mesh("line", mesh.positions, mesh.normals, mesh.tangents, texcoords, mesh.indices),
                line,
                False,
            )
        )

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


def _grass() -> object:
    blades = textures.noise((1024, 1024), (3.0, 1.2), 51) + textures.noise((1024, 1024), 40.0, 52)
    return open_pbr(
        base_color=np.clip(0.55 + 0.22 * blades, 0.1, 1.3)[..., None] * np.array([0.105, 0.130, 0.036]),
        specular_roughness=0.75,
    )


_DELINEATOR: list[object] = []


def _delineator() -> object:
    """White plastic with a dark sleeve and a strip of sheeting in it; v is the height."""
    if not _DELINEATOR:
        v = (1.0 - (np.arange(512) + 0.5) / 512)[:, None] * np.ones(256)
        sleeve = step(v, 0.66, 0.665) * step(v, 0.90, 0.895)
        strip = step(v, 0.70, 0.705) * step(v, 0.86, 0.855)
        color = mix(strip, mix(sleeve, np.full((512, 256, 3), 0.62), (0.02, 0.02, 0.02)), (0.55, 0.55, 0.55))
        cells = textures.sheeting(512, 256, 8)
        _DELINEATOR.append(
            open_pbr(
                base_color=color,
                specular_retroreflectivity=strip * cells,
                specular_roughness=0.5 - 0.2 * strip,
                base_metalness=0.2 * strip,
            )
        )
    return _DELINEATOR[0]


def _sheet(color: Array, strength: Array) -> object:
    """A sign: sheeting whose colour tints what returns, too: ink lies over the beads."""
    return open_pbr(
        base_color=color,
        specular_color=np.clip(1.3 * color, 0.0, 1.0),
        specular_retroreflectivity=strength,
        specular_roughness=0.38,
        base_metalness=0.3 * strength,
    )


def _chevron() -> object:
    height, width = 512, 1024
    x, y = np.meshgrid((np.arange(width) + 0.5) / height, (np.arange(height) + 0.5) / height)
    phase = (x + np.abs(y - 0.5)) / 0.5 % 1.0
    red = step(phase, 0.0, 0.012) * step(phase, 0.5, 0.488)
    edge = np.minimum(np.minimum(x, 2.0 - x), np.minimum(y, 1.0 - y))
    color = mix(red, (0.75, 0.75, 0.74), (0.55, 0.012, 0.012))
    color = mix(step(edge, 0.028, 0.022), color, (0.75, 0.75, 0.74))
    return _sheet(color, textures.sheeting(height, width, 10) * (0.95 - 0.25 * red))


def _speed_limit() -> object:
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


def road_scene(mesh: str | None) -> Rows:
    """A drive by night: what the driver sees with the headlights on, and the same road at dusk without them."""
    things = road_things()
    camera = Camera((-1.5, 1.25, 2.2), (0.35, 1.20, -14.0), fov=22.0)
    room = {"shadow_center": (0.0, 0.0, -20.0), "shadow_radius": 26.0}
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
    night = Scene(things, camera, [*beams, *dome(0.006, 3, (0.5, 0.65, 1.0))], sky, 0.6, **room)
    sun = Lamp(DirectionalLight((0.55, -0.50, -0.67), (1.0, 0.93, 0.82), 2.6), 0.01, 4, 2048)
    day = Scene(things, camera, [sun, *dome(0.5, 5)], ((0.70, 0.77, 0.86), (0.30, 0.47, 0.76)), 0.1, **room)
    return [[(day, (846, 300))], [(night, (846, 300))]]


# --- the paper's figures 3 and 5 ------------------------------------------------------------------------------


def ball(mesh: str | None) -> Mesh:
    """Return the user's mesh, or a ball in a cup."""
    if mesh is not None:
        return load_mesh(mesh)
    cup = shapes.turned(
        "cup",
        [
            [(0.0001, -1.32), (0.72, -1.32)],
            [(0.72, -1.32), *shapes.arc((0.66, -1.22), 0.06, 0, 90, 8)],
            [(0.66, -1.16), (0.40, -1.12), *shapes.arc((0.40, -1.04), 0.08, -90, -180, 8)],
            [(0.32, -1.04), (0.44, -0.86), (0.50, -0.80), *shapes.arc((0.47, -0.80), 0.03, 0, 100, 6)],
        ],
    )
    return shapes.joined("ball", [shapes.patch("ball", shapes.unit_sphere, 256, 128), cup])


def around(center: Vec3, position: Vec3, degrees: float) -> Vec3:
    """Return a position turned about the vertical axis through a centre."""
    x, y, z = np.subtract(position, center)
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (center[0] + c * x + s * z, center[1] + y, center[2] - s * x + c * z)


def grey(exposure: float) -> tuple[Vec3, Vec3]:
    """Return a background that is dark grey at this exposure: the unlit side stays visible against it."""
    value = 0.022 * 2.0**-exposure
    return (value, value, value), (value, value, value)


def figure3(mesh: str | None) -> Rows:
    """A dielectric of roughness 0.5: GGX and MRM, the light at the camera and 60 degrees from it."""
    solid = ball(mesh)
    camera = Framing((0.0, 0.22, 1.0), fov=24.0).camera(solid.center, 0.97 * solid.radius, 1.0)
    beside = PointLight(around(solid.center, camera.position, 60.0), decay_rate=0.0)
    row = []
    for weight in (0.0, 1.0):
        skin = open_pbr(base_color=(0.0, 0.0, 0.0), specular_roughness=0.5, specular_retroreflectivity=weight)
        for light in (CameraLight(), beside):
            row.append(
                (Scene([Thing(solid, skin, False)], camera, [Lamp(light)], grey(2.5), 2.5), (208, 208))
            )
    return [row]


def figure5(mesh: str | None) -> Rows:
    """A metal: GGX above, MRM below; the light stays, the camera turns 0, 45 and 90 degrees away from it."""
    solid = ball(mesh)
    front = Framing((0.0, 0.22, 1.0), fov=24.0).camera(solid.center, 0.97 * solid.radius, 1.0)
    light = PointLight(front.position, decay_rate=0.0)
    rows = []
    for weight in (0.0, 1.0):
        skin = open_pbr(
            base_color=(0.95, 0.64, 0.38),
            base_metalness=1.0,
            specular_roughness=0.4,
            specular_retroreflectivity=weight,
        )
        row = []
        for degrees in (0.0, 45.0, 90.0):
            camera = Camera(around(solid.center, front.position, degrees), solid.center, fov=24.0)
            row.append(
                (Scene([Thing(solid, skin, False)], camera, [Lamp(light)], grey(-1.1), -1.1), (208, 208))
            )
        rows.append(row)
    return rows


SCENES: dict[str, Callable[[str | None], Rows]] = {
    "cone": cone_scene,
    "vest": vest_scene,
    "road": road_scene,
    "figure3": figure3,
    "figure5": figure5,
}

if __name__ == "__main__":
    main()
