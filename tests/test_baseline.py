"""Stored images: accepted case by case, recorded, and changed by nothing else."""

from __future__ import annotations

import errno
import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases import baseline
from mrm_nodes.regression.cases.baseline import Missing, Store
from mrm_nodes.regression.cases.material_case import MaterialCase
from mrm_nodes.regression.run import journal
from mrm_nodes.regression.run import runner as run
from mrm_nodes.regression.run.pool import Judged
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.verdict.outcome import as_record
from mrm_nodes.render import probe_backends, read_image, write_exr
from mrm_nodes.render.context import BackendReport

VELVET = """<materialx version="1.39">
<sheen_bsdf name="b" type="BSDF"><input name="roughness" type="float" value="0.4" /></sheen_bsdf>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="velvet" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""
DARKER = '<input name="weight" type="float" value="0.9" /></sheen_bsdf>'
SUITE = """
[defaults]
size = 32
[[case]]
material = "velvet.mtlx"
[case.matrix]
"input:b/roughness" = [0.3, 0.6]
[[case]]
material = "metal.mtlx"
"""
SOFT, ROUGH, METAL = "velvet-roughness0.3", "velvet-roughness0.6", "metal"


@pytest.fixture(scope="module")
def backend() -> str:
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working and run.required_backends():
        pytest.fail("no backend works")
    return working[0] if working else pytest.skip("no backend works")


@pytest.fixture(scope="module")
def worker(backend: str) -> Worker:
    return Worker(backend)


def run_cases(folder: Path, worker: Worker) -> dict[str, str]:
    """What `regress` does, in this process: the verdict of each case, and report.json."""
    cases = load(folder / "suite.toml").cases
    outcomes = [worker.run(case, folder / "report") for case in cases]
    around = {"backends": {worker.backend: "some driver"}, "versions": {"MaterialX": "1"}, "platform": "here"}
    report = {"environment": around, "cases": [as_record(outcome) for outcome in outcomes]}
    (folder / "report" / "report.json").write_text(json.dumps(report))
    return {outcome.name: outcome.verdict for outcome in outcomes}


@pytest.fixture(scope="module")
def made(worker: Worker, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    (folder / "velvet.mtlx").write_text(VELVET)
    (folder / "metal.mtlx").write_text(VELVET.replace("sheen_bsdf", "oren_nayar_diffuse_bsdf"))
    (folder / "suite.toml").write_text(SUITE)
    assert run_cases(folder, worker) == {SOFT: "error", ROUGH: "error", METAL: "pass"}
    return folder


@pytest.fixture
def suite(made: Path, tmp_path: Path) -> Path:
    """A folder with a suite and the report of a run without baselines."""
    return Path(shutil.copytree(made, tmp_path / "suite"))


@pytest.fixture
def command(suite: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run `mrm-nodes baseline`: exit status, stdout, stderr."""

    def call(*arguments: str) -> tuple[int, str, str]:
        files = ["--suite", str(suite / "suite.toml"), "--report", str(suite / "report")]
        with pytest.raises(SystemExit) as ended:
            cli.main(["baseline", *arguments, *files])
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call


def stored(suite: Path) -> dict[str, bytes]:
    """The files of the baselines, but for the log."""
    folder = suite / "baselines"
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*")) if path.name != baseline.LOG}


def log(suite: Path) -> list[tuple[str, str, str | None]]:
    return [(entry["what"], entry["case"], entry["why"]) for entry in Store(suite / "baselines").decisions()]


def test_a_case_without_a_baseline_is_an_error_that_says_how_to_accept_and_shows_the_render(suite: Path):
    (record,) = (
        each
        for each in json.loads((suite / "report" / "report.json").read_text())["cases"]
        if each["name"] == SOFT
    )
    assert record["truth"] == "baseline"
    assert f"mrm-nodes baseline accept {SOFT}" in record["message"]
    assert read_image(suite / "report" / record["files"]["render_data"]).max() > 0.01
    assert "reference" not in record["files"]


