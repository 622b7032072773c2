"""Every public name has a text that says what applies to it: shapes, units, errors, source. The site shows it, and
`help()` does."""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import pkgutil
import pydoc
import re
import textwrap
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mrm_nodes
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.suites import suitetable

Array = NDArray[np.float64]

#: (...), (..., 3), (n), (n, 3), (h, w, 3), (3,), 4 × 4, or words that say as much.
SHAPE = re.compile(
    r"\((?:\.\.\.|[nkmhw]|height|\d)(?:, (?:2 )?\w+)*,?\)|\d × \d|\bbroadcasts?\b|\ba (?:single )?number\b"
)
ARRAYS = re.compile(r"\b(?:ArrayLike|Array|NDArray|Floats)\b")

#: What a parameter, a field or a function of a name is measured in, and the words that say so.
_DEGREES, _RADIANS, _SR = r"degree|°", r"radian", r"1/sr|per steradian"
_SCENE, _COEFFICIENT = r"scene(?:'s)? unit", r"cd/\(lx m²\)"
UNITS = {
    "fov": _DEGREES,
    "rotation": _DEGREES,
    "observation": _DEGREES,
    "max_observation": _DEGREES,
    "beta1": _DEGREES,
    "beta2": _DEGREES,
    "elevation": _DEGREES,
    "angles": _DEGREES,
    "half_width": _DEGREES,
    "azimuth": _RADIANS,
    "theta_v": _RADIANS,
    "theta_l": _RADIANS,
    "from_retro": _RADIANS,
    "thinfilm_thickness": r"nm\b|nanomet",
    "position": _SCENE,
    "Camera.target": _SCENE,
    "positions": _SCENE,
    "width": _SCENE,
    "near": _SCENE,
    "far": _SCENE,
    "radius": _SCENE,
    "size": "pixel",
    "time_limit": "second",
    "seconds": "second",
    "exposure": "stop",
    "eval": _SR,
    "pdf": _SR,
    "pdf_visible": _SR,
    "D": _SR,
    "lambert": _SR,
    "eon": _SR,
    "oren_nayar": _SR,
    "diffuse_microfacets": _SR,
    "retroreflection": _COEFFICIENT,
    "luminance_coefficient": _COEFFICIENT,
    "diffuse_luminance": _COEFFICIENT,
    "R_A": _COEFFICIENT,
    "image": "radiance",
    "intensity": "irradiance|radiance|radiant|factor|intensity /",
}

#: A paper by author and year, a book, a standard, or MaterialX, whose formulas the evaluator has too.
SOURCE = re.compile(
    r"\b[A-Z]\w+(?:,? (?:and|et|al\.?|[A-Z]\w+),?)* (?:19|20)\d\d\b|MaterialX|Born and Wolf|Mally"
)

#: "As for `eon`", "as in `Renderer.render`": what that says holds here too.
REFERENCE = re.compile(r"\b[Aa]s\s+(?:for\s+|in\s+|of\s+)?`(?:\w+\.)*(\w+)`")

#: What a name says by itself.
SELF_EVIDENT = {"self", "path", "name_or_path"}

#: Checks of the evaluator, each of which raises ValueError.
CHECKS = {
    "numbers",
    "scalar",
    "colour",
    "pair",
    "choice",
    "directions",
    "check_unit",
    "check_shapes",
    "_index",
}


