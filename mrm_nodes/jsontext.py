"""JSON of files that others wrote: limited in depth, so that whoever goes through it needs no limit of his own."""

from __future__ import annotations

import json
from typing import Any

DEEPEST = 100
"""Objects and arrays within each other."""


def loads(text: str | bytes) -> Any:
    """What `json.loads` returns.

    Raises:
        ValueError: no JSON, or more than `DEEPEST` objects and arrays within each other.
    """
    try:
        tree = json.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    level = [tree]
    for _ in range(DEEPEST + 1):
        level = [
            inner
            for outer in level
            if isinstance(outer, dict | list)
            for inner in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(inner, dict | list)
        ]
        if not level:
            return tree
    raise ValueError(_TOO_DEEP)


_TOO_DEEP = f"more than {DEEPEST} objects and arrays within each other"
