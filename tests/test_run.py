"""A run knows its backends, loses nothing that it came to, and does nothing twice."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, get_args
from xml.etree import ElementTree

import pytest

from mrm_nodes import cli
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.files import LARGEST
from mrm_nodes.regression.run import journal
from mrm_nodes.regression.run import runner as run
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.pool import Judged
from mrm_nodes.regression.run.runner import merge, plan_backends, run_suite, shard_of
from mrm_nodes.regression.verdict.outcome import Fault, fault_of, outcome_of
from mrm_nodes.render.context import BackendReport

EGL = BackendReport("egl", True, "Mesa", "llvmpipe", "4.5")
OSMESA = BackendReport("osmesa", True, "Mesa", "llvmpipe", "4.5")
NO_OSMESA = BackendReport("osmesa", False, reason="libOSMesa is not installed", hint="install libosmesa6")
NO_EGL = BackendReport("egl", False, reason="no device", hint="install libegl1")


def test_auto_takes_the_first_that_works():
    assert list(plan_backends("auto", [EGL, OSMESA]).drivers) == ["egl"]
    assert list(plan_backends("auto", [NO_EGL, OSMESA]).drivers) == ["osmesa"]


def test_all_skips_what_is_missing_and_says_why():
    plan = plan_backends("all", [EGL, NO_OSMESA])
    assert plan.drivers == {"egl": "llvmpipe, OpenGL 4.5"}
    assert plan.skipped == {"osmesa": "libOSMesa is not installed; install libosmesa6"}


@pytest.mark.parametrize(
    ("request_", "probes", "required", "message"),
    [
        ("osmesa", [EGL, NO_OSMESA], (), "backend osmesa does not work here: libOSMesa is not installed"),
        ("all", [EGL, NO_OSMESA], ("egl", "osmesa"), "backend osmesa does not work here"),
        ("all", [NO_EGL, NO_OSMESA], (), "backend egl does not work here: no device; install libegl1"),
        ("auto", [NO_EGL, NO_OSMESA], (), "backend egl does not work here"),
        ("glx", [EGL, OSMESA], (), "unknown backend glx; known: auto, all, egl, osmesa"),
        ("all", [EGL, OSMESA], ("metal",), "MRM_REQUIRE_BACKENDS names metal; known: egl, osmesa"),
    ],
)
def test_a_backend_that_is_asked_for_and_missing_is_an_error(request_, probes, required, message):
    with pytest.raises(MrmError, match=message):
        plan_backends(request_, probes, required)


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(MrmError, match="cannot be written"):
        run_suite([], tmp_path / "file" / "report")
    assert (tmp_path / "file").read_text() == "kept"


@dataclass(frozen=True)
class Copy:
    """A task that copies a file into the report."""

    name: str
    file: Path
    value: int = 0
    kind: ClassVar[str] = "image"
    node: ClassVar[str] = "none"
    target: ClassVar[str] = "glsl"
    structure: ClassVar[str] = "copy"

    def describe(self):
        return {"value": self.value}

    def files(self):
        return (self.file,)


class Judges:
    """In place of worker processes: judges here, and remembers what."""

    def __init__(self):
        self.judged = []
        self.before = {}
        self.faults = {}
        """By a task's name, what of the machine is at fault; nothing for an error of its own."""

    def __call__(self, tasks, backend, scratch, *others):
        for number, task in enumerate(tasks):
            self.before.get(task.name, lambda: None)()
            folder = scratch / str(number)
            place = folder / "cases" / task.name
            place.mkdir(parents=True)
            (place / "copy").write_bytes(task.file.read_bytes())
            self.judged.append(task.name)
            fault = self.faults.get(task.name)
            verdict, message = ("pass", "") if fault is None else ("error", f"{fault} is at fault")
            outcome = outcome_of(task, backend, verdict, message=message, fault=fault or "")
            yield Judged(task, outcome, folder)


