"""Photometry of retroreflectors: the coefficients of the standards, of anything that scatters.

This is help with a design, no certification: for that, a laboratory measures the sheet by the standard itself.
"""

from mrm_nodes.photometry.classes import Requirement, RetroClass, Row, check, classes, find_class
from mrm_nodes.photometry.coefficients import (
    diffuse_luminance,
    half_width,
    luminance_coefficient,
    retroreflection,
    total_retroreflectance,
)
from mrm_nodes.photometry.colour import luminance, night_chromaticity
from mrm_nodes.photometry.design import Design, material_for
from mrm_nodes.photometry.geometry import directions
from mrm_nodes.photometry.sheet import Sheet, SheetPoints, read_sheet

__all__ = [
    "Design",
    "Requirement",
    "RetroClass",
    "Row",
    "Sheet",
    "SheetPoints",
    "check",
    "classes",
    "diffuse_luminance",
    "directions",
    "find_class",
    "half_width",
    "luminance",
    "luminance_coefficient",
    "material_for",
    "night_chromaticity",
    "read_sheet",
    "retroreflection",
    "total_retroreflectance",
]
