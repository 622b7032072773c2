"""Suites as files: a TOML, or a folder of materials, becomes the cases that a run consists of.

`docs/suites.md` describes the format.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import itertools
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, TypeVar, cast

import MaterialX as mx
import pydantic

from mrm_nodes import documents, elements, external, filenames
from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.library import shared_library
from mrm_nodes.regression.cases.material_case import (
    EnvironmentMap,
    Layering,
    MaterialCase,
    Truth,
    with_values,
)
from mrm_nodes.regression.suites.patterns import files_matching
from mrm_nodes.regression.suites.suitetable import (
    SETTINGS,
    AdjustTable,
    CaseTable,
    EnvironmentTable,
    Fault,
    Settings,
    SuiteError,
    SuiteTable,
    ToleranceTable,
    Where,
    faults,
    listed,
    read_table,
)
from mrm_nodes.regression.truth.closure import UnknownClosure, closure_of, has_layers
from mrm_nodes.regression.truth.material import Value
from mrm_nodes.regression.verdict.tolerance import Tolerance
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS
from mrm_nodes.render.mesh import BUILT_IN
from mrm_nodes.render.meshfile import MESH_SUFFIXES
from mrm_nodes.render.scene import (
    CAMERA_SYNTAX,
    LIGHT_SYNTAX,
    Camera,
    DirectionalLight,
    Framing,
    Light,
    parse_camera,
    parse_light,
)

MOST_CASES = 100_000
"""A matrix that makes more is taken for a slip."""
LONGEST_NAME = 180
"""Letters of a case's name: it becomes a folder's."""
_KEPT = 16
"""Documents that are kept: a material's cases are made one after the other."""

DEFAULT_LIGHTS: tuple[Light, ...] = (
    DirectionalLight(direction=(-0.08, -0.05, -1.0)),
    DirectionalLight(direction=(-0.9, -0.8, -0.7), color=(0.3, 0.5, 1.0), intensity=2.0),
)
"""One light a few degrees from the view, for retro lobes, and one from the side, for forward lobes."""


_IN_MATRIX = ("mesh", "camera", "light", "environment", "size", "element")
_INPUT = "input:"
_ALL = "**/*.mtlx"


@dataclass(frozen=True)
class Suite:
    """The cases of a suite, and where it was read."""

    path: Path
    title: str
    cases: tuple[MaterialCase, ...]
    broken: tuple[str, ...] = ()
    """What is wrong with materials, a line each with file, line and key: their cases are errors, the others run."""


def load(path: Path, allow_external: bool = False, layering: Layering | None = None) -> Suite:
    """Read a suite: a TOML file, or a folder whose .mtlx files are the cases.

    layering: in place of what the suite says.

    Raises:
        SuiteError: the suite has faults, each with file, line and key.
        MrmError: there is no such file or folder, or no material in it.
    """
    if path.is_dir():
        if not files_matching(_ALL, path):
            raise MrmError(f"{path}: no .mtlx file in this folder")
        table = SuiteTable(case=[CaseTable(material=[_ALL])])
        return _Maker(path, path, table, allow_external, lambda keys: str(path), layering).suite()
    table, where = read_table(path)
    return _Maker(path, path.parent, table, allow_external, where, layering).suite()


_Method = TypeVar("_Method", bound=Callable[..., Any])


def _remembered(method: _Method) -> _Method:
    """As functools.cache, but what a method returned goes with its object."""

    @functools.wraps(method)
    def once(self: _Maker, *given: Any) -> Any:
        key = (method.__name__, *given)
        if key not in self._known:
            self._known[key] = method(self, *given)
        return self._known[key]

    return cast(_Method, once)


