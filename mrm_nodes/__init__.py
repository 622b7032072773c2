"""The Minimal Retroreflective Microfacet model for MaterialX: nodes, evaluator, rendering, regression."""

from __future__ import annotations

import importlib
from typing import Any

#: Public names and the module of each; loaded when first used, so that `import mrm_nodes` costs nothing.
_PUBLIC = {
    "library_path": "library",
    "load_library": "library",
    "search_path": "library",
    "Shader": "shadergen",
    "generate_shader": "shadergen",
    "supported_targets": "shadergen",
    "retrofit": "surfaces",
    "MrmError": "errors",
    "MrmWarning": "errors",
}

__all__ = [
    "MrmError",
    "MrmWarning",
    "Shader",
    "generate_shader",
    "library_path",
    "load_library",
    "measured",
    "photometry",
    "reference",
    "regression",
    "render",
    "retrofit",
    "search_path",
    "supported_targets",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"mrm_nodes.{_PUBLIC[name]}"), name)
    if name in ("measured", "photometry", "reference", "regression", "render"):
        return importlib.import_module(f"mrm_nodes.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