@pytest.fixture
def judges(monkeypatch):
    judges = Judges()
    monkeypatch.setattr(run, "run_locally", judges)
    monkeypatch.setattr(run, "probe_backends", lambda *_: [EGL, NO_OSMESA])
    monkeypatch.delenv("MRM_REQUIRE_BACKENDS", raising=False)
    return judges


@pytest.fixture
def suite(tmp_path):
    tasks = [Copy(name, tmp_path / f"{name}.mtlx") for name in "abcde"]
    for task in tasks:
        task.file.write_text(f"contents of {task.name}")
    return tasks


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "report"


def interrupt(at):
    """End this process as Ctrl-C or its like does."""
    return lambda: signal.raise_signal(at)


@pytest.mark.parametrize("signal_", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interrupted_run_leaves_a_partial_report_and_goes_on_from_there(judges, suite, folder, signal_):
    judges.before["c"] = interrupt(signal_)
    with pytest.raises(KeyboardInterrupt):
        run_suite(suite, folder)
    report = json.loads((folder / "report.json").read_text())
    assert report["environment"]["partial"] == "it was interrupted"
    assert {case["name"]: case["verdict"] for case in report["cases"]} == {
        "a": "pass", "b": "pass", "c": "skipped", "d": "skipped", "e": "skipped"
    }  # fmt: skip
    assert (folder / "cases" / "a" / "copy").read_text() == "contents of a"

    judges.judged, judges.before = [], {}
    report = run_suite(suite, folder, resume=True)
    assert judges.judged == ["c", "d", "e"]
    assert report["summary"]["passed"] == 5
    assert "partial" not in report["environment"]
    assert report["environment"]["resumed"] == 2
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_what_is_known_needs_no_evaluator():
    """A run whose results are all in the cache waits for none of what only a worker needs."""
    program = """
        import sys
        import mrm_nodes.commands.regress, mrm_nodes.regression.run.runner, mrm_nodes.regression.suites.selection
        import mrm_nodes.regression.run.worker
        assert not {"numba", "scipy"} & {*sys.modules}
    """
    subprocess.run([sys.executable, "-c", textwrap.dedent(program)], check=True)


def test_a_run_that_is_interrupted_as_it_writes_its_report_has_one(judges, suite, folder, monkeypatch):
    def write_once(*arguments):
        monkeypatch.undo()
        raise KeyboardInterrupt

    partial = []
    monkeypatch.setattr(run._Run, "report", write_once)
    with pytest.raises(KeyboardInterrupt):
        run_suite(suite, folder, on_partial=partial.append)
    report = json.loads((folder / "report.json").read_text())
    assert partial == [report]
    assert report["environment"]["partial"] == "it was interrupted"
    assert report["summary"]["passed"] == 5


def test_a_line_that_a_kill_tore_off_is_no_result(judges, suite, folder):
    run_suite(suite, folder)
    file = folder / journal.NAME
    file.write_bytes(file.read_bytes()[:-30])
    judges.judged = []
    assert run_suite(suite, folder, resume=True)["summary"]["passed"] == 5
    assert judges.judged == ["e"]
    assert len(journal.read(folder).entries) == 5


def test_a_damaged_line_is_no_result_and_said(judges, suite, folder):
    run_suite(suite, folder)
    lines = (folder / journal.NAME).read_bytes().splitlines(keepends=True)
    lines[2] = lines[2].replace(b'"pass"', b'"fail"')
    (folder / journal.NAME).write_bytes(b"".join(lines))
    judges.judged = []
    with pytest.warns(MrmWarning, match="1 damaged lines"):
        run_suite(suite, folder, resume=True)
    assert judges.judged == ["b"]


def test_a_journal_whose_head_is_damaged_is_begun_anew(judges, suite, folder):
    run_suite(suite, folder)
    file = folder / journal.NAME
    file.write_bytes(b"x" + file.read_bytes())
    judges.judged = []
    with pytest.warns(MrmWarning, match="every case is run again"):
        assert run_suite(suite, folder, resume=True)["summary"]["passed"] == 5
    assert judges.judged == list("abcde")


def test_a_case_whose_file_in_the_report_was_damaged_is_run_again(judges, suite, folder):
    run_suite(suite, folder)
    (folder / "cases" / "b" / "copy").write_text("contents of B")
    (folder / "cases" / "d" / "copy").unlink()
    judges.judged = []
    with pytest.warns(MrmWarning, match="files of 2 cases were changed or removed"):
        run_suite(suite, folder, resume=True)
    assert judges.judged == ["b", "d"]
    assert (folder / "cases" / "b" / "copy").read_text() == "contents of b"


def test_a_report_that_was_damaged_is_written_anew(judges, suite, folder):
    run_suite(suite, folder)
    (folder / "report.json").write_text("{")
    judges.judged = []
    run_suite(suite, folder, resume=True)
    assert judges.judged == []
    assert json.loads((folder / "report.json").read_text())["summary"]["passed"] == 5


def test_another_suite_is_not_gone_on_with(judges, suite, folder):
    run_suite(suite, folder)
    changes = {
        "egl e is gone": suite[:-1],
        "egl f is new": [*suite, Copy("f", suite[0].file)],
        "egl c changed": [*suite[:2], Copy("c", suite[2].file, value=1), *suite[3:]],
    }
    for reason, tasks in changes.items():
        with pytest.raises(MrmError, match=f"the suite changed since: {reason}; run without it"):
            run_suite(tasks, folder, resume=True)
    suite[1].file.write_text("edited")
    with pytest.raises(MrmError, match="the suite changed since: egl b changed"):
        run_suite(suite, folder, resume=True)
    suite[1].file.write_text("contents of b")
    assert run_suite(suite, folder, resume=True)["summary"]["passed"] == 5


def test_another_driver_is_not_gone_on_with(judges, suite, folder, monkeypatch):
    run_suite(suite, folder)
    monkeypatch.setattr(
        run, "probe_backends", lambda *_: [BackendReport("egl", True, "Mesa", "llvmpipe", "4.6")]
    )
    with pytest.raises(MrmError, match="--resume: OpenGL of the egl backend changed since"):
        run_suite(suite, folder, resume=True)


def test_a_second_run_into_one_folder_is_refused(judges, suite, folder):
    def second():
        with pytest.raises(MrmError, match=rf"{folder}: another run is writing there \(process \d+\)"):
            run_suite(suite, folder)
        refused.append(True)

    refused = []
    judges.before["b"] = second
    assert run_suite(suite, folder)["summary"]["passed"] == 5
    assert refused
    assert run_suite(suite, folder)["summary"]["passed"] == 5


def test_a_disk_that_is_full_at_the_start_is_one_line(judges, suite, folder, monkeypatch):
    def no_room(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.pwrite", no_room)
    for begin in (lambda: run_suite(suite, folder), lambda: merge([folder / "part"], folder)):
        with pytest.raises(MrmError, match=f"{folder}: cannot be written: No space left on device"):
            begin()


def test_a_file_that_changes_during_the_run_is_an_error_of_its_case(judges, suite, folder, tmp_path):
    judges.before["b"] = lambda: suite[3].file.write_text("edited")
    judges.before["e"] = lambda: suite[0].file.write_text("contents of a")  # touched, not changed
    report = run_suite(suite, folder, cache=Cache(tmp_path / "cache"))
    found = {case["name"]: (case["verdict"], case["message"]) for case in report["cases"]}
    assert found["d"] == ("error", f"{suite[3].file}: changed during the run")
    assert [found[name][0] for name in "abce"] == ["pass"] * 4
    assert not (folder / "cases" / "d").exists()


def test_two_cases_of_one_name_are_an_error(judges, suite, folder):
    with pytest.raises(MrmError, match="two cases are called a; give each a name of its own"):
        run_suite([*suite, suite[0]], folder)


def test_an_earlier_report_is_gone_while_a_run_is_on(judges, suite, folder):
    """Else a kill would leave it beside pictures that are not its own."""
    run_suite(suite, folder)
    judges.before["a"] = lambda: seen.append((folder / "report.json").exists())
    seen = []
    run_suite(suite, folder)
    assert seen == [False]


def test_a_run_that_cannot_begin_leaves_an_earlier_report_alone(judges, suite, folder):
    run_suite(suite, folder)
    before = (folder / "report.json").read_bytes()
    with pytest.raises(MrmError, match="unknown backend"):
        run_suite(suite, folder, "glx")
    assert (folder / "report.json").read_bytes() == before


def test_what_did_not_change_comes_from_the_cache(judges, suite, folder, tmp_path):
    cache = Cache(tmp_path / "cache")
    first = run_suite(suite, folder, cache=cache)
    suite[2].file.write_text("edited")
    judges.judged = []
    second = run_suite(suite, tmp_path / "other", cache=cache)
    assert judges.judged == ["c"]
    assert second["environment"]["cached"] == 4
    assert (tmp_path / "other" / "cases" / "a" / "copy").read_text() == "contents of a"
    assert [case for case in first["cases"] if case["name"] != "c"] == [
        case for case in second["cases"] if case["name"] != "c"
    ]


def test_shards_share_no_case_and_are_the_suite_together(suite):
    for count in (1, 2, 3, 7):
        parts = [shard_of(suite, (number, count)) for number in range(1, count + 1)]
        names = [task.name for part in parts for task in part]
        assert sorted(names) == list("abcde")
        assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_shards_merge_to_the_report_of_the_whole(judges, suite, folder, tmp_path):
    whole = run_suite(suite, folder, "all")
    parts = [tmp_path / f"part-{number}" for number in (1, 2, 3)]
    for number, part in enumerate(parts, 1):
        run_suite(suite, part, "all", shard=(number, 3))
    merged = merge(parts[::-1], tmp_path / "merged")
    assert merged["cases"] == whole["cases"]
    assert {"shard", "partial"}.isdisjoint(merged["environment"])
    for name in "abcde":
        assert (tmp_path / "merged" / "cases" / name / "copy").read_text() == f"contents of {name}"


@pytest.mark.parametrize("fault", [each for each in get_args(Fault) if each not in ("", "disk")])
def test_what_the_machine_did_is_no_verdict_and_is_run_again(judges, suite, folder, tmp_path, fault):
    cache = Cache(tmp_path / "cache")
    judges.faults = {"b": fault, "d": ""}
    report = run_suite(suite, folder, cache=cache)
    cases = {case["name"]: case for case in report["cases"]}
    assert {name: case["fault"] for name, case in cases.items() if "fault" in case} == {"b": fault}
    assert cases["b"]["message"] == f"{fault} is at fault"
    entries = {entry.record["name"]: entry for entry in journal.read(folder).entries}
    assert entries["b"].outcome.fault == fault and entries["d"].outcome.fault == ""

    judges.judged, judges.faults = [], {"d": ""}
    report = run_suite(suite, folder, resume=True)
    assert judges.judged == ["b"]
    assert [case["verdict"] for case in report["cases"]].count("pass") == 4
    judges.judged, judges.faults = [], {}
    report = run_suite(suite, folder, retry_errors=True, cache=cache)
    assert judges.judged == ["d"]
    assert report["summary"]["passed"] == 5
    judges.judged = []
    run_suite(suite, tmp_path / "another", cache=cache)
    assert judges.judged == ["b"]


@pytest.mark.parametrize("how", ["a name above", "a link to a folder", "a link to a file"])
def test_no_file_of_a_shard_leads_outside_of_its_folder(judges, suite, folder, tmp_path, how):
    part, secret = tmp_path / "part", tmp_path / "secret"
    run_suite(suite, part, shard=(1, 1))
    secret.mkdir()
    (secret / "copy").write_bytes((part / "cases" / "b" / "copy").read_bytes())
    if how == "a name above":
        past = journal.read(part)
        entries = [
            journal.Entry(
                each.record, {name.replace("cases/b", "../secret"): sum_ for name, sum_ in each.sums.items()}
            )
            for each in past.entries
        ]
        with journal.Journal(part, past.header, entries):
            pass
    elif how == "a link to a folder":
        (part / "cases" / "b").rename(part / "away")
        (part / "cases" / "b").symlink_to(secret)
    else:
        (part / "cases" / "b" / "copy").unlink()
        (part / "cases" / "b" / "copy").symlink_to(secret / "copy")
    with (
        warnings.catch_warnings(),
        pytest.raises(MrmError, match=r"cases are not done|leads outside of the shard"),
    ):
        warnings.simplefilter("ignore", MrmWarning)
        merge([part], folder)
    assert not (folder / "report.json").exists()


@pytest.mark.parametrize("missing", ["suite", "shard", "conditions", "keys", "environment"])
def test_a_journal_whose_first_line_lacks_something_is_none(judges, suite, folder, missing):
    run_suite(suite, folder)
    lines = (folder / journal.NAME).read_bytes().splitlines(keepends=True)
    header = journal.parsed(lines[0].rstrip(b"\n"))
    del header[missing]
    (folder / journal.NAME).write_bytes(b"".join([journal.line_with_sum(header), *lines[1:]]))
    with pytest.warns(MrmWarning, match="cannot be read; every case is run again"):
        assert journal.read(folder) is None


def test_a_disk_that_is_full_ends_the_run_though_what_failed_left_room(judges, suite, folder):
    judges.faults = {"c": "disk"}
    with pytest.raises(MrmError, match="c: disk is at fault; what is done is kept: go on with --resume"):
        run_suite(suite, folder)
    assert [entry.record["name"] for entry in journal.read(folder).entries] == ["a", "b"]
    judges.faults = {}
    assert run_suite(suite, folder, resume=True)["environment"]["resumed"] == 2


def wrapped(error):
    """As whoever reads or writes a file says it: an MrmError in place of the other."""
    try:
        try:
            raise error
        except type(error):
            raise MrmError("told in a line") from None
    except MrmError as told:
        return told


@pytest.mark.parametrize(
    ("error", "fault"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "disk"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "disk"),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "memory"),
        (MemoryError(), "memory"),
        (FileNotFoundError(errno.ENOENT, "No such file"), ""),
        (OSError("a message only"), ""),
        (ValueError("of the case's own"), ""),
    ],
)
def test_what_of_the_machine_is_behind_an_error_is_found(error, fault):
    assert fault_of(error) == fault_of(wrapped(error)) == fault


