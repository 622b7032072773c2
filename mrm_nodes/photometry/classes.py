"""Classes of retroreflectors: the values that laws and standards ask for, and whether something has them.

The values and where they were read are in classes.toml. What could not be confirmed is not there.
"""

from __future__ import annotations

import functools
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError, unknown
from mrm_nodes.photometry.coefficients import (
    diffuse_luminance,
    luminance_coefficient,
    retroreflection,
)
from mrm_nodes.photometry.colour import luminance
from mrm_nodes.photometry.geometry import ROAD_ENTRANCE, ROAD_OBSERVATION
from mrm_nodes.reference.polar import Scatterer

Array = NDArray[np.float64]
Quantity = Literal["R_A", "R_L", "Q_d"]
UNITS: dict[Quantity, str] = {"R_A": "cd/(lx m²)", "R_L": "mcd/(lx m²)", "Q_d": "mcd/(lx m²)"}
"""What each quantity is given in; roads have a thousandth of what sheets have."""

ANY = "any"
"""The colour of a class that asks the same of all."""
COLOURS = ("white", "yellow", "orange", "red", "green", "blue", "brown", "grey")
"""What a class of any colour may have."""
_SYNONYMS = {"gray": "grey", "silver": "white", "amber": "orange"}

_FILE = Path(__file__).with_name("classes.toml")


@dataclass(frozen=True)
class Requirement:
    """The least, and where there is one the greatest, value of a quantity in one geometry."""

    quantity: Quantity
    """R_A in cd/(lx m²); R_L or Q_d in mcd/(lx m²)."""
    minimum: float
    """In the quantity's unit."""
    maximum: float | None = None
    """Likewise."""
    observation: float | None = None
    """Degrees; None for Q_d, which has none."""
    beta1: float | None = None
    """The entrance angle in degrees; None for Q_d."""

    @property
    def geometry(self) -> str:
        """Observation and entrance angle, for people."""
        if self.observation is None or self.beta1 is None:
            return "diffuse light"
        return f"{self.observation:g}°, {self.beta1:g}°"


@dataclass(frozen=True)
class RetroClass:
    """A class of a standard: what it asks for, by colour."""

    name: str
    """As `find_class` takes it."""
    aliases: tuple[str, ...]
    """Other names that it is known by."""
    title: str
    """What it is."""
    standing: Literal["law", "secondary"]
    """Whether a law or regulation prints the values, or somebody who reports a standard."""
    source: str
    """Where the values were read."""
    requirements: Mapping[str, tuple[Requirement, ...]]
    """What is asked, by colour."""

    def resolve(self, colour: str | None) -> str:
        """The class's name of a colour, however it is spelt; a class of a single one, or of any, need not be told.

        Raises:
            MrmError: the class has no such colour, or several.
        """
        own = list(self.requirements)
        if colour is None:
            if len(own) > 1:
                raise MrmError(f"{self.name} has several colours; name one: {', '.join(own)}")
            return own[0]
        known = [*COLOURS, ANY] if own == [ANY] else own
        wanted = _plain(colour)
        wanted = _SYNONYMS.get(wanted, wanted)
        if wanted not in known:
            raise MrmError(f"{self.name}: {unknown('colour', colour, known)}")
        return wanted

    def of(self, colour: str | None) -> tuple[Requirement, ...]:
        """What is asked of a colour.

        Raises:
            MrmError: as `resolve`.
        """
        resolved = self.resolve(colour)
        return self.requirements[resolved if resolved in self.requirements else ANY]


@dataclass(frozen=True)
class Row:
    """What a material has where a class asks for something; of a sheet with a pattern, the mean is what counts."""

    requirement: Requirement
    """What is asked."""
    value: float
    """In the requirement's unit, under illuminant A."""
    least: float
    """The least of several points' values."""
    most: float
    """The greatest."""

    @property
    def margin(self) -> float:
        """By which share of the minimum it is above it."""
        return self.value / self.requirement.minimum - 1.0

    @property
    def passes(self) -> bool:
        """Whether it is in the class here."""
        greatest = self.requirement.maximum
        return self.value >= self.requirement.minimum and (greatest is None or self.value <= greatest)


def classes() -> Mapping[str, RetroClass]:
    """All classes by name, in the order of classes.toml."""
    return _read(_FILE.read_text(encoding="utf-8"))


def find_class(name: str) -> RetroClass:
    """A class by its name or another that it is known by, however it is spaced and capitalised.

    Raises:
        MrmError: there is none; says what is like it.
    """
    known = classes()
    by_name = {_plain(each): found for found in known.values() for each in (found.name, *found.aliases)}
    if _plain(name) not in by_name:
        raise MrmError(unknown("class", name, known))
    return by_name[_plain(name)]


def check(bsdf: Scatterer, name: str, colour: str | None = None) -> list[Row]:
    """What a BSDF has in each geometry of a class.

    Args:
        bsdf: as in `retroreflection`; of one that has several points, such as a material's, their mean counts, as in an
            instrument that sees more than a bead.
        name: of the class.
        colour: where the class has several.

    Raises:
        MrmError: no such class, or colour of it.
    """
    asked = find_class(name).of(colour)
    return [
        Row(each, float(points.mean()), float(points.min()), float(points.max()))
        for each, points in zip(asked, values(bsdf, asked), strict=True)
    ]


def values(bsdf: Scatterer, asked: Sequence[Requirement]) -> Array:
    """What a BSDF has in the geometries of requirements of one quantity, (..., n points): luminances, in its unit."""
    quantity = asked[0].quantity
    if quantity == "Q_d":
        return np.reshape(luminance(diffuse_luminance(bsdf) * 1e3), (len(asked), -1))
    angles = np.array([(each.observation, each.beta1) for each in asked]).T[..., None]
    if quantity == "R_L":
        return luminance(luminance_coefficient(bsdf, *angles) * 1e3)
    return luminance(retroreflection(bsdf, *angles))


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.casefold())


@functools.lru_cache(maxsize=1)
def _read(text: str) -> Mapping[str, RetroClass]:
    found = [_class(table) for table in tomllib.loads(text)["class"]]
    return {each.name: each for each in found}


def _class(table: dict[str, Any]) -> RetroClass:
    largest = table.get("maximum", {})
    asked: dict[str, tuple[Requirement, ...]] = {}
    for colour, rows in table.get("R_A", {}).items():
        asked[colour] = tuple(
            Requirement("R_A", minimum, largest.get(colour), float(observation), beta1)
            for observation, line in rows.items()
            for beta1, minimum in line
        )
    for colour, minimum in table.get("R_L", {}).items():
        asked[colour] = (Requirement("R_L", minimum, None, ROAD_OBSERVATION, ROAD_ENTRANCE),)
    for colour, minimum in table.get("Q_d", {}).items():
        asked[colour] = (Requirement("Q_d", minimum),)
    return RetroClass(
        table["name"], tuple(table["aliases"]), table["title"], table["standing"], table["source"], asked
    )
