"""A road by night whose retroreflectors are made of classes, in the light of headlamps: luminances in cd/m²."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown
from mrm_nodes.photometry import find_class, luminance, material_for
from mrm_nodes.render import Camera, Mesh, PointLight
from mrm_nodes.render.exposure import auto_exposure
from mrm_nodes.render.sheet import labelled
from mrm_nodes.render.tonemap import find_tonemap, srgb_decoded
from mrm_nodes.scenes import shapes, textures
from mrm_nodes.scenes.compose import Lamp, Room, Scene, Thing, reduced, sampled
from mrm_nodes.scenes.headlamp import Headlamp
from mrm_nodes.scenes.road import grass, line_meshes
from mrm_nodes.scenes.surface import open_pbr
from mrm_nodes.shadergen import Shader, generate_shader

Array = NDArray[np.float64]
Vec3 = tuple[float, float, float]

CLASSES = {"sign": "RA2", "cone": "RA2", "post": "RA2", "vest": "ISO 20471", "paint": "EN 1436 dry"}
"""What each kind of thing is made of, where nobody says otherwise."""
SHEETS = ("sign", "cone", "post")
"""What a class without a kind is of."""

EYE: Vec3 = (-1.5, 1.2, 2.2)
LAMPS: tuple[Vec3, ...] = ((-2.1, 0.65, 0.4), (-0.9, 0.65, 0.4))
"""Metres. Eye and lamps are as high as in the 30 m geometry of road markings."""
SKY = 0.01
"""cd/m², of a clear sky far from towns at the end of dusk, in round numbers."""

SIZE = (846, 330)
LEGEND = 240
"""Pixels across that the legend takes at least."""
SCALE = (0.01, 100.0)
"""cd/m², the ends of the false colours' scale."""
# Matplotlib's viridis, by Smith and van der Walt (CC0).
STOPS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"]


@dataclass(frozen=True, eq=False)
class NightPicture:
    """What is seen of the road by night.

    Args:
        luminance: (h, w), cd/m², as a meter that looks at each pixel has it.
        picture: (h, w, 3), tone-mapped: linear light of a screen, 0 to 1.
        exposure: stops; of 1 cd/m².
    """

    luminance: Array
    picture: NDArray[np.float32]
    exposure: float


def parse_classes(texts: Sequence[str]) -> dict[str, str]:
    """Return the class of each kind of thing from `RA1`, which is signs, cones and posts, or `vest=ISO 20471`.

    Raises:
        MrmError: an unknown kind or class, or a class of sheets for paint, or the other way round.
    """
    chosen = dict(CLASSES)
    for text in texts:
        kind, equals, name = text.rpartition("=")
        if equals and kind.strip() not in CLASSES:
            raise MrmError(f"--class {text}: {unknown('kind', kind.strip(), CLASSES)}")
        for each in (kind.strip(),) if equals else SHEETS:
            chosen[each] = find_class(name).name
    for kind, name in chosen.items():
        found = find_class(name)
        quantities = {row.quantity for rows in found.requirements.values() for row in rows}
        wanted = "R_L" if kind == "paint" else "R_A"
        if quantities != {wanted}:
            raise MrmError(
                f"{kind} of {name}: a class with {wanted} is wanted, and it has {quantities.pop()}"
            )
        for colour in ("white", "red") if kind == "sign" else ("white",):
            found.of(colour)
    return chosen


def draw_night(
    classes: Mapping[str, str],
    headlamp: Headlamp,
    scale: float = 1.0,
    samples: int = 2,
    shadows: float = 1.0,
    exposure: float | None = None,
    tonemap: str = "neutral",
    drawn: Callable[[], object] = lambda: None,
) -> NightPicture:
    """Draw the road.

    Args:
        classes: see `parse_classes`.
        scale: of the picture.
        samples: a pixel is the mean of samples × samples.
        shadows: share of the finest shadows, above 0.
        exposure: stops; None: automatic.
        tonemap: see `find_tonemap`.
        drawn: called after each of `compose.steps`.

    Raises:
        MrmError: an unknown class or tone mapping; no OpenGL.
    """
    return seen_of(night_road(classes, headlamp), scale, samples, shadows, exposure, tonemap, drawn)


def seen_of(
    scene: Scene,
    scale: float,
    samples: int,
    shadows: float = 1.0,
    exposure: float | None = None,
    tonemap: str = "neutral",
    drawn: Callable[[], object] = lambda: None,
) -> NightPicture:
    """Draw a scene whose lamps' strengths are illuminances in lx, so that its luminances are in cd/m².

    What is as bright as SKY counts as sky, and not for the exposure.

    Args:
        scale: of SIZE.
        samples, shadows, exposure, tonemap, drawn: as of `draw_night`.

    Raises:
        MrmError: an unknown tone mapping; no OpenGL.
    """
    size = round(SIZE[0] * scale), round(SIZE[1] * scale)
    radiance = sampled(scene, size, samples, shadows, drawn)
    mapped = find_tonemap(tonemap)
    if exposure is None:
        ours = np.asarray((np.abs(radiance - SKY) > 1e-9).any(axis=-1), np.float32)
        exposure = auto_exposure(radiance.astype(np.float32), ours, mapped.headroom) or 0.0
    picture = reduced(mapped(radiance * 2.0**exposure), samples).astype(np.float32)
    return NightPicture(luminance(reduced(radiance, samples)), picture, exposure)


