"""No contents of a file make one of our readers end in another way than with MrmError, or not at all.

MRM_FUZZ_SECONDS says for how long coverage leads the search; without it each reader takes some mutations as they come.
"""

from __future__ import annotations

import json
import os
import random
import warnings
from pathlib import Path

import fuzz_readers
import fuzzing
import guided
import pytest
from fuzz_readers import READERS

from mrm_nodes.errors import MrmError

SECONDS = float(os.environ.get("MRM_FUZZ_SECONDS", "0"))
MUTATIONS = 30


def read(name: str, contents: bytes, folder: Path) -> str:
    """What a reader says to a file; nothing where it takes it. Any other exception is the test's."""
    READERS[name].prepare(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            READERS[name].read(contents, folder)
        except MrmError as error:
            return str(error)
    return ""


@pytest.mark.parametrize("name", READERS)
def test_a_reader_takes_its_seeds_and_their_mutations(name, tmp_path):
    reader, rng = READERS[name], random.Random(name)
    taken = [read(name, seed, tmp_path) for seed in reader.seeds]
    # A material that is of our nodes already is none to retrofit, an output none for the evaluator.
    assert any(not each or "no such image" in each for each in taken), taken
    for _ in range(MUTATIONS):
        changed = rng.choice(reader.seeds)
        for _ in range(rng.choice((1, 2, 4))):
            changed = guided.mutated(
                changed, reader.form, rng, lambda each: rng.choice(fuzzing.BYTES)(each, rng)
            )
        read(name, changed, tmp_path)


def deep(count: int) -> bytes:
    return b'{"asset": {"version": "2.0"}, "extras": ' + b"[" * count + b"]" * count + b"}"


def with_record(**others: object) -> bytes:
    """A shard whose journal and report are sound but for some values of its record."""
    header, line, *rest = READERS["shard"].seeds[0].split(b"\n")
    told = json.loads(line)
    told["outcome"] |= others
    return b"\n".join([header, json.dumps(told).encode(), *rest])


FOUND = {
    "a colour as no number has it": (
        "document",
        fuzzing.METAL.replace('value="0.2, 0.3"', 'value="0x10, 0.3"').encode(),
        "",
    ),
    "a node whose name has slashes, in a document with a colour space": (
        "document",
        fuzzing.PATTERN.replace('name="ramp"', 'name="../../x"').replace('"ramp"', '"../../x"').encode(),
        "it is no material with a surface",
    ),
    "an input beside the nodes": (
        "document",
        fuzzing.PATTERN.replace(
            "<nodedef", '<input name="i" type="float" nodename="ramp" /><nodedef'
        ).encode(),
        "it is no material with a surface",
    ),
    "glTF that lies deep within itself": ("gltf material", deep(100_000), "more than 100 objects and arrays"),
    "glTF that lies less deep": ("gltf material", deep(150), "more than 100 objects and arrays"),
    "a mesh that lies deep within itself": ("gltf", deep(100_000), "more than 100 objects and arrays"),
    "a baseline's record that does": ("baseline", b"[" * 100_000, "damaged"),
    "a report that does": ("report", b"[" * 100_000, "damaged"),
    "glTF whose materials are a number": (
        "gltf material",
        b'{"asset": {"version": "2.0"}, "materials": 1e308}',
        "materials is no list",
    ),
    "a folder's name that is too long": ("name", b"/".join([b"a" * 300] * 30) + b"/b.png", ""),
    "a name of twenty thousand folders, which took their square in time": (
        "name",
        b"a/" * 20_000 + b"b.png",
        "",
    ),
    "a shard whose figure is a list": (
        "shard",
        with_record(max_rel=[1], used=[1]),
        "holds what no run writes",
    ),
    "a shard with a verdict of its own": ("shard", with_record(verdict="fine"), "holds what no run writes"),
    "a shard with an infinite figure": ("shard", with_record(rmse=float("inf")), "holds what no run writes"),
    "a shard whose report is a number": (
        "shard",
        READERS["shard"].seeds[0].partition(b"\n\n")[0] + b"\n\n1e308",
        "cannot be read",
    ),
}
"""What the search found, by what it was."""


@pytest.mark.parametrize("what", FOUND)
def test_what_was_found_is_told(what, tmp_path):
    name, contents, told = FOUND[what]
    said = read(name, contents, tmp_path)
    assert told in said and bool(told) == bool(said)


PLANTED = """
import os
from pathlib import Path
from fuzz_readers import Reader
from mrm_nodes.errors import MrmError

def stumble(data, folder):
    if data[:1] == b"A":
        raise ZeroDivisionError("planted")
    raise MrmError("as it may")

def crash(data, folder):
    if data[:1] == b"A":
        os.abort()

READERS = {"stumbles": Reader(stumble, (b"@ab",)), "crashes": Reader(crash, (b"@ab",))}
"""


@pytest.mark.parametrize(
    ("name", "seen"), [("stumbles", "ZeroDivisionError: planted"), ("crashes", "deadly signal")]
)
def test_the_search_finds_what_is_planted(name, seen, tmp_path, monkeypatch):
    pytest.importorskip("atheris", reason="needs atheris: pip install 'mrm-nodes[fuzz]'")
    (tmp_path / "planted.py").write_text(PLANTED)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    result = guided.search(tmp_path, 8, [name], "planted")
    assert any(seen in line for line in result.faults.values()), result


@pytest.mark.skipif(not SECONDS, reason="MRM_FUZZ_SECONDS is not set: minutes, in `make fuzz`")
def test_the_search_finds_nothing(tmp_path):
    result = guided.search(tmp_path, SECONDS, list(READERS))
    print(result)
    assert not result.faults, "\n".join(
        f"{tmp_path}/faults/{name}: {what}" for name, what in result.faults.items()
    )
    assert set(result.executions) == set(fuzz_readers.READERS)
    assert result.edges > 1000