@pytest.mark.parametrize("given", [(1,), (1, 3)])
def test_a_shard_that_is_missing_is_an_error_unless_it_may_be(judges, suite, folder, tmp_path, given):
    """A CI job that was cancelled must not pass for one whose cases passed."""
    for number in given:
        run_suite(suite, tmp_path / f"part{number}", shard=(number, 3))
    junit = tmp_path / "junit.xml"
    arguments = [f"{tmp_path}/part{number}" for number in given] + ["-o", str(folder), "--junit", str(junit)]

    def status(*more):
        with pytest.raises(SystemExit) as ended:
            cli.main(["merge", *arguments, *more])
        return ended.value.code

    absent = [f"{number}/3" for number in (1, 2, 3) if number not in given]
    assert status() == 1
    report = json.loads((folder / "report.json").read_text())
    assert report["environment"]["partial"] == f"shards are missing: {', '.join(absent)}"
    tests = ElementTree.parse(junit).getroot().findall("testsuite[@name='shards']/testcase")
    assert [test.get("name") for test in tests] == [f"shard {each}" for each in absent]
    for test, each in zip(tests, absent, strict=True):
        assert f"shard {each} is missing" in test.find("error").get("message")
    assert status("--partial") == 0
    assert "shards are missing" in junit.read_text() and "<error" not in junit.read_text()


