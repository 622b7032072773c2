"""Draws a generated shader on a mesh, or on a cloud of points, and hands back the image with its geometry."""

from __future__ import annotations

import functools
import itertools
import math
import os
import re
import time
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import MaterialX as mx
import moderngl
import numpy as np
from numpy.typing import NDArray

from mrm_nodes import filenames
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import write_bytes
from mrm_nodes.render.antialias import sample_offsets
from mrm_nodes.render.checks import CHECK_VARIABLE, check_draw
from mrm_nodes.render.commonnames import common_names, documents_names
from mrm_nodes.render.context import GLContext, get_context
from mrm_nodes.render.environment import Environment, EnvironmentTextures, find_environment
from mrm_nodes.render.gbuffer import (
    ALPHA_THRESHOLD,
    BITANGENT_SIGN,
    TARGETS,
    Stages,
    mesh_stages,
    point_stages,
    sheet_stages,
)
from mrm_nodes.render.images import exr_bytes
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.picture import Developer, Development, Picture, automatic_stops
from mrm_nodes.render.recent import Recent
from mrm_nodes.render.scene import Camera, Framing, Light, parse_camera, parse_light, vector
from mrm_nodes.render.textures import Sampling, TextureCache, border_color, find_image
from mrm_nodes.render.uniforms import Uniform, uniforms_of
from mrm_nodes.shadergen import Shader, generate_shader, room_for

Floats = NDArray[np.float32]
T = TypeVar("T")

#: Points of one draw; more are drawn in turns, so that memory stays modest.
POINTS_PER_DRAW = 1 << 20

_KEPT_PROGRAMS, _KEPT_MESHES, _KEPT_TARGETS, _KEPT_ENVIRONMENTS = (
    16,
    16,
    2,
    4,
)  # a program: to 65 MB with llvmpipe
#: A pixel takes 128 bytes on the GPU and in memory.
_MAX_PIXELS = 8192 * 8192

_GL_SAMPLER_2D = 0x8B5E
#: What MaterialX's viewer takes for opaque and draws first; and what it draws at all.
_OPAQUE, _VISIBLE = 0.99, 0.001
#: What of OpenGL's state some draws have otherwise than others: see `check_draw`.
State = Mapping[str, tuple[int, ...]]
_USUAL: State = {}
_BLENDING: State = {"GL_BLEND": (1,)}
_DEPTH_ONLY: State = {"GL_COLOR_WRITEMASK": (0, 0, 0, 0)}
_SAME_DEPTH: State = {"GL_DEPTH_FUNC": (0x0202,)}  # GL_EQUAL
_ENVIRONMENT_MAPS = "u_envRadiance", "u_envIrradiance"
_IDENTITY = tuple(np.eye(4).ravel().tolist())


