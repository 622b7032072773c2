"""A cache gives back what was put in, or nothing."""

import errno
import os
import random
import zlib

import pytest

from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.cache import Cache
from mrm_nodes.regression.compare import Figures
from mrm_nodes.regression.inputs import MISSING, Inputs, conditions, digest, digest_of, key
from mrm_nodes.regression.journal import line_of
from mrm_nodes.regression.outcome import Outcome, as_record

KEY = digest(b"key")
CONTENTS = random.Random(1).randbytes(200_000)
SUM = [len(CONTENTS), zlib.crc32(CONTENTS)]


@pytest.fixture
def report(tmp_path):
    """A report's folder with one case's file."""
    (tmp_path / "report" / "cases").mkdir(parents=True)
    (tmp_path / "report" / "cases" / "render.exr").write_bytes(CONTENTS)
    return tmp_path / "report"


@pytest.fixture
def cache(tmp_path, report):
    """A cache that knows the case."""
    cache = Cache(tmp_path / "cache")
    cache.put(KEY, outcome(), report, {"cases/render.exr": SUM})
    return cache


def outcome(verdict="pass"):
    figures = Figures(1e-7, 2e-7, float("inf"), 1 / 3, 0.5, 10, 9)
    return Outcome("case", "node", "egl", verdict, figures=figures, setup={"alpha": [0.1, 0.2]})


def entry_of(tmp_path):
    """The files of the only entry."""
    (entry,) = (tmp_path / "cache").glob("*/*")
    return sorted(entry.iterdir())


def test_it_gives_back_the_outcome_and_the_files(cache, tmp_path):
    found, line = cache.get(KEY, tmp_path / "other")
    assert as_record(found.outcome) == as_record(outcome())
    assert found.sums == {"cases/render.exr": SUM}
    assert line == line_of(found)
    assert (tmp_path / "other" / "cases" / "render.exr").read_bytes() == CONTENTS
    assert cache.get(digest(b"another"), tmp_path) is None


def test_damage_anywhere_in_an_entry_is_found(cache, tmp_path, report):
    rng = random.Random(2)
    for number in range(100):
        damaged = entry_of(tmp_path)[number % 2]
        contents = bytearray(damaged.read_bytes())
        contents[rng.randrange(len(contents) - 1)] ^= 1 << rng.randrange(8)
        damaged.write_bytes(contents)
        with pytest.warns(MrmWarning, match="the cached result is damaged"):
            assert cache.get(KEY, tmp_path / "other") is None
        assert not damaged.exists()
        (report / "cases" / "render.exr").write_bytes(CONTENTS)
        cache.put(KEY, outcome(), report, {"cases/render.exr": SUM})
        assert cache.get(KEY, tmp_path / "other") is not None


def test_an_entry_that_is_cut_off_is_found(cache, tmp_path):
    for file in entry_of(tmp_path):
        file.write_bytes(file.read_bytes()[:100])
    with pytest.warns(MrmWarning, match="the cached result is damaged"):
        assert cache.get(KEY, tmp_path / "other") is None


def test_an_entry_without_a_file_is_found(cache, tmp_path):
    entry_of(tmp_path)[0].unlink()
    with pytest.warns(MrmWarning, match="the cached result is damaged"):
        assert cache.get(KEY, tmp_path / "other") is None


def test_what_is_put_in_a_report_replaces_what_was_there(cache, tmp_path):
    there = tmp_path / "other" / "cases" / "render.exr"
    there.parent.mkdir(parents=True)
    there.write_text("old")
    cache.get(KEY, tmp_path / "other")
    assert there.read_bytes() == CONTENTS


def test_another_file_system_gets_copies(cache, tmp_path, monkeypatch):
    def refuse(source, target):
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    (tmp_path / "other" / "cases").mkdir(parents=True)
    monkeypatch.setattr("os.link", refuse)
    cache.get(KEY, tmp_path / "other")
    assert (tmp_path / "other" / "cases" / "render.exr").read_bytes() == CONTENTS


def test_errors_are_not_kept(cache, report, tmp_path):
    for verdict in ("error", "skipped"):
        cache.put(digest(verdict.encode()), outcome(verdict), report, {})
        assert cache.get(digest(verdict.encode()), tmp_path) is None


def test_a_cache_that_cannot_be_written_costs_nothing_but_a_warning(tmp_path, report):
    (tmp_path / "file").write_text("kept")
    cache = Cache(tmp_path / "file")
    with pytest.warns(MrmWarning, match="results are not cached"):
        cache.put(KEY, outcome(), report, {})
    cache.put(KEY, outcome(), report, {})  # says it once


def test_the_entries_that_were_used_longest_ago_go_first(tmp_path, report):
    names = {"cases/render.exr": SUM}
    keys = [digest(bytes([number])) for number in range(4)]
    cache = Cache(tmp_path / "cache", limit=500_000)
    for age, each in enumerate(reversed(keys)):
        cache.put(each, outcome(), report, names)
        os.utime(tmp_path / "cache" / each[:2] / each / "outcome", (1000 + age, 1000 + age))
    assert cache.get(keys[3], tmp_path / "other") is not None  # and so it is the one used last
    cache.prune()
    kept = [each for each in keys if cache.get(each, tmp_path / "other") is not None]
    assert kept == [keys[0], keys[3]]


class Task:
    """A task with settings of its own."""

    name, kind, node, target = "case", "image", "node", "glsl"

    def __init__(self, *files, **settings):
        self._files, self._settings = files, settings

    def describe(self):
        return self._settings

    def files(self):
        return self._files


def test_a_key_hangs_on_everything_that_the_result_hangs_on(tmp_path):
    file = tmp_path / "a.mtlx"
    file.write_text("one")

    def key_of(task=None, backend="egl", **changed):
        around = {**conditions("llvmpipe"), **changed}
        return key(task or Task(file, alpha=0.5), backend, Inputs(), digest_of(around))

    same = key_of()
    assert key_of() == same
    others = [
        key_of(Task(file, alpha=0.6)),
        key_of(Task(alpha=0.5)),
        key_of(backend="osmesa"),
        *(key_of(**{name: "another"}) for name in conditions("llvmpipe")),
    ]
    file.write_text("two")
    others.append(key_of())
    file.unlink()
    others.append(key_of())
    assert len({same, *others}) == len(others) + 1


def test_conditions_name_our_source_the_versions_and_the_driver():
    assert {"OpenGL", "source", "mrm-nodes", "MaterialX", "numba"} <= set(conditions("llvmpipe"))


def test_contents_are_fixed_when_they_are_first_asked_for(tmp_path):
    file = tmp_path / "a.mtlx"
    file.write_text("one")
    inputs = Inputs()
    first = inputs.digest(file)
    assert inputs.changed([file]) == []
    file.write_text("two")
    assert inputs.digest(file) == first
    assert inputs.changed([file]) == [file]
    file.write_text("one")
    assert inputs.changed([file]) == []
    absent = tmp_path / "absent"
    assert inputs.digest(absent) == MISSING
    absent.write_text("now it is there")
    assert inputs.changed([absent]) == [absent]
