"""What a result depends on, by content: the task, its files, our own source, the versions and the driver."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import os
import platform
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mrm_nodes import library
from mrm_nodes.regression.verdict.outcome import Task

MISSING = "missing"
"""In place of a file's digest, where there is no file to read."""

VERSIONED = ("MaterialX", "moderngl", "numba", "numpy", "OpenImageIO", "flip-evaluator")


def digest(*parts: bytes) -> str:
    """32 hexadecimal digits that tell contents apart."""
    state = hashlib.blake2b(digest_size=16)
    for part in parts:
        # Each part's length keeps ("ab", "c") and ("a", "bc") apart.
        state.update(len(part).to_bytes(8, "little"))
        state.update(part)
    return state.hexdigest()


def digest_of(value: Any) -> str:
    """The digest of a value that JSON can hold, whatever the order of its keys."""
    return digest(json.dumps(value, sort_keys=True, default=repr).encode())


class Inputs:
    """Files by content, as they were when they were first asked for: a run fixes them at its start."""

    def __init__(self) -> None:
        self._known: dict[Path, tuple[tuple[int, ...], str]] = {}

    def digest(self, path: Path) -> str:
        """The digest of a file's contents when it was first asked for."""
        if path not in self._known:
            self._known[path] = (_signature(path), _file_digest(path))
        return self._known[path][1]

    def changed(self, paths: Iterable[Path]) -> list[Path]:
        """Those of the files whose contents are no longer what they were."""
        return [path for path in paths if self._has_changed(path)]

    def _has_changed(self, path: Path) -> bool:
        signature, contents = self._known[path]
        now = _signature(path)
        if now == signature:
            return False
        if _file_digest(path) != contents:
            return True
        self._known[path] = (now, contents)
        return False


def _signature(path: Path) -> tuple[int, ...]:
    """What changes whenever a file is written to, so that contents are not read again for nothing."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return (found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns)


def _file_digest(path: Path) -> str:
    try:
        return digest(path.read_bytes())
    except OSError:
        return MISSING


@functools.cache
def source_digest() -> str:
    """The digest of this package's own source, the node library and its GLSL included."""
    package = Path(__file__).parents[2]
    nodes = library.root_path()
    folders = {package: "*.py", nodes / "mtlx": "*", nodes / "glsl": "*"}
    parts = []
    for folder, pattern in folders.items():
        for file in sorted(folder.rglob(pattern)):
            if file.is_file():
                parts += [str(file.relative_to(folder)).encode(), file.read_bytes()]
    return digest(*parts)


@functools.cache
def versions() -> dict[str, str]:
    """Versions of this package, of Python, and of the packages that images and references are made with."""
    found = {name: importlib.metadata.version(name) for name in ("mrm-nodes", *VERSIONED)}
    return {"mrm-nodes": found.pop("mrm-nodes"), "Python": platform.python_version(), **found}


def conditions(driver: str) -> dict[str, str]:
    """All that results depend on besides the task, by name. Equal conditions give equal results.

    driver: the name of the OpenGL that renders.
    """
    # MaterialX finds more source through this variable.
    libraries = os.environ.get("MATERIALX_SEARCH_PATH", "")
    return {
        "OpenGL": driver,
        "machine": platform.machine(),
        "source": source_digest(),
        "MATERIALX_SEARCH_PATH": libraries,
        **versions(),
    }


def key(task: Task, backend: str, inputs: Inputs, around: str, setup: Mapping[str, Any] | None = None) -> str:
    """The digest of everything that the result of a task on a backend depends on.

    Args:
        around: the digest of the `conditions`.
        setup: what `task.describe()` gives, where that is known.
    """
    return digest_of(
        {
            "name": task.name,
            "kind": task.kind,
            "node": task.node,
            "target": task.target,
            "setup": task.describe() if setup is None else setup,
            "files": by_name({path: inputs.digest(path) for path in task.files()}, home_of(task)),
            "backend": backend,
            "conditions": around,
        }
    )


def root_of(task: Task) -> Path:
    """The folder that the names of a task's files are relative to; `moved` puts another in its place."""
    root: Path = getattr(task, "root", Path("/"))
    return root


def home_of(task: Any) -> Path:
    """The folder that a task's files move with: the suite's own."""
    home: str = getattr(task, "home", ".")
    return Path(os.path.normpath(root_of(task) / home))


def by_name(digests: Mapping[Path, str], home: Path) -> dict[str, Any]:
    """Files' digests by names that are the same wherever the suite lies; what is outside of its folder has none."""
    found: dict[str, Any] = {}
    outside = []
    for path, each in digests.items():
        name = os.path.relpath(path, home)
        if Path(name).parts[:1] == ("..",):
            outside.append(each)
        else:
            found[name] = each
    return {**found, "..": sorted(outside)} if outside else found
