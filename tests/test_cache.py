"""A cache gives back what was put in, or nothing."""

import errno
import os
import random
import shutil
import warnings
import zlib
from pathlib import Path

import pytest

from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.cases.digests import MISSING, Inputs, conditions, digest, digest_of, key
from mrm_nodes.regression.run import cache as cache_module
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.journal import checksum, entry_for, line_with_sum, parsed
from mrm_nodes.regression.verdict.compare import Figures
from mrm_nodes.regression.verdict.outcome import Outcome, as_record

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
    cache.put(KEY, entry_for(outcome(), {"cases/render.exr": SUM}), report)
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
    assert line == found.line
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
        cache.put(KEY, entry_for(outcome(), {"cases/render.exr": SUM}), report)
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


def entry_line(tmp_path):
    """The file that says what an entry holds."""
    return next((tmp_path / "cache").glob("*/*")) / "outcome"


def forged(tmp_path, change):
    """Change what an entry says, its checksums made right."""
    file = entry_line(tmp_path)
    header, record = (parsed(line) for line in file.read_bytes().splitlines())
    change(header, record)
    file.write_bytes(line_with_sum(header) + line_with_sum(record))


def renamed(name):
    def change(header, record):
        record["files"] = {name: SUM}

    return change


def removed(*keys):
    def change(header, record):
        for each in (header, record, record.get("outcome", {})):
            for name in keys:
                each.pop(name, None)

    return change


def replaced(**values):
    def change(header, record):
        record["outcome"] |= values

    return change


FORGERIES = {
    "a name above": renamed("../stolen"),
    "a name above, further down": renamed("cases/../../stolen"),
    "an absolute name": renamed("/tmp/stolen"),
    "an empty name": renamed(""),
    "a name with NUL": renamed("cases/\0"),
    "a picture above": replaced(files={"render": "../../secret.png"}),
    "no key": removed("key"),
    "no files": removed("files"),
    "no outcome": removed("outcome"),
    "no verdict": removed("verdict"),
    "no setup": removed("setup"),
    "sums that are none": lambda header, record: record.update(files={"cases/render.exr": "x"}),
    "files that are a list": lambda header, record: record.update(files=["cases/render.exr"]),
    "an outcome that is a text": lambda header, record: record.update(outcome="pass"),
    "another key": lambda header, record: header.update(key=digest(b"another")),
    "another case": replaced(name="another"),
    "another backend": replaced(backend="osmesa"),
    "another setup": replaced(setup={"alpha": [0.3, 0.2]}),
}


@pytest.mark.parametrize("change", FORGERIES.values(), ids=FORGERIES)
def test_an_entry_that_is_not_this_case_s_or_leads_elsewhere_is_a_miss(cache, tmp_path, change):
    task = Task(alpha=[0.1, 0.2])
    assert cache.get(KEY, tmp_path / "before", task, "egl") is not None
    forged(tmp_path, change)
    before = {file for file in tmp_path.rglob("*") if "cache" not in file.parts}
    with pytest.warns(MrmWarning, match="the cached result is damaged"):
        assert cache.get(KEY, tmp_path / "report", task, "egl") is None
    assert {file for file in tmp_path.rglob("*") if "cache" not in file.parts} == before
    assert not entry_line_exists(tmp_path)


def entry_line_exists(tmp_path):
    return any((tmp_path / "cache").glob("*/*/outcome"))


@pytest.mark.parametrize("kind", ["link", "folder", "pipe"])
def test_a_file_of_an_entry_that_is_none_is_a_miss(cache, tmp_path, kind):
    file = entry_line(tmp_path).with_name("0")
    file.unlink()
    (tmp_path / "secret").write_bytes(CONTENTS)
    {
        "link": lambda: file.symlink_to(tmp_path / "secret"),
        "folder": file.mkdir,
        "pipe": lambda: os.mkfifo(file),
    }[kind]()
    with pytest.warns(MrmWarning, match="the cached result is damaged"):
        assert cache.get(KEY, tmp_path / "other") is None
    assert (tmp_path / "secret").read_bytes() == CONTENTS


def test_a_link_in_a_report_is_replaced_and_not_written_through(cache, tmp_path):
    there = tmp_path / "other" / "cases" / "render.exr"
    there.parent.mkdir(parents=True)
    (tmp_path / "mine").write_text("kept")
    there.symlink_to(tmp_path / "mine")
    cache.get(KEY, tmp_path / "other")
    assert there.read_bytes() == CONTENTS and not there.is_symlink()
    assert (tmp_path / "mine").read_text() == "kept"


def test_a_case_costs_one_look_at_its_folder(cache, report, tmp_path, monkeypatch):
    """Ten thousand cases from a cache are mostly calls of the system: counted here."""
    key = digest(b"seven files")
    sums = {f"cases/egl/c/{number}": SUM for number in range(7)}
    (report / "cases/egl/c").mkdir(parents=True)
    for name in sums:
        (report / name).write_bytes(CONTENTS)
    cache.put(key, entry_for(outcome(), sums), report)
    (tmp_path / "other" / "cases" / "egl").mkdir(parents=True)
    calls = []
    for name in ("open", "mkdir", "unlink", "stat", "lstat"):
        function = getattr(os, name)

        def call(*arguments, name=name, function=function, **others):
            calls.append(name)
            return function(*arguments, **others)

        monkeypatch.setattr(os, name, call)
    assert cache.get(key, tmp_path / "other") is not None
    counts = {name: calls.count(name) for name in ("open", "unlink", "mkdir")}
    # Each file is read, removed where it is there, and written; the folder above it is looked at once.
    assert counts == {"open": 1 + 7 + 7, "unlink": 7, "mkdir": 2}
    assert calls.count("stat") + calls.count("lstat") < 14


