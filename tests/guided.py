"""Fuzzing led by coverage: atheris looks for contents of files that our readers end on as they may not.

    python tests/guided.py --seconds 600 [--corpus DIR] [--only NAME]

An exception other than MrmError is noted, and the search goes on. A crash, a hang or too much memory ends the process
that searches, and another one goes on from the same corpus. Needs the `fuzz` extra.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fuzzing

LONGEST = 1 << 15
"""Bytes of a file."""
SECONDS, MEGABYTES = 60, 3072
"""What a process may take for one file, and at all: none takes a tenth of it."""
_STATISTICS = "statistics.json"


@dataclass(frozen=True)
class Result:
    """What came of a search.

    faults: the last line of each, by the name of the file in the folder that shows it.
    executions: by reader.
    slowest: seconds, by reader.
    edges: how much of the readers' code was reached, in atheris's own count.
    """

    faults: Mapping[str, str]
    executions: Mapping[str, int]
    slowest: Mapping[str, float]
    edges: int


def search(folder: Path, seconds: float, names: list[str], module: str = "fuzz_readers") -> Result:
    """Feed readers with what mutations and coverage come to, for so many seconds.

    folder: takes the corpus and what shows a fault.
    names: the readers.
    module: has them, as READERS.
    """
    faults = folder / "faults"
    faults.mkdir(parents=True, exist_ok=True)
    until = time.monotonic() + seconds
    done: Counter[str] = Counter()
    slowest: dict[str, float] = {}
    edges = number = 0
    while (left := until - time.monotonic()) > 1 and number < 100:
        number += 1
        said = folder / f"said-{number}.txt"
        command = [
            sys.executable,
            __file__,
            "--child",
            str(folder),
            "--seconds",
            str(int(left)),
            "--module",
            module,
        ]
        with said.open("w") as stream:
            process = subprocess.run([*command, "--only", *names], stderr=stream, stdout=stream)
        text = said.read_text(errors="replace")
        edges = max([edges, *(int(each) for each in re.findall(r"\bcov: (\d+)", text))])
        try:
            told = json.loads((folder / _STATISTICS).read_text())
        except (OSError, ValueError):
            told = {"executions": {}, "slowest": {}}
        (folder / _STATISTICS).unlink(missing_ok=True)
        done.update(told["executions"])
        for name, each in told["slowest"].items():
            slowest[name] = max(each, slowest.get(name, 0.0))
        if process.returncode:
            if not done and "ERROR: libFuzzer" not in text:
                raise RuntimeError(f"the search does not start: {text[-2000:]}")
            (faults / f"ended-{number}.txt").write_text(text[-20_000:])
    found = {}
    for file in sorted(faults.glob("*.txt")):
        lines = [line for line in file.read_text(errors="replace").splitlines() if line.strip()]
        ended = [line for line in lines if "ERROR: libFuzzer" in line]
        found[file.stem] = (ended or lines or [""])[-1][:300]
    return Result(found, done, slowest, edges)


def _child(folder: Path, seconds: int, names: list[str], module: str) -> None:
    """Search until the time is over; what is found lies in the folder."""
    import atheris

    with atheris.instrument_imports(
        include=["mrm_nodes"], exclude=["mrm_nodes.reference", "mrm_nodes.render.context"]
    ):
        readers = __import__(module).READERS
    from mrm_nodes.errors import MrmError

    warnings.simplefilter("ignore")
    corpus = folder / "corpus"
    corpus.mkdir(exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix="guided-"))
    chosen = [readers[name] for name in names]
    for number, (name, reader) in enumerate(zip(names, chosen, strict=True)):
        (work / str(number)).mkdir()
        reader.prepare(work / str(number))
        for place, seed in enumerate(reader.seeds):
            (corpus / f"seed-{name.replace(' ', '-')}-{place}").write_bytes(bytes([number]) + seed)
    executions: Counter[str] = Counter()
    slowest: dict[str, float] = {}

    def one(data: bytes) -> None:
        if not data or data[0] >= len(names):
            return
        name, reader = names[data[0]], chosen[data[0]]
        began = time.perf_counter()
        try:
            reader.read(data[1:], work / str(data[0]))
        except MrmError:
            pass
        except Exception as error:
            _note(folder / "faults", name, error, data[1:])
        took = time.perf_counter() - began
        if took > slowest.get(name, 0.0):
            slowest[name] = took
            if took > 1.0:
                (folder / f"slow-{name.replace(' ', '-')}").write_bytes(data[1:])
        executions[name] += 1
        if executions.total() % 200 == 0:
            text = json.dumps({"executions": executions, "slowest": slowest})
            (folder / _STATISTICS).write_text(text)

    def mutate(data: bytes, most: int, seed: int) -> bytes:
        if len(data) < 2 or data[0] >= len(names):
            data = bytes([seed % len(names)]) + chosen[seed % len(names)].seeds[0]
        rng = random.Random(seed)
        contents = mutated(data[1:], chosen[data[0]].form, rng, lambda each: atheris.Mutate(each, most - 1))
        return data[:1] + contents[: most - 1]

    arguments = [
        sys.argv[0],
        f"-max_total_time={seconds}",
        f"-timeout={SECONDS}",
        f"-rss_limit_mb={MEGABYTES}",
        f"-max_len={LONGEST}",
        f"-artifact_prefix={folder}/faults/",
        "-len_control=0",
        "-print_final_stats=1",
        str(corpus),
    ]
    atheris.Setup(arguments, one, custom_mutator=mutate)
    try:
        atheris.Fuzz()
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _note(faults: Path, name: str, error: Exception, data: bytes) -> None:
    """Keep what shows a fault, once for each place that raises."""
    frames = [each for each in traceback.extract_tb(error.__traceback__) if "mrm_nodes" in each.filename]
    at = frames[-1] if frames else traceback.extract_tb(error.__traceback__)[-1]
    stem = f"{name.replace(' ', '-')}-{type(error).__name__}-{Path(at.filename).stem}-{at.lineno}"
    if not (faults / f"{stem}.txt").exists():
        (faults / f"{stem}.bin").write_bytes(data)
        (faults / f"{stem}.txt").write_text("".join(traceback.format_exception(error)))


def mutated(content: bytes, form: str, rng: random.Random, bytewise: Callable[[bytes], bytes]) -> bytes:
    """A file's contents changed as its form asks for, or byte by byte."""
    chance = rng.random()
    if form == "json" and chance < 0.5:
        return _other_tree(content, rng)
    if form != "bytes" and chance < 0.7:
        return bytes(rng.choice(fuzzing.TEXT)(content, rng))
    return bytes(bytewise(content))


