"""Gives a shader's uniforms and variables names that do not depend on its document.

A generated shader names them by the document's nodes, and what is compiled is kept by its text. With names in the
order of their appearance instead, materials written from one template, each with names of its own, have one text.
"""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

from mrm_nodes.render.gbuffer import MATERIALX_MAIN, Stages

_WORD = re.compile(r"[A-Za-z_]\w*")
#: A name that stands for itself, not for a member of a structure.
_OWN_WORD = re.compile(r"(?<![.\w])[A-Za-z_]\w*")
#: MaterialX's own begin with `u_`: the renderer sets them by name.
_UNIFORM = re.compile(r"^uniform \w+ (?!u_)(\w+);", re.MULTILINE)
_VARIABLE = re.compile(r"^\s+(?:const )?(?!return\b)[A-Za-z]\w* ([A-Za-z_]\w*)(?: =|;)", re.MULTILINE)
_COMMON = re.compile(r"mrm_name_\d+")


@functools.lru_cache(maxsize=32)
def common_names(stages: Stages) -> tuple[Stages, Mapping[str, str]]:
    """Return the stages with names of the pixel stage replaced, and the document's name of each that stands there.

    Lines stay where they are. A name that means something outside of `main` as well, such as one that is a function's
    too, is left as it is.
    """
    found = MATERIALX_MAIN.search(stages.pixel)
    if found is None or _COMMON.search(stages.pixel):
        return stages, {}
    outside, inside = stages.pixel[: found.start()], stages.pixel[found.start() :]
    elsewhere = Counter(_WORD.findall(outside)) + Counter(_WORD.findall(stages.vertex))
    uniforms = [name for name in _UNIFORM.findall(outside) if elsewhere[name] == 1]
    variables = [name for name in _VARIABLE.findall(inside) if not elsewhere[name]]
    common = {name: f"mrm_name_{index}" for index, name in enumerate(dict.fromkeys(uniforms + variables))}

    def renamed(word: re.Match[str]) -> str:
        return common.get(word[0], word[0])

    outside = _UNIFORM.sub(lambda line: _OWN_WORD.sub(renamed, line[0]), outside)
    inside = _OWN_WORD.sub(renamed, inside)
    return replace(stages, pixel=outside + inside), {own: name for name, own in common.items()}


def documents_names(text: str, names: Mapping[str, str]) -> str:
    """Return a compiler's message, or a uniform's name with its members, in the document's names."""
    return _COMMON.sub(lambda word: names.get(word[0], word[0]), text)
