"""Pictures for eyes, developed from linear light: exposed, tone-mapped, on a background, as PNG."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.background import ENVIRONMENT, TRANSPARENT, environment_behind, parse_background
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.exposure import auto_exposure, clipped_share, lit_pixels, parse_exposure, stops_text
from mrm_nodes.render.images import png_bytes
from mrm_nodes.render.scene import Camera
from mrm_nodes.render.tonemap import ToneMap, find_tonemap, srgb_encoded

Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Picture:
    """What a screen shows of a render.

    Args:
        pixels: (h, w, 3) linear light of an sRGB screen, 0 to 1, multiplied with alpha.
        alpha: (h, w); None where a background fills what is not covered.
        exposure: stops.
        clipped: share of the lit pixels in which a channel is as bright as a picture can have it.
        tonemap: its description.
    """

    pixels: Floats
    alpha: Floats | None
    exposure: float
    clipped: float
    tonemap: str

    def encoded(self) -> Floats:
        """Values of a PNG from 0 to 1: (h, w, 3), or with alpha (h, w, 4), colours not multiplied with it."""
        if self.alpha is None:
            return srgb_encoded(self.pixels)
        alpha = self.alpha[..., None]
        straight = np.divide(self.pixels, alpha, out=np.zeros_like(self.pixels), where=alpha > 0.0)
        return np.concatenate([srgb_encoded(np.minimum(straight, 1.0)), alpha], axis=-1)

    def png(self) -> bytes:
        """The bytes of an 8-bit PNG, which says how it was exposed and tone-mapped."""
        return png_bytes(self.codes(), self.said())

    def codes(self) -> NDArray[np.uint8]:
        """What `encoded` returns, in 8 bits."""
        return np.round(self.encoded() * 255.0).astype(np.uint8)

    def said(self) -> dict[str, str]:
        """What a PNG says of itself, by keyword."""
        return {"mrm:exposure": stops_text(self.exposure), "mrm:tonemap": self.tonemap}

    def summary(self) -> str:
        """One line: exposure, tone mapping, and how much was clipped."""
        clipped = f"{_percent(self.clipped)} of lit pixels clipped"
        return f"exposure {stops_text(self.exposure, '+')} stops, {self.tonemap}: {clipped}"


def _percent(share: float) -> str:
    percent = max(100.0 * share, 0.01)
    return "none" if share == 0.0 else f"{percent:.2g} %" if percent < 10.0 else f"{percent:.0f} %"


@dataclass(frozen=True)
class Development:
    """How pictures are made of linear light.

    Args:
        exposure: stops, or `auto`: see `exposure.auto_exposure`.
        tonemap: `none`, `neutral` or a view: see `tonemap.find_tonemap`.
        background: see `background.SYNTAX`; by default the environment where there is one, else transparent.

    Raises:
        MrmError: any of these is none.
    """

    exposure: float | str = "auto"
    tonemap: str = "neutral"
    background: str | None = None

    def __post_init__(self) -> None:
        parse_exposure(self.exposure)
        find_tonemap(self.tonemap)
        if self.background is not None:
            parse_background(self.background)

    def behind(self, environment: Environment | None) -> str | Floats:
        """The background: `transparent`, `environment`, or a colour (3,) of the screen.

        Raises:
            MrmError: the environment is to be drawn, and there is none.
        """
        if self.background is None:
            return TRANSPARENT if environment is None else ENVIRONMENT
        found = parse_background(self.background)
        if isinstance(found, str) and found == ENVIRONMENT and environment is None:
            raise MrmError("background environment: there is no environment; name one with --env")
        return found


def automatic_stops(
    development: Development, image: Floats, alpha: Floats, environment: Environment | None, camera: Camera
) -> float | None:
    """The stops that `auto` has, whatever exposure is asked for; None where nothing is lit.

    image, alpha: (h, w, 3), multiplied with alpha, and (h, w).

    Raises:
        MrmError: see `Development.behind`.
    """
    behind = _seen_behind(development.behind(environment), environment, camera, alpha.shape)
    return auto_exposure(image, alpha, find_tonemap(development.tonemap).headroom, behind)


def _seen_behind(
    background: str | Floats,
    environment: Environment | None,
    camera: Camera,
    shape: tuple[int, ...],
    offset: tuple[float, float] = (0.0, 0.0),
) -> Floats | None:
    """The environment behind each pixel, (h, w, 3), where that is to be seen."""
    if environment is None or not isinstance(background, str) or background != ENVIRONMENT:
        return None
    height, width = shape
    return environment_behind(environment, camera, (width, height), offset)


class Developer:
    """Develops one picture, sample by sample: each is tone-mapped before the mean, or bright edges stay jagged.

    Args:
        image, alpha: (h, w, 3) and (h, w): a sample in the middle of each pixel, whose exposure all have, and of which
            the clipped pixels are counted.
        environment, camera: what is behind.

    Raises:
        MrmError: see `Development.behind`.
    """

    def __init__(
        self,
        development: Development,
        image: Floats,
        alpha: Floats,
        environment: Environment | None,
        camera: Camera,
    ) -> None:
        self._tonemap: ToneMap = find_tonemap(development.tonemap)
        self._behind = development.behind(environment)
        self._around = functools.partial(_seen_behind, self._behind, environment, camera)
        stops = parse_exposure(development.exposure)
        if stops is None:
            stops = automatic_stops(development, image, alpha, environment, camera) or 0.0
        self.exposure = stops
        self._gain = np.float32(2.0**self.exposure)
        lit = lit_pixels(image, alpha)
        straight = np.zeros_like(image)
        straight[lit] = self._tonemap(image[lit] / alpha[lit][:, None] * self._gain)
        self._clipped = clipped_share(srgb_encoded(straight), lit)
        self._pixels = np.zeros_like(image)
        self._alpha = np.zeros_like(alpha)
        self._count = 0

    def add(self, image: Floats, alpha: Floats, offset: tuple[float, float] = (0.0, 0.0)) -> None:
        """Add a sample of each pixel, `offset` from the middles: (h, w, 3), multiplied with alpha, and (h, w)."""
        self._count += 1
        self._alpha += alpha
        behind = self._around(alpha.shape, offset)
        if behind is not None:
            self._pixels += self._tonemap((image + (1.0 - alpha)[..., None] * behind) * self._gain)
            return
        covered = alpha > 0.0
        share = alpha[covered][:, None]
        self._pixels[covered] += share * self._tonemap(image[covered] / share * self._gain)

    def picture(self) -> Picture:
        """The mean of the samples so far."""
        pixels, alpha = self._pixels / np.float32(self._count), self._alpha / np.float32(self._count)
        is_transparent = isinstance(self._behind, str) and self._behind == TRANSPARENT
        if not isinstance(self._behind, str):
            pixels = pixels + (1.0 - alpha)[..., None] * self._behind
        return Picture(
            np.clip(pixels, 0.0, 1.0),
            alpha if is_transparent else None,
            self.exposure,
            self._clipped,
            self._tonemap.description,
        )
