"""Units: lengths become metres and angles degrees, as MaterialX's own unit system turns them."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes.errors import MrmError, suggestion

METER = "meter"

#: Types whose values MaterialX converts.
CONVERTED = ("float", "vector2", "vector3", "vector4")

#: MaterialX keeps the converters of a whole process in one registry.
_REGISTRY = threading.RLock()


def unit_definitions(document: mx.Document, shared: mx.Document) -> mx.Document:
    """The unit types and units that a library and a document define, as a document of their own.

    Where a definition names no unit, MaterialX asks for the one unit that its options hold, metres, whatever the
    type: it throws for angles. So every other type gets a "meter" that is its base unit: degrees for angles.
    """
    found = mx.createDocument()
    for source in (shared, document):
        for each in (*source.getUnitTypeDefs(), *source.getUnitDefs()):
            if found.getChild(each.getName()) is None:
                found.addChildOfCategory(each.getCategory(), each.getName()).copyContentFrom(each)
    for kind in found.getUnitTypeDefs():
        if kind.getName() != "distance":
            base = found.addChildOfCategory("unitdef", found.createValidChildName(f"base_{kind.getName()}"))
            base.setAttribute("unittype", kind.getName())
            base.addChildOfCategory("unit", METER).setAttribute("scale", "1.0")
    found.setDataLibrary(shared)
    return found


def scales(definitions: mx.Document, kind: str) -> dict[str, float]:
    """The units of a type, such as `distance`, by name: each in base units."""
    return {
        unit.getName(): float(unit.getAttribute("scale"))
        for definition in definitions.getUnitDefs()
        if definition.getAttribute("unittype") == kind
        for unit in definition.getChildren()
    }


def factor(port: mx.Input, unit: str, kind: str, definitions: mx.Document) -> float:
    """What a value in a unit is multiplied with, so that it is in the one that the definition of a port's node wants.

    Raises:
        MrmError: an unknown unit.
    """
    known = scales(definitions, kind)
    if unit not in known:
        names = [name for name in known if kind == "distance" or name != METER]
        raise MrmError(f"{port.getNamePath()}: unknown unit {unit} of {kind}; {suggestion(unit, names)}")
    return known[unit] / known.get(port.getActiveUnit() or METER, 1.0)


@contextlib.contextmanager
def unit_system(generator: Any, context: Any, definitions: mx.Document) -> Iterator[None]:
    """Have a generator convert units while this lasts."""
    system = mx_gen_shader.UnitSystem.create(generator.getTarget())
    system.loadLibrary(definitions)
    registry = mx.UnitConverterRegistry.create()
    kinds = definitions.getUnitTypeDefs()
    with _REGISTRY:
        before = [registry.getUnitConverter(kind) for kind in kinds]
        for kind in kinds:
            registry.removeUnitConverter(kind)
            registry.addUnitConverter(kind, mx.LinearUnitConverter.create(kind))
        system.setUnitConverterRegistry(registry)
        generator.setUnitSystem(system)
        context.getOptions().targetDistanceUnit = METER
        try:
            yield
        finally:
            for kind, converter in zip(kinds, before, strict=True):
                registry.removeUnitConverter(kind)
                if converter is not None:
                    registry.addUnitConverter(kind, converter)
