"""Image regression: suites of materials, run here or on a cluster, and compared with physics or with baselines."""

from __future__ import annotations

import importlib
from typing import Any

#: Public names and the module of each; loaded when first used: a worker needs few of them.
_PUBLIC = {
    "Cache": "run.cache",
    "Cluster": "run.cluster",
    "MaterialCase": "cases.material_case",
    "Outcome": "verdict.outcome",
    "Tolerance": "verdict.tolerance",
    "dask_cluster": "run.cluster",
    "merge": "run.runner",
    "run_suite": "run.runner",
    "suite": "suites.selection",
}

__all__ = [
    "Cache",
    "Cluster",
    "MaterialCase",
    "Outcome",
    "Tolerance",
    "dask_cluster",
    "merge",
    "run_suite",
    "suite",
]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(f"mrm_nodes.regression.{_PUBLIC[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