def test_what_is_accepted_passes_from_then_on_and_the_rest_does_not(suite: Path, command, worker: Worker):
    status, out, _ = command("accept", SOFT, "--reason", "seen on a monitor")
    assert status == 0 and f"accepted {SOFT}" in out
    assert run_cases(suite, worker) == {SOFT: "pass", ROUGH: "error", METAL: "pass"}
    assert log(suite) == [("accept", SOFT, "seen on a monitor")]


def test_provenance_says_who_when_why_and_with_what(suite: Path, command):
    command("accept", SOFT, "--reason", "as bought")
    record = Store(suite / "baselines").provenance(SOFT)
    assert record["accepted"]["why"] == "as bought" and record["accepted"]["who"]
    assert record["driver"] == "some driver" and record["versions"] == {"MaterialX": "1"}
    assert len(record["suite"]) == len(record["inputs"]) == len(record["sha256"]) == 64


def test_a_changed_material_fails_against_its_baseline(suite: Path, command, worker: Worker):
    command("accept", SOFT, "--reason", "seen")
    (suite / "velvet.mtlx").write_text(VELVET.replace("</sheen_bsdf>", DARKER))
    before = stored(suite)
    assert run_cases(suite, worker)[SOFT] == "fail"
    assert command("status")[0] == 1
    assert stored(suite) == before


def test_a_render_of_other_inputs_is_not_accepted(suite: Path, command):
    (suite / "velvet.mtlx").write_text(VELVET + "\n<!-- edited since the run -->\n")
    status, _, err = command("accept", SOFT, "--reason", "seen")
    assert status == 2 and "changed since" in err
    assert stored(suite) == {}


def test_several_are_accepted_by_a_pattern_and_each_is_named(suite: Path, command):
    status, out, _ = command("accept", "velvet-*", "--reason", "seen")
    assert status == 0
    assert f"accepted {SOFT}" in out and f"accepted {ROUGH}" in out
    assert len(log(suite)) == 2


def test_one_case_that_cannot_be_accepted_keeps_the_others_from_it(suite: Path, command):
    record = suite / "report" / "report.json"
    report = json.loads(record.read_text())
    report["cases"] = [each for each in report["cases"] if each["name"] != ROUGH]
    record.write_text(json.dumps(report))
    assert command("accept", SOFT, ROUGH, "--reason", "seen")[0] == 2
    assert stored(suite) == {}


def test_rejecting_is_recorded_and_changes_no_baseline(suite: Path, command):
    command("accept", SOFT, "--reason", "seen")
    before = stored(suite)
    status, out, _ = command("reject", SOFT, ROUGH, "--reason", "too bright")
    assert status == 0 and "as it was" in out
    assert stored(suite) == before
    assert log(suite)[1:] == [("reject", SOFT, "too bright"), ("reject", ROUGH, "too bright")]
    assert "rejected, none accepted" in command("status")[1]


def test_status_tells_missing_accepted_and_forgotten_ones_apart(suite: Path, command):
    assert command("status")[0] == 1
    command("accept", "*", "--reason", "seen")
    status, out, _ = command("status")
    assert status == 0 and out.count("accepted") == 2
    (suite / "suite.toml").write_text(SUITE.replace("[0.3, 0.6]", "[0.3]"))
    assert "of no case" in command("status")[1]


@pytest.mark.parametrize("words", [[], ["--reason", " "]])
def test_whoever_accepts_says_why(words: list[str], suite: Path, command):
    status, _, err = command("accept", SOFT, *words)
    assert status == 2 and err.count("\n") == 1 and '--reason "' in err
    assert stored(suite) == {}


TEXTURED = VELVET.replace(
    '<sheen_bsdf name="b" type="BSDF">',
    """<image name="i" type="color3"><input name="file" type="filename" value="a.exr" /></image>
<sheen_bsdf name="b" type="BSDF"><input name="color" type="color3" nodename="i" />""",
)
AGAIN = """
[[case]]
material = "velvet.mtlx"
truth = "baseline"
[[case]]
material = "textured.mtlx"
[[case]]
material = "textured.mtlx"
name = "surrounded"
environment = "sky"
"""