class _Maker:
    """Makes the cases of one suite."""

    def __init__(
        self,
        path: Path,
        folder: Path,
        table: SuiteTable,
        allow_external: bool,
        where: Where,
        layering: Layering | None,
    ) -> None:
        self._path = path
        self._folder = Path(os.path.abspath(folder))  # noqa: PTH100  links stay as the user wrote them
        self._table = table
        self._allow_external = allow_external
        self._where = where
        self._layering = layering
        self._faults: list[str] = []
        self._broken: list[str] = []
        self._known: dict[tuple[Any, ...], Any] = {}
        self._as_read = functools.lru_cache(maxsize=_KEPT)(self._read_now)
        self._names: dict[str, tuple[str, str | int, tuple[str, ...]]] = {}

    def suite(self) -> Suite:
        """All cases, or all faults."""
        self._check_names()
        cases: dict[str, tuple[MaterialCase, int]] = {}
        for index, table in enumerate(self._table.case):
            try:
                for case in self._cases(index, table):
                    if case.name in cases:
                        _, other = cases[case.name]
                        raise Fault(
                            ("case", index),
                            f"the name {case.name} is taken by case {other + 1}: "
                            'give one of them a `name`, such as name = "{material}-2"',
                        )
                    cases[case.name] = (case, index)
                    if len(cases) > MOST_CASES:
                        raise Fault(("case", index, "matrix"), f"more than {MOST_CASES} cases")
            except Fault as fault:
                self._note(fault)
        for index, adjust in enumerate(self._table.adjust):
            unused = [p for p in adjust.cases if not any(fnmatchcase(name, p) for name in cases)]
            # A broken material has no elements that its cases could be called by.
            if unused and not self._faults and not self._broken:
                self._note(Fault(("adjust", index, "cases"), f"no case matches {unused[0]}"))
        if self._faults:
            raise SuiteError(list(dict.fromkeys([*self._faults, *self._broken])))
        rooted = self._rooted([case for case, _ in cases.values()])
        return Suite(self._path, self._table.title, rooted, tuple(dict.fromkeys(self._broken)))

    def _note(self, fault: Fault) -> None:
        self._faults.append(self._located(fault.keys, fault.message))

    def _located(self, keys: tuple[str | int, ...], message: str) -> str:
        return f"{self._where(keys)}: {message}"

    def _check_names(self) -> None:
        """Names that are given in tables are sound whether or not a case uses them."""
        checks: list[tuple[str, Iterable[str], Any]] = [
            ("meshes", self._table.meshes, self._mesh),
            ("cameras", self._table.cameras, self._camera),
            ("lights", self._table.lights, lambda name: self._lights([name])),
            ("environments", self._table.environments, self._environment),
        ]
        for kind, names, check in checks:
            for name in names:
                try:
                    check(name)
                except MrmError as error:
                    self._note(Fault((kind, name), str(error)))

    def _cases(self, index: int, table: CaseTable) -> Iterator[MaterialCase]:
        here: tuple[str | int, ...] = ("case", index)
        for axis, values in table.matrix.items():
            if not axis.startswith(_INPUT) and axis not in _IN_MATRIX:
                known = [*_IN_MATRIX, f"{_INPUT}NODE/INPUT"]
                raise Fault((*here, "matrix", axis), f"unknown axis; {suggestion(axis, known)}")
            if not values:
                raise Fault((*here, "matrix", axis), "an empty list makes no case")
            if axis in table.model_fields_set or axis.removeprefix(_INPUT) in table.input:
                raise Fault((*here, "matrix", axis), "is also given outside of the matrix")
        count = math.prod(map(len, table.matrix.values()))
        if count > MOST_CASES:
            raise Fault((*here, "matrix"), f"makes {count} cases; at most {MOST_CASES}")
        if table.element is not None and len(table.element) > 1 and "element" in table.matrix:
            raise Fault((*here, "element"), "is also an axis of the matrix")
        for material, label in self._materials(here, table):
            for combination in itertools.product(*table.matrix.values()):
                chosen = dict(zip(table.matrix, combination, strict=True))
                yield from self._of_elements(here, table, material, label, chosen)

    def _materials(self, here: tuple[str | int, ...], table: CaseTable) -> Iterator[tuple[str, str]]:
        """The files that a case names, relative to the suite's folder, and what they are called in names."""
        for pattern in map(filenames.with_slashes, table.material):
            try:
                found = [
                    name
                    for name in files_matching(pattern, self._folder)
                    if filenames.is_file(self._folder / name) and not self._is_reported(name)
                ]
            except (ValueError, OSError, re.error) as error:
                raise Fault((*here, "material"), f"{pattern}: {error}") from None
            if not found:
                beside = [str(file.relative_to(self._folder)) for file in self._folder.glob("*.mtlx")]
                beside += [str(file.relative_to(self._folder)) for file in self._folder.glob("*/*.mtlx")]
                raise Fault((*here, "material"), f"no file matches {pattern}; {suggestion(pattern, beside)}")
            fixed = Path(re.split(r"[*?\[]", pattern)[0] + "x").parent if glob.has_magic(pattern) else None
            for name in found:
                inner = Path(name).relative_to(fixed) if fixed is not None else Path(Path(name).name)
                yield self._beside(name), ".".join(inner.with_suffix("").parts)

    def _beside(self, name: str) -> str:
        """A file's name relative to the suite's folder; one that is named absolutely and lies elsewhere, as it is."""
        if not Path(name).is_absolute():
            return name
        file = os.path.normpath(name)
        if Path(file).is_relative_to(self._folder):
            return os.path.relpath(file, self._folder)
        real, folder = os.path.realpath(file), os.path.realpath(self._folder)
        return os.path.relpath(real, folder) if Path(real).is_relative_to(folder) else file

    def _relative(self, file: Path) -> str:
        """A file's name relative to the suite's folder, wherever it lies."""
        return os.path.relpath(self._folder / self._beside(str(file)), self._folder)

    def _is_reported(self, name: str) -> bool:
        """Whether a file is a report's copy of a material."""
        folders = Path(name).parents
        return any((self._folder / each / "report.json").is_file() for each in folders if each != Path())

    def _of_elements(
        self,
        here: tuple[str | int, ...],
        table: CaseTable,
        material: str,
        label: str,
        chosen: Mapping[str, Any],
    ) -> Iterator[MaterialCase]:
        known, wrong = self._elements(material)
        wanted = chosen.get("element", table.element)
        paths = known if wanted is None else listed(wanted)
        for element in paths:
            if element not in known and not (
                isinstance(element, str) and (wrong or elements.descendant(self._document(material), element))
            ):
                raise Fault(
                    (*here, "element"), f"{material} has no {element}; {suggestion(str(element), known)}"
                )
            parts = [label]
            if wanted is not None or len(known) > 1:
                parts.append(element)
            yield self._case(here, table, material, element, parts, chosen)

    def _case(
        self,
        here: tuple[str | int, ...],
        table: CaseTable,
        material: str,
        element: str,
        parts: list[str],
        chosen: Mapping[str, Any],
    ) -> MaterialCase:
        names = {axis: _label(value) for axis, value in chosen.items() if axis != "element"}
        shown = [
            f"{axis.rpartition('/')[2]}{text}" if axis.startswith(_INPUT) else text
            for axis, text in names.items()
        ]
        name = "-".join([*parts, *shown])
        if table.name is not None:
            name = self._named(here, table.name, {"material": parts[0], "element": element, **names})
        what = (material, element, *names.values())
        name = self._safe_name(name, here[1], table.name is not None, what)
        settings = self._settings(here, table, name, chosen)
        inputs, files = self._inputs(here, table, material, element, chosen)
        try:
            options = self._resolved(settings)
        except Fault as fault:
            keys = self._given_at(here, table, name, chosen, str(fault.keys[0]))
            raise Fault(keys, fault.message) from None
        truth, reason, is_layered = self._truth(here, material, element, inputs, settings)
        wrong = self._wrong(material, element)
        if wrong:
            self._broken.append(self._located((*here, "material"), wrong))
        return MaterialCase(
            name=name,
            root=self._folder,
            material=material,
            element=element,
            inputs=inputs,
            truth=truth,
            reason=reason,
            broken=bool(wrong),
            depends=tuple(dict.fromkeys([*self._depends(material), *files])),
            allow_external=self._allow_external,
            # A case that has nothing to tell is the same with it and without: from the cache too.
            layering=(self._layering or settings.layering or "materialx") if is_layered else "materialx",
            **options,
        )

    def _inputs(
        self,
        here: tuple[str | int, ...],
        table: CaseTable,
        material: str,
        element: str,
        chosen: Mapping[str, Any],
    ) -> tuple[dict[str, Value], list[str]]:
        """The values of a case's inputs, and the files that they name."""
        given = {(*here, "input", path): (path, value) for path, value in table.input.items()}
        for axis, value in chosen.items():
            if axis.startswith(_INPUT):
                given[(*here, "matrix", axis)] = (axis.removeprefix(_INPUT), value)
        inputs: dict[str, Value] = {}
        files: list[str] = []
        for keys, (path, value) in given.items():
            inputs[path] = self._value(keys, value)
            try:
                files += self._checked(material, element, path, inputs[path])
            except MrmError as error:
                raise Fault(keys, str(error)) from None
        return inputs, files

    def _named(self, here: tuple[str | int, ...], template: str, names: Mapping[str, str]) -> str:
        """A name from its template: `{material}`, `{element}` and the axes of the matrix."""
        known = {axis.removeprefix(_INPUT): text for axis, text in names.items()}

        def fill(found: re.Match[str]) -> str:
            if found[1] not in known:
                shown = [f"{{{each}}}" for each in known]
                raise Fault((*here, "name"), f"unknown {found[0]}; {suggestion(found[0], shown)}")
            return known[found[1]]

        return re.sub(r"\{([^{}]*)\}", fill, template)

    def _safe_name(self, name: str, index: str | int, is_given: bool, what: tuple[str, ...]) -> str:
        """A case's name as a file's, which no other case's is on any system.

        Documents name their elements, and one document costs its own cases: a name that is too long, or that
        another has once both are safe, ends in a part of its digest. What the suite's author called by one name
        stays so, and is an error.

        Args:
            index: the case's table.
            is_given: whether that has a template for names.
            what: the material, its element, and the place in the matrix.
        """
        safe = _safe(name)
        digest = hashlib.sha256("\0".join((name, *what)).encode(errors="surrogateescape")).hexdigest()[:10]
        marked = f"{safe[: LONGEST_NAME - len(digest) - 1]}-{digest}"
        if len(safe) > LONGEST_NAME:
            safe = marked
        other = self._names.setdefault(safe.casefold(), (name, index, what))
        if other[0] == name and (is_given or other[1] != index or other[2] == what):
            return safe
        self._names.setdefault(marked.casefold(), (name, index, what))
        return marked

    def _adjustments(self, name: str) -> Iterator[tuple[int, AdjustTable]]:
        for index, adjust in enumerate(self._table.adjust):
            if any(fnmatchcase(name, pattern) for pattern in adjust.cases):
                yield index, adjust

    def _settings(
        self, here: tuple[str | int, ...], table: CaseTable, name: str, chosen: Mapping[str, Any]
    ) -> Settings:
        """The defaults, what the case says, its place in the matrix, and what adjusts it, each over the one before."""
        given: dict[str, Any] = {}
        for source in (self._table.defaults, table):
            given |= {key: getattr(source, key) for key in SETTINGS if getattr(source, key) is not None}
        for axis, value in chosen.items():
            if axis in SETTINGS:
                try:
                    given[axis] = getattr(Settings.model_validate({axis: value}), axis)
                except pydantic.ValidationError as error:
                    _, message = next(faults(error))
                    raise Fault((*here, "matrix", axis), message) from None
        for _, adjust in self._adjustments(name):
            given |= {key: getattr(adjust, key) for key in SETTINGS if getattr(adjust, key) is not None}
        return Settings.model_construct(**given)

    def _given_at(
        self,
        here: tuple[str | int, ...],
        table: CaseTable,
        name: str,
        chosen: Mapping[str, Any],
        key: str,
    ) -> tuple[str | int, ...]:
        """Where a setting of a case comes from."""
        for index, adjust in reversed(list(self._adjustments(name))):
            if getattr(adjust, key) is not None:
                return ("adjust", index, key)
        if key in chosen:
            return (*here, "matrix", key)
        return (*here, key) if getattr(table, key) is not None else ("defaults", key)

    def _resolved(self, settings: Settings) -> dict[str, Any]:
        """A case's fields for its settings."""
        makers: dict[str, Any] = {
            "mesh": self._mesh,
            "camera": self._camera,
            "light": self._lights,
            "environment": self._environment,
            "tolerance": self._tolerance,
            "mask": self._file,
        }
        fields: dict[str, Any] = {"lights": DEFAULT_LIGHTS if settings.environment is None else ()}
        for key, make in makers.items():
            value = getattr(settings, key)
            if value is not None:
                try:
                    fields["lights" if key == "light" else key] = make(value)
                except MrmError as error:
                    raise Fault((key,), str(error)) from None
        if not fields["lights"] and settings.environment is None:
            raise Fault(("light",), "no light and no environment: the image would be black; name one of them")
        if settings.max_lights is not None:
            if settings.max_lights < len(fields["lights"]):
                raise Fault(
                    ("max_lights",),
                    f"{len(fields['lights'])} lights, but room for {settings.max_lights}: raise it, or leave it out",
                )
            fields["max_lights"] = settings.max_lights
        if settings.size is not None:
            fields["size"] = settings.size
        if settings.time_limit is not None:
            fields["time_limit"] = settings.time_limit
        return fields

    def _file(self, name: str) -> str:
        """The name of a file beside the suite, written as on this system."""
        file = filenames.with_slashes(name)
        if not filenames.is_file(self._folder / file):
            why = filenames.absence(name, [self._folder])
            raise MrmError(f"no file {name} beside the suite: {why}")
        return self._beside(file)

    def _mesh(self, name: str) -> str:
        file = self._table.meshes.get(name, name)
        if file in BUILT_IN:
            return file
        if filenames.is_file(self._folder / filenames.with_slashes(file)):
            if Path(file).suffix.lower() in MESH_SUFFIXES:
                return self._file(file)
            raise MrmError(f"{file} is no mesh file ({', '.join(MESH_SUFFIXES)})")
        if name in self._table.meshes or Path(name).suffix:
            why = filenames.absence(file, [self._folder])
            raise MrmError(f"no mesh file {file} ({', '.join(MESH_SUFFIXES)}) beside the suite: {why}")
        raise MrmError(f"unknown mesh {name}; {suggestion(name, [*BUILT_IN, *self._table.meshes])}")

    @_remembered
    def _camera(self, name: str) -> Camera | Framing:
        if name not in self._table.cameras and not re.search(r"[,:]", name):
            hint = f"{suggestion(name, self._table.cameras)} A camera is {CAMERA_SYNTAX}"
            raise MrmError(f"unknown camera {name}; {hint}")
        return parse_camera(self._table.cameras.get(name, name))

    def _lights(self, names: Sequence[str]) -> tuple[Light, ...]:
        lights: list[Light] = []
        for name in names:
            for text in self._table.lights.get(name, [name]):
                if text != "camera" and ":" not in text:
                    hint = f"{suggestion(text, self._table.lights)} A light is {LIGHT_SYNTAX}"
                    raise MrmError(f"unknown light {text}; {hint}")
                lights.append(self._light(text))
        return tuple(lights)

    @_remembered
    def _light(self, text: str) -> Light:
        return parse_light(text)

    def _environment(self, name: str) -> EnvironmentMap:
        table = self._table.environments.get(name) or EnvironmentTable(map=name)
        file = filenames.with_slashes(table.map)
        if table.map not in BUILT_IN_ENVIRONMENTS and not filenames.is_file(self._folder / file):
            known = [*BUILT_IN_ENVIRONMENTS, *self._table.environments]
            hint = (
                suggestion(name, known) if not Path(file).suffix else filenames.absence(file, [self._folder])
            )
            raise MrmError(f"no environment {table.map}: not a file beside the suite; {hint}")
        options = {
            key: getattr(table, key)
            for key in ("rotation", "intensity", "samples")
            if getattr(table, key) is not None
        }
        built_in = table.map in BUILT_IN_ENVIRONMENTS
        return EnvironmentMap(file if built_in else self._beside(file), tuple(options.items()))

    def _tolerance(self, given: str | ToleranceTable) -> Tolerance:
        table = given if isinstance(given, ToleranceTable) else self._table.tolerances.get(given)
        if table is None:
            raise MrmError(f"unknown tolerance {given}; {suggestion(str(given), self._table.tolerances)}")
        return Tolerance(**table.model_dump())

    def _value(self, keys: tuple[str | int, ...], value: Any) -> Value:
        if isinstance(value, bool | str):
            return value
        numbers = value if isinstance(value, list) else [value]
        if not numbers or not all(isinstance(n, int | float) and not isinstance(n, bool) for n in numbers):
            raise Fault(
                keys, f"{value!r} is no value of an input: a number, a list of numbers, text, true or false"
            )
        if not all(abs(n) < 3.4e38 for n in numbers):
            raise Fault(keys, f"{value!r} is no finite number of 32 bits")
        return tuple(map(float, value)) if isinstance(value, list) else float(value)

    def _truth(
        self,
        here: tuple[str | int, ...],
        material: str,
        element: str,
        inputs: Mapping[str, Value],
        settings: Settings,
    ) -> tuple[Truth, str, bool]:
        """What a case is compared with, why, and whether the evaluator has layers of it to tell of."""
        wanted = settings.truth or "auto"
        wrong = self._wrong(material, element)
        if wrong:
            return ("baseline" if wanted == "baseline" else "physics"), wrong, False
        try:
            unknown, is_layered = self._unknown(material, element, tuple(sorted(inputs.items())))
        except MrmError as error:
            raise Fault((*here, "input" if inputs else "material"), str(error)) from None
        if wanted == "baseline":
            return "baseline", "the suite says so", False
        if wanted == "physics" and unknown:
            raise Fault((*here, "truth"), f'{material}: {unknown}: write truth = "baseline" or "auto"')
        if unknown:
            return "baseline", unknown, False
        return "physics", "the evaluator knows all of its lobes", is_layered

    @_remembered
    def _elements(self, material: str) -> tuple[list[str], str]:
        """The paths of a document's materials, and what is wrong with it: then there is one path, and it is empty."""
        try:
            return materials_of(self._document(material), material), ""
        except MrmError as error:
            return [""], str(error)

    @_remembered
    def _wrong(self, material: str, element: str) -> str:
        """What is wrong with a document, or with what one of its elements is made of; or nothing."""
        _, wrong = self._elements(material)
        document = None if wrong else self._document(material)
        try:
            if document is not None:
                elements.check_document(document, material, elements.descendant(document, element), "genglsl")
        except MrmError as error:
            return str(error)
        return wrong

    @_remembered
    def _depends(self, material: str) -> tuple[str, ...]:
        _, wrong = self._elements(material)
        if wrong:
            return (os.path.normpath(material),)
        _, found = self._as_read(material)
        return tuple(map(self._relative, found))

    def _unknown(
        self, material: str, element: str, inputs: tuple[tuple[str, Value], ...]
    ) -> tuple[str, bool]:
        """Why the evaluator has no model of a material, or nothing; whether it has layers."""
        alike = tuple((path, _alike(value)) for path, value in inputs)
        return self._unknown_alike(material, element, alike)

    @_remembered
    def _checked(self, material: str, element: str, path: str, value: Value) -> tuple[str, ...]:
        """The files that a value of an input names; the value fits the input, where the document is sound."""
        if self._wrong(material, element):
            return ()
        file = self._folder / material
        document = self._with_values(material, {path: value})
        if not isinstance(value, str):
            return ()
        found = external.check_files(document, file, self._allow_external)
        return tuple(map(self._relative, found))

    def _read_now(self, material: str) -> tuple[mx.Document, list[Path]]:
        """A document, to be read only, and the files that its shaders are made of."""
        return documents.read_with_files(self._folder / material, allow_external=self._allow_external)

    def _document(self, material: str) -> mx.Document:
        return self._as_read(material)[0]

    def _with_values(self, material: str, values: Mapping[str, Value]) -> mx.Document:
        """A copy of a document with values of inputs: reading it anew would be most of the time that a suite takes."""
        document = mx.createDocument()
        document.copyContentFrom(self._document(material))
        document.setDataLibrary(shared_library())
        return with_values(document, values, material)

    @_remembered
    def _unknown_alike(
        self, material: str, element: str, inputs: tuple[tuple[str, Value], ...]
    ) -> tuple[str, bool]:
        try:
            document = self._with_values(material, dict(inputs)) if inputs else self._document(material)
            closure = closure_of(document, element)
        except UnknownClosure as error:
            return str(error), False
        return "", has_layers(closure.tree)

    def _rooted(self, cases: list[MaterialCase]) -> tuple[MaterialCase, ...]:
        """The cases with the folder above all of their files for root."""
        files = {os.path.normpath(path) for case in cases for path in (*case.sources(), *case.files())}
        root = Path(os.path.commonpath([self._folder, *(os.path.dirname(file) for file in files)]))  # noqa: PTH120
        if root == self._folder:
            return tuple(cases)

        def moved(name: str) -> str:
            return os.path.relpath(os.path.normpath(self._folder / name), root)

        def moved_case(case: MaterialCase) -> MaterialCase:
            around = case.environment
            named = [case.material, case.mesh, case.mask or "", around.name if around else ""]
            if around is not None and around.name not in BUILT_IN_ENVIRONMENTS:
                around = replace(around, name=moved(around.name))
            return replace(
                case,
                root=root,
                material=moved(case.material),
                mesh=case.mesh if case.mesh in BUILT_IN else moved(case.mesh),
                mask=case.mask and moved(case.mask),
                environment=around,
                depends=tuple(map(moved, case.depends)),
                baselines=moved(case.baselines),
                home=moved("."),
                fixed=tuple(moved(name) for name in named if Path(name).is_absolute()),
            )

        return tuple(map(moved_case, cases))


