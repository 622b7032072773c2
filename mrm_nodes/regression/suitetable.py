"""What a suite's TOML may hold, and where in the file a fault lies."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

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
_Seconds = Annotated[float, Field(gt=0, le=86400)]
_Threshold = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class ToleranceTable(_Table):
    max_rel: _Threshold | None = None
    p999_rel: _Threshold | None = None
    rmse: _Threshold | None = None
    flip: _Threshold | None = None
    hdr_flip: _Threshold | None = None


class EnvironmentTable(_Table):
    map: _Name
    rotation: Annotated[float, Field(allow_inf_nan=False)] | None = None
    intensity: _Threshold | None = None
    samples: Annotated[int, Field(ge=1, le=1 << 20)] | None = None


class Settings(_Table):
    """What a case, the defaults and an adjustment have in common."""

    mesh: _Name | None = None
    camera: _Name | None = None
    light: _Names | None = None
    environment: _Name | None = None
    size: _Size | None = None
    tolerance: _Name | None = None
    mask: _Name | None = None
    truth: Literal["auto", "physics", "baseline"] | None = None
    time_limit: _Seconds | None = None


class CaseTable(Settings):
    material: _Names
    element: _Names | None = None
    name: _Name | None = None
    input: dict[str, Any] = {}
    matrix: dict[str, list[Any]] = {}


class AdjustTable(Settings):
    cases: _Names


class SuiteTable(_Table):
    title: str = ""
    defaults: Settings = Settings()
    meshes: dict[str, _Name] = {}
    cameras: dict[str, _Name] = {}
    lights: dict[str, _Names] = {}
    environments: dict[str, Annotated[EnvironmentTable, BeforeValidator(_environment)]] = {}
    tolerances: dict[str, ToleranceTable] = {}
    case: Annotated[list[CaseTable], Field(min_length=1)]
    adjust: list[AdjustTable] = []


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
        keys = each["loc"]
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