@dataclass(eq=False)
class Public:
    """A public name: a function, a class, or what is public in a class."""

    path: str
    value: Any
    owner: type | None
    package: types.ModuleType

    @property
    def name(self) -> str:
        return self.path.rpartition(".")[2]

    @functools.cached_property
    def said(self) -> str:
        """Its docstring, those of its fields, and those that it refers to: "as for `eon`", "parameters as of ..."."""
        return _said(self.value, (self.owner, self.package), ())

    @functools.cached_property
    def text(self) -> str:
        """What is said of it, and, of what is public in a class, of the class and its bases."""
        classes = [
            each for each in getattr(self.owner, "__mro__", ()) if each.__module__.startswith("mrm_nodes")
        ]
        return "\n".join([self.said, *(_said(each, (self.package,), ()) for each in classes)])

    @property
    def function(self) -> Callable[..., Any] | None:
        """What is called, where something is; of a property what gets it."""
        value = self.value
        if isinstance(value, property):
            return value.fget
        value = getattr(value, "func", getattr(value, "__wrapped__", getattr(value, "__func__", value)))
        return value if inspect.isfunction(value) else None

    @property
    def body(self) -> ast.Module:
        """The code of it; of a class, what makes one."""
        found: list[Any] = [self.function]
        if inspect.isclass(self.value):
            found = [self.value.__dict__.get(name) for name in ("__init__", "__post_init__")]
        return ast.Module([node for each in found if inspect.isfunction(each) for node in parsed(each)], [])

    @property
    def parameters(self) -> dict[str, str]:
        """Annotations by the names of what it takes, and of fields."""
        is_base = "it is not made by itself" in (inspect.getdoc(self.value) or "")
        if is_base or isinstance(self.value, property) or not callable(self.value):
            return {}
        try:
            signature = inspect.signature(self.value)
        except ValueError:
            return {}
        given = {p.name: str(p.annotation) for p in signature.parameters.values()}
        return {name: kind for name, kind in given.items() if name not in SELF_EVIDENT and name[0] != "_"}

    @property
    def returned(self) -> str:
        return str(inspect.signature(self.function).return_annotation) if self.function else ""


def _said(value: Any, places: tuple[Any, ...], seen: tuple[Any, ...]) -> str:
    own = inspect.getdoc(value) or ""
    if inspect.isclass(value):
        own += "".join(f"\n{name}: {text}" for name, text in fields(value).items())
    for name in REFERENCE.findall(own):
        for other in (getattr(place, name, None) for place in places):
            if other is not None and other is not value and other not in seen:
                own += "\n" + _said(other, places, (*seen, value))
    return own


@functools.cache
def parsed(function: Callable[..., Any]) -> list[ast.stmt]:
    try:
        return ast.parse(textwrap.dedent(inspect.getsource(function))).body
    except OSError:  # made by dataclasses
        return []


@functools.cache
def fields(found: type) -> dict[str, str]:
    """The text below each field of a class, its bases' fields too."""
    texts: dict[str, str] = {}
    for each in reversed(found.__mro__[:-1]):
        if not each.__module__.startswith("mrm_nodes"):
            continue
        (tree,) = ast.parse(textwrap.dedent(inspect.getsource(each))).body
        for field, below in zip(tree.body, tree.body[1:], strict=False):
            if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                texts[field.target.id] = ast.literal_eval(below.value)
    return texts


def public_names() -> Iterator[Public]:
    inner = (found.name for found in pkgutil.iter_modules(mrm_nodes.__path__, "mrm_nodes.") if found.ispkg)
    for package in map(importlib.import_module, ("mrm_nodes", *inner)):
        for name in getattr(package, "__all__", ()):
            value = getattr(package, name)
            if isinstance(value, types.ModuleType):
                continue
            yield Public(f"{package.__name__}.{name}", value, None, package)
            if inspect.isclass(value):
                for member, inside in vars(value).items():
                    is_code = callable(inside) or hasattr(inside, "__get__")
                    if not member.startswith("_") and is_code and not hasattr(inside, "__member__"):
                        yield Public(f"{package.__name__}.{name}.{member}", inside, value, package)


def in_reference(found: Public) -> bool:
    return found.package.__name__ == "mrm_nodes.reference"


def about(text: str, name: str) -> str:
    """What a text says of a name: its entry, or the sentences that have it."""
    entry = re.search(rf"^(\s*)`?{name}`? ?:(.*(?:\n\1\s+.*)*)", text, re.MULTILINE)
    if entry is not None:
        return entry[2]
    return " ".join(part for part in re.split(r"(?<=[.;])\s|\n\n", text) if re.search(rf"\b{name}\b", part))


def lacks_text(found: Public) -> str:
    if callable(found.value) or isinstance(found.value, property):
        return "" if inspect.getdoc(found.value) else "has no docstring"
    return ""


def lacks_parameters(found: Public) -> str:
    missing = [name for name in found.parameters if not re.search(rf"\b{name}\b", found.text)]
    return f"says nothing of {', '.join(missing)}" if missing else ""


