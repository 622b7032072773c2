"""Draws the README's pictures into docs/images: `python docs/make_images.py`, or with the names of some of them.

`materials`: each finished material on the baluster, by day and twice by night, with the light at the camera and 30
degrees beside it, these two at one exposure for all; `night`: the road of classes; the others are the scenes of
`mrm-nodes scene`. All take a quarter of an hour.
"""

from __future__ import annotations

import io
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mrm_nodes.files import write_bytes
from mrm_nodes.library import materials_path
from mrm_nodes.render import CameraLight, Framing, Light, PointLight, baluster, render
from mrm_nodes.render.environment import Environment, sky
from mrm_nodes.render.sheet import labelled
from mrm_nodes.render.tonemap import srgb_encoded
from mrm_nodes.scenes import TITLES, draw
from mrm_nodes.scenes.headlamp import dipped
from mrm_nodes.scenes.night import CLASSES, draw_night, with_legend

MATERIALS = {
    "hi_vis_tape": "hi-vis tape",
    "traffic_cone": "traffic cone",
    "road_paint": "road paint",
    "chevron_sign": "chevron sign",
    "number_plate": "number plate",
    "yellow_tape": "yellow tape",
}
ROWS = ("by day", "by night, torch at the eye", "by night, torch 30° aside")
FOLDER = Path(__file__).parent / "images"

TILE = (300, 536)  # width and height of one picture in pixels
SAMPLES = 9  # of a pixel
DIRECTIONS = 16  # of the sky, for each lobe of each sample
DUSK = 0.02  # of the day's light
NIGHT_EXPOSURE = 0.0  # stops; a retroreflector is white then, and what is not is still seen
SCALE, SCENE_SAMPLES = 2.0, 2
GAP, LABEL, TEXT = 12, 52, 30
GROUND = 0.012
QUALITY = 82

Floats = NDArray[np.float32]


def main(names: list[str]) -> None:
    """Draw pictures of those names, all by default."""
    own = {"materials": materials, "night": night}
    for name in names or [*own, *TITLES]:
        picture = own[name]() if name in own else draw(name, scale=SCALE, samples=SCENE_SAMPLES)
        save(FOLDER / f"{'' if name in own else 'scene-'}{name}.webp", picture)


def night() -> Floats:
    """Return the road by night of classes, and its luminances."""
    return with_legend(draw_night(CLASSES, dipped(), scale=SCALE, samples=SCENE_SAMPLES))


def materials() -> Floats:
    """Return every material by day and by night, as a contact sheet of linear light of a screen."""
    mesh = baluster()
    framing = Framing(direction=(0.0, 0.28, 1.0), fov=30.0)
    camera = framing.camera(mesh.center, 0.99 * mesh.radius, 1.0)
    day = replace(sky(), samples=DIRECTIONS)
    dusk = replace(day, intensity=DUSK)
    aside = PointLight(turned_about_y(camera.position, mesh.center, 30.0), decay_rate=0.0)
    rows: tuple[tuple[Environment, list[Light], float | str], ...] = (
        (day, [], "auto"),
        (dusk, [CameraLight()], NIGHT_EXPOSURE),
        (dusk, [aside], NIGHT_EXPOSURE),
    )
    size = (LABEL + len(rows) * (LABEL + TILE[1]) + GAP, GAP + len(MATERIALS) * (TILE[0] + GAP), 3)
    sheet = np.full(size, GROUND, np.float32)
    written = [
        (text, sheet.shape[1] // 2, 3 * LABEL // 2 + row * (TILE[1] + LABEL)) for row, text in enumerate(ROWS)
    ]
    for column, (name, label) in enumerate(MATERIALS.items()):
        left = GAP + column * (TILE[0] + GAP)
        for row, (around, lights, exposure) in enumerate(rows):
            top = 2 * LABEL + row * (TILE[1] + LABEL)
            drawn = render(
                materials_path() / f"{name}.mtlx",
                *(mesh, camera, lights, TILE),
                environment=around,
                samples=SAMPLES,
                exposure=exposure,
                background="transparent",
            )
            assert drawn.picture.alpha is not None
            ground = GROUND * (1.0 - drawn.picture.alpha[..., None])
            sheet[top : top + TILE[1], left : left + TILE[0]] = drawn.picture.pixels + ground
        written.append((label, left + TILE[0] // 2, LABEL // 2))
    return labelled(sheet, written, TEXT)


def turned_about_y(point: Any, center: Any, degrees: float) -> tuple[float, float, float]:
    """Return a point turned about the vertical through `center`."""
    x, y, z = np.subtract(point, center)
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (center[0] + cosine * x + sine * z, center[1] + y, center[2] - sine * x + cosine * z)


def save(path: Path, picture: Floats) -> None:
    """Write linear light of a screen as WebP: such pictures are large as PNG."""
    codes = np.round(srgb_encoded(np.clip(picture, 0.0, 1.0)) * 255.0).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(codes).save(file, "WEBP", quality=QUALITY, method=6)
    write_bytes(path, file.getvalue())


if __name__ == "__main__":
    main(sys.argv[1:])