@dataclass(frozen=True, eq=False)
class RenderedImage:
    """An image and, from the same draw, the geometry that its shader saw: float32, row 0 at the top.

    Args:
        image: (h, w, 3) linear radiance; 0 where nothing was drawn, and behind what is transparent: multiplied with
            `alpha`. Of several samples the mean, while the geometry is that of the pixels' middles.
        alpha: (h, w), how much of a pixel is covered, and how opaque by, 0 to 1.
        position: (h, w, 3) in world space, in scene units.
        normal: (h, w, 3) in world space, as interpolated: not quite a unit vector.
        tangent: (h, w, 3), likewise.
        texcoord: (h, w, 2), as interpolated.
        mask: (h, w), True where the mesh covers the middle of the pixel, and is not cut out there (alpha below 0.001).
        camera: the camera that was used.
        backend: which OpenGL drew it, `egl` or `osmesa`.
        device: the name that its driver gives.
        seconds: `compile` (0 where the program was known) and `render`, until the pixels are in memory; in seconds.
        environment: what was around it.
        development: how a picture for eyes is made of it; None where none was wanted.
        developed: that picture, where it was made as the samples were drawn.
    """

    image: Floats
    alpha: Floats
    position: Floats
    normal: Floats
    tangent: Floats
    texcoord: Floats
    mask: NDArray[np.bool_]
    camera: Camera
    backend: str
    device: str
    seconds: Mapping[str, float]
    environment: Environment | None = None
    development: Development | None = field(default_factory=Development)
    developed: Picture | None = None

    def __repr__(self) -> str:
        height, width = self.mask.shape
        return f"<RenderedImage {width}x{height}, {self.mask.mean():.0%} covered, by {self.backend}: {self.device}>"

    @functools.cached_property
    def picture(self) -> Picture:
        """What a screen shows of it.

        Raises:
            MrmError: none was wanted; see `Development.behind`.
        """
        return self.developed or self.developer().picture()

    def developer(self) -> Developer:
        """What develops the picture of this one sample, and takes others.

        Raises:
            MrmError: none was wanted; see `Development.behind`.
        """
        developer = self._undeveloped()
        developer.add(self.image, self.alpha)
        return developer

    def _undeveloped(self) -> Developer:
        if self.development is None:
            raise MrmError("this image was drawn without a picture: draw it with picture=True")
        return Developer(self.development, self.image, self.alpha, self.environment, self.camera)

    def auto_exposure(self) -> float | None:
        """The stops that `auto` has for this one sample; None where nothing is lit: see `exposure.auto_exposure`.

        Raises:
            MrmError: see `Development.behind`.
        """
        development = self.development or Development()
        return automatic_stops(development, self.image, self.alpha, self.environment, self.camera)

    def file_bytes(self, path: str | os.PathLike[str]) -> bytes:
        """The bytes of an image file, by the ending of its name: see `save`.

        Raises:
            MrmError: another ending; see `Development.behind`.
        """
        ending = Path(path).suffix.lower()
        if ending not in IMAGE_ENDINGS:
            raise MrmError(unknown_ending(path))
        if ending == ".exr":
            return exr_bytes(np.concatenate([self.image, self.alpha[..., None]], axis=-1), str(path))
        return self.picture.png()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the image: .exr has linear radiance and alpha in float32, .png what a screen shows.

        The file appears complete or not at all.

        Raises:
            MrmError: another ending; a folder that cannot be written; see `Development.behind`.
        """
        write_bytes(Path(path), self.file_bytes(path))

    def _repr_png_(self) -> bytes:
        """What a notebook shows."""
        return self.picture.png()


IMAGE_ENDINGS = (".exr", ".png")


def unknown_ending(path: str | os.PathLike[str], endings: Sequence[str] = IMAGE_ENDINGS) -> str:
    """What to say of a file that is to be an image and has another ending."""
    return f"{path}: unknown image ending {Path(path).suffix or '(none)'}; use {' or '.join(endings)}"


@dataclass(frozen=True, eq=False)
class _Program:
    """A linked program, its active uniforms, samplers and attributes, and a number that is never used again."""

    number: int
    program: moderngl.Program
    uniforms: Mapping[str, Any]  # moderngl.Uniform; without the samplers
    samplers: Mapping[str, Any]
    attributes: dict[str, int]  # by name: how many floats
    sheets: int  # of gbuffer.sheet_stages; 0 for other programs
    targets: int

    def named(self, names: Mapping[str, str]) -> _Program:
        """The same program, its uniforms and samplers by the names that they have in one of its documents."""

        def own(members: Mapping[str, Any]) -> dict[str, Any]:
            return {documents_names(name, names): member for name, member in members.items()}

        return replace(self, uniforms=own(self.uniforms), samplers=own(self.samplers))


@dataclass(frozen=True, eq=False)
class _MeshBuffers:
    """A mesh on the GPU, and a vertex array for each program that drew it."""

    mesh: Mesh  # kept alive, so that no other mesh gets its id
    buffers: dict[str, tuple[moderngl.Buffer, str]]
    indices: moderngl.Buffer
    arrays: dict[int, moderngl.VertexArray] = field(default_factory=dict)

    def release(self) -> None:
        _release(*self.arrays.values(), *(buffer for buffer, _ in self.buffers.values()), self.indices)


@dataclass(frozen=True, eq=False)
class _Target:
    """A float32 framebuffer: the image and the geometry."""

    colors: list[moderngl.Texture]
    depth: moderngl.Renderbuffer
    framebuffer: moderngl.Framebuffer

    def read(self, index: int) -> Floats:
        """Return one attachment, (h, w, 4), row 0 at the bottom."""
        width, height = self.framebuffer.size
        return np.frombuffer(self.colors[index].read(), np.float32).reshape(height, width, 4)

    def read_split(self, index: int) -> tuple[Floats, Floats]:
        """Return one attachment's first three channels (h, w, 3) and its last (h, w), row 0 at the top."""
        pixels = self.read(index)[::-1]
        return np.ascontiguousarray(pixels[..., :3]), np.ascontiguousarray(pixels[..., 3])

    def release(self) -> None:
        # moderngl binds again and again what is bound, although it may be gone.
        self.framebuffer.ctx.screen.use()
        _release(self.framebuffer, *self.colors, self.depth)


def _release(*items: Any) -> None:
    for item in items:
        item.release()


class _Kept:
    """What a renderer keeps on the GPU between calls; without a way back to the renderer, which it outlives."""

    def __init__(self, gl: GLContext) -> None:
        self.numbers = itertools.count()
        self.programs: Recent[Stages, _Program] = Recent(_KEPT_PROGRAMS, self._release_program)
        self.meshes: Recent[int, _MeshBuffers] = Recent(_KEPT_MESHES, _MeshBuffers.release)
        self.targets: Recent[tuple[str, int, int, int], _Target] = Recent(_KEPT_TARGETS, _Target.release)
        self.environments: Recent[int, EnvironmentTextures] = Recent(
            _KEPT_ENVIRONMENTS, EnvironmentTextures.release
        )
        self.textures = TextureCache(gl)
        self.black = gl.ctx.texture((1, 1), 4, np.zeros(4, np.float32), dtype="f4")

    def _release_program(self, program: _Program) -> None:
        for mesh in self.meshes:
            _release(*filter(None, [mesh.arrays.pop(program.number, None)]))
        program.program.release()

    def release(self) -> None:
        for kept in (self.meshes, self.programs, self.targets, self.environments):
            kept.clear()
        _release(self.textures, self.black)