@pytest.mark.parametrize(
    ("versions", "again"),
    [
        ({"mrm-nodes": "0.1.0"}, True),
        (None, True),
        ("damaged", True),
        ({"mrm-nodes": "0.2.0"}, False),
        ({"mrm-nodes": "0.10.1.dev3"}, False),
        ({"mrm-nodes": "1.0"}, False),
    ],
)
def test_a_texture_that_may_have_been_a_light_is_to_be_looked_at_again(
    versions: Any, again: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """Before 0.2.0 a textured material without an environment could be lit by its own texture."""
    (tmp_path / "suite.toml").write_text(AGAIN)
    (tmp_path / "velvet.mtlx").write_text(VELVET)
    (tmp_path / "textured.mtlx").write_text(TEXTURED)
    write_exr(tmp_path / "a.exr", np.ones((4, 4, 3)))
    for case in load(tmp_path / "suite.toml").cases:
        provenance = {"inputs": baseline.fingerprint(case), "versions": versions}
        case.store.accept(case.name, tmp_path / "a.exr", provenance, "seen")
    with pytest.raises(SystemExit) as ended:
        cli.main(["baseline", "status", "--suite", str(tmp_path / "suite.toml")])
    out = capsys.readouterr().out
    assert (ended.value.code or 0) == int(again)
    marked = [line.split()[1] for line in out.splitlines() if "to be looked at again" in line]
    assert marked == (["textured"] if again else [])
    assert not isinstance(versions, dict) or out.count(versions["mrm-nodes"]) == 3


def test_diff_compares_the_last_run_with_the_baseline(suite: Path, command, worker: Worker):
    command("accept", SOFT, "--reason", "seen")
    assert command("diff", SOFT)[0] == 0
    render = suite / "report" / "cases" / worker.backend / SOFT / "render.exr"
    write_exr(render, read_image(render) * 1.02)
    status, out, _ = command("diff", SOFT)
    assert status == 1 and "fail" in out
    assert command("diff", ROUGH)[0] == 2


@pytest.mark.parametrize("name", [METAL, "nothing"])
def test_only_a_case_whose_truth_is_a_baseline_has_one(name: str, command, suite: Path):
    status, _, err = command("accept", name, "--reason", "seen")
    assert status == 2
    assert ('truth = "baseline"' in err) == (name == METAL)
    assert stored(suite) == {}


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(bytes(content))


def replace_by_another(path: Path) -> None:
    write_exr(path, np.zeros((32, 32, 3)))


@pytest.mark.parametrize(
    ("file", "harm"),
    [("exr", cut), ("exr", flip), ("exr", replace_by_another), ("exr", Path.unlink), ("json", cut)],
)
def test_a_damaged_baseline_is_an_error_that_says_what_to_do(
    file: str, harm: Callable[[Path], None], suite: Path, command, worker: Worker
):
    command("accept", SOFT, "--reason", "seen")
    harm(suite / "baselines" / f"{SOFT}.{file}")
    before = stored(suite)
    (case,) = (case for case in load(suite / "suite.toml").cases if case.name == SOFT)
    outcome = worker.run(case, suite / "report")
    assert outcome.verdict == "error"
    assert "restore it, or accept a new one" in outcome.message
    status, out, _ = command("status")
    assert status == 1 and "damaged" in out
    assert stored(suite) == before
    assert command("accept", SOFT, "--reason", "seen")[0] == 0
    assert worker.run(case, suite / "report").verdict == "pass"


@pytest.mark.parametrize("content", ["", "{", "[]", '{"cases": 3}', '{"cases": [1], "environment": {}}'])
def test_a_damaged_report_is_an_error(content: str, suite: Path, command):
    (suite / "report" / "report.json").write_text(content)
    status, _, err = command("accept", SOFT, "--reason", "seen")
    assert status == 2 and "report.json" in err


@pytest.mark.parametrize("key", ["backend", "setup", "tolerance", "files", "details"])
def test_a_report_with_something_else_in_a_record_is_an_error(key: str, suite: Path, command):
    file = suite / "report" / "report.json"
    report = json.loads(file.read_text())
    for damaged in ({**report["cases"][0], key: None}, {**report["cases"][0], key: ["x"]}):
        file.write_text(json.dumps({**report, "cases": [damaged]}))
        status, _, err = command("accept", SOFT, "--reason", "seen")
        assert status == 2 and "report.json: damaged; run regress again" in err


def test_a_damaged_render_is_not_accepted(suite: Path, command, worker: Worker):
    cut(suite / "report" / "cases" / worker.backend / SOFT / "render.exr")
    assert command("accept", SOFT, "--reason", "seen")[0] == 2
    assert stored(suite) == {}


# Nothing but `baseline accept` changes a baseline, whatever happens to a run.


@dataclass
class Studio:
    """A suite with baselines, and `mrm-nodes` on it, which judges cases in this process."""

    folder: Path
    worker: Worker
    during: list[Callable[[], None]] = field(default_factory=list)
    """What happens as each case is judged, for those that have one."""
    baselines: dict[str, tuple[bytes, int, int]] = field(default_factory=dict)
    """As they have to stay: see `look`."""

    def judge(self, tasks: list[Any], backend: str, scratch: Path, *others: object) -> Iterator[Judged]:
        """In place of worker processes."""
        for number, task in enumerate(tasks):
            for happens in self.during[number : number + 1]:
                happens()
            (scratch / str(number)).mkdir()
            yield Judged(task, self.worker.run(task, scratch / str(number)), scratch / str(number))

    def run(self, command: str, *arguments: object) -> int:
        with pytest.raises(SystemExit) as ended:
            cli.main([command, *map(str, arguments)])
        return int(ended.value.code or 0)

    def regress(self, *arguments: object, report: str = "run", cached: bool = False) -> int:
        given = ["--suite", self.folder / "suite.toml", "-o", self.folder / report, *arguments]
        return self.run("regress", *given, *([] if cached else ["--no-cache"]))

    def look(self) -> dict[str, tuple[bytes, int, int]]:
        """The contents of the baselines, their log included, and whether a file was written anew."""
        found = sorted((self.folder / "baselines").iterdir())
        return {each.name: (each.read_bytes(), each.stat().st_mtime_ns, each.stat().st_ino) for each in found}


def stop() -> None:
    raise KeyboardInterrupt


def fill_disk() -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def edit(file: Path) -> None:
    file.write_text(file.read_text().replace("</sheen_bsdf>", DARKER))


def in_two_halves(studio: Studio, harm: Callable[[], None]) -> list[int]:
    """The statuses of a run that is stopped, and of one that goes on after some harm."""
    studio.during = [lambda: None, stop]
    first = studio.regress()
    harm()
    studio.during = []
    return [first, studio.regress("--resume")]


def damage_cache(studio: Studio) -> list[int]:
    cache = studio.folder / "cache"
    first = studio.regress("--cache", cache, cached=True)
    for file in cache.glob("*/*/outcome"):
        cut(file)
    return [first, studio.regress("--cache", cache, report="other", cached=True)]


def write_over(studio: Studio) -> list[int]:
    baselines = studio.folder / "baselines"
    return [
        studio.regress(report="baselines"),
        studio.regress("--json", baselines / f"{SOFT}.json"),
        studio.regress("--junit", baselines / f"{SOFT}.exr"),
        studio.run("merge", studio.folder, "-o", baselines),
    ]


def from_shards(studio: Studio) -> list[int]:
    parts = [studio.regress("--shard", f"{part}/2", report=f"part-{part}") for part in (1, 2)]
    names = [studio.folder / f"part-{part}" for part in (1, 2)]
    return [*parts, studio.run("merge", *names, "-o", studio.folder / "merged")]


def damage(studio: Studio, name: str, harm: Callable[[Path], None]) -> None:
    harm(studio.folder / "baselines" / name)
    studio.baselines = studio.look()


def with_harm_before(studio: Studio, harm: Callable[..., object], *arguments: Any) -> list[int]:
    harm(*arguments)
    return [studio.regress()]


def with_harm_during(studio: Studio, harm: Callable[..., object], *arguments: Any) -> list[int]:
    studio.during = [lambda: None, lambda: harm(*arguments) and None]
    return [studio.regress()]


MISHAPS: dict[str, tuple[Callable[[Studio], list[int]], list[int]]] = {
    "none": (lambda s: [s.regress()], [0]),
    "the material was edited": (lambda s: with_harm_before(s, edit, s.folder / "velvet.mtlx"), [1]),
    "the material is broken": (lambda s: with_harm_before(s, cut, s.folder / "velvet.mtlx"), [1]),
    "the material is edited during the run": (
        lambda s: with_harm_during(s, edit, s.folder / "velvet.mtlx"), [1]),
    "the suite is edited during the run": (
        lambda s: with_harm_during(s, (s.folder / "suite.toml").write_text, "x = "), [0]),
    "a baseline is damaged": (lambda s: with_harm_before(s, damage, s, f"{SOFT}.exr", flip), [1]),
    "its provenance is damaged": (lambda s: with_harm_before(s, damage, s, f"{SOFT}.json", cut), [1]),
    "a baseline is damaged during the run": (
        lambda s: with_harm_during(s, damage, s, f"{ROUGH}.exr", flip), [1]),
    "Ctrl-C": (lambda s: in_two_halves(s, lambda: None), [130, 0]),
    "Ctrl-C, and the journal is cut": (
        lambda s: in_two_halves(s, lambda: cut(s.folder / "run" / journal.NAME)), [130, 0]),
    "Ctrl-C, and the report is damaged": (
        lambda s: in_two_halves(s, lambda: cut(s.folder / "run" / "report.json")), [130, 0]),
    "the cache is damaged": (damage_cache, [0, 0]),
    "the disk is full": (lambda s: with_harm_during(s, fill_disk), [2]),
    "the output cannot be written": (lambda s: [s.regress(report="suite.toml/report")], [2]),
    "a second run into the folder": (
        lambda s: with_harm_during(s, lambda: Studio(s.folder, s.worker).regress()), [0]),
    "a report is to go where baselines lie": (write_over, [2] * 4),
    "shards": (from_shards, [0, 0, 0]),
}  # fmt: skip


@pytest.mark.parametrize(("happens", "statuses"), MISHAPS.values(), ids=MISHAPS)
def test_no_baseline_is_changed_by_anything_that_happens_to_a_run(
    happens: Callable[[Studio], list[int]],
    statuses: list[int],
    suite: Path,
    command,
    worker: Worker,
    monkeypatch: pytest.MonkeyPatch,
):
    command("accept", "*", "--reason", "seen")
    studio = Studio(suite, worker)
    monkeypatch.setattr(run, "run_locally", studio.judge)
    monkeypatch.setattr(run, "probe_backends", lambda *_: [BackendReport(worker.backend, True)])
    studio.baselines = studio.look()
    assert len(studio.baselines) == 2 * 2 + 1
    assert happens(studio) == statuses
    assert studio.look() == studio.baselines


def image(folder: Path, value: float) -> Path:
    path = folder / f"{value}.exr"
    write_exr(path, np.full((4, 4, 3), value))
    return path


@pytest.mark.parametrize(
    "step", ["the image is written", "the provenance is replaced", "the image is replaced"]
)
def test_an_acceptance_that_is_cut_short_leaves_the_old_baseline_or_the_new_one(
    step: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)

    class Killed(BaseException):
        pass

    def die(*arguments: object) -> None:
        raise Killed

    original = baseline.write_durably
    second = image(tmp_path, 2.0)

    def write(path: Path, contents: bytes) -> None:
        """Dies before or after the provenance is there; the image is written before it."""
        if path.suffix == ".json" and step == "the image is written":
            raise Killed
        original(path, contents)
        if path.suffix == ".json":
            raise Killed

    if step != "the image is replaced":
        monkeypatch.setattr(baseline, "write_durably", write)
    else:
        monkeypatch.setattr(Path, "replace", die)
    with pytest.raises(Killed):
        store.accept("a", second, {"inputs": "y"}, None)
    monkeypatch.undo()
    new = step == "the provenance is replaced"
    if step != "the image is replaced":
        assert store.provenance("a")["inputs"] == ("y" if new else "x")
    assert (store.read("a") == (2.0 if store.provenance("a")["inputs"] == "y" else 1.0)).all()
    store.accept("a", image(tmp_path, 3.0), {"inputs": "z"}, None)
    assert (store.read("a") == 3.0).all()


def test_an_acceptance_for_which_there_is_no_room_leaves_the_old_baseline_and_nothing_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)
    before = stored(tmp_path)
    for full in ("os.fsync", "mrm_nodes.regression.cases.baseline.write_durably"):
        with monkeypatch.context() as patch:
            patch.setattr(full, lambda *_: fill_disk())
            with pytest.raises(MrmError, match="cannot be written: No space left on device"):
                store.accept("a", image(tmp_path, 2.0), {"inputs": "y"}, None)
        assert stored(tmp_path) == before


