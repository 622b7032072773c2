"""A disk that is full at the n-th change, whoever makes it: Python, OpenImageIO, a worker process.

`disk_faults.c` is preloaded into a process that imports the package once, and forks for each command: so hundreds of
commands can be tried, each with the disk full at another of its changes.
"""

from __future__ import annotations

import functools
import json
import mmap
import os
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

SOURCE = Path(__file__).with_name("disk_faults.c")


@functools.cache
def library() -> Path:
    """The library to preload, compiled once a process; without a compiler the test is skipped, or fails where one is
    required (MRM_REQUIRE_COMPILERS has `cc`)."""
    compiler = shutil.which("cc")
    if compiler is None or not sys.platform.startswith("linux"):
        is_required = "cc" in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(",")
        (pytest.fail if is_required else pytest.skip)("a disk that fails needs a C compiler (cc) and Linux")
    folder = Path(tempfile.mkdtemp(prefix="mrm-nodes-faults-"))
    target = folder / "disk_faults.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", target, SOURCE, "-ldl"], check=True)
    return target


@dataclass(frozen=True)
class Ended:
    """How a command ended, and how many changes it had made to the disk."""

    status: int
    out: str
    err: str
    changes: int


class Machine:
    """Runs commands on a disk that can be full; `root` is its folder."""

    def __init__(self, root: Path, log: Path | None = None, **environment: str) -> None:
        self.root = root.resolve()
        self.root.mkdir(exist_ok=True)
        beside = self.root.parent
        state = beside / f"{self.root.name}.state"
        state.write_bytes(bytes(24))
        with state.open("r+b") as file:
            self._state = mmap.mmap(file.fileno(), 24)
        variables = {
            "LD_PRELOAD": os.fspath(library()),
            "MRM_FAULT_ROOT": os.fspath(self.root),
            "MRM_FAULT_STATE": os.fspath(state),
        }
        if log is not None:
            log.touch()
            variables["MRM_FAULT_LOG"] = os.fspath(log)
        self._server = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **variables, **environment},
            text=True,
        )

    def run(
        self,
        arguments: Sequence[object],
        full_at: int = 0,
        stays: bool = True,
        how: str = "cli",
        folder: Path | None = None,
    ) -> Ended:
        """Run a command; its disk is full at a change, the first being 1, and never at 0.

        stays: whether it is full from then on; else there is room again at once.
        how: `cli` or `pytest`, or a function of this file's users, as `module:name`.
        folder: where it runs, by default in the root.
        """
        self._state[:] = struct.pack("3q", 0, full_at, stays)
        order = {
            "arguments": [str(each) for each in arguments],
            "how": how,
            "folder": str(folder or self.root),
        }
        assert self._server.stdin is not None and self._server.stdout is not None
        self._server.stdin.write(json.dumps(order) + "\n")
        self._server.stdin.flush()
        told = json.loads(self._server.stdout.readline())
        (changes,) = struct.unpack("q", self._state[:8])
        self._state[:] = bytes(24)
        return Ended(told["status"], told["out"], told["err"], changes)

    def close(self) -> None:
        assert self._server.stdin is not None
        self._server.stdin.close()
        self._server.wait(30)


@contextmanager
def machine(root: Path, log: Path | None = None, **environment: str) -> Iterator[Machine]:
    """A machine for as long as the block lasts."""
    it = Machine(root, log, **environment)
    try:
        yield it
    finally:
        it.close()


def contents(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by its relative name."""
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file() and not file.is_symlink()
    }


def without_time(report: Path) -> tuple[Mapping[str, Any], list[Any]]:
    """What a report.json says, but for when, how fast, and whether it was in one go."""
    told = json.loads(report.read_text("utf-8"))
    environment = {
        name: value
        for name, value in told["environment"].items()
        if name not in ("date", "backend_seconds", "resumed", "cached", "jobs")
    }
    for case in told["cases"]:
        case.pop("seconds")
    told["summary"].pop("seconds")
    ordered = sorted(told["cases"], key=lambda case: (case["backend"], case["name"]))
    return {**environment, **told["summary"]}, ordered


def _call(order: Mapping[str, Any]) -> int:
    """What a forked process does."""
    os.chdir(order["folder"])
    if order["how"] == "cli":
        from mrm_nodes.cli import main

        main(order["arguments"])
    if order["how"] == "pytest":
        return int(pytest.main(order["arguments"]))
    module, _, name = order["how"].partition(":")
    return int(getattr(__import__(module), name)(*order["arguments"]) or 0)


def _serve() -> None:
    """Read an order a line, fork a process for each, and tell how it ended."""
    import MaterialX  # noqa: F401
    import OpenImageIO  # noqa: F401

    import mrm_nodes
    import mrm_nodes.regression.suites.selection
    import mrm_nodes.regression.testing
    import mrm_nodes.surfaces.convert

    # What is read once a process is read here once for all of them.
    mrm_nodes.load_library()
    for line in sys.stdin:
        order = json.loads(line)
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            child = os.fork()
            if not child:
                os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
                os.dup2(out.fileno(), 1)
                os.dup2(err.fileno(), 2)
                status = 99
                try:
                    status = _call(order)
                except SystemExit as ended:
                    status = int(ended.code or 0)
                except BaseException:
                    import traceback

                    traceback.print_exc()
                finally:
                    sys.stdout.flush()
                    sys.stderr.flush()
                    os._exit(status)
            _, ended = os.waitpid(child, 0)
            told = {"status": os.waitstatus_to_exitcode(ended)}
            for name, file in (("out", out), ("err", err)):
                file.seek(0)
                told[name] = file.read().decode(errors="replace")
        sys.stdout.write(json.dumps(told) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    _serve()