def test_what_is_no_shard_of_the_same_run_is_not_merged(judges, suite, folder, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    run_suite(suite, one, shard=(1, 2))
    with pytest.raises(MrmError, match="no run's journal is there"):
        merge([one, tmp_path], folder)
    with pytest.raises(MrmError, match="that is a shard's own folder"):
        merge([one], one)
    with pytest.raises(MrmError, match="shard 1/2 does not go together with"):
        merge([one, one], folder)
    run_suite(suite, two, shard=(2, 3))
    with pytest.raises(MrmError, match="shard 2/3 does not go together with"):
        merge([one, two], folder)
    run_suite(suite[:-1], two, shard=(2, 2))
    with pytest.raises(MrmError, match="its suite differs"):
        merge([one, two], folder)
    run_suite(suite, two, shard=(2, 2))
    (two / "cases" / "b" / "copy").write_text("edited")
    with pytest.raises(MrmError, match="files of b were changed or removed"):
        merge([one, two], folder)


def test_pictures_of_a_gallery_are_drawn_into_the_folder_and_named_in_the_report(judges, suite, folder):
    def gallery(where):
        (where / "cones.png").write_bytes(b"")
        return [{"title": "cones", "caption": "by day", "image": "cones.png"}]

    report = run_suite(suite, folder, gallery=gallery)
    assert report["environment"]["gallery"] == [{"title": "cones", "caption": "by day", "image": "cones.png"}]
    assert (folder / "cones.png").exists()


def test_a_link_in_a_report_s_folder_leads_no_file_elsewhere(judges, suite, folder, tmp_path):
    """Somebody who can write there could otherwise have a run's user write where only that user can."""
    victim = tmp_path / "victim"
    (victim / "a").mkdir(parents=True)
    (victim / "a" / "copy").write_text("kept")
    for link, target in (
        ("cases", victim),
        ("cases/a", victim / "a"),
        ("cases/a/copy", victim / "a" / "copy"),
    ):
        for cache in (None, Cache(tmp_path / "cache")):
            shutil.rmtree(folder, ignore_errors=True)
            (folder / link).parent.mkdir(parents=True)
            (folder / link).symlink_to(target)
            assert run_suite(suite, folder, cache=cache)["summary"]["passed"] == 5
            assert (folder / "cases" / "a" / "copy").read_text() == "contents of a"
            assert not (folder / link).is_symlink()
        merged = tmp_path / "merged"
        shutil.rmtree(merged, ignore_errors=True)
        (merged / link).parent.mkdir(parents=True)
        (merged / link).symlink_to(target)
        merge([folder], merged)
        assert not (merged / link).is_symlink()
        assert {each.name for each in victim.rglob("*")} == {"a", "copy"}
        assert (victim / "a" / "copy").read_text() == "kept"


def test_a_lock_that_is_a_link_is_refused_and_what_it_leads_to_is_kept(judges, suite, folder, tmp_path):
    (tmp_path / "mine").write_text("kept")
    folder.mkdir()
    (folder / ".lock").symlink_to(tmp_path / "mine")
    with pytest.raises(
        MrmError, match=r"\.lock: cannot be written: it is a link; choose another folder with -o"
    ):
        run_suite(suite, folder)
    assert (tmp_path / "mine").read_text() == "kept"


def pipe(path):
    os.mkfifo(path)


def endless(path):
    path.symlink_to("/dev/zero")


def sparse(path):
    path.touch()
    # Of a case's files the sum is taken, piece by piece: more than the largest that is read at once is enough.
    os.truncate(path, LARGEST + 1 if path.name == "copy" else 8 << 30)


@pytest.mark.parametrize("trap", [pipe, endless, sparse])
def test_what_lies_in_place_of_a_report_s_files_is_neither_waited_for_nor_read_without_an_end(
    judges, suite, folder, tmp_path, trap
):
    for name in ("journal", "report.json", "index.html", "cases/b/copy"):
        run_suite(suite, folder)
        (folder / name).unlink()
        trap(folder / name)
        if name != "index.html":
            with warnings.catch_warnings(), pytest.raises(MrmError):
                warnings.simplefilter("ignore", MrmWarning)
                merge([folder], tmp_path / "merged")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MrmWarning)
            assert run_suite(suite, folder, resume=True)["summary"]["passed"] == 5
        assert (folder / "cases" / "b" / "copy").read_text() == "contents of b"
