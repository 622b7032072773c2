"""The scenes by name, as pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown
from mrm_nodes.render import Mesh, load_mesh, write_png
from mrm_nodes.render.tonemap import find_tonemap
from mrm_nodes.scenes import cone, figures, road, vest
from mrm_nodes.scenes.compose import Rows, reduced, sampled, steps

Array = NDArray[np.float64]

TITLES = {
    "torch": "The same cones by night at one exposure: the torch at the eye, and the torch an arm's length aside",
    "cone": "Traffic cones by day, and in the beam of a torch beside the camera",
    "vest": "A safety vest by day, and in the beam of a torch beside the camera",
    "road": "A road by day, and at night as its driver sees it",
    "figure3": "A dielectric ball: GGX and then MRM, each with the light at the camera and 60° from it",
    "figure5": "A metal ball, GGX above and MRM below, with 0°, 45° and 90° between view and light",
}

_BUILT: dict[str, Callable[[], Rows]] = {
    "torch": cone.torch,
    "cone": cone.scene,
    "vest": vest.scene,
    "road": road.scene,
}
_ON_A_MESH: dict[str, Callable[[Mesh], Rows]] = {"figure3": figures.figure3, "figure5": figures.figure5}
_GAP = 6


@contextmanager
def _quietly(steps: int) -> Iterator[Callable[[], object]]:
    yield lambda: None


def draw(
    name: str,
    mesh: str | os.PathLike[str] | None = None,
    scale: float = 1.0,
    samples: int = 2,
    shadows: float = 1.0,
    exposure: float = 0.0,
    tonemap: str = "neutral",
    progress: Callable[[int], AbstractContextManager[Callable[[], object]]] = _quietly,
) -> NDArray[np.float32]:
    """Return a scene's pictures beside and above each other: (h, w, 3), linear light of a screen, from 0 to 1.

    Each sample is tone-mapped before the mean.

    Args:
        name: one of `TITLES`.
        mesh: as in `mrm_nodes.render`, shown in place of the ball of the paper's figures.
        scale: of the pictures.
        samples: a pixel is the mean of samples × samples.
        shadows: share of the finest shadows, above 0.
        exposure: stops beyond those of each picture.
        tonemap: see `find_tonemap`.
        progress: is told how many steps it takes, and gives what to call after each.

    Raises:
        MrmError: an unknown scene or tone mapping, a mesh where the scene has its own, or one that cannot be read.
    """
    if name not in TITLES:
        raise MrmError(unknown("scene", name, TITLES))
    mapped = find_tonemap(tonemap)
    if name in _ON_A_MESH:
        rows = _ON_A_MESH[name](figures.ball() if mesh is None else load_mesh(mesh))
    elif mesh is None:
        rows = _BUILT[name]()
    else:
        raise MrmError(f"{name}: has its own geometry; a mesh can be shown in {' and '.join(_ON_A_MESH)}")
    with progress(sum(steps(scene) for row in rows for scene, _ in row)) as step:
        pictures = [
            [
                reduced(
                    mapped(
                        sampled(scene, (round(w * scale), round(h * scale)), samples, shadows, step)
                        * 2.0 ** (scene.exposure + exposure)
                    ),
                    samples,
                )
                for scene, (w, h) in row
            ]
            for row in rows
        ]
    return _tiled(pictures).astype(np.float32)


def scene_gallery(
    folder: str | os.PathLike[str], names: Iterable[str] = tuple(TITLES), scale: float = 0.5
) -> list[dict[str, str]]:
    """Draw scenes, small, into a folder that exists, and return title, caption and image file of each.

    Args:
        folder: that exists.
        names: of `TITLES`.
        scale: of the pictures.

    The two figures take a few seconds, all six about a minute.
    """
    shown = []
    for name in names:
        image = f"scene-{name}.png"
        write_png(Path(folder) / image, draw(name, scale=scale, samples=1, shadows=0.2))
        shown.append({"title": name, "caption": TITLES[name], "image": image})
    return shown


def _tiled(rows: Sequence[Sequence[Array]]) -> Array:
    """Put pictures side by side and above each other, with white between."""
    bands = []
    for row in rows:
        gap = np.ones((row[0].shape[0], _GAP, 3))
        bands.append(np.concatenate([part for picture in row for part in (picture, gap)][:-1], axis=1))
    gap = np.ones((_GAP, bands[0].shape[1], 3))
    return np.concatenate([part for band in bands for part in (band, gap)][:-1], axis=0)