def materials_of(document: mx.Document, where: str) -> list[str]:
    """The paths of a document's own materials.

    Raises:
        MrmError: there is none.
    """
    # Not `getMaterialNodes`, which looks through the data library too.
    own = [each for each in document.getChildren() if isinstance(each, mx.Node)]
    found = [each.getNamePath() for each in own if each.getType() == "material"]
    if not found:
        found = [elements.find_renderable(document, where, None).getNamePath()]
    return found


def _alike(value: Value) -> Value:
    """A value for all that make the same closures: 0 and 1 leave parts out, and numbers may be alike (isotropic)."""
    if isinstance(value, bool | str):
        return value
    if isinstance(value, tuple):
        return tuple(0.5 if number not in (0.0, 1.0) and number == value[0] else number for number in value)
    return value if value in (0.0, 1.0) else 0.5


def _label(value: Any) -> str:
    """A value of a matrix as a part of a name."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float | int):
        return f"{value:g}"
    if isinstance(value, list):
        return "none" if not value else "_".join(_label(each) for each in value)
    return Path(value).stem if re.search(r"\.\w+$", str(value)) and "," not in str(value) else str(value)


#: What Windows takes for a device, with any ending.
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)


def _safe(name: str) -> str:
    """A name that is fit for a file on any system."""
    text = re.sub(r"[^\w.+-]+", "_", name, flags=re.ASCII).strip("._")
    return f"_{text}" if _DEVICES.match(text) else text or "case"