def test_an_image_that_is_not_the_run_s_is_not_accepted(suite: Path, command: Callable[..., Any]):
    """A later run in the same folder was cut short, or a power cut kept one file and lost another."""
    (report,) = (suite / "report").glob("cases/*")
    shutil.copyfile(report / ROUGH / "render.exr", report / SOFT / "render.exr")
    status, _, err = command("accept", SOFT, "--reason", "looked at")
    assert status == 2
    assert err.endswith("render.exr: not the render that the run came to: go on with regress --resume\n")
    assert stored(suite) == {}
    assert command("accept", ROUGH, "--reason", "looked at")[0] == 0


def test_two_acceptances_that_are_cut_short_leave_the_first_one_s_image(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    store = Store(tmp_path / "baselines")
    first, second = image(tmp_path, 1.0), image(tmp_path, 2.0)
    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", lambda *_: stop())
        patch.setattr(baseline, "write_durably", lambda path, contents: path.write_bytes(contents))
        with pytest.raises(KeyboardInterrupt):
            store.accept("a", first, {"inputs": "x"}, None)
    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", lambda *_: stop())
        with pytest.raises(KeyboardInterrupt):
            store.accept("a", second, {"inputs": "y"}, None)
    assert (store.read("a") == 1.0).all()


def test_a_store_that_cannot_be_written_is_one_clear_error_and_stays_as_it_is(tmp_path: Path):
    (tmp_path / "baselines").write_text("a file in the way")
    with pytest.raises(MrmError, match="cannot be written"):
        Store(tmp_path / "baselines").accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)


