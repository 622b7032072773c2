"""What a run consists of: the suites by name, and the choice of some of their tasks."""

from __future__ import annotations

import difflib
import fnmatch
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import MapLight, default_suite, more_image_lights
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.cases.material_case import Layering, MaterialCase, Method, read
from mrm_nodes.regression.cases.textured import (
    more_surrounded_cases,
    more_textured_cases,
    surrounded_cases,
    textured_cases,
    transmitting_cases,
)
from mrm_nodes.regression.truth.closure import closure_of, has_layers
from mrm_nodes.regression.truth.material import NODES, PAIRS
from mrm_nodes.regression.verdict.outcome import Task

AnyTask = TypeVar("AnyTask", bound=Task)

BUILT_IN = ("default", "full")
CONFIGURATIONS = 1_000_000
"""Random configurations of each node in the default suite."""
_PER_TRANSMITTING = 200
"""Times fewer are those of a cloud in image light: each is a sum over samples."""


def clouds(configurations: int = CONFIGURATIONS) -> list[Cloud]:
    """The clouds of every node, its configurations spread over the pairs of distribution and masking."""
    if configurations <= 0:
        return []
    each = -(-configurations // len(PAIRS))
    return [Cloud(node, *pair, configurations=each) for node in NODES for pair in PAIRS]


def transmitting_clouds(configurations: int = CONFIGURATIONS, every: bool = False) -> list[Cloud]:
    """The clouds of the nodes that transmit, in image light; one of each node and method of the host's.

    every: every pair of distribution and masking, and every mode.
    """
    each = configurations // _PER_TRANSMITTING
    if each <= 0:
        return []
    found = []
    methods: tuple[tuple[Method, str], ...] = (("fis", "T"), ("prefilter", "RT"))
    for node, (method, usual) in itertools.product(NODES[1:], methods):
        for pair, mode in itertools.product(PAIRS, ("T", "RT")):
            if every != (pair == PAIRS[0] and mode == usual):
                light = MapLight("sky", rotation=20.0, samples=8, method=method)
                found.append(Cloud(node, *pair, each, environment=light, scatter_mode=mode))
    return found


def suite(
    name: str = "default",
    configurations: int = CONFIGURATIONS,
    allow_external: bool = False,
    layering: Layering | None = None,
) -> list[Task]:
    """The tasks of a suite, the longest first.

    Args:
        name: `default`, `full` (more of it), a suite's TOML file, or a folder of materials.
        configurations: of each node, in the default suite.
        allow_external: whether a material may read files outside of its folder and the node libraries.
        layering: `exact` to be told what MaterialX's rule costs each case that has layers; None: as the suite says.

    Raises:
        MrmError: no such suite, or one with faults.
    """
    if name in BUILT_IN:
        more: list[Task] = []
        if name == "full":
            more += [*more_textured_cases(), *more_surrounded_cases(), *transmitting_cases()]
            more += [*transmitting_clouds(configurations, every=True), *more_image_lights()]
        tasks: list[Task] = [
            *clouds(configurations),
            *transmitting_clouds(configurations),
            *more,
            *textured_cases(),
            *surrounded_cases(),
            *default_suite(),
        ]
        return [_with_layering(task, layering or "materialx") for task in tasks]
    path = Path(name)
    if not path.is_dir() and path.suffix != ".toml":
        near = difflib.get_close_matches(name[:100], BUILT_IN)
        known = "it is `default`, `full`, a .toml file, or a folder of .mtlx files"
        raise MrmError(f"unknown suite {name}: {f'did you mean {near[0]}?' if near else known}")
    from mrm_nodes.regression.suites.suitefile import load

    return list(load(path, allow_external, layering).cases)


def _with_layering(task: Task, layering: Layering) -> Task:
    """A task of our own that is told what its layers cost, where it has any."""
    if layering == "materialx" or not isinstance(task, MaterialCase):
        return task
    has_any = has_layers(closure_of(read(task), task.element).tree)
    return replace(task, layering=layering) if has_any else task


def choose(tasks: Sequence[AnyTask], expression: str | None) -> list[AnyTask]:
    """The tasks whose name matches: a pattern with * ? [ ], or a part of the name.

    Raises:
        MrmError: none matches.
    """
    if expression is None:
        return list(tasks)
    pattern = expression if any(c in expression for c in "*?[") else f"*{expression}*"
    chosen = [task for task in tasks if fnmatch.fnmatchcase(task.name, pattern)]
    if not chosen:
        examples = ", ".join(task.name for task in tasks[:: max(1, len(tasks) // 4)][:4])
        raise MrmError(f"no case matches {expression}; names are like {examples}")
    return chosen
