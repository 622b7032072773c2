"""What a suite's TOML may hold, and where in the file a fault lies."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag

from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.files import read_bytes

LARGEST_FILE = 16 << 20
"""Bytes of a suite."""

_MOST_NAMES = 100
#: The TOML reader takes the square of a key's names in time.
_MANY_NAMES = re.compile(
    rf"""(?<![\w-])(?>(?>"[^"\n]*+"|'[^'\n]*+'|[\w-]++)[ \t]*+\.[ \t]*+){{{_MOST_NAMES}}}"""
)

Where = Callable[[Sequence[str | int]], str]
"""File, line and key of a fault, by the keys under which it lies."""


class SuiteError(MrmError):
    """What is wrong with a suite: a line for each fault."""

    def __init__(self, faults: Sequence[str]) -> None:
        self.faults = list(faults)
        more = f" (and {len(faults) - 1} more: `mrm-nodes suite check` lists them)" if len(faults) > 1 else ""
        super().__init__(faults[0] + more)


class Fault(Exception):
    """A fault, and the keys under which it lies."""

    def __init__(self, keys: Sequence[str | int], message: str) -> None:
        super().__init__(message)
        self.keys = tuple(keys)
        self.message = message


# The schema. Each form is told as a user would write it.


def _size(value: Any) -> Any:
    """`256x256`, 256, or [256, 256]."""
    if isinstance(value, str) and re.fullmatch(r"\d{1,5}x\d{1,5}", value):
        value = [int(side) for side in value.split("x")]
    elif isinstance(value, int) and not isinstance(value, bool):
        value = [value, value]
    fits = isinstance(value, list) and len(value) == 2
    if not fits or not all(isinstance(side, int) and 1 <= side <= 16384 for side in value):
        raise ValueError('a size is "640x480", or one number for a square, each side 1 to 16384 pixels')
    return (value[0], value[1])


