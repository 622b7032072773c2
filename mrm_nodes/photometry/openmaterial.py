"""Retroreflectors of ASAM OpenMATERIAL 3D (.xomp): one coefficient, without an angle and without a colour.

Source: the material schema of ASAM OpenMATERIAL 3D 1.0, `materialProperties.retroreflectivityData`.
"""

from __future__ import annotations

import json
import math
import re
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mrm_nodes import jsontext
from mrm_nodes.errors import MrmError
from mrm_nodes.photometry.classes import find_class
from mrm_nodes.photometry.coefficients import retroreflection
from mrm_nodes.photometry.colour import luminance
from mrm_nodes.photometry.design import material_for
from mrm_nodes.photometry.retroreflector import Retroreflector

LARGEST = 5000.0
"""The largest coefficient of the schema."""
GEOMETRY = (0.2, -4.0)
"""Observation and entrance angle in degrees of the coefficient that is written."""
_LARGEST_FILE = 16 << 20
_SAID = re.compile(
    r"observation (?P<observation>\d+(?:\.\d+)?) deg, entrance (?P<entrance>-?\d+(?:\.\d+)?) deg"
    r"(?:, colour (?P<colour>[a-z]+))?"
)
"""How our own files say in `sources` what the coefficient is of."""
_BEFORE = "; before: "


@dataclass(frozen=True)
class XompAsset:
    """What a .xomp says of how its material sends light back."""

    name: str
    coefficient: float
    """R_A in cd/(lx m²)."""
    sources: str
    tree: Mapping[str, Any]
    """All of the file."""

    @property
    def geometry(self) -> tuple[float, float] | None:
        """Observation and entrance angle in degrees, where `sources` says them as we write them."""
        found = _SAID.search(self.sources)
        return None if found is None else (float(found["observation"]), float(found["entrance"]))

    @property
    def colour(self) -> str | None:
        """The colour, likewise."""
        found = _SAID.search(self.sources)
        return None if found is None else found["colour"]


def read_asset(path: Path) -> XompAsset:
    """The retroreflectivity of a .xomp file.

    Raises:
        MrmError: the file cannot be read, is no JSON, or has none; the coefficient is no number from 0 to 5000.
    """
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise MrmError(
                f"{path}: more than {_LARGEST_FILE >> 20} MB, which is no description of a material"
            )
        tree = jsontext.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise MrmError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, ValueError) as error:
        raise MrmError(f"{path}: not the JSON of a .xomp file: {error}") from None
    place: Any = tree
    for key in ("materialProperties", "retroreflectivityData", "coefficientOfRetroreflection"):
        if not isinstance(place, dict) or key not in place:
            raise MrmError(
                f"{path}: no {key}: a retroreflector has "
                "materialProperties/retroreflectivityData/coefficientOfRetroreflection"
            )
        data, place = place, place[key]
    if isinstance(place, bool) or not isinstance(place, int | float) or not 0.0 <= place <= LARGEST:
        raise MrmError(f"{path}: coefficientOfRetroreflection is {place!r}, no number from 0 to {LARGEST:g}")
    sources, metadata = data.get("sources"), tree.get("metadata")
    name = metadata.get("name") if isinstance(metadata, dict) else None
    return XompAsset(
        name if isinstance(name, str) and name else path.stem,
        float(place),
        sources if isinstance(sources, str) else "",
        tree,
    )


def material_of(
    coefficient: float, geometry: Sequence[float], colour: str, like: str = "RA2"
) -> Retroreflector:
    """The sheet that has a coefficient in one geometry, and the width and falloff of a class's material.

    A coefficient that such a width cannot have without sending back more light than there is gets a narrower lobe.

    Args:
        coefficient: R_A in cd/(lx m²). geometry: observation and entrance angle in degrees.
        colour: of the class. like: a class of sheets.

    Raises:
        MrmError: no such class, colour or geometry; a coefficient that is not above 0, or more than any sheet has.
    """
    if not (math.isfinite(coefficient) and coefficient > 0.0):
        raise MrmError(f"a coefficient of {coefficient:g}: nothing comes back, and there is no lobe to make")
    if find_class(like).of(colour)[0].quantity != "R_A":
        raise MrmError(
            f"{find_class(like).name} is no class of sheets, whose coefficient this is: name one, such as RA2"
        )
    design = material_for(like, colour).bsdf
    back = np.asarray(design.f0, np.float64) / np.max(design.f0)
    alpha, x = float(np.asarray(design.alpha)), float(np.max(design.f0))

    def made(x: float) -> Retroreflector:
        return replace(design, alpha=alpha, f0=tuple((x * back).tolist()))

    def share(x: float) -> float:
        """The part of the coefficient that it has."""
        return float(luminance(retroreflection(made(x), *geometry))) / coefficient

    if share(0.0) >= 1.0:
        raise MrmError(f"a coefficient of {coefficient:g}: the {colour} film alone has more by day")
    most = 1.0
    while share(most) < 1.0:
        alpha *= 0.9
        if alpha < 2e-4:
            raise MrmError(
                f"a coefficient of {coefficient:g} at {geometry[0]:g}°: more than any {colour} sheet has there"
            )
    for _ in range(60):
        x = min(x / share(x), most)
    return made(x)


def asset_text(name: str, bsdf: Any, colour: str, title: str, asset: XompAsset | None = None) -> str:
    """The text of a .xomp file with the coefficient of a BSDF at 0.2, -4 degrees, which `sources` says.

    title: what the values are of, such as the name of a class.
    asset: one that is kept, but for the coefficient and its sources, and that has a name of its own.

    Raises:
        MrmError: the coefficient is more than the schema allows.
    """
    value = float(luminance(retroreflection(bsdf, *GEOMETRY)))
    if value > LARGEST:
        raise MrmError(
            f"R_A {value:g} at {GEOMETRY[0]:g}°, {GEOMETRY[1]:g}°: a .xomp file has at most {LARGEST:g}"
        )
    sources = (
        f"mrm-nodes: {title}; R_A at observation {GEOMETRY[0]:g} deg, entrance {GEOMETRY[1]:g} deg, "
        f"colour {colour}; illuminant A"
    )
    data = {"coefficientOfRetroreflection": float(f"{value:.6g}"), "sources": sources}
    if asset is not None:
        ours = _SAID.search(asset.sources) is not None
        before = asset.sources.partition(_BEFORE)[2] if ours else asset.sources
        if before:
            data["sources"] = f"{sources}{_BEFORE}{before}"
        properties = asset.tree["materialProperties"]
        kept = {**properties["retroreflectivityData"], **data}
        whole = {**asset.tree, "materialProperties": {**properties, "retroreflectivityData": kept}}
        return json.dumps(whole, indent=2) + "\n"
    tree = {
        "metadata": {
            "name": name,
            "uuid": str(uuid.uuid5(uuid.NAMESPACE_URL, f"mrm-nodes:{name}:{sources}")),
            "materialVersion": "1.0.0",
            "openMaterial3dVersion": "1.0.0",
            "copyrights": [],
            "license": "unspecified",
            "authors": [],
        },
        "materialProperties": {"retroreflectivityData": data},
    }
    return json.dumps(tree, indent=2) + "\n"