def lacks_shapes(found: Public) -> str:
    text = found.text
    if re.search(r"[Aa]rguments (?:all )?broadcast|[Aa]ll (?:of them |arguments )?broadcast", text):
        return ""
    missing = [
        name
        for name, kind in found.parameters.items()
        if ARRAYS.search(kind) and not SHAPE.search(about(text, name))
    ]
    if ARRAYS.search(found.returned) and not SHAPE.search(found.said):
        missing.append("what is returned")
    return f"names no shape of {', '.join(missing)}" if missing else ""


def lacks_units(found: Public) -> str:
    missing = []
    for name in found.parameters:
        unit = UNITS.get(f"{found.name}.{name}", UNITS.get(name, ""))
        if not re.search(unit, about(found.text, name), re.IGNORECASE):
            missing.append(name)
    if found.function and not re.search(UNITS.get(found.name, ""), found.said, re.IGNORECASE):
        missing.append("what is returned")
    return f"names no unit of {', '.join(missing)}" if missing else ""


def lacks_errors(found: Public) -> str:
    raised = set()
    for node in ast.walk(found.body):
        if (
            isinstance(node, ast.Raise)
            and isinstance(node.exc, ast.Call)
            and isinstance(node.exc.func, ast.Name)
        ):
            raised.add(node.exc.func.id)
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") in CHECKS and in_reference(found):
            raised.add("ValueError")
    missing = [name for name in sorted(raised) if not re.search(rf"\b{name}\b", found.text)]
    return f"does not say when it raises {', '.join(missing)}" if missing else ""


def lacks_source(found: Public) -> str:
    if not in_reference(found) or found.owner is not None:
        return ""
    return "" if SOURCE.search(found.text) else "names no source"


def lacks_a_plain_signature(found: Public) -> str:
    """Annotations that numpy's aliases were spelt out in fill a screen."""
    kinds = [*found.parameters.values(), found.returned]
    return "has a signature that nobody can read" if any("numpy._typing" in kind for kind in kinds) else ""


RULES = (
    lacks_text,
    lacks_parameters,
    lacks_shapes,
    lacks_units,
    lacks_errors,
    lacks_source,
    lacks_a_plain_signature,
)


@pytest.fixture(scope="module")
def names() -> list[Public]:
    return list(public_names())


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_every_public_name_says_what_applies(names: list[Public], rule: Callable[[Public], str]):
    faults = [f"{found.path} {fault}" for found in names if (fault := rule(found))]
    assert not faults, "\n" + "\n".join(faults)


def bare(v: Array, time_limit: float) -> Array:
    raise MrmError("no")


def told(v: Array, time_limit: float) -> Array:
    """What Heitz 2014, eq. 1 says: (..., 3).

    Args:
        v: (..., 3), to the viewer.
        time_limit: in seconds.

    Raises:
        MrmError: always.
    """
    raise MrmError("no")


def spelt_out(v: Annotated[Array, "numpy._typing"]) -> Array:
    return v


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.__name__)
def test_each_rule_finds_what_lacks(rule: Callable[[Public], str]):
    value = spelt_out if rule is lacks_a_plain_signature else bare
    assert rule(Public("mrm_nodes.reference.f", value, None, mrm_nodes.reference))
    assert not rule(Public("mrm_nodes.reference.f", told, None, mrm_nodes.reference))


def test_every_key_of_a_suite_has_its_text():
    tables = (suitetable.SuiteTable, suitetable.CaseTable, suitetable.AdjustTable, suitetable.ToleranceTable)
    for table in (*tables, suitetable.EnvironmentTable):
        assert [name for name, field in table.model_fields.items() if not field.description] == []


def test_help_of_render_is_about_the_function():
    assert "material: a .mtlx file" in pydoc.plain(pydoc.render_doc(mrm_nodes.render))


def test_what_holds_much_says_what_it_is_in_a_line():
    direction = np.array([[0.0, 0.0, 1.0]])
    shown = {
        "<Shader 'traffic_cone' for glsl, ": mrm_nodes.generate_shader("traffic_cone"),
        "<Mesh 'plane': 4 vertices, 2 triangles>": mrm_nodes.render.plane(),
        "<Environment 256x128: rotation 0, ": mrm_nodes.render.find_environment("sky"),
        "<Measurement of tape: 1 samples of luminance>": mrm_nodes.measured.Measurement(
            direction, direction, np.ones((1, 1)), sample="tape"
        ),
    }
    for text, value in shown.items():
        assert repr(value).startswith(text) and len(repr(value)) < 160, repr(value)