def listed(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


def _environment(value: Any) -> Any:
    return {"map": value} if isinstance(value, str) else value


_Size = Annotated[tuple[int, int], BeforeValidator(_size)]
_Name = Annotated[str, Field(min_length=1, max_length=1000)]
_Names = Annotated[list[_Name], BeforeValidator(listed), Field(min_length=1)]
_Lights = Annotated[list[_Name], BeforeValidator(listed)]
_Seconds = Annotated[float, Field(gt=0, le=86400)]
_Threshold = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Table(BaseModel):
    # The texts below are the reference's, and each belongs to its key.
    model_config = ConfigDict(extra="forbid", strict=True, use_attribute_docstrings=True)


class ToleranceTable(_Table):
    """A tolerance by its name: what is not given is not asked for."""

    max_rel: _Threshold | None = None
    """Relative error of the worst value."""
    p999_rel: _Threshold | None = None
    """Relative error that 99.9 % of the values keep."""
    rmse: _Threshold | None = None
    """Root mean square of the differences, in the image's own unit."""
    flip: _Threshold | None = None
    """Mean FLIP of the pictures as shown, 0 to 1."""
    hdr_flip: _Threshold | None = None
    """Mean HDR-FLIP, 0 to 1."""


_BY_NAME, _INLINE = "by name", "inline"
_Tolerance = Annotated[
    Annotated[_Name, Tag(_BY_NAME)] | Annotated[ToleranceTable, Tag(_INLINE)],
    Discriminator(lambda value: _INLINE if isinstance(value, dict | ToleranceTable) else _BY_NAME),
]


class EnvironmentTable(_Table):
    """The light around a case, by its name; a text is taken for `map`."""

    map: _Name
    """`sky`, `studio`, or a latitude-longitude .hdr or .exr file."""
    rotation: Annotated[float, Field(allow_inf_nan=False)] | None = None
    """Degrees by which it is turned about +y, from +z towards +x."""
    intensity: _Threshold | None = None
    """What its radiance is multiplied by."""
    samples: Annotated[int, Field(ge=1, le=1 << 20)] | None = None
    """Directions that a lobe takes from it."""


class Settings(_Table):
    """What every case has unless it says otherwise."""

    mesh: _Name | None = None
    """`sphere`, `plane`, `baluster`, a name of `[meshes]`, or an .obj, .gltf or .glb file."""
    camera: _Name | None = None
    """A name of `[cameras]`, or a camera as `render --camera` takes it; by default the whole mesh from +z."""
    light: _Lights | None = None
    """One or a list: names of `[lights]`, or lights as `render --light` takes them; `[]` is none, in an environment.
    Without it two directional lights, or none where there is an environment."""
    environment: _Name | None = None
    """`sky`, `studio`, a name of `[environments]`, or a latitude-longitude .hdr or .exr file."""
    max_lights: Annotated[int, Field(ge=1, le=1000)] | None = None
    """How many lights its shader has room for; without it 4, or as many as the case has."""
    size: _Size | None = None
    """Pixels: `"640x480"`, `[640, 480]`, or `256` for a square."""
    tolerance: _Tolerance | None = None
    """A name of `[tolerances]`, or what that table would hold; without it the evaluator's own bounds, or a
    baseline's."""
    mask: _Name | None = None
    """An image of the case's size: only its bright pixels count."""
    truth: Literal["auto", "physics", "baseline"] | None = None
    """What the image is compared with; `"auto"` takes physics where it can."""
    layering: Literal["materialx", "exact"] | None = None
    """`"exact"` tells, beside the verdict, what MaterialX's rule of layering costs a material that has layers."""
    time_limit: _Seconds | None = None
    """Seconds after which the case is an error."""


class CaseTable(Settings):
    """One case for each material, and for each place in the matrix."""

    material: _Names
    """A .mtlx file or a pattern (`*`, `**`), relative to the suite, or a list of them."""
    element: _Names | None = None
    """The path of a material in the document, or a list; without it, each material is a case."""
    name: _Name | None = None
    """A template: `{material}`, `{element}` and each axis of the matrix in braces."""
    input: dict[str, Any] = {}
    """Values by the path of an input, `node/input` or `graph/node/input`; a connection there is cut."""
    matrix: dict[str, list[Any]] = {}
    """Lists by `mesh`, `camera`, `light`, `environment`, `size`, `element` or `input:PATH`, multiplied out."""


class AdjustTable(Settings):
    """What some cases have instead."""

    cases: _Names
    """Patterns of the cases' names, one or a list."""


class SuiteTable(_Table):
    """The file itself."""

    title: str = ""
    """What the report is called."""
    defaults: Settings = Settings()
    """What every case has unless it says otherwise."""
    meshes: dict[str, _Name] = {}
    """Files by name: .obj, .gltf and .glb, relative to the suite."""
    cameras: dict[str, _Name] = {}
    """Cameras by name, each as `render --camera` takes it."""
    lights: dict[str, _Lights] = {}
    """Lights by name, each one or a list, as `render --light` takes them."""
    environments: dict[str, Annotated[EnvironmentTable, BeforeValidator(_environment)]] = {}
    """Environments by name."""
    tolerances: dict[str, ToleranceTable] = {}
    """Tolerances by name."""
    case: Annotated[list[CaseTable], Field(min_length=1)]
    """The cases."""
    adjust: list[AdjustTable] = []
    """Adjustments; where several fit a case, the last one counts."""


SETTINGS = tuple(Settings.model_fields)


def read_table(path: Path) -> tuple[SuiteTable, Where]:
    """Read a suite's TOML.

    Raises:
        SuiteError: it has faults.
        MrmError: it cannot be read.
    """
    text = _text(path)
    if _MANY_NAMES.search(text):
        raise SuiteError([f"{path}: a key of more than {_MOST_NAMES} names"])
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SuiteError([_syntax_fault(path, str(error))]) from None
    except RecursionError:
        raise SuiteError([f"{path}: lists or tables that are too deep within each other"]) from None
    except ValueError as error:  # a number of too many digits
        raise SuiteError([f"{path}: {error}"]) from None
    lines = _Lines(text)

    def where(keys: Sequence[str | int]) -> str:
        return f"{path}:{lines.of(keys)}: {_dotted(keys)}"

    try:
        table = SuiteTable.model_validate(content)
    except pydantic.ValidationError as error:
        raise SuiteError([f"{where(keys)}: {message}" for keys, message in faults(error)]) from None
    return table, where


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise MrmError(f"{path}: larger than {LARGEST_FILE >> 20} MiB, which is no suite")
        return read_bytes(path).decode("utf-8")
    except OSError as error:
        raise MrmError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise SuiteError([f"{path}: not UTF-8 text (byte {error.start})"]) from None


def _syntax_fault(path: Path, message: str) -> str:
    place = re.search(r" \(at line (\d+), column (\d+)\)$", message)
    if place is None:
        return f"{path}: not TOML: {message.removesuffix(' (at end of document)')}"
    return f"{path}:{place[1]}: not TOML: {message[: place.start()]}, column {place[2]}"


def _dotted(keys: Sequence[str | int]) -> str:
    """Keys as TOML names them; the first [[case]] is case 1."""
    text = ""
    for key in keys:
        text += f" {key + 1}" if isinstance(key, int) else f"{'.' if text else ''}{key}"
    return text or "the file"


def faults(error: pydantic.ValidationError) -> Iterator[tuple[tuple[str | int, ...], str]]:
    """Where the faults of a table lie, and what is expected there."""
    for each in error.errors(include_url=False):
        keys = tuple(key for key in each["loc"] if key not in (_BY_NAME, _INLINE))
        message = each["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
        if each["type"] == "extra_forbidden":
            message = f"unknown key; {suggestion(str(keys[-1]), _keys_beside(keys))}"
        elif each["type"] == "missing":
            message = "is missing"
        elif not message.startswith("a size"):
            message = f"expected {message[:1].lower()}{message[1:]}"
        yield keys, message


def _keys_beside(keys: Sequence[str | int]) -> Iterable[str]:
    tables: dict[Any, type[BaseModel]] = {
        "defaults": Settings,
        "tolerances": ToleranceTable,
        "environments": EnvironmentTable,
        "case": CaseTable,
        "adjust": AdjustTable,
    }
    if keys[-2:-1] == ("tolerance",):
        return ToleranceTable.model_fields
    return (tables.get(keys[0], SuiteTable) if len(keys) > 1 else SuiteTable).model_fields


class _Lines:
    """The lines on which a TOML's keys stand. A key inside an inline table stands where that begins."""

    # Nothing in these is tried in two ways, so that a line is read once.
    _HEADER = re.compile(r"\s*+(\[\[?+)([^\]]++)\]\]?+\s*+(?:#.*)?$")
    _KEY = re.compile(
        r"""\s*+((?>"(?:[^"\\]|\\.)*+"|'[^']*+'|[\w-]++)(?>\s*+\.\s*+(?>"[^"]*+"|'[^']*+'|[\w-]++))*+)\s*+="""
    )
    _PART = re.compile(r"""\s*(?:"((?:[^"\\]|\\.)*)"|'([^']*)'|([\w-]+))\s*\.?""")

    def __init__(self, text: str) -> None:
        self._lines: dict[tuple[str | int, ...], int] = {(): 1}
        counts: dict[tuple[str | int, ...], int] = {}
        table: tuple[str | int, ...] = ()
        for number, line in enumerate(text.splitlines(), start=1):
            header = self._HEADER.match(line)
            if header is not None and "=" not in re.sub(r'"[^"]*"', "", line.split("#")[0]):
                names = self._parts(header[2])
                table = ()
                for index, name in enumerate(names):
                    table = (*table, name)
                    if header[1] == "[[" and index == len(names) - 1:
                        counts[table] = counts.get(table, -1) + 1
                    if table in counts:
                        table = (*table, counts[table])
                self._lines.setdefault(table, number)
                continue
            key = self._KEY.match(line)
            if key is not None:
                self._lines.setdefault((*table, *self._parts(key[1])), number)

    def _parts(self, dotted: str) -> list[str]:
        return [next(part for part in found if part) for found in self._PART.findall(dotted) if any(found)]

    def of(self, keys: Sequence[str | int]) -> int:
        """The line of a key, or of the nearest table around it."""
        for count in range(len(keys), -1, -1):
            if tuple(keys[:count]) in self._lines:
                return self._lines[tuple(keys[:count])]
        return 1