def night_road(classes: Mapping[str, str], headlamp: Headlamp) -> Scene:
    """The scene, in light that is in lx: its radiance has cd/m² as luminance under illuminant A."""
    camera = Camera(EYE, (0.35, 1.15, -14.0), fov=22.0)
    sky = (SKY, SKY, SKY)
    return Scene(
        road_things(classes), camera, headlights(headlamp), (sky, sky), room=Room((0.0, 0.0, -20.0), 26.0)
    )


def headlights(headlamp: Headlamp, places: Sequence[Vec3] = LAMPS, size: float = 0.05) -> list[Lamp]:
    """Return one of a headlamp at each place: a light of 1 lx everywhere, multiplied with its illuminance in lx.

    Args:
        places: in metres; each lamp looks along -z.
        size: the lamps' radius in metres.
    """
    return [
        Lamp(
            PointLight(place, decay_rate=0.0),
            size,
            4,
            2048,
            functools.partial(headlamp.illuminance, place),
        )
        for place in places
    ]


@functools.cache
def class_shader(name: str, colour: str) -> Shader:
    """The shader of a class's material."""
    document = material_for(name, colour).bsdf.document()
    return generate_shader(document, max_lights=1, interface="reduced")


def road_things(classes: Mapping[str, str]) -> list[Thing]:
    """Return a lane closure, in metres: lines, cones, posts, three signs, and somebody in a vest.

    classes: as `parse_classes` has them.

    Raises:
        MrmError: an unknown class, or one without white (of signs, without red).
    """
    color, rough = textures.asphalt()
    asphalt = open_pbr(base_color=color * 0.75, specular_roughness=rough)
    things = [
        Thing(shapes.ground("road", (-4.6, 4.6), (-95.0, 2.5), turn=0.5), asphalt, False),
        Thing(shapes.ground("verge", (-60.0, 60.0), (-95.0, 2.5), -0.03, 0.4), grass(), False),
    ]
    paint = class_shader(classes["paint"], "white")
    things += [Thing(mesh, paint, False) for mesh in line_meshes()]
    orange = open_pbr(base_color=(0.86, 0.105, 0.006), specular_roughness=0.4)
    rubber = open_pbr(base_color=(0.024, 0.023, 0.022), specular_roughness=0.55)
    steel = open_pbr(base_color=(0.42, 0.43, 0.44), base_metalness=1.0, specular_roughness=0.45)
    plastic = open_pbr(base_color=(0.62, 0.62, 0.62), specular_roughness=0.5)
    collars = class_shader(classes["cone"], "white")
    cone = [
        (shapes.moved(shapes.cone_body(), (0.0, 0.03, 0.0)), orange),
        (shapes.slab("foot", 0.42, 0.034, 0.05, 0.012), rubber),
        *((_band(low, high), collars) for low, high in ((0.315, 0.435), (0.515, 0.615))),
    ]
    for k in range(6):
        to = (0.55 + 0.50 * k, 0.0, -8.0 - 4.2 * k)
        things += [Thing(shapes.moved(mesh, to, 17.0 * k), shader) for mesh, shader in cone]

    pole = shapes.turned("pole", [[(0.035, 0.0), (0.035, 3.1)]], 32)
    white, red = (class_shader(classes["sign"], colour) for colour in ("white", "red"))
    for x, z, width, height, y, marks in (
        (5.3, -27.0, 1.5, 0.75, 1.55, _chevrons()),
        (4.9, -15.5, 0.75, 0.75, 2.25, shapes.plate("disc", 0.54, 0.54, 0.269)),
        (-5.4, -42.0, 1.5, 0.75, 1.55, _chevrons()),
    ):
        turn = -8.0 if x > 0.0 else 8.0
        corner = 0.06 if width > height else 0.374
        back = shapes.moved(shapes.plate("sign", width, height, corner), (x, y, z + 0.05), turn)
        things += [
            Thing(back, red),
            Thing(shapes.moved(shapes.moved(marks, (0.0, 0.0, 0.004)), (x, y, z + 0.05), turn), white),
            Thing(shapes.moved(pole, (x, 0.0, z), scale=0.99 * (y + height / 2) / 3.1), steel),
        ]

    post = shapes.turned(
        "post", [[(0.055, 0.0), (0.050, 0.98)], shapes.arc((0.0, 0.98), 0.050, 0, 90, 8)], 32
    )
    strip, reflecting = (
        shapes.turned("strip", [[(0.0535, 0.70), (0.0525, 0.86)]], 32),
        class_shader(classes["post"], "white"),
    )
    for z in np.arange(-10.0, -90.0, -12.5):
        for x in (-4.9, 5.2):
            things += [
                Thing(shapes.moved(mesh, (x, 0.0, z)), shader)
                for mesh, shader in ((post, plastic), (strip, reflecting))
            ]
    return things + _somebody(class_shader(classes["vest"], "white"))