def test_a_baseline_of_another_size_is_an_error(tmp_path: Path):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, None)
    with pytest.raises(MrmError, match=r"4 × 4 pixels, but the case 8 × 8"):
        store.read("a", (8, 8, 3))
    with pytest.raises(Missing, match="no baseline yet"):
        store.read("b")


def test_a_damaged_log_costs_its_lines_only(tmp_path: Path):
    store = Store(tmp_path / "baselines")
    store.accept("a", image(tmp_path, 1.0), {"inputs": "x"}, "first")
    with (tmp_path / "baselines" / baseline.LOG).open("a") as file:
        file.write('{"what": "acc\n')
    store.reject("a", image(tmp_path, 2.0), "second")
    assert [entry["why"] for entry in store.decisions()] == ["first", "second"]


def test_a_fingerprint_follows_what_is_rendered_and_nothing_else(suite: Path):
    def of(text: str) -> str:
        (suite / "suite.toml").write_text(text)
        (case,) = (case for case in load(suite / "suite.toml").cases if case.name == SOFT)
        assert isinstance(case, MaterialCase)
        return baseline.fingerprint(case)

    first = of(SUITE)
    assert of(SUITE + '\n[tolerances]\nt = { flip = 0.1 }\n[[adjust]]\ncases = "*"\ntolerance = "t"') == first
    assert of(SUITE.replace("size = 32", "size = 33")) != first
    assert of(SUITE.replace("size = 32", 'size = 32\nmesh = "plane"')) != first
