"""A case of a material: rendered, and compared with the evaluator, with a stored image, or with its mirror."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import MaterialX as mx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes import documents, external
from mrm_nodes.elements import descendant
from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.regression.cases import baseline
from mrm_nodes.regression.cases.pictures import write_pictures
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.truth.closure import Driven, Port, SurfaceTree, closure_of, has_layers, reflecting
from mrm_nodes.regression.truth.material import CHANNELS, Value
from mrm_nodes.regression.verdict.compare import Bounds, compare, relative_error, why_undecided
from mrm_nodes.regression.verdict.outcome import Outcome, timed
from mrm_nodes.regression.verdict.tolerance import Tolerance, compare_images
from mrm_nodes.render.arithmetic import measure
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS, Environment, find_environment
from mrm_nodes.render.gbuffer import ALPHA_THRESHOLD
from mrm_nodes.render.images import read_image
from mrm_nodes.render.mesh import BUILT_IN, Mesh
from mrm_nodes.render.meshfile import load_mesh, mesh_files
from mrm_nodes.render.renderer import RenderedImage
from mrm_nodes.render.scene import Camera, Framing, Light
from mrm_nodes.render.uniforms import uniforms_of
from mrm_nodes.shadergen import Shader, room_for

Array = NDArray[np.float64]
Truth = Literal["physics", "baseline", "mirror"]
Layering = Literal["materialx", "exact"]
Method = Literal["fis", "prefilter"]

BASELINE_TOLERANCE = Tolerance(max_rel=1e-2, p999_rel=1e-3)
"""Against a stored image, where a suite says nothing else: what another driver's rounding makes of a narrow lobe."""


@dataclass(frozen=True)
class EnvironmentMap:
    """The light around a case: a built-in environment or a file, and how it is used."""

    name: str
    """`sky`, `studio`, or a file's name below the case's root."""
    options: tuple[tuple[str, float], ...] = ()
    """Of `rotation`, `intensity`, `samples` and `filtered`, those that differ from `find_environment`'s."""


IMAGE_SUFFIXES = (
    *(".bmp", ".dds", ".dpx", ".exr", ".gif", ".hdr", ".jpeg", ".jpg", ".pic", ".png"),
    *(".psd", ".tga", ".tif", ".tiff", ".tx", ".txr", ".webp"),
)
"""Endings of the images that MaterialX's loaders know."""


_WHOLE = Framing()

MIRROR_ERROR = 1e-6
"""Relative error of a retro lobe in a map against the forward lobe in the map turned about the normal."""


