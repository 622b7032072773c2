"""Light from all around: latitude-longitude maps as MaterialX reads them, from a file or made here."""

from __future__ import annotations

import functools
import math
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, MrmWarning, suggestion
from mrm_nodes.render.context import GLContext
from mrm_nodes.render.images import complaint_of, read_image

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

#: A wider map is averaged down to this when it is loaded: with its mip levels it takes 130 MB.
MAX_WIDTH = 4096

#: Width of an irradiance map, and of the map that it is computed from: both vary slowly.
_IRRADIANCE_WIDTH, _IRRADIANCE_SOURCE_WIDTH = 64, 128

#: The host's samples for each lobe, where nobody says otherwise.
DEFAULT_SAMPLES = 64


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from infinitely far away, and how the host samples it.

    Args:
        radiance: (h, 2 h, 3), linear, row 0 towards +y; the middle column looks along -z, and columns go on
            to +x, as MaterialX's `mx_latlong_projection` has it.
        rotation: degrees by which the map is turned about +y, from +z towards +x.
        intensity: factor on everything.
        samples: directions for each lobe, for hosts that sample.
        filtered: whether samples read the mip level of their solid angle; else the map as it is.

    Raises:
        MrmError: not twice as wide as high; texels that are negative, infinite or NaN; an option out of range.
    """

    radiance: Floats
    rotation: float = 0.0
    intensity: float = 1.0
    samples: int = DEFAULT_SAMPLES
    filtered: bool = True

    def __repr__(self) -> str:
        height, width = self.radiance.shape[:2]
        options = {"rotation": self.rotation, "intensity": self.intensity, "samples": self.samples}
        told = ", ".join(f"{name} {value:g}" for name, value in options.items())
        return f"<Environment {width}x{height}: {told}{'' if self.filtered else ', not filtered'}>"

    def __post_init__(self) -> None:
        self._check_options()
        pixels = np.array(self.radiance, dtype=np.float32)
        if pixels.ndim != 3 or pixels.shape[2] != 3:
            raise MrmError(f"environment: radiance has shape {pixels.shape}, not (height, width, 3)")
        _check_shape(pixels.shape[1], pixels.shape[0], "environment")
        _check_texels(pixels, "environment")
        if (pixels < 0.0).any():
            raise MrmError(f"environment: {(pixels < 0.0).sum()} values are negative")
        pixels.flags.writeable = False
        object.__setattr__(self, "radiance", pixels)

    def _check_options(self) -> None:
        for name in ("rotation", "intensity"):
            if not math.isfinite(getattr(self, name)):
                raise MrmError(f"environment: {name} {getattr(self, name)} is not a finite number")
        if self.intensity < 0.0:
            raise MrmError(f"environment: intensity {self.intensity:g} is negative")
        if not 1 <= self.samples <= 1 << 20:
            raise MrmError(f"environment: {self.samples} samples; it takes 1 to {1 << 20}")

    @functools.cached_property
    def matrix(self) -> Array:
        """The 4 × 4 rotation from world space to the map's, for column vectors: MaterialX's `u_envMatrix`."""
        # Quarter turns exactly.
        turns = math.fmod(self.rotation, 360.0)
        exact = {0.0: (1, 0), 90.0: (0, 1), 180.0: (-1, 0), 270.0: (0, -1)}
        cosine, sine = exact.get(
            turns % 360.0, (math.cos(math.radians(turns)), math.sin(math.radians(turns)))
        )
        matrix = np.eye(4)
        matrix[0, 0], matrix[0, 2], matrix[2, 0], matrix[2, 2] = cosine, -sine, sine, cosine
        return matrix

    @functools.cached_property
    def levels(self) -> list[Floats]:
        """The mip levels, (h, w, 3) each, from the map itself down to one texel: the mean over its solid angle."""
        levels = [self.radiance]
        while max(levels[-1].shape[:2]) > 1:
            height, width = (max(length // 2, 1) for length in levels[-1].shape[:2])
            levels.append(shrink(levels[-1], height, width))
        return levels

    def turned(self, degrees: float) -> Environment:
        """Return the same light, the same map, turned further about +y, from +z towards +x.

        Raises:
            MrmError: the degrees are not finite.
        """
        return self._with(rotation=math.fmod(self.rotation + degrees, 360.0))

    def _with(self, **options: Any) -> Environment:
        """The same map with other options: neither copied nor checked again, nor its levels and irradiance made."""
        other = object.__new__(Environment)
        # What is made of the map, but not the matrix.
        made = {"levels": self.levels, "irradiance": self.irradiance}
        given = {each.name: getattr(self, each.name) for each in fields(self)}
        other.__dict__.update(given | made | options)
        other._check_options()
        return other

    def uniforms(self) -> dict[str, Any]:
        """Return MaterialX's uniforms, but for the two textures."""
        return {
            "u_envMatrix": self.matrix.T.ravel(),
            "u_envLightIntensity": self.intensity,
            "u_envRadianceSamples": self.samples,
            "u_envRadianceMips": len(self.levels) if self.filtered else 1,
        }

    @functools.cached_property
    def irradiance(self) -> Floats:
        """Irradiance over π by normal, (h, w, 3) in the same projection: a white Lambertian's radiance."""
        width = min(_IRRADIANCE_SOURCE_WIDTH, self.radiance.shape[1])
        source = shrink(self.radiance, width // 2, width)
        normals = directions(_IRRADIANCE_WIDTH // 2, _IRRADIANCE_WIDTH).reshape(-1, 3)
        cosines = np.maximum(normals @ directions(width // 2, width).reshape(-1, 3).T, 0.0)
        cosines *= np.repeat(solid_angles(width // 2, width), width)
        cosines /= cosines.sum(axis=1, keepdims=True)
        result = cosines @ source.reshape(-1, 3).astype(np.float64)
        return result.reshape(_IRRADIANCE_WIDTH // 2, _IRRADIANCE_WIDTH, 3).astype(np.float32)


def directions(height: int, width: int) -> Array:
    """The direction (height, width, 3) of each texel's middle, as `mx_latlong_projection` maps it back."""
    latitude = math.pi * (0.5 - (np.arange(height) + 0.5) / height)[:, None]
    longitude = 2.0 * math.pi * ((np.arange(width) + 0.5) / width - 0.5)
    x = np.cos(latitude) * np.sin(longitude)
    z = -np.cos(latitude) * np.cos(longitude)
    return np.stack([x, np.broadcast_to(np.sin(latitude), x.shape), z], axis=-1)


def solid_angles(height: int, width: int) -> Array:
    """The solid angle of a texel in each row, (height,)."""
    edges = np.cos(math.pi * np.arange(height + 1) / height)
    return -np.diff(edges) * (2.0 * math.pi / width)


def shrink(pixels: NDArray[Any], height: int, width: int) -> Floats:
    """Average a map to a smaller size: each texel is the mean over its solid angle, whatever the two sizes."""
    weights = solid_angles(*pixels.shape[:2])[:, None, None]
    rows = _means(pixels * weights, height, axis=0) / _means(weights, height, axis=0)
    return _means(rows, width, axis=1).astype(np.float32)


def _means(values: NDArray[Any], count: int, axis: int) -> Array:
    """Means over `count` equal stretches of an axis, with the right share of what an edge cuts."""
    values = np.moveaxis(np.asarray(values, dtype=np.float64), axis, 0)
    if len(values) % count == 0:
        return np.moveaxis(values.reshape(count, -1, *values.shape[1:]).mean(axis=1), 0, axis)
    total = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    edges = np.arange(count + 1) * len(values) / count
    whole = np.minimum(edges.astype(int), len(values) - 1)
    part = (edges - whole).reshape(-1, *[1] * (values.ndim - 1))
    upto = total[whole] + part * values[whole]
    return np.moveaxis(np.diff(upto, axis=0) * count / len(values), 0, axis)


def load_environment(path: str | os.PathLike[str], *, layer: str = "", **options: Any) -> Environment:
    """Read a latitude-longitude map (.hdr, .exr, or whatever OpenImageIO knows).

    Negative texels, which resampling leaves in many maps, become 0, and a map wider than `MAX_WIDTH` is averaged
    down to it; either gives an MrmWarning. One channel is grey; alpha is dropped.

    Args:
        layer: of an EXR, where the colours without a layer's name, or the first such layer, are not what is meant.
        options: what `Environment` takes beside its radiance.

    Raises:
        MrmError: a file that is missing, damaged or no image; not twice as wide as high; infinite or NaN texels.
    """
    pixels = _read(Path(path), layer)
    if pixels.shape[2] < 3:
        pixels = np.repeat(pixels[:, :, :1], 3, axis=2)
    pixels = pixels[:, :, :3]
    _check_texels(pixels, str(path))
    negative = (pixels < 0.0).any(axis=2)
    if negative.any():
        message = f"{path}: {negative.sum()} texels are negative, down to {pixels.min():g}; they become 0"
        warnings.warn(message, MrmWarning, stacklevel=2)
        pixels = np.maximum(pixels, 0.0)
    return Environment(pixels, **options)


def _read(file: Path, layer: str) -> Floats:
    """Read a map, by strips where it is too wide, so that it is never in memory as a whole."""
    source = oiio.ImageInput.open(str(file)) if file.is_file() else None
    if source is None:
        return read_image(file, layer)  # which says what is wrong
    spec = source.spec()
    # By strips only what is one picture and nothing else.
    is_layered = bool(layer) or spec.deep or spec.nchannels > 4 or bool(source.seek_subimage(1, 0))
    is_whole = (spec.width, spec.height) == (spec.full_width, spec.full_height)
    width, height = spec.width, spec.height
    if is_whole and not is_layered:
        _check_shape(width, height, str(file))
    if is_layered or not is_whole or width <= MAX_WIDTH or spec.tile_width:
        source.close()
        pixels = read_image(file, layer)
        height, width = pixels.shape[:2]
        _check_shape(width, height, str(file))
    else:
        source.seek_subimage(0, 0)
        strips = []
        for first in range(0, spec.height, 64):
            strip = source.read_scanlines(
                first, min(first + 64, spec.height), 0, 0, spec.nchannels, oiio.FLOAT
            )
            if strip is None:
                raise MrmError(f"{file}: the image is damaged or truncated: {complaint_of(source.geterror)}")
            strip = np.asarray(strip).reshape(-1, spec.width, spec.nchannels)
            _check_texels(strip, str(file))
            strips.append(_means(strip, MAX_WIDTH, axis=1).astype(np.float32))
        source.close()
        pixels = np.concatenate(strips)
    if width > MAX_WIDTH:
        size = f"{MAX_WIDTH} × {MAX_WIDTH // 2}"
        message = f"{file}: {width} × {height} texels are more than this renders with; averaged to {size}"
        warnings.warn(message, MrmWarning, stacklevel=3)
        _check_texels(pixels, str(file))
        pixels = shrink(pixels, MAX_WIDTH // 2, MAX_WIDTH)
    return pixels


def _check_shape(width: int, height: int, what: str) -> None:
    if width != 2 * height:
        raise MrmError(
            f"{what}: {width} × {height} texels; a latitude-longitude map is twice as wide as high"
        )


def _check_texels(pixels: NDArray[Any], what: str) -> None:
    bad = ~np.isfinite(pixels).all(axis=2)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise MrmError(
            f"{what}: {bad.sum()} texels are infinite or NaN, the first in row {row}, column {column}; "
            "a renderer would spread them over everything, so mend the map first"
        )


@functools.cache
def sky() -> Environment:
    """A clear sky with a sun, over brown ground.

    The sun stands 40 degrees high towards +x and +z; it is wider than the real one (5 degrees across) and as much
    dimmer, so that a small map holds it.
    """
    toward = directions(128, 256)
    height = toward[..., 1:2]
    zenith, horizon = np.array([0.15, 0.32, 0.8]), np.array([0.75, 0.85, 1.0])
    ground = np.array([0.16, 0.12, 0.09])
    blend = _smoothstep(-0.02, 0.02, height)
    above = horizon + (zenith - horizon) * np.sqrt(np.clip(height, 0.0, 1.0))
    sun = np.array([0.6, math.sin(math.radians(40.0)), 0.0])
    sun[2] = math.sqrt(1.0 - sun[0] ** 2 - sun[1] ** 2)
    cosine = toward @ sun
    disc = _smoothstep(math.cos(math.radians(3.5)), math.cos(math.radians(1.5)), cosine)[..., None]
    radiance = ground + (above - ground) * blend + disc * np.array([650.0, 590.0, 500.0])
    return Environment(radiance.astype(np.float32))


@functools.cache
def studio() -> Environment:
    """A dark room with three soft boxes: a large one above, a warm one at the left, a cold strip at the right."""
    toward = directions(128, 256)
    radiance = np.full((128, 256, 3), 0.03)
    boxes = (
        ((0.1, 1.0, 0.25), (0.55, 0.35), (6.0, 6.0, 6.0)),
        ((-1.0, 0.35, 0.6), (0.3, 0.45), (9.0, 6.5, 4.0)),
        ((1.0, 0.2, 0.1), (0.08, 0.7), (5.0, 7.5, 12.0)),
    )
    for middle, size, color in boxes:
        axis = np.array(middle) / np.linalg.norm(middle)
        across = np.cross((0.0, 1.0, 0.0), axis)
        across /= np.linalg.norm(across)
        depth = toward @ axis
        seen = np.maximum(depth, 1e-6)
        x, y = np.abs(toward @ across) / seen, np.abs(toward @ np.cross(axis, across)) / seen
        inside = _smoothstep(1.08, 0.92, x / size[0]) * _smoothstep(1.08, 0.92, y / size[1]) * (depth > 0.0)
        radiance += inside[..., None] * np.array(color)
    return Environment(radiance.astype(np.float32))


@functools.cache
def white() -> Environment:
    """Radiance 1 from everywhere: a lobe shows its directional albedo, and one that loses nothing vanishes."""
    return Environment(np.ones((8, 16, 3), np.float32))


def _smoothstep(low: float, high: float, x: Array) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


#: The environments that need no file, by the name that the command line uses.
BUILT_IN_ENVIRONMENTS: dict[str, Callable[[], Environment]] = {"sky": sky, "studio": studio, "white": white}


def find_environment(name: str | os.PathLike[str], **options: Any) -> Environment:
    """Return a built-in environment, or read a map.

    Args:
        name: `sky`, `studio`, or a latitude-longitude map, an .hdr or .exr file.
        options: `rotation`, `intensity`, `samples` and `filtered` as of `Environment`; `layer` of an EXR.

    Raises:
        MrmError: as `load_environment`.
    """
    if str(name) in BUILT_IN_ENVIRONMENTS:
        if options.pop("layer", ""):
            raise MrmError(f"environment {name} is no file, and has no layers")
        return replace(BUILT_IN_ENVIRONMENTS[str(name)](), **options)
    if not Path(name).suffix and not Path(name).exists():
        raise MrmError(
            f"unknown environment {name}: no such file; {suggestion(os.fspath(name), BUILT_IN_ENVIRONMENTS)}"
        )
    return load_environment(name, **options)


@dataclass(frozen=True, eq=False)
class EnvironmentTextures:
    """An environment's map on the GPU, whatever its rotation, intensity and samples are."""

    map: Floats  # kept alive, so that no other map gets its id
    radiance: moderngl.Texture
    irradiance: moderngl.Texture

    @classmethod
    def upload(cls, context: GLContext, environment: Environment) -> EnvironmentTextures:
        """Upload a map with its mip levels, and its irradiance.

        Raises:
            MrmError: the map is larger than the driver takes.
        """
        limit = context.ctx.info["GL_MAX_TEXTURE_SIZE"]
        width = environment.radiance.shape[1]
        if width > limit:
            raise MrmError(f"environment: {width} texels wide, but this driver takes {limit} at most")
        return cls(
            environment.radiance,
            _texture(context, environment.levels),
            _texture(context, [environment.irradiance]),
        )

    def release(self) -> None:
        """Free the GPU's memory."""
        self.radiance.release()
        self.irradiance.release()


def _texture(context: GLContext, levels: list[Floats]) -> moderngl.Texture:
    height, width, _ = levels[0].shape
    texture = context.ctx.texture(
        (width, height), 3, np.ascontiguousarray(levels[0]), alignment=1, dtype="f4"
    )
    if len(levels) > 1:
        texture.build_mipmaps()
        for number, level in enumerate(levels[1:], start=1):
            texture.write(np.ascontiguousarray(level), level=number, alignment=1)
        texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    else:
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
    texture.repeat_x, texture.repeat_y = True, False
    return texture
