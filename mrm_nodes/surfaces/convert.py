"""One entry for every way in which materials move over: by the endings of the two files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from mrm_nodes.errors import MrmError
from mrm_nodes.files import ABANDONED, clear
from mrm_nodes.shipped import material_file
from mrm_nodes.surfaces.gltf import gltf_to_materialx, materialx_to_gltf
from mrm_nodes.surfaces.rewrite import retrofit_file
from mrm_nodes.surfaces.weights import Weight

_GLTF = (".gltf", ".glb")


def convert(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    weights: Mapping[str, Weight] | None = None,
    allow_external: bool = False,
) -> list[str]:
    """Write `source` with surfaces of ours to `target`, and return the names of what changed.

    .mtlx to .mtlx is `retrofit_file`, .gltf or .glb to .mtlx `gltf_to_materialx`, and back `materialx_to_gltf`.
    source: a file, or a finished material by its name.

    Raises:
        MrmError: as theirs; also two glTF files, or weights on the way back to glTF.
    """
    source, target = material_file(source), Path(target)
    from_gltf, to_gltf = (path.suffix.lower() in _GLTF for path in (source, target))
    if from_gltf and to_gltf:
        raise MrmError(f"{target}: both files are glTF; name one of them .mtlx")
    clear(target.parent, ABANDONED)
    if from_gltf:
        return gltf_to_materialx(source, target, weights, allow_external)
    if to_gltf:
        if weights:
            raise MrmError(f"{source}: weights are set in the document, not on the way to glTF")
        return materialx_to_gltf(source, target, allow_external)
    return retrofit_file(source, target, weights, allow_external)
