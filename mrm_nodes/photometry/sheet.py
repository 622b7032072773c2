"""A document's material as a flat sheet that a goniometer turns before source and receiver."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import MaterialX as mx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.documents import read_document
from mrm_nodes.elements import check_document, find_renderable
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.truth.closure import Driven, Port, SurfaceTree, closure_of, lobes, ports
from mrm_nodes.regression.truth.physics import Points, respond
from mrm_nodes.render.renderer import shared_renderer
from mrm_nodes.shadergen import Shader, generate_shader
from mrm_nodes.shipped import material_file

Array = NDArray[np.float64]

_EYE = np.array([0.0, 0.0, 1e4])
"""Where the sheet is looked at from: so far that all of it is seen from one direction."""
_MOST = 1 << 18
"""Points that are evaluated at once."""


def read_sheet(
    path: str | os.PathLike[str],
    element: str | None = None,
    allow_external: bool = False,
    backend: str = "auto",
) -> Sheet:
    """The sheet of a .mtlx file's material, or of a finished one by its name.

    Args:
        path: of the file.
        element: the material, where there are several.
        allow_external: whether it may read files outside of its folder and the node libraries.
        backend: `egl`, `osmesa` or `auto`, for what graphs drive.

    Raises:
        MrmError: as `read_document`; nothing to render, or several; it has a lobe that the evaluator does not know.
    """
    file = material_file(path)
    return sheet_of(read_document(file, allow_external=allow_external), str(file), element, backend)


def sheet_of(document: mx.Document, where: str, element: str | None = None, backend: str = "auto") -> Sheet:
    """The sheet of a document's material.

    where: what errors call the document. Others as `read_sheet`.

    Raises:
        MrmError: as `read_sheet`.
    """
    found = find_renderable(document, where, element)
    check_document(document, where, found)
    try:
        closure = closure_of(document, found.getNamePath())
    except MrmError as error:
        raise MrmError(f"{where}: {error}") from None
    return Sheet(where, closure, backend)


@dataclass(frozen=True)
class Sheet:
    """A material on the square from (-1, -1, 0) to (1, 1, 0), as MaterialX renders it, in float64.

    What graphs drive (patterns, images, normal maps) is rendered, so OpenGL is needed for that, and comes in float32.
    """

    where: str
    """The file that it was read from."""
    closure: SurfaceTree
    """Its lobes, and what drives their inputs."""
    backend: str = "auto"
    """OpenGL for what graphs drive: `egl`, `osmesa` or `auto`."""
    _shaders: dict[str, Shader] = field(default_factory=dict, repr=False, compare=False)

    @property
    def is_retroreflective(self) -> bool:
        """Whether a lobe has a weight of retroreflection that is not 0."""
        weights = (
            lobe.inputs.get(name)
            for lobe in lobes(self.closure.tree)
            for name in ("retroreflectivity", "retroreflective")
        )
        return any(weight not in (None, 0.0, False) for weight in weights)

    @property
    def is_driven(self) -> bool:
        """Whether a graph drives an input of a lobe, or how they are put together."""
        return any(isinstance(port, Driven) for port in ports(self.closure.tree))

    @property
    def asks_where(self) -> bool:
        """Whether a graph that drives it asks for texture coordinates, or what else a mesh may have."""
        own = re.compile(r"^in \w+ i_(?!(?:position|normal|tangent|bitangent);)\w+;", re.MULTILINE)
        return any(
            own.search(self.shader(port.element).vertex)
            for port in ports(self.closure.tree)
            if isinstance(port, Driven)
        )

    def shader(self, element: str) -> Shader:
        """The shader that shows what drives an input, by the path of the element that drives it."""
        if element not in self._shaders:
            self._shaders[element] = generate_shader(self.closure.document, element=element)
        return self._shaders[element]

    def at(self, uv: ArrayLike = (0.5, 0.5)) -> SheetPoints:
        """What has `eval(v, l)` at texture coordinates uv, (..., 2), that broadcast with the directions.

        Raises:
            MrmError: the material is not opaque there; OpenGL is needed and not there.
        """
        points = SheetPoints(self, np.asarray(uv, np.float64))
        points.check()
        return points


@dataclass(frozen=True)
class SheetPoints:
    """Some points of a sheet."""

    sheet: Sheet
    """What they are on."""
    uv: Array
    """(..., 2), texture coordinates."""

    def eval(self, v: ArrayLike, l: ArrayLike) -> Array:  # noqa: E741  the field's own name
        """f(v, l) in 1/sr without the cosine, (..., 3), in the frame of the sheet: u along +x, the normal +z.

        v and l are (..., 3), unit vectors to receiver and source. 0 where source or receiver is behind the sheet.

        Raises:
            MrmError: what a graph gives is not finite, or the evaluator has no model of it.
        """
        view, light = np.asarray(v, np.float64), np.asarray(l, np.float64)
        resolve = self._resolver(view)
        shape = np.broadcast_shapes(view.shape[:-1], light.shape[:-1], self.uv.shape[:-1])
        views, lights = (np.broadcast_to(each, (*shape, 3)).reshape(-1, 3) for each in (view, light))
        response = np.zeros(views.shape)
        for start in range(0, len(views), _MOST):
            part = slice(start, start + _MOST)

            def resolved(port: Port, part: slice = part) -> Any:
                value = resolve(port)
                if not isinstance(port, Driven):
                    return value
                return np.broadcast_to(value, (*shape, *value.shape[-1:])).reshape(-1, value.shape[-1])[part]

            response[part] = self._respond(views[part], lights[part], resolved)
        cosine = lights[:, 2:]
        front = (cosine > 0.0) & (views[:, 2:] > 0.0)
        value = np.where(front, response / np.where(front, cosine, 1.0), 0.0)
        result: Array = value.reshape(*shape, 3)
        return result

    def check(self) -> None:
        """Check that it is opaque, and say where it emits light.

        Raises:
            MrmError: it is not.
        """
        resolve = self._resolver(np.array([0.0, 0.0, 1.0]))
        closure = self.sheet.closure
        if np.any(np.asarray(resolve(closure.opacity)) != 1.0):
            raise MrmError(f"{self.sheet.where}: its opacity is not 1 everywhere, which has no coefficients")
        if any(np.any(np.asarray(resolve(each)) != 0.0) for each in closure.emission):
            warnings.warn(
                f"{self.sheet.where}: it emits light, which is no part of what it sends back",
                MrmWarning,
                stacklevel=3,
            )

    def _respond(self, view: Array, light: Array, resolve: Callable[[Port], Any]) -> Array:
        """The response (n, 3), its cosine included, in the frame of the sheet."""

        def of_numbers(port: Port) -> Any:
            value = resolve(port)
            return value[:, 0] if isinstance(port, Driven) and port.channels == 1 else value

        # With the eye at the origin, a point's place is all that its view depends on, to the last digit.
        normal, tangent = (np.broadcast_to(axis, view.shape) for axis in np.eye(3)[[2, 0]])
        try:
            return respond(
                self.sheet.closure.tree, Points(-view, normal, tangent, (0.0, 0.0, 0.0)), light, of_numbers
            )
        except MrmError as error:
            raise MrmError(f"{self.sheet.where}: {error}") from None

    def _resolver(self, view: Array) -> Callable[[Port], Any]:
        """What an input is from views (..., 3): a constant, or (..., channels); each source is rendered once."""
        seen: dict[str, Array] = {}

        def resolve(port: Port) -> Any:
            if not isinstance(port, Driven):
                return port
            if port.element not in seen:
                seen[port.element] = self._rendered(port, view)
            return seen[port.element]

        return resolve

    def _rendered(self, port: Driven, view: Array) -> Array:
        """What a graph gives where the sheet is turned so that it is seen from a direction of its own frame."""
        sheet = self.sheet
        shader = sheet.shader(port.element)
        shape = np.broadcast_shapes(view.shape[:-1], self.uv.shape[:-1])
        uv = np.broadcast_to(self.uv, (*shape, 2)).reshape(-1, 2)
        views = np.broadcast_to(view, (*shape, 3)).reshape(-1, 3)
        position = np.concatenate([2.0 * uv - 1.0, np.zeros((len(uv), 1))], axis=-1).astype(np.float32)
        towards = _EYE - position
        turn = _turn(views, towards / np.linalg.norm(towards, axis=-1, keepdims=True))
        drawn = shared_renderer(sheet.backend).draw_points(
            shader, _vertex_data(shader, position, uv, turn), tuple(_EYE)
        )
        values = drawn["image"].astype(np.float64)
        if not np.isfinite(values).all():
            raise MrmError(f"{sheet.where}: {port.element} is NaN or infinite")
        if _is_direction(sheet.closure.document, port):
            values = np.einsum("nij,ni->nj", turn, values)
        result: Array = values[:, : port.channels].reshape(*shape, port.channels)
        return result


def _is_direction(document: mx.Document, port: Driven) -> bool:
    """Whether a vector is a normal or tangent in world space; a lobe has no other vectors of three."""
    return bool(document.getDescendant(port.element).getType() == "vector3")


def _turn(before: Array, after: Array) -> Array:
    """The shortest turns (n, 3, 3) of unit vectors to others that are no further than 90 degrees from them."""
    axis = np.cross(before, after)
    k = np.zeros((len(axis), 3, 3))
    k[:, 0, 1], k[:, 0, 2], k[:, 1, 2] = -axis[:, 2], axis[:, 1], -axis[:, 0]
    k -= np.swapaxes(k, 1, 2)
    cosine = np.sum(before * after, axis=-1)[:, None, None]
    turn: Array = np.eye(3) + k + k @ k / (1.0 + cosine)
    return turn


def _vertex_data(shader: Shader, position: NDArray[np.float32], uv: Array, turn: Array) -> dict[str, Any]:
    """What the shader asks for of a mesh, by name."""
    x, y, z = np.moveaxis(turn, -1, 0)
    known = {"normal": z, "tangent": x, "bitangent": y, "color_0": np.ones((len(uv), 4))}
    known |= dict.fromkeys(("texcoord_0", "geomprop_UV0", "geomprop_st"), uv)
    declared = re.findall(r"^in \w+ i_(\w+);", shader.vertex, re.MULTILINE)
    return {"position": position} | {name: known[name] for name in declared if name in known}
