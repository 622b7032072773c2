"""Which rules a MaterialX `libraries` folder follows, read from its own files: a version number says less."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mrm_nodes.errors import MrmError

#: MaterialX 1.39.3 introduced the file that every node of ours includes.
CLOSURE_TYPE = Path("pbrlib/genglsl/lib/mx_closure_type.glsl")
_MICROFACET = Path("pbrlib/genglsl/lib/mx_microfacet_specular.glsl")
_DEFINITIONS = Path("pbrlib/pbrlib_defs.mtlx")
_MATH = Path("stdlib/genglsl/lib/mx_math.glsl")

#: Rules of energy compensation, by the names that the evaluator has for them.
Compensation = Literal["materialx-1.39.5", "materialx-1.39.6"]

#: Methods of image light, by MaterialX's names, that our nodes have code of their own for.
Environment = Literal["any", "fis", "prefilter"]


#: What to do about a MaterialX that is too old.
UPGRADE = "install 1.39.3 or newer: pip install 'MaterialX>=1.39.3'"


@dataclass(frozen=True)
class Host:
    """What our nodes must know of the `libraries` folder that they are used with."""

    compensation: Compensation = "materialx-1.39.5"
    """Which Fresnel reflectance tints the energy compensation of its own microfacet nodes."""
    has_retroreflective: bool = True
    """Whether its own microfacet nodes have the switch `retroreflective` (from 1.39.5)."""
    forward_targets: frozenset[str] = frozenset({"genosl"})
    """Targets without GLSL that drop the switch: they render the forward lobe only."""
    has_matrix_function: bool = True
    """Whether its GLSL multiplies a matrix with a vector by a function of its own (from 1.39.5)."""
    prefilters_by_albedo: bool = True
    """Whether its prefiltered image light is scaled by the directional albedo (from 1.39.5)."""
    environment: Environment = "any"
    """How it evaluates image light, where that is known: our nodes then need one loop, not two calls of its own."""


def read_host(libraries: Path) -> Host:
    """Read the rules of a `libraries` folder.

    Raises:
        MrmError: it is no such folder, or older than our nodes can live with.
    """
    if not libraries.is_dir():
        raise MrmError(f"{libraries}: no such folder; name a MaterialX `libraries` folder")
    if not (libraries / "pbrlib" / "genglsl").is_dir():
        raise MrmError(f"{libraries}: not a MaterialX `libraries` folder (no pbrlib/genglsl in it)")
    if not (libraries / CLOSURE_TYPE).is_file():
        raise MrmError(f"{libraries}: this MaterialX is too old (no {CLOSURE_TYPE}); {UPGRADE}")
    microfacet = (libraries / _MICROFACET).read_text(encoding="utf-8")
    by_average = re.search(r"\bmx_ggx_energy_compensation\s*\([^)]*\bFresnelData\b", microfacet)
    has_retroreflective = 'name="retroreflective"' in (libraries / _DEFINITIONS).read_text(encoding="utf-8")
    return Host(
        compensation="materialx-1.39.6" if by_average else "materialx-1.39.5",
        has_retroreflective=has_retroreflective,
        forward_targets=frozenset(
            target
            for target in ("genosl", "genmdl")
            if not has_retroreflective or not _passes_on_retroreflective(libraries, target)
        ),
        prefilters_by_albedo=re.search(r"\bmx_ggx_dir_albedo\s*\([^)]*\bFresnelData\b", microfacet)
        is not None,
        has_matrix_function="mx_matrix_mul" in (libraries / _MATH).read_text(encoding="utf-8"),
    )


def _passes_on_retroreflective(libraries: Path, target: str) -> bool:
    """Whether a target's own conductor node hands `retroreflective` to the renderer."""
    bindings = libraries / "pbrlib" / target / f"pbrlib_{target}_impl.mtlx"
    text = bindings.read_text(encoding="utf-8") if bindings.is_file() else ""
    binding = re.search(rf'<implementation name="IM_conductor_bsdf_{target}"[^>]*>', text)
    return binding is not None and "{{retroreflective}}" in binding[0]
