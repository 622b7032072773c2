"""Draws docs/images/materials.png, the README's picture: `python docs/make_images.py`.

Each finished material on the baluster, with the light at the camera and 30 degrees beside it.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.library import materials_path
from mrm_nodes.render import CameraLight, Framing, Light, PointLight, baluster, render, write_png

MATERIALS = {
    "hi_vis_tape": "hi-vis tape",
    "traffic_cone": "traffic cone",
    "road_paint": "road paint",
    "chevron_sign": "chevron sign",
    "number_plate": "number plate",
    "yellow_tape": "yellow tape",
}
ROWS = ("light at the camera", "light 30° away")
PICTURE = Path(__file__).parent / "images" / "materials.png"

TILE = (150, 268)  # width and height of one picture in pixels
SAMPLES = 3  # per pixel and direction
GAP, LABEL, TEXT = 6, 26, 15
EXPOSURE, SHOULDER = 1.4, 0.6

Floats = NDArray[np.float64]


def main() -> None:
    """Render every material under both lights, and write the contact sheet."""
    mesh = baluster()
    framing = Framing(direction=(0.0, 0.28, 1.0), fov=30.0)
    camera = framing.camera(mesh.center, 0.99 * mesh.radius, 1.0)
    lights: tuple[Light, ...] = (
        CameraLight(),
        PointLight(turned_about_y(camera.position, mesh.center, 30.0), decay_rate=0.0),
    )
    sheet = np.zeros((LABEL + 2 * (LABEL + TILE[1]) + GAP, GAP + len(MATERIALS) * (TILE[0] + GAP), 3))
    for column, (name, label) in enumerate(MATERIALS.items()):
        left = GAP + column * (TILE[0] + GAP)
        for row, light in enumerate(lights):
            top = 2 * LABEL + row * (TILE[1] + LABEL)
            image = render(
                materials_path() / f"{name}.mtlx",
                mesh=mesh,
                camera=camera,
                lights=[light],
                size=(SAMPLES * TILE[0], SAMPLES * TILE[1]),
            ).image
            sheet[top : top + TILE[1], left : left + TILE[0]] = reduced(displayed(image))
        write_label(sheet, label, left + TILE[0] // 2, LABEL // 2)
    for row, text in enumerate(ROWS):
        write_label(sheet, text, sheet.shape[1] // 2, 3 * LABEL // 2 + row * (TILE[1] + LABEL))
    write_png(PICTURE, sheet)


def turned_about_y(point: Any, center: Any, degrees: float) -> tuple[float, float, float]:
    """Return a point turned about the vertical through `center`."""
    x, y, z = np.subtract(point, center)
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return (center[0] + cosine * x + sine * z, center[1] + y, center[2] - sine * x + cosine * z)


def displayed(radiance: NDArray[np.float32]) -> Floats:
    """Map linear radiance to linear display values, the same for every tile: unchanged up to a shoulder."""
    exposed = EXPOSURE * radiance.astype(np.float64)
    room = 1.0 - SHOULDER
    above = np.maximum(exposed - SHOULDER, 0.0) / room
    return np.minimum(exposed, SHOULDER) + room * (1.0 - np.exp(-above))


def reduced(image: Floats) -> Floats:
    """Average the samples of each pixel."""
    height, width = image.shape[0] // SAMPLES, image.shape[1] // SAMPLES
    averages: Floats = image.reshape(height, SAMPLES, width, SAMPLES, 3).mean(axis=(1, 3))
    return averages


def write_label(sheet: Floats, text: str, x: int, y: int) -> None:
    """Write light grey text, centred on (x, y), into the sheet."""
    canvas = oiio.ImageBuf(np.ascontiguousarray(sheet, dtype=np.float32))
    grey = (0.6, 0.6, 0.6)
    if not oiio.ImageBufAlgo.render_text(
        canvas, x, y, text, TEXT, textcolor=grey, alignx="center", aligny="center"
    ):
        raise RuntimeError(canvas.geterror())
    sheet[...] = canvas.get_pixels(oiio.FLOAT)


if __name__ == "__main__":
    main()