_NUMBERS: tuple[Any, ...] = (True, 0, -1, 3, 1e308, float("nan"), float("inf"), 1 << 70)
_VALUES: tuple[Any, ...] = (*_NUMBERS, None, "", "x", "../x", "a.txt", [], {}, [0, 0])


def _other_tree(content: bytes, rng: random.Random) -> bytes:
    """Something else in place of a value of one line's JSON: another of its values, none, or one of another kind."""
    lines = content.split(b"\n")
    place = rng.randrange(len(lines))
    try:
        tree = json.loads(lines[place])
        spots = list(_spots(tree))
    except (ValueError, RecursionError):
        return content
    if not spots:
        return content
    holder, key = rng.choice(spots)
    match rng.randrange(4):
        case 0:
            del holder[key]
        case 1:
            other, its = rng.choice(spots)
            # As text, since a value may not hold itself.
            holder[key] = json.loads(json.dumps(other.get(its) if isinstance(other, dict) else other[its]))
        case 2:
            holder[key] = [holder[key]]
        case 3:
            holder[key] = rng.choice(_VALUES)
    lines[place] = json.dumps(tree).encode()
    return b"\n".join(lines)


def _spots(tree: Any) -> Any:
    """Each place of a value: what holds it, and its key."""
    keys = tree.keys() if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    for key in keys:
        yield tree, key
        yield from _spots(tree[key])


def main() -> int:
    """Search, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--corpus", type=Path, help="a folder to keep the corpus and the faults in")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="readers")
    parser.add_argument("--module", default="fuzz_readers", help=argparse.SUPPRESS)
    parser.add_argument("--child", type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        _child(given.child, given.seconds, given.only, given.module)
        return 0
    names = given.only or list(__import__(given.module).READERS)
    result = search(
        given.corpus or Path(tempfile.mkdtemp(prefix="guided-")), given.seconds, names, given.module
    )
    for name in names:
        print(
            f"{name:<14} {result.executions.get(name, 0):>9} files, {result.slowest.get(name, 0.0):.2f} s at most"
        )
    print(f"{sum(result.executions.values())} files, {result.edges} edges, {len(result.faults)} faults")
    for name, what in result.faults.items():
        print(f"{name}: {what}")
    return 1 if result.faults else 0


if __name__ == "__main__":
    sys.exit(main())