@pytest.mark.parametrize("at", ["before the outcome is read", "before a file is read"])
def test_an_entry_that_is_evicted_while_it_is_read_is_a_miss(cache, tmp_path, monkeypatch, at):
    read, place = cache_module._read, entry_line(tmp_path).parent

    def evict(file):
        if (Path(file).name == "outcome") == (at == "before the outcome is read"):
            shutil.rmtree(place, ignore_errors=True)
        return read(file)

    monkeypatch.setattr(cache_module, "_read", evict)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert cache.get(KEY, tmp_path / "other") is None


def test_losing_a_race_is_no_fault(tmp_path, report, monkeypatch):
    """Another run puts the same entry between the removal of an earlier one and the renaming of ours."""
    names = {"cases/render.exr": SUM}
    remove = cache_module._remove

    def be_quicker(place):
        remove(place)
        monkeypatch.setattr(cache_module, "_remove", remove)
        Cache(tmp_path / "cache").put(KEY, entry_for(outcome(), names), report)

    monkeypatch.setattr(cache_module, "_remove", be_quicker)
    cache = Cache(tmp_path / "cache")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cache.put(KEY, entry_for(outcome(), names), report)
        cache.put(digest(b"another"), entry_for(outcome(), names), report)
        assert cache.get(KEY, tmp_path / "other") and cache.get(digest(b"another"), tmp_path / "other")
    assert not list((tmp_path / "cache").glob("*/.*"))


@pytest.mark.parametrize(("umask", "folder", "file"), [(0o022, 0o755, 0o644), (0o002, 0o775, 0o664)])
def test_modes_are_those_that_the_umask_asks_for(tmp_path, report, umask, folder, file):
    before = os.umask(umask)
    try:
        cache = Cache(tmp_path / "cache")
        cache.put(KEY, entry_for(outcome(), {"cases/render.exr": SUM}), report)
        cache.get(KEY, tmp_path / "other")
    finally:
        os.umask(before)
    place = entry_line(tmp_path).parent
    for each, mode in (
        (place, folder),
        (place.parent, folder),
        (place / "0", file),
        (place / "outcome", file),
    ):
        assert each.stat().st_mode & 0o777 == mode
    assert (tmp_path / "other" / "cases" / "render.exr").stat().st_mode & 0o777 == file


@pytest.mark.parametrize("link", [False, True])
def test_report_and_cache_share_files_only_where_that_is_asked_for(tmp_path, report, link):
    cache = Cache(tmp_path / "cache", link=link)
    cache.put(KEY, entry_for(outcome(), {"cases/render.exr": SUM}), report)
    cache.get(KEY, tmp_path / "other")
    kept = entry_line(tmp_path).with_name("0")
    for folder in (report, tmp_path / "other"):
        assert kept.samefile(folder / "cases" / "render.exr") == link


def test_with_a_secret_only_what_was_signed_with_it_is_used(tmp_path, report, monkeypatch):
    names = {"cases/render.exr": SUM}
    monkeypatch.setenv("MRM_CACHE_SECRET", "ours")
    Cache(tmp_path / "cache").put(KEY, entry_for(outcome(), names), report)
    assert Cache(tmp_path / "cache").get(KEY, tmp_path / "other") is not None
    assert Cache(tmp_path / "cache", secret="another").get(KEY, tmp_path / "other") is None
    assert Cache(tmp_path / "cache", secret="").get(KEY, tmp_path / "other") is not None
    # A file of the same size and CRC-32 can be made by anybody.
    kept = entry_line(tmp_path).with_name("0")
    kept.write_bytes(b"x" + CONTENTS[1:])
    forged(
        tmp_path,
        lambda header, record: record.update(files={"cases/render.exr": checksum(kept)}),
    )
    assert Cache(tmp_path / "cache").get(KEY, tmp_path / "other") is None
    assert Cache(tmp_path / "cache", secret="").get(KEY, tmp_path / "other") is not None
    unsigned = Cache(tmp_path / "unsigned", secret="")
    unsigned.put(KEY, entry_for(outcome(), names), report)
    assert Cache(tmp_path / "unsigned").get(KEY, tmp_path / "other") is None


def test_errors_are_not_kept(cache, report, tmp_path):
    for verdict in ("error", "skipped"):
        cache.put(digest(verdict.encode()), entry_for(outcome(verdict), {}), report)
        assert cache.get(digest(verdict.encode()), tmp_path) is None


def test_a_cache_that_cannot_be_written_costs_nothing_but_a_warning(tmp_path, report):
    (tmp_path / "file").write_text("kept")
    cache = Cache(tmp_path / "file")
    with pytest.warns(MrmWarning, match="results are not cached"):
        cache.put(KEY, entry_for(outcome(), {}), report)
    cache.put(KEY, entry_for(outcome(), {}), report)  # says it once


def test_the_entries_that_were_used_longest_ago_go_first(tmp_path, report):
    names = {"cases/render.exr": SUM}
    keys = [digest(bytes([number])) for number in range(4)]
    cache = Cache(tmp_path / "cache", limit=500_000)
    for age, each in enumerate(reversed(keys)):
        cache.put(each, entry_for(outcome(), names), report)
        os.utime(tmp_path / "cache" / each[:2] / each / "outcome", (1000 + age, 1000 + age))
    assert cache.get(keys[3], tmp_path / "other") is not None  # and so it is the one used last
    cache.prune()
    kept = [each for each in keys if cache.get(each, tmp_path / "other") is not None]
    assert kept == [keys[0], keys[3]]


class Task:
    """A task with settings of its own."""

    name, kind, node, target = "case", "material", "node", "glsl"

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