@dataclass(frozen=True)
class MaterialCase:
    """One image of a material. File names are relative to `root`."""

    name: str
    """The case's own, fit for a folder."""
    root: Path
    """The folder that names are relative to."""
    material: str
    """The document's name."""
    element: str
    """Path of the material in its document."""
    truth: Truth
    """What the image is compared with: `physics`, `baseline` or, in the default suite, `mirror`: the other lobe in the
    map turned by half a turn ([MRM] eq. 3), both on the plane with the normal +y, the pole of every map."""
    reason: str
    """Why this truth; what is wrong with the document, where it is broken."""
    inputs: Mapping[str, Value] = field(default_factory=dict)
    """Values in place of the document's, by the path of an input (`node/input`, `graph/node/input`)."""
    mesh: str = "sphere"
    """`sphere`, `plane`, `baluster` or a file's name."""
    camera: Camera | Framing = _WHOLE
    """By default it stands on the +z side and shows the whole mesh."""
    lights: tuple[Light, ...] = ()
    """None by default."""
    environment: EnvironmentMap | None = None
    """Black by default."""
    max_lights: int | None = None
    """How many lights its shader has room for; by default as many as it needs, and no fewer than usual."""
    size: tuple[int, int] = (256, 256)
    """Width and height in pixels."""
    tolerance: Tolerance = field(default_factory=Tolerance)
    """Asks for nothing: the evaluator's own bounds, or BASELINE_TOLERANCE."""
    mask: str | None = None
    """An image whose bright pixels count."""
    depends: tuple[str, ...] = ()
    """The files of the material: documents and textures, itself included."""
    baselines: str = "baselines"
    """Folder of the stored images."""
    home: str = "."
    """The suite's folder, which names in its description are relative to: they stay when it moves."""
    fixed: tuple[str, ...] = ()
    """Files outside of it that the suite names absolutely."""
    time_limit: float | None = None
    """Seconds that the case may take, or the run's own limit."""
    allow_external: bool = False
    """Whether it may read files outside of its folder and the node libraries."""
    broken: bool = False
    """Its document cannot be used: judging it is an error."""
    origin: Path | None = None
    """Where it was moved, the root that its documents know: their absolute names are below it."""
    target: str = "glsl"
    """What its shader is generated for."""
    method: Method = "fis"
    """How its shader evaluates image light: by samples, or by one look-up at a level for alpha."""
    layering: Layering = "materialx"
    """`exact` to be told what MaterialX's rule of layering costs it, beside its verdict, which is by that rule."""

    @property
    def node(self) -> str:
        """The material: the report filters by it."""
        return self.element.rpartition("/")[2] or Path(self.material).stem

    @property
    def kind(self) -> str:
        """Who judges it."""
        return "material"

    @property
    def structure(self) -> tuple[Any, ...]:
        """Values are uniforms: which inputs have one is what makes a shader another one."""
        inputs = tuple(sorted(self.inputs))
        return (self.target, str(self.root), self.material, self.element, inputs, self.room, self.method)

    @property
    def room(self) -> int:
        """How many lights its shader has room for."""
        return room_for(len(self.lights)) if self.max_lights is None else self.max_lights

    def describe(self) -> dict[str, Any]:
        """What it is, for the report; the same wherever the suite lies."""
        around = self.environment
        if around is not None and not _is_built_in(around):
            around = replace(around, name=self._described(around.name))
        return {
            "material": self._described(self.material),
            "element": self.element,
            "truth": self.truth,
            "reason": self.reason,
            "inputs": {name: self._described_value(value) for name, value in self.inputs.items()},
            "mesh": self.mesh if self.mesh in BUILT_IN else self._described(self.mesh),
            "camera": repr(self.camera),
            "lights": [repr(light) for light in self.lights],
            "environment": None if around is None else repr(around),
            "size": list(self.size),
            "tolerance": self.tolerance.limits(),
            "mask": self.mask and self._described(self.mask),
            "baselines": self._described(self.baselines),
            "allow_external": self.allow_external,
            # Without them a case is told as before they could be asked for: its stored image stays accepted.
            **({} if self.max_lights is None else {"max_lights": self.max_lights}),
            **({} if self.method == "fis" else {"method": self.method}),
            **({} if self.layering == "materialx" else {"layering": self.layering}),
        }

    def _described(self, name: str) -> str:
        """A file's name as its description has it."""
        if name in self.fixed:
            return str((self.origin or self.root) / name)
        return name if self.home == "." else os.path.relpath(name, self.home)

    def _described_value(self, value: Value) -> Value:
        """A value of an input; a file of the suite's folder that it names absolutely is named as any other."""
        if not isinstance(value, str):
            return value
        folder = os.path.normpath((self.origin or self.root) / self.home)
        inside = external.moved_name(value, Path(folder), Path())
        return (
            inside if inside != value else external.moved_name(value, Path(os.path.realpath(folder)), Path())
        )

    @property
    def has_textures(self) -> bool:
        """Whether its material reads images."""
        return any(Path(name).suffix.lower() in IMAGE_SUFFIXES for name in self.depends)

    def sources(self) -> tuple[Path, ...]:
        """The files that the render depends on."""
        names = [*self.depends]
        if self.mesh not in BUILT_IN:
            names += [os.path.relpath(file, self.root) for file in mesh_files(self.root / self.mesh)]
        if self.environment is not None and not _is_built_in(self.environment):
            names.append(self.environment.name)
        return tuple(self.root / name for name in dict.fromkeys(names))

    def files(self) -> tuple[Path, ...]:
        """The files that the result depends on: `sources`, the mask, and the stored image with its provenance."""
        more = [] if self.mask is None else [self.root / self.mask]
        if self.truth == "baseline":
            more += [path for path in self.store.paths(self.name) if path.is_file()]
        return (*self.sources(), *more)

    def moved(self, root: Path) -> Self:
        """The same case with its files below another folder, root."""
        return replace(self, root=root, origin=self.origin or self.root)

    def placed(self, value: Value) -> Value:
        """A value of an input; the name of a file that moved with the case is the name that it has now."""
        if self.origin is None or not isinstance(value, str):
            return value
        return external.moved_name(value, self.origin, self.root)

    @property
    def store(self) -> baseline.Store:
        """Where its stored image lies, if it has one."""
        return baseline.Store(self.root / self.baselines)


