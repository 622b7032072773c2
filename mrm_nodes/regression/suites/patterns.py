"""The files that a suite names by a pattern."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator
from pathlib import Path, PurePath


def files_matching(pattern: str, folder: Path) -> list[str]:
    """The paths that match a pattern with * ? [ ] and **, relative to a folder, sorted; a folder is looked into once.

    That is where links make a circle, or several ways to one place: the place's own path counts, then the first.

    Raises:
        ValueError, OSError, re.error: it is no pattern.
    """
    return sorted(_matching(PurePath(pattern).parts, folder, set()))


def _matching(parts: tuple[str, ...], folder: Path, seen: set[tuple[str, tuple[str, ...]]]) -> Iterator[str]:
    if "**" not in parts:
        yield from glob.glob(str(PurePath(*parts)), root_dir=folder)  # noqa: PTH207
        return
    place = parts.index("**")
    above, below = parts[:place], parts[place + 1 :] or ("*",)
    bases = glob.glob(str(PurePath(*above)), root_dir=folder) if above else [""]  # noqa: PTH207
    for base in sorted(bases):
        for each in _folders_below(folder / base, seen, below):
            within = PurePath(glob.escape(str(PurePath(base, os.path.relpath(each, folder / base))))).parts
            yield from _matching((*within, *below), folder, seen)


def _folders_below(
    base: Path, seen: set[tuple[str, tuple[str, ...]]], what: tuple[str, ...]
) -> Iterator[str]:
    """A folder and all below it that were not looked into for the same; links after all others."""
    waiting = [str(base)]
    while waiting:
        start = waiting.pop(0)
        for path, names, _ in os.walk(start):
            key = (os.path.realpath(path), what)
            if key in seen:
                names.clear()
                continue
            seen.add(key)
            names[:] = sorted(name for name in names if not name.startswith("."))
            waiting += [full for name in names if os.path.islink(full := os.path.join(path, name))]  # noqa: PTH114, PTH118
            yield path