def _somebody(tape: Shader) -> list[Thing]:
    """Somebody who stands at the roadside, in a vest with two bands of tape."""
    body = shapes.patch("body", shapes.torso, 128, 210)
    center = body.positions[body.indices.reshape(-1, 3)].mean(axis=1)
    taped = np.minimum(np.abs(center[:, 1] + 0.315), np.abs(center[:, 1] + 0.135)) < 0.025
    faces = body.indices.reshape(-1, 3)
    parts = [
        Mesh("vest", body.positions, body.normals, body.tangents, body.texcoords, chosen)
        for chosen in (faces[~taped], faces[taped])
    ]
    cloth = open_pbr(base_color=(0.55, 0.85, 0.02), specular_roughness=0.6)
    trousers = open_pbr(base_color=(0.02, 0.022, 0.03), specular_roughness=0.7)
    skin = open_pbr(base_color=(0.45, 0.27, 0.19), specular_roughness=0.5)
    leg = shapes.turned("leg", [[(0.07, -1.22), (0.095, -0.42)]], 24)
    head = shapes.patch("head", shapes.unit_sphere, 32, 24)
    to = (2.4, 1.22, -19.0)
    return [
        Thing(shapes.moved(parts[0], to), cloth),
        Thing(shapes.moved(parts[1], to), tape),
        *(Thing(shapes.moved(shapes.moved(leg, (x, 0.0, 0.0)), to), trousers) for x in (-0.1, 0.1)),
        Thing(shapes.moved(shapes.moved(head, (0.0, 0.56, 0.0), scale=0.11), to), skin),
    ]


def _band(low: float, high: float) -> Mesh:
    """A collar just outside of a cone, between two heights above the ground."""
    radius = [0.153 - (y - 0.03 - 0.035) * 0.178 for y in (low, high)]
    return shapes.turned("collar", [[(radius[0], low), (radius[1], high)]], 128)


def _chevrons() -> Mesh:
    """Three arrowheads to the right on a sign 1.5 wide and 0.75 high."""
    quads = []
    for left in (-0.62, -0.15, 0.32):
        tip = left + 0.29
        for y in (0.34, -0.34):
            corners = [(left, y), (left + 0.2, y), (tip + 0.2, 0.0), (tip, 0.0)]
            quads.append(corners if y < 0.0 else corners[::-1])
    points = np.array(quads).reshape(-1, 2)
    positions = np.column_stack([points, np.zeros(len(points))])
    count = len(points)
    indices = np.array(
        [(k, k + 1, k + 2) for k in range(0, count, 4)] + [(k, k + 2, k + 3) for k in range(0, count, 4)]
    )
    normals, tangents = np.tile([0.0, 0.0, 1.0], (count, 1)), np.tile([1.0, 0.0, 0.0], (count, 1))
    return Mesh("chevrons", positions, normals, tangents, points, indices)


def false_colours(values: Array) -> NDArray[np.float32]:
    """Linear colours (..., 3) of luminances (...), by their logarithm between the ends of SCALE."""
    low, high = np.log10(SCALE)
    at = (np.log10(np.maximum(values, 1e-12)) - low) / (high - low)
    stops = np.array([[int(stop[i : i + 2], 16) / 255.0 for i in (1, 3, 5)] for stop in STOPS])
    place = np.linspace(0.0, 1.0, len(stops))
    encoded = np.stack([np.interp(at, place, stops[:, channel]) for channel in range(3)], axis=-1)
    return srgb_decoded(encoded.astype(np.float32))


def with_legend(night: NightPicture) -> NDArray[np.float32]:
    """Return the tone-mapped picture, the false colours below it, and their scale, in linear light of a screen.

    Returns:
        (H, W, 3), 0 to 1: W is the picture's width w, or LEGEND where that is more, and the picture in the middle then;
        H is twice its height and what the scale takes.
    """
    height, seen = night.luminance.shape
    width = max(seen, LEGEND)
    left = (width - seen) // 2
    gap = max(4, width // 140)
    letters = max(10, width // 55)
    bar, ground = 2 * gap, 0.012
    sheet = np.full((2 * height + 2 * gap + bar + 2 * letters, width, 3), ground, np.float32)
    sheet[:height, left : left + seen] = night.picture
    sheet[height + gap : 2 * height + gap, left : left + seen] = false_colours(night.luminance)
    top = 2 * height + 2 * gap
    margin = 3 * letters
    ramp = np.geomspace(*SCALE, width - 2 * margin)
    sheet[top : top + bar, margin : width - margin] = false_colours(ramp)
    decades = round(np.log10(SCALE[1] / SCALE[0]))
    written = []
    for k in range(decades + 1):
        value = SCALE[0] * 10.0**k
        x = margin + round(k / decades * (width - 2 * margin - 1))
        unit = " cd/m²" if k == decades else ""
        written.append((f"{value:g}{unit}", x - (letters if unit else 0), top + bar + letters))
    return labelled(sheet, written, letters)