def _is_built_in(environment: EnvironmentMap) -> bool:
    return environment.name in BUILT_IN_ENVIRONMENTS


def judge(case: MaterialCase, workshop: Workshop, outcome: Outcome, folder: Path) -> None:
    """Render a case, compare it with its truth, and write its pictures below `folder`."""
    outcome.truth = case.truth
    if case.broken:
        raise MrmError(case.reason)
    bench = _Bench(case, workshop, outcome)
    drawn = bench.render(bench.shader(case.element), _environment(case))
    mask = drawn.mask & _mask(case)
    place = Path("cases") / outcome.backend / case.name
    (folder / place).mkdir(parents=True, exist_ok=True)
    source = source_of(case)

    expected = _Expected(drawn.image)
    if case.truth == "baseline":
        outcome.details = {"inputs": baseline.fingerprint(case)}
        try:
            expected.truth = case.store.read(case.name, drawn.image.shape)
        except MrmError:
            _write_render(drawn, mask, source, folder / place, outcome)
            _note_render(folder, outcome)
            raise
        expected.tolerance = BASELINE_TOLERANCE
    elif case.truth == "mirror":
        _mirror(bench, expected)
    else:
        _compute(bench, drawn, mask, expected)
    with timed(outcome, "compare"):
        used, flip = _compare(case, expected, mask, outcome)
        written = write_pictures(folder / place, expected.image, expected.truth, mask, used, flip, source)
        outcome.files = _below(place, written)
    _note_render(folder, outcome)


def _note_render(folder: Path, outcome: Outcome) -> None:
    """Note what an acceptance is of: by then another file may lie in its place."""
    if outcome.truth == "baseline":
        render = baseline.digest_of(folder / str(outcome.files["render_data"]))
        outcome.details = {**outcome.details, "render": render}


@dataclass
class _Expected:
    """An image, and what it is compared with."""

    image: ArrayLike
    """`(h, w, 3)`."""
    truth: ArrayLike = ()
    """`(h, w, 3)`."""
    bounds: Bounds | None = None
    """Of the points of the mask, where float32's rounding is all that may differ."""
    tolerance: Tolerance = field(default_factory=Tolerance)
    """Where the suite has none."""


def _compare(
    case: MaterialCase, expected: _Expected, mask: NDArray[np.bool_], outcome: Outcome
) -> tuple[Array | None, Array | None]:
    """Complete an outcome's verdict; return `used` and `flip`, `(h, w)`, as `write_pictures` takes them."""
    if expected.bounds is not None and not case.tolerance.limits():
        image, truth = np.asarray(expected.image)[mask], np.asarray(expected.truth)[mask]
        outcome.verdict, outcome.figures = compare(image, truth, expected.bounds)
        outcome.tolerance = expected.bounds.loosest()
        if outcome.verdict == "undecided":
            outcome.message = why_undecided(outcome.figures)
        used = np.max(relative_error(image, truth) / expected.bounds.max_rel, axis=-1)
        return _spread(used, mask), None
    tolerance = case.tolerance if case.tolerance.limits() else expected.tolerance
    compared = compare_images(expected.image, expected.truth, mask, tolerance)
    outcome.verdict, outcome.figures = compared.verdict, compared.figures
    outcome.tolerance = tolerance.limits()
    return compared.used, compared.flip


def _write_render(
    drawn: RenderedImage, mask: NDArray[np.bool_], source: str, folder: Path, outcome: Outcome
) -> None:
    """Write what can be looked at, and accepted, of a case that has no reference."""
    written = write_pictures(folder, drawn.image, None, mask, source=source)
    outcome.files = _below(Path("cases") / outcome.backend / outcome.name, written)


def _below(place: Path, written: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: (place / file).as_posix() if isinstance(file, str) else file for name, file in written.items()
    }