class Renderer:
    """Renders on one backend; programs, meshes and images stay on the GPU between calls.

    All renderers of a process share one context per backend, and any thread may use them: they draw one after the
    other. `close`, the end of a `with` block or being collected gives the memory back.

    Args:
        backend: `egl`, `osmesa`, or `auto` for the first of them that works.

    Raises:
        MrmError: an unknown backend, or no OpenGL there; a process that was forked from one which has rendered.
    """

    def __init__(self, backend: str = "auto") -> None:
        self._gl = get_context(backend)
        self.backend = self._gl.backend
        self.device = self._gl.renderer
        self._kept = self._gl.run(lambda: _Kept(self._gl))
        self._finalizer = weakref.finalize(self, self._gl.post, self._kept.release)
        # When the process ends, so does its context.
        self._finalizer.atexit = False

    def close(self) -> None:
        """Free the GPU's memory; this renderer draws nothing more. A second time it does nothing."""
        self._finalizer()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return not self._finalizer.alive

    def __enter__(self) -> Renderer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _run(self, work: Callable[[], T]) -> T:
        """Do something on the context's thread, where `close` may have come first."""

        def unless_closed() -> T:
            if self.closed:
                raise MrmError("this renderer was closed: make another one")
            return work()

        return self._gl.run(unless_closed)

    def render(
        self,
        shader: Shader,
        mesh: Mesh,
        camera: Camera | Framing | None = None,
        lights: Sequence[Light] = (),
        size: tuple[int, int] = (512, 512),
        uniforms: Mapping[str, Any] | None = None,
        environment: Environment | None = None,
        visible: tuple[Shader, Mapping[str, Any]] | None = None,
        offset: tuple[float, float] = (0.0, 0.0),
    ) -> RenderedImage:
        """Draw a mesh with one sample in the middle of each pixel.

        A transparent surface is drawn as MaterialX's viewer does: first what is opaque, then the rest over it, in the
        order of the mesh's triangles.

        Args:
            camera: by default it stands on the +z side and shows the whole mesh.
            size: width and height in pixels.
            uniforms: values in place of the material's, by the path of an input (`graph/node/input`) or by
                the uniform's name; an enum takes its name or its number.
            environment: black by default.
            visible: a surface, with its `uniforms`: only where that is seen anything is drawn, holes of an alpha mask
                and what is behind them included.
            offset: of the samples from the pixels' middles, in pixels to the right and upwards.

        Raises:
            MrmError: the shader does not compile; an image is missing or damaged; an unknown uniform; NaN;
                more lights than the shader has room for; a size that the driver cannot draw.
        """
        width, height = self.checked_size(size)
        aspect = width / height
        if camera is None:
            camera = Framing()
        if isinstance(camera, Framing):
            camera = camera.camera(mesh.center, mesh.radius, aspect, mesh.positions)
        near, far = camera.clip_distances(mesh.center, mesh.radius)
        view_projection = camera.projection_matrix(aspect, near, far) @ camera.view_matrix()
        if any(offset):
            shift = np.eye(4)
            shift[:2, 3] = -2.0 * offset[0] / width, -2.0 * offset[1] / height
            view_projection = shift @ view_projection
        values = uniforms_of(shader, uniforms)
        if mesh.colors is None and " i_color_0;" in shader.vertex:
            _warn(
                f"mesh {mesh.name} has no vertex colours (color_0), which {shader.name} uses: they are white"
            )

        def draw() -> RenderedImage:
            started = time.perf_counter()
            program, is_new = self._program(shader, mesh_stages(shader.vertex, shader.pixel))
            textures = self._upload(shader, program, values, view_projection, camera, lights, environment)
            images = _images(shader, program, values)
            parts = _parts_of(mesh, images)
            _warn_of_missing_tiles(images, parts, mesh)
            if is_new:
                # Drivers compile the second half of a program when it first draws.
                target = self._begin((width, height), program.targets, depth_test=True)
                first = self._vertex_array(program, mesh, shader)
                read = self._with_images(textures, images, next(iter(parts)))
                self._draw(program, first, target, read, moderngl.TRIANGLES, 3)
            compiled = time.perf_counter()
            target = self._begin((width, height), program.targets, depth_test=True)
            state = _USUAL
            if visible is not None:
                self._draw_depth(visible, mesh, target, view_projection, camera)
                state = _SAME_DEPTH
                # The two may share a program.
                textures = self._upload(shader, program, values, view_projection, camera, lights, environment)
            self._draw_surface(
                program,
                lambda given: self._draw_parts(shader, program, parts, images, textures, target, given),
                state,
            )
            (image, opacity), (position, covered), (normal, u), (tangent, v) = map(
                target.read_split, range(TARGETS)
            )
            mask = covered > 0.5
            # The fourth number of a colour that is not blended is no opacity.
            blends = ALPHA_THRESHOLD in program.uniforms
            alpha = np.where(mask, np.clip(opacity, 0.0, 1.0) if blends else np.float32(1.0), np.float32(0.0))
            texcoord = np.stack([u, v], axis=-1)
            if program.targets > TARGETS:
                texcoord = np.ascontiguousarray(target.read_split(TARGETS)[0][..., :2])
            finished = time.perf_counter()
            return RenderedImage(
                image=image,
                alpha=alpha,
                position=position,
                normal=normal,
                tangent=tangent,
                texcoord=texcoord,
                mask=mask,
                camera=camera,
                backend=self.backend,
                device=self.device,
                seconds={"compile": compiled - started if is_new else 0.0, "render": finished - compiled},
                environment=environment,
            )

        return self._run(draw)

    def _draw_surface(
        self,
        program: _Program,
        draw: Callable[[State], None],
        state: State,
    ) -> None:
        """Draw a mesh into the target that was begun: opaque, or in the two passes of MaterialX's viewer."""
        if ALPHA_THRESHOLD not in program.uniforms:
            draw(state)
            return
        ctx = self._gl.ctx
        program.uniforms[ALPHA_THRESHOLD].value = _OPAQUE
        draw(state)
        program.uniforms[ALPHA_THRESHOLD].value = _VISIBLE
        ctx.enable(moderngl.BLEND)
        # Alpha adds up as coverage does: colours are multiplied with it then, over black.
        over = moderngl.ONE_MINUS_SRC_ALPHA
        factors: Any = (moderngl.SRC_ALPHA, over, moderngl.ONE, over)
        ctx.blend_func = factors
        draw({**state, **_BLENDING})
        ctx.disable(moderngl.BLEND)

    def _draw_parts(
        self,
        shader: Shader,
        program: _Program,
        parts: Mapping[filenames.Tile, Mesh],
        images: Mapping[str, _Image],
        textures: Mapping[str, moderngl.Texture],
        target: _Target,
        state: State,
    ) -> None:
        """Draw the parts of a mesh, each with the images of its tile."""
        for tile, part in parts.items():
            array = self._vertex_array(program, part, shader)
            read = self._with_images(textures, images, tile)
            self._draw(program, array, target, read, moderngl.TRIANGLES, state=state)

    def _draw_depth(
        self,
        visible: tuple[Shader, Mapping[str, Any]],
        mesh: Mesh,
        target: _Target,
        view_projection: NDArray[np.float64],
        camera: Camera,
    ) -> None:
        """Have the next draw into a target draw only what is seen of a surface."""
        shader, uniforms = visible
        program, _ = self._program(shader, mesh_stages(shader.vertex, shader.pixel))
        values = uniforms_of(shader, uniforms)
        textures = self._upload(shader, program, values, view_projection, camera, (), None)
        if ALPHA_THRESHOLD in program.uniforms:
            program.uniforms[ALPHA_THRESHOLD].value = _VISIBLE
        images = _images(shader, program, values)
        parts = _parts_of(mesh, images)
        framebuffer: Any = target.framebuffer
        framebuffer.color_mask = [(False,) * 4] * len(target.colors)
        try:
            self._draw_parts(shader, program, parts, images, textures, target, _DEPTH_ONLY)
        finally:
            framebuffer.color_mask = [(True,) * 4] * len(target.colors)
        self._gl.ctx.depth_func = "=="

    def draw_points(
        self,
        shader: Shader,
        attributes: Mapping[str, NDArray[Any]],
        camera_position: Sequence[float],
        lights: Sequence[Light] = (),
        uniforms: Mapping[str, Any] | None = None,
        environment: Environment | None = None,
    ) -> dict[str, Floats]:
        """Shade n points, each with its own vertex data: n configurations of the same shader.

        Args:
            attributes: arrays of length n, (n,) or (n, k), by the name of the vertex attribute without `i_`:
                `position`, `normal`, `tangent` (and `bitangent`, `texcoord_0`, `color_0`), and by the name
                that a `geompropvalue` node gives. `position` is needed, and what the shader uses.
            camera_position: where the shader takes the view direction from.
            uniforms: as in `render`.
            environment: as in `render`.

        Returns:
            `image`, `position`, `normal`, `tangent`: (n, 3) float32, in the order of the points.

        Raises:
            MrmError: as `render`; also vertex data that is missing, of the wrong shape, unknown, or NaN.
        """
        data = {
            name.removeprefix("i_").removeprefix("geomprop_"): value for name, value in attributes.items()
        }
        if "position" not in data:
            raise MrmError("draw_points: the attribute position is missing")
        count = len(np.asarray(data["position"]))
        if count == 0:
            raise MrmError("draw_points: there are no points")
        # The shader sees nothing of the camera but its position.
        position = vector(camera_position, "draw_points: camera_position")
        camera = Camera(position, (position[0], position[1], position[2] - 1.0))
        values = uniforms_of(shader, uniforms)
        names = ("image", "position", "normal", "tangent")
        results = {name: np.empty((count, 3), np.float32) for name in names}

        def draw() -> None:
            # Images are read at the level of detail of single points, which one triangle does not have.
            reads_images = any(value.type == "filename" and value.value for value in values.values())
            stages = None if reads_images else sheet_stages(shader.vertex, shader.pixel)
            # Programs that run one after the other: one that places points and shades them, or one of each.
            programs = [
                self._program(shader, part)[0]
                for part in (stages or (point_stages(shader.vertex, shader.pixel),))
            ]
            streams = self._point_streams(programs[0], data, count, shader)
            textures = []
            for program in programs:
                images = _images(shader, program, values)
                tiled = next((files.name for files, _ in images.values() if files.tiles), None)
                if tiled is not None:
                    raise MrmError(f"draw_points: {tiled}: tiles are drawn on meshes only")
                others = self._upload(shader, program, values, np.eye(4), camera, lights, environment)
                textures.append(self._with_images(others, images, (0, 0)))
            for start in range(0, count, POINTS_PER_DRAW):
                end = min(start + POINTS_PER_DRAW, count)
                chunk = {name: stream[start:end] for name, stream in streams.items()}
                target = self._draw_chunk(programs, textures, chunk, end - start)
                for index, result in enumerate(results.values()):
                    result[start:end] = target.read(index).reshape(-1, 4)[: end - start, :3]

        self._run(draw)
        return results

    def _draw_chunk(
        self,
        programs: list[_Program],
        textures: list[dict[str, moderngl.Texture]],
        streams: dict[str, Floats],
        count: int,
    ) -> _Target:
        width = math.isqrt(count - 1) + 1
        size = (width, -(-count // width))
        ctx = self._gl.ctx
        placing, shading = programs[0], programs[-1]
        placing.uniforms["mrm_grid"].value = size
        buffers = {name: ctx.buffer(np.ascontiguousarray(stream)) for name, stream in streams.items()}
        content = [(buffer, f"{placing.attributes[name]}f", name) for name, buffer in buffers.items()]
        points = ctx.vertex_array(placing.program, content)
        triangle = ctx.vertex_array(shading.program, [])
        try:
            target = self._begin(size, placing.sheets, role="sheets") if placing.sheets else self._begin(size)
            self._draw(placing, points, target, textures[0], moderngl.POINTS, count)
            if shading is not placing:
                # A driver drops the samplers of data that come to nothing.
                named = {f"mrm_sheet_{index}": sheet for index, sheet in enumerate(target.colors)}
                sheets = {name: sheet for name, sheet in named.items() if name in shading.samplers}
                target = self._begin(size)
                self._draw(shading, triangle, target, textures[-1] | sheets, moderngl.TRIANGLES, 3)
            return target
        finally:
            _release(points, triangle, *buffers.values())

    def _point_streams(
        self, program: _Program, data: Mapping[str, NDArray[Any]], count: int, shader: Shader
    ) -> dict[str, Floats]:
        """Return the arrays of the program's vertex attributes, by their names in GLSL."""
        declared = {_bare(name) for name in program.attributes} | {
            _bare(name) for name in re.findall(r"^in \w+ i_(\w+);", shader.vertex, re.MULTILINE)
        }
        known = declared | {"position", "normal", "tangent", "bitangent", "texcoord_0", "color_0"}
        unknown = sorted(set(data) - known)
        if unknown:
            raise MrmError(
                f"draw_points: {shader.name} has no attribute {unknown[0]}; known: {sorted(known)}"
            )
        streams = {}
        for name, width in program.attributes.items():
            bare = _bare(name)
            if bare not in data:
                if bare in ("normal", "tangent", "texcoord_0") and f" {name};" not in shader.vertex:
                    continue  # only the geometry targets want it
                raise MrmError(f"draw_points: {shader.name} needs the attribute {bare}")
            stream = np.asarray(data[bare], dtype=np.float32).reshape(len(data[bare]), -1)
            if stream.shape != (count, width):
                raise MrmError(f"draw_points: {bare} has shape {stream.shape}, not {(count, width)}")
            if not np.isfinite(stream).all():
                raise MrmError(f"draw_points: {bare} has values that are NaN or infinite")
            streams[name] = stream
        return streams

    def checked_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return a size, width and height in pixels, that can be drawn.

        Raises:
            MrmError: they are none, more than the driver draws, or than fits into memory.
        """
        limit = min(self._gl.ctx.info["GL_MAX_TEXTURE_SIZE"], self._gl.ctx.info["GL_MAX_RENDERBUFFER_SIZE"])
        try:
            width, height = (int(length) for length in size)
        except (TypeError, ValueError):
            raise MrmError(f"size {size} is not a width and a height") from None
        if not (1 <= width <= limit and 1 <= height <= limit):
            raise MrmError(f"size {width}x{height}: this driver draws 1x1 to {limit}x{limit} pixels")
        if width * height > _MAX_PIXELS:
            raise MrmError(f"size {width}x{height}: more than {_MAX_PIXELS} pixels would not fit into memory")
        return width, height

    def _program(self, shader: Shader, stages: Stages) -> tuple[_Program, bool]:
        """Return the program of a shader's stages, and whether it was compiled just now."""
        is_new = False
        common, names = common_names(stages)

        def link() -> _Program:
            nonlocal is_new
            is_new = True
            try:
                program = self._gl.ctx.program(vertex_shader=common.vertex, fragment_shader=common.pixel)
            except moderngl.Error as error:
                message = documents_names(str(error), names)
                raise MrmError(compile_error(message, shader.name, stages)) from None
            members: dict[str, Any] = {name: program[name] for name in program}
            uniforms: dict[str, Any] = {
                name: member for name, member in members.items() if isinstance(member, moderngl.Uniform)
            }
            samplers = {name: member for name, member in uniforms.items() if member.gl_type == _GL_SAMPLER_2D}
            return _Program(
                next(self._kept.numbers),
                program,
                {name: member for name, member in uniforms.items() if name not in samplers},
                samplers,
                {
                    name: member.dimension
                    for name, member in members.items()
                    if isinstance(member, moderngl.Attribute) and name.startswith("i_")
                },
                stages.sheets,
                stages.targets,
            )

        return self._kept.programs.get(common, link).named(names), is_new

    def _upload(
        self,
        shader: Shader,
        program: _Program,
        values: Mapping[str, Uniform],
        view_projection: NDArray[np.float64],
        camera: Camera,
        lights: Sequence[Light],
        environment: Environment | None,
    ) -> dict[str, moderngl.Texture]:
        """Set every active uniform: a program is shared by cases, so that none may keep a former value.

        Returns:
            what each sampler is to read; those of the sheets, which are not drawn yet, read black.
        """
        own: dict[str, Any] = {
            "u_worldMatrix": _IDENTITY,
            "u_worldInverseTransposeMatrix": _IDENTITY,
            # GLSL stores columns.
            "u_viewProjectionMatrix": view_projection.T.ravel(),
            "u_viewPosition": camera.position,
            "u_numActiveLightSources": len(lights),
            "u_envRadianceSamples": samples_in_the_dark(shader),
            "u_envLightIntensity": 1.0,
            # As MaterialX's own renderer has them where nobody plays a film.
            "u_time": 0.0,
            "u_frame": 1.0,
            # Every point is drawn; meshes have a threshold of each pass.
            ALPHA_THRESHOLD: 0.0,
        }
        room = sum(re.fullmatch(r"u_lightData\[\d+\]\.type", name) is not None for name in program.uniforms)
        if lights and len(lights) > room and "u_numActiveLightSources" in program.uniforms:
            raise MrmError(
                f"{shader.name}: {len(lights)} lights, but the shader was generated for {room}: "
                f"generate it with max_lights={len(lights)}"
            )
        for index, light in enumerate(lights):
            own |= {f"u_lightData[{index}].{name}": value for name, value in light.data(camera).items()}

        textures = dict.fromkeys(program.samplers, self._kept.black)
        if environment is not None:
            around = self._kept.environments.get(
                id(environment.radiance), lambda: EnvironmentTextures.upload(self._gl, environment)
            )
            own |= environment.uniforms()
            maps = dict(zip(_ENVIRONMENT_MAPS, (around.radiance, around.irradiance), strict=True))
            textures |= {name: texture for name, texture in maps.items() if name in textures}
        for name, uniform in program.uniforms.items():
            if name == "mrm_grid":
                continue
            value = own[name] if name in own else values[name].value if name in values else None
            kind = np.float32 if uniform.fmt.endswith("f") else np.int32
            floats = uniform.dimension * uniform.array_length
            numbers = np.zeros(floats, kind)
            if value is not None:
                given = np.ravel(value)[:floats]
                numbers[: len(given)] = given
            uniform.write(numbers)
        return textures

    def _with_images(
        self, textures: Mapping[str, moderngl.Texture], images: Mapping[str, _Image], tile: filenames.Tile
    ) -> dict[str, moderngl.Texture]:
        """What samplers read, with a material's images as they are in one tile.

        Raises:
            MrmError: an image is damaged, or there are more than the driver reads at once.
        """
        found = dict(textures)
        for name, (files, sampling) in images.items():
            file = files.tiles.get(tile) if files.tiles else files.file
            found[name] = (
                self._kept.textures.plain(sampling)
                if file is None
                else self._kept.textures.texture(file, sampling)
            )
        read, room = len({texture.glo for texture in found.values()}), self._gl.upload_unit
        if read > room:
            raise MrmError(f"{read} images, but this driver reads {room} at once")
        return found

    def _begin(
        self, size: tuple[int, int], colors: int = TARGETS, *, role: str = "image", depth_test: bool = False
    ) -> _Target:
        """Bind and clear a target, and set every state that a draw depends on."""
        ctx = self._gl.ctx

        def make() -> _Target:
            try:
                textures = [ctx.texture(size, 4, dtype="f4") for _ in range(colors)]
                depth = ctx.depth_renderbuffer(size)
                return _Target(textures, depth, ctx.framebuffer(textures, depth))
            except moderngl.Error as error:
                # Which of its calls fails, and how, is the driver's.
                raise MrmError(
                    f"size {size[0]}x{size[1]}: OpenGL has no room for it ({error}): memory may have run out"
                ) from MemoryError()

        # The image is drawn from the sheets: they never share a framebuffer.
        target = self._kept.targets.get((role, *size, colors), make)
        target.framebuffer.use()
        target.framebuffer.clear()
        # Back faces are shaded, nothing is blended.
        ctx.enable_only(moderngl.DEPTH_TEST if depth_test else moderngl.NOTHING)
        ctx.depth_func = "<"
        ctx.front_face = "ccw"
        ctx.wireframe = False
        ctx.polygon_offset = 0.0, 0.0
        ctx.point_size = 1.0
        return target

    def _draw(
        self,
        program: _Program,
        array: moderngl.VertexArray,
        target: _Target,
        textures: Mapping[str, moderngl.Texture],
        mode: int,
        vertices: int = -1,
        state: State = _USUAL,
    ) -> None:
        """Draw into the target that was begun last; each sampler reads the texture of its name.

        state: what of OpenGL's state is not as usual.
        """
        self._gl.bind(textures, program.samplers)
        if os.environ.get(CHECK_VARIABLE):
            check_draw(self._gl, program.samplers, target.framebuffer, textures, state)
        array.render(mode, vertices=vertices)
        self._gl.wait()

    def _vertex_array(self, program: _Program, mesh: Mesh, shader: Shader) -> moderngl.VertexArray:
        kept = self._kept.meshes.get(id(mesh), lambda: self._mesh_buffers(mesh))
        if program.number not in kept.arrays:
            content = []
            for name, width in program.attributes.items():
                if name not in kept.buffers:
                    raise MrmError(
                        f"mesh {mesh.name} has no vertex data {_bare(name)}, which {shader.name} uses"
                    )
                buffer, suffix = kept.buffers[name]
                available = buffer.size // (4 if suffix else 4 * len(mesh.positions))
                if available < width:
                    raise MrmError(
                        f"mesh {mesh.name}: {_bare(name)} has {available} components; "
                        f"{shader.name} wants {width}"
                    )
                padding = f" {4 * (available - width)}x" if available > width else ""
                content.append((buffer, f"{width}f{padding}{suffix}", name))
            kept.arrays[program.number] = self._gl.ctx.vertex_array(program.program, content, kept.indices)
        return kept.arrays[program.number]

    def _mesh_buffers(self, mesh: Mesh) -> _MeshBuffers:
        ctx = self._gl.ctx
        signs = 1.0 if mesh.bitangent_signs is None else mesh.bitangent_signs
        streams = {
            "i_position": mesh.positions,
            "i_normal": mesh.normals,
            "i_tangent": mesh.tangents,
            "i_bitangent": signs * np.cross(mesh.normals, mesh.tangents),
        }
        sets = {"texcoord_0": mesh.texcoords, **mesh.sets}
        streams |= {f"i_{name}": data for name, data in sets.items()}
        # MaterialX's own names for sets of texture coordinates, and USD's for the first.
        named = {name.replace("texcoord_", "UV"): data for name, data in sets.items() if "texcoord" in name}
        named["st"] = mesh.texcoords
        streams |= {f"i_geomprop_{name}": data for name, data in named.items()}
        streams |= {f"i_geomprop_{name}": data for name, data in mesh.geomprops.items()}
        buffers = {name: (ctx.buffer(np.ascontiguousarray(data)), "") for name, data in streams.items()}
        for name, vertices, constant in (
            ("i_color_0", mesh.colors, np.ones(4, np.float32)),
            (BITANGENT_SIGN, mesh.bitangent_signs, np.ones(1, np.float32)),
        ):
            given = vertices is not None
            buffers[name] = (ctx.buffer(vertices if given else constant), "" if given else "/r")
        return _MeshBuffers(mesh, buffers, ctx.buffer(mesh.indices))


_Image = tuple[filenames.Files, Sampling]
"""Which files a sampler reads, none where none is named, and how."""


def _images(shader: Shader, program: _Program, values: Mapping[str, Uniform]) -> dict[str, _Image]:
    """What each sampler of an image reads, sampled as its neighbours say (ImageSamplingProperties)."""
    found = {}
    for name in program.samplers:
        # MaterialX lists the environment's maps as files without a name.
        if name in _ENVIRONMENT_MAPS or name not in values or values[name].type != "filename":
            continue
        uniform, stem = values[name], name.rpartition("_")[0]
        path = uniform.path or name
        files = filenames.Files("")
        if uniform.value:
            files = find_image(uniform.value, shader.search_path, path)
        u_mode, v_mode, filter_type = (
            int((_neighbour(shader, values, stem, suffix) or [-1])[0])
            for suffix in ("uaddressmode", "vaddressmode", "filtertype")
        )
        found[name] = (
            files,
            Sampling(
                (u_mode, v_mode),
                filter_type,
                border_color(_default_of(shader, values, stem, path) or [0.0]),
                shader.spaces.get(path, ""),
                _layer(shader, values.get(f"{stem}_layer")),
                top_row_first=re.search(r"1\.0 - uv\.y", shader.pixel) is not None,
            ),
        )
    return found


def _neighbour(shader: Shader, values: Mapping[str, Uniform], stem: str, suffix: str) -> Any:
    """The value of an input beside an image's file; one that the shader decodes has a longer name."""
    for name in (f"{stem}_{suffix}", f"{stem}_{suffix}_cm_in"):
        if name in values:
            return values[name].value
        if name in shader.sampling:
            return shader.sampling[name]
    return None


def _default_of(shader: Shader, values: Mapping[str, Uniform], stem: str, path: str) -> Any:
    """What an image shows where there is none of it.

    path: of the input that names the file.
    """
    near = _neighbour(shader, values, stem, "default")
    if near is not None:
        return near
    in_unit, factor = values.get(f"{stem}_default_unit_in1"), values.get(f"{stem}_default_unit_in2")
    if in_unit is not None and factor is not None:
        return np.multiply(in_unit.value, factor.value).tolist()
    # What comes by a graph's interface is the graph's own uniform.
    port = shader.element_at(f"{path.rpartition('/')[0]}/default")
    given = port.getInterfaceInput() if isinstance(port, mx.Input) else None
    inputs = {uniform.path: uniform.value for uniform in values.values()}
    return None if given is None else inputs.get(given.getNamePath())


def _layer(shader: Shader, uniform: Uniform | None) -> str:
    port = None if uniform is None else shader.element_at(uniform.path)
    return "" if port is None else str(port.getValueString())


def _parts_of(mesh: Mesh, images: Mapping[str, _Image]) -> Mapping[filenames.Tile, Mesh]:
    """A mesh by tiles, where an image is a set of them; else the whole."""
    return mesh.tiles if any(files.tiles for files, _ in images.values()) else {(0, 0): mesh}


def _warn_of_missing_tiles(
    images: Mapping[str, _Image], parts: Mapping[filenames.Tile, Mesh], mesh: Mesh
) -> None:
    for files, _ in images.values():
        missing = sorted(filenames.udim(tile) for tile in parts if files.tiles and tile not in files.tiles)
        if missing:
            shown = ", ".join(map(str, missing[:5])) + (", …" if len(missing) > 5 else "")
            _warn(
                f"{files.name}: no image of tile {shown}, where mesh {mesh.name} has texture coordinates: "
                "the input's default is shown"
            )


def samples_in_the_dark(shader: Shader) -> int:
    """Environment samples where there is no environment: none, or one of the black map.

    Up to MaterialX 1.39.4, its own function divides by their number.
    """
    return 0 if "u_envRadianceSamples == 0" in shader.pixel else 1


def _warn(text: str) -> None:
    warnings.warn(text, MrmWarning, stacklevel=3)


def _bare(attribute: str) -> str:
    """Return the name of a vertex attribute as users know it."""
    return attribute.removeprefix("i_").removeprefix("geomprop_")


def compile_error(message: str, name: str, stages: Stages) -> str:
    """Return one line with the compiler's first complaints and the source lines that they are about."""
    stage, source = ("vertex", stages.vertex) if "vertex_shader" in message else ("pixel", stages.pixel)
    lines = source.splitlines()
    # Mesa writes 0:12(5): error; NVIDIA 0(12) : error; others ERROR: 0:12: …
    located = re.compile(r"(?:^|\b)0(?::(\d+)|\((\d+)\))")
    complaints: list[str] = []
    quoted: set[int] = set()
    for text in message.splitlines():
        found = located.search(text)
        if found is None:
            if "error" in text.lower():
                complaints.append(text.strip())
            continue
        number = int(found[1] or found[2])
        complaint = text.strip()
        if 1 <= number <= len(lines) and number not in quoted:
            complaint += f", in line {number}: `{lines[number - 1].strip()}`"
        quoted.add(number)
        complaints.append(complaint)
    if "Compiler" not in message:
        stage = "linked"
    shown = "; ".join(complaints[:3]) or " ".join(message.split())
    more = f"; and {len(complaints) - 3} more" if len(complaints) > 3 else ""
    return f"{name}: the {stage} shader does not compile: {shown}{more}"


def render(
    material: str | os.PathLike[str] | mx.Document | Shader,
    mesh: str | os.PathLike[str] | Mesh = "sphere",
    camera: Camera | Framing | str | None = None,
    lights: Sequence[Light | str] | Light | str = (),
    size: tuple[int, int] = (512, 512),
    backend: str = "auto",
    uniforms: Mapping[str, Any] | None = None,
    environment: str | os.PathLike[str] | Environment | None = None,
    samples: int = 1,
    exposure: float | str = "auto",
    tonemap: str = "neutral",
    background: str | None = None,
    picture: bool = True,
    drawn: Callable[[], object] = lambda: None,
) -> RenderedImage:
    """Render a material on a mesh; without a light and an environment the image is black.

    Any thread may call it: OpenGL draws on a thread of its own, one image after the other, and every image is the
    one that it would be alone. A process that was forked from one which has rendered is refused: start such
    processes with `multiprocessing.get_context("spawn")`.

    Args:
        material: a .mtlx file, a MaterialX document, or a shader generated for GLSL.
        mesh: `sphere`, `plane`, `baluster`, an .obj, .gltf or .glb file, or a Mesh.
        camera: a Camera, a Framing, or text as in CAMERA_SYNTAX; by default it shows the whole mesh from +z.
        lights: lights, or texts as in LIGHT_SYNTAX, such as `camera`.
        size: width and height in pixels.
        backend: `egl`, `osmesa`, or `auto` for the first of them that works.
        uniforms: values in place of the material's: see `Renderer.render`.
        environment: `sky`, `studio`, a latitude-longitude map (.hdr, .exr) or an Environment; black by default.
        samples: of each pixel. `image` and `alpha` are their mean; a picture is the mean of tone-mapped samples.
        exposure: stops of the picture that is made of it, to be saved as .png or shown by a notebook; `auto` by its
            own light. See `Development`. Like the next two it changes nothing of `image`, nor of an .exr.
        tonemap: of that picture, `neutral`, `none` or a view; see `Development`.
        background: behind that picture: `transparent`, `environment` or a colour; see `Development`.
        picture: whether one is wanted; several samples for an .exr alone cost less without.
        drawn: called after each draw, of which there are `draws_of(samples)`.

    Raises:
        MrmError: any of these is unreadable, unknown, out of range or NaN; the shader does not compile; there
            is no OpenGL; a draw takes longer than half an hour (`MRM_DRAW_SECONDS`); a forked process.
    """
    offsets = sample_offsets(samples)
    development = Development(exposure, tonemap, background)
    # A forked child must hear of it before it touches anything that has threads of its own.
    renderer = shared_renderer(backend)
    listed = [lights] if isinstance(lights, str | Light) else lights
    parsed_lights = [parse_light(light) if isinstance(light, str) else light for light in listed]
    parsed_camera = parse_camera(camera) if isinstance(camera, str) else camera
    loaded = mesh if isinstance(mesh, Mesh) else load_mesh(mesh)
    room = room_for(len(parsed_lights))
    shader = (
        material
        if isinstance(material, Shader)
        else generate_shader(material, varying=uniforms or (), max_lights=room)
    )
    around = environment if isinstance(environment, Environment | None) else find_environment(environment)
    development.behind(around)

    def draw(offset: tuple[float, float]) -> RenderedImage:
        image = renderer.render(
            shader, loaded, parsed_camera, parsed_lights, size, uniforms, around, offset=offset
        )
        drawn()
        return image

    middle = replace(draw((0.0, 0.0)), development=development if picture else None)
    return middle if samples == 1 else _supersampled(middle, draw, offsets.tolist())


def draws_of(samples: int) -> int:
    """How many draws `samples` take: the middle is one of an odd number."""
    return samples if samples % 2 else samples + 1


def _supersampled(
    middle: RenderedImage,
    draw: Callable[[tuple[float, float]], RenderedImage],
    offsets: Sequence[tuple[float, float]],
) -> RenderedImage:
    """Return the mean of several samples of each pixel, and its picture where one is wanted.

    middle: the sample in the middle, from which exposure and geometry are.
    """
    image, alpha = np.zeros_like(middle.image), np.zeros_like(middle.alpha)
    developer = None if middle.development is None else middle._undeveloped()
    for x, y in offsets:
        sample = middle if x == y == 0.0 else draw((x, y))
        image += sample.image
        alpha += sample.alpha
        if developer is not None:
            developer.add(sample.image, sample.alpha, (x, y))
    image /= np.float32(len(offsets))
    alpha /= np.float32(len(offsets))
    developed = None if developer is None else developer.picture()
    return replace(middle, image=image, alpha=alpha, developed=developed)


_RENDERERS: dict[str, Renderer] = {}


def shared_renderer(backend: str = "auto") -> Renderer:
    """Return this process's renderer of a backend, so that programs and meshes are shared by all who ask.

    Raises:
        MrmError: an unknown backend, or no OpenGL there.
    """
    gl = get_context(backend)

    def shared() -> Renderer:
        # On the context's thread one comes after the other.
        if gl.backend not in _RENDERERS or _RENDERERS[gl.backend].closed:
            _RENDERERS[gl.backend] = Renderer(gl.backend)
        return _RENDERERS[gl.backend]

    return gl.run(shared)