class _Bench:
    """One case's renders: of its material, and of what drives the inputs of its lobes."""

    def __init__(self, case: MaterialCase, workshop: Workshop, outcome: Outcome) -> None:
        self.case = case
        self._workshop = workshop
        self.outcome = outcome
        self._mesh = _mesh(case)
        self._stamp = tuple(_stamp(path) for path in case.sources())
        self._baked: tuple[tuple[str, Value], ...] = ()
        """Values that are no uniform of the material's shader: they make a shader of their own."""

    @functools.cached_property
    def document(self) -> mx.Document:
        """The material with the case's values."""
        with timed(self.outcome, "generate"):
            return _placed(self.case)

    @functools.cached_property
    def closure(self) -> SurfaceTree:
        """The tree of the material's lobes."""
        with timed(self.outcome, "generate"):
            return closure_of(self.document, self.case.element)

    def shader(self, element: str) -> Shader:
        """The material's own shader."""
        shader = self._generate(
            ("material", self._stamp, *self.case.structure), lambda: self.document, element
        )
        known = {uniform.path for uniform in uniforms_of(shader).values()}
        self._baked = tuple(sorted((name, v) for name, v in self.case.inputs.items() if name not in known))
        if not self._baked:
            return shader
        key = ("material", self._stamp, *self.case.structure, self._baked)
        return self._generate(key, lambda: self.document, element)

    def shown(self, element: str) -> Shader:
        """The shader of one output of the closure's document."""
        fixed = tuple(sorted(self.case.inputs.items())) if self.closure.flattened else self._baked
        key = ("input", self._stamp, *self.case.structure, element, fixed)
        return self._generate(key, lambda: self.closure.document, element)

    def _generate(self, key: Any, document: Callable[[], mx.Document], element: str) -> Shader:
        with timed(self.outcome, "generate"):
            case = self.case
            return self._workshop.shader(key, document, element, case.inputs, case.room, case.method)

    def render(
        self,
        shader: Shader,
        environment: Environment | None = None,
        values: Mapping[str, Value] | None = None,
    ) -> RenderedImage:
        """Draw the case with its lights; values: of inputs, in place of the case's."""
        return self._render(shader, values or {}, environment=environment, lights=self.case.lights)

    def show(self, port: Driven) -> RenderedImage:
        """Draw what drives an input, without a light, where the material is seen."""
        shader = self.shader(self.case.element)
        visible = (shader, self._uniforms(shader)) if ALPHA_THRESHOLD in shader.pixel else None
        return self._render(self.shown(port.element), {}, visible=visible)

    def _uniforms(self, shader: Shader) -> dict[str, Value]:
        """The case's values of a shader's inputs."""
        known = {uniform.path for uniform in uniforms_of(shader).values()}
        return {name: self.case.placed(value) for name, value in self.case.inputs.items() if name in known}

    def _render(self, shader: Shader, values: Mapping[str, Value], **more: Any) -> RenderedImage:
        case = self.case
        drawn = self._workshop.renderer.render(
            shader,
            self._mesh,
            case.camera,
            size=case.size,
            uniforms={**self._uniforms(shader), **values},
            **more,
        )
        for stage, seconds in drawn.seconds.items():
            self.outcome.seconds[stage] += seconds
        return drawn

    def resolver(self, mask: NDArray[np.bool_]) -> Callable[[Port], Any]:
        """What an input is at the points of a mask; each source is rendered once."""
        seen: dict[str, Array] = {}

        def resolve(port: Port) -> Any:
            if not isinstance(port, Driven):
                return port
            if port.element not in seen:
                drawn = self.show(port)
                if not drawn.mask[mask].all():
                    raise MrmError(f"{self.case.material}: {port.element} is not seen where the material is")
                values = drawn.image[mask].astype(np.float64)
                if np.isnan(values).any() or not (port.infinite or np.isfinite(values).all()):
                    raise MrmError(
                        f"{self.case.material}: {port.element} is NaN or infinite where it is seen"
                    )
                seen[port.element] = values
            return seen[port.element][:, 0] if port.channels == 1 else seen[port.element][:, : port.channels]

        return resolve


def _mirror(bench: _Bench, expected: _Expected) -> None:
    """Complete what is expected with the other lobe in the map turned about the normal."""
    case, light = bench.case, _environment(bench.case)
    if light is None:
        raise MrmError(f"{case.name}: there is no environment to turn")
    name = next(name for name in case.inputs if name.endswith("/retroreflectivity"))
    turned = replace(light, rotation=light.rotation + 180.0)
    other = {name: 1.0 - float(np.asarray(case.inputs[name], np.float64))}
    expected.truth = bench.render(bench.shader(case.element), turned, other).image.astype(np.float64)
    expected.bounds = Bounds(np.array(MIRROR_ERROR), np.array(MIRROR_ERROR))


def _compute(bench: _Bench, drawn: RenderedImage, mask: NDArray[np.bool_], expected: _Expected) -> None:
    """Complete what is expected with the evaluator's reference of the points of a mask."""
    # The evaluator takes half a second to import: who compares with stored images does without it.
    from mrm_nodes.regression.truth.environment_reference import beside_integral, some_of
    from mrm_nodes.regression.truth.image_sum import Surroundings
    from mrm_nodes.regression.truth.physics import Points, beside_exact, light_tree, shade_both, shade_tree

    case, closure, resolve = bench.case, bench.closure, bench.resolver(mask)
    if mask.any():
        if np.any(np.asarray(resolve(closure.opacity)) != 1.0):
            raise MrmError(f"{case.element}: its opacity is not 1 everywhere: {_WAY_OUT}")
        if any(np.any(np.asarray(resolve(each)) != 0.0) for each in closure.emission):
            raise MrmError(f"{case.element}: it emits light: {_WAY_OUT}")
    points = Points(
        drawn.position[mask].astype(np.float64),
        drawn.normal[mask].astype(np.float64),
        drawn.tangent[mask].astype(np.float64),
        drawn.camera.position,
    )
    lights = [light.data(drawn.camera) for light in case.lights]
    light = _environment(case)
    around = None if light is None else Surroundings(light, measure(bench.outcome.backend), case.method)
    with timed(bench.outcome, "reference"):
        if case.layering == "exact" and mask.any() and has_layers(closure.tree):
            reference, bounds, exact = shade_both(closure.tree, points, lights, resolve, around)
            bench.outcome.details = {"layering": beside_exact(reference, exact)}
        else:
            reference, bounds = shade_tree(closure.tree, points, lights, resolve, around)
    expected.truth, expected.bounds = _spread(reference, mask), bounds
    if light is None or not mask.any():
        return

    chosen = some_of(int(mask.sum()))

    def at_some(port: Port) -> Any:
        found = resolve(port)
        return found[chosen] if isinstance(port, Driven) else found

    with timed(bench.outcome, "reference"):
        some, reflected = points.at(chosen), reflecting(closure.tree)
        seen, _ = shade_tree(reflected, some, [], at_some, around)
        truth = light_tree(reflected, some, light, at_some)
    about = {"image_light": beside_integral(seen, truth, light.samples)}
    bench.outcome.details = {**bench.outcome.details, **about}


_WAY_OUT = 'such a material has no model; give the case truth = "baseline"'


def read(case: MaterialCase) -> mx.Document:
    """The case's document.

    Raises:
        MrmError: as `documents.read_document`.
    """
    return documents.read_document(case.root / case.material, allow_external=case.allow_external)


def source_of(case: MaterialCase) -> str:
    """What is rendered, as a MaterialX document with the case's values."""
    if not case.inputs or case.truth == "baseline":
        return (case.root / case.material).read_text(encoding="utf-8", errors="replace")
    return str(mx.writeToXmlString(with_values(read(case), case.inputs, case.material)))


def _placed(case: MaterialCase) -> mx.Document:
    """The case's document with the case's values; absolute names in it are those of the files that moved with it.

    Raises:
        MrmError: it names a file that did not move with it.
    """
    if case.origin is None:
        return with_values(read(case), case.inputs, case.material)
    file = case.root / case.material
    # What it may read was checked where it came from. Here it is what came along.
    external.check_travelled(documents.included_documents(file), file, case.origin, case.root)
    document = with_values(documents.read_document(file, allow_external=True), case.inputs, case.material)
    external.move_names(document, case.origin, case.root)
    external.check_travelled(external.check_files(document, file, True), file, case.origin, case.root)
    return document


def with_values(document: mx.Document, values: Mapping[str, Value], where: str) -> mx.Document:
    """The document itself, its inputs set to values; what drove them is disconnected.

    Raises:
        MrmError: no such input, or a value that does not fit its type.
    """
    for path, value in values.items():
        holder_path, _, name = path.rpartition("/")
        holder = descendant(document, holder_path)
        port = None
        if isinstance(holder, mx.Node | mx.NodeGraph):
            definition = holder.getNodeDef() if isinstance(holder, mx.Node) else None
            declared = definition.getActiveInput(name) if definition is not None else None
            port = holder.getInput(name) or (declared and holder.addInput(name, declared.getType()))
        if port is None:
            raise MrmError(f"{where}: no input {path}; {_known_inputs(document, path)}")
        for connection in ("nodename", "nodegraph", "output", "interfacename"):
            port.removeAttribute(connection)
        port.setValueString(as_text(value, port.getType(), path))
    return document


def _known_inputs(document: mx.Document, path: str) -> str:
    holders = [
        each
        for each in document.traverseTree()
        if isinstance(each, mx.Node | mx.NodeGraph) and not each.getAttribute("nodedef")
    ]
    known = []
    for holder in holders:
        names = {port.getName() for port in holder.getInputs()}
        if isinstance(holder, mx.Node) and holder.getNodeDef() is not None:
            names |= {port.getName() for port in holder.getNodeDef().getActiveInputs()}
        known += [f"{holder.getNamePath()}/{name}" for name in names]
    return suggestion(path, known)


_COUNTS = {**CHANNELS, "integer": 1, "color4": 4, "vector4": 4}


def as_text(value: Value, kind: str, path: str) -> str:
    """A value as MaterialX writes it.

    Raises:
        MrmError: it does not fit the type.
    """
    if kind == "boolean" and isinstance(value, bool):
        return "true" if value else "false"
    if kind in ("string", "filename") and isinstance(value, str):
        return value
    numbers = np.ravel([] if isinstance(value, str | bool) else value)
    if len(numbers) != _COUNTS.get(kind) or not np.isfinite(numbers).all():
        raise MrmError(f"{path}: {value!r} is no {kind}")
    if kind == "integer" and numbers[0] != int(numbers[0]):
        raise MrmError(f"{path}: {value!r} is no integer")
    return ", ".join(f"{number:.9g}" for number in numbers)


def _mask(case: MaterialCase) -> NDArray[np.bool_] | bool:
    """The pixels that count, `(h, w)`, or True for all."""
    if case.mask is None:
        return True
    pixels = read_image(case.root / case.mask)
    width, height = case.size
    if pixels.shape[:2] != (height, width):
        raise MrmError(
            f"{case.root / case.mask}: the mask has {pixels.shape[1]} × {pixels.shape[0]} pixels, "
            f"but the case {width} × {height}"
        )
    counts: NDArray[np.bool_] = pixels[..., 0] > 0.5
    return counts


def _spread(points: ArrayLike, mask: NDArray[np.bool_]) -> Array:
    """Values of the pixels of a mask `(n, ...)` put back into an image `(h, w, ...)`, zero elsewhere."""
    values = np.asarray(points)
    image = np.zeros(mask.shape + values.shape[1:])
    image[mask] = values
    return image


def _mesh(case: MaterialCase) -> Mesh:
    if case.truth == "mirror":
        return _floor()
    if case.mesh in BUILT_IN:
        return load_mesh(case.mesh)
    path = case.root / case.mesh
    return _loaded_mesh(path, _stamp(path))


def _floor() -> Mesh:
    """The built-in plane, turned to face +y: its normal is the pole of every map."""
    flat = load_mesh("plane")

    def turned(vectors: NDArray[Any]) -> NDArray[Any]:
        swapped: NDArray[Any] = vectors[:, [0, 2, 1]]
        return swapped * (1.0, 1.0, -1.0)

    return replace(
        flat,
        name="floor",
        positions=turned(flat.positions),
        normals=turned(flat.normals),
        tangents=turned(flat.tangents),
    )


def _environment(case: MaterialCase) -> Environment | None:
    around = case.environment
    if around is None:
        return None
    if _is_built_in(around):
        return _loaded_environment(around.name, (), around.options)
    path = case.root / around.name
    return _loaded_environment(str(path), _stamp(path), around.options)


def _stamp(path: Path) -> tuple[str, int, int]:
    """What tells one content of a file from another without reading it."""
    try:
        found = path.stat()
    except OSError:
        raise MrmError(f"{path}: no such file") from None
    return (str(path), found.st_mtime_ns, found.st_size)


@functools.lru_cache(maxsize=16)
def _loaded_mesh(path: Path, stamp: tuple[Any, ...]) -> Mesh:
    return load_mesh(path)


@functools.lru_cache(maxsize=4)
def _loaded_environment(
    name: str, stamp: tuple[Any, ...], options: tuple[tuple[str, float], ...]
) -> Environment:
    return find_environment(name, **dict(options))
