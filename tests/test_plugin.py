"""The pytest plugin, through runs of pytest on a studio's own tests."""

import errno
import importlib.metadata
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

# What an inner run imports it also drops; what is here already stays.
from mrm_nodes.regression import testing  # noqa: F401
from mrm_nodes.render.context import probe_backends

pytest_plugins = ["pytester"]

GUIDE = Path(__file__).parents[1] / "docs" / "pytest.md"

if not any(each.works for each in probe_backends()):
    pytest.skip("no OpenGL", allow_module_level=True)


def examples():
    """The guide's files: by the name that their first line has, their text."""
    blocks = re.findall(
        r"```(?:python|xml)\n(?:# |<!-- )(\S+?)(?: -->)?\n(.*?)```", GUIDE.read_text("utf-8"), re.DOTALL
    )
    return dict(blocks)


@pytest.fixture
def studio(pytester):
    """A folder with the guide's files."""
    for name, text in examples().items():
        path = pytester.path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, "utf-8")
    pytester.path.joinpath("tests/test_more.py").rename(pytester.path / "test_more.py")
    return pytester


def run(pytester, *arguments):
    return pytester.runpytest_inprocess("-p", "no:cacheprovider", "--mrm-report=out", "-q", *arguments)


def edit(pytester, old, new):
    path = pytester.path / "tests/tape.mtlx"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))


def stored(pytester):
    return {path.name: path.read_bytes() for path in (pytester.path / "tests/baselines").glob("*")}


def test_the_guide_s_example_is_complete(studio):
    """Fails first, is accepted, passes, and fails when the material changes."""
    first = run(studio, "tests")
    first.assert_outcomes(failed=1)
    first.stdout.fnmatch_lines(
        ["*tape-tape_by_night: no baseline yet in *", "*pytest --mrm-accept '*test_tape_by_night'"]
    )
    assert stored(studio) == {}
    accepted = run(studio, "tests", "--mrm-accept", "--mrm-reason=new dye")
    accepted.assert_outcomes(passed=1)
    accepted.stdout.fnmatch_lines(
        ["accepted *tape-tape_by_night.exr for *test_tape_by_night; it is the first"]
    )
    assert sorted(stored(studio)) == ["log.jsonl", "tape-tape_by_night.exr", "tape-tape_by_night.json"]
    assert json.loads(stored(studio)["tape-tape_by_night.json"])["accepted"]["why"] == "new dye"
    run(studio, "tests").assert_outcomes(passed=1)

    before = stored(studio)
    edit(studio, 'value="0.2, 0.2"', 'value="0.3, 0.3"')
    changed = run(studio, "tests")
    changed.assert_outcomes(failed=1)
    changed.stdout.fnmatch_lines(
        ["*tape-tape_by_night: differs from its baseline: * of its bound, max_rel *(bound 1.0e-2)*"]
    )
    assert stored(studio) == before
    assert (studio.path / "out/index.html").is_file()
    (case,) = json.loads((studio.path / "out/report.json").read_text())["cases"]
    assert case["verdict"] == "fail"
    assert all(
        (studio.path / "out" / case["files"][name]).is_file() for name in ("render", "reference", "data")
    )
    again = run(studio, "tests", "--mrm-accept")
    again.stdout.fnmatch_lines(["accepted *; it differed: *"])


def test_only_what_is_run_and_differs_is_accepted(studio):
    studio.path.joinpath("tests/test_two.py").write_text(
        """
import pytest

@pytest.mark.parametrize("what", ["one", "two", "same"])
def test_pair(mrm_render, mrm_assert_image, what):
    inputs = {} if what == "same" else {"foil/retroreflectivity": WEIGHT}
    mrm_assert_image(mrm_render("tape.mtlx", size=(24, 24), inputs=inputs), what)

WEIGHT = 0.1
"""
    )
    run(studio, "tests/test_two.py", "--mrm-accept").assert_outcomes(passed=3)
    before = stored(studio)
    changed = studio.path.joinpath("tests/test_two.py")
    changed.write_text(changed.read_text().replace("WEIGHT = 0.1", "WEIGHT = 0.9"))
    result = run(studio, "tests/test_two.py", "--mrm-accept", "-k", "one or same")
    result.assert_outcomes(passed=2, deselected=1)
    after = stored(studio)
    assert {name for name in after if before.get(name) != after[name]} == {"one.exr", "one.json", "log.jsonl"}
    assert len(re.findall(r"^accepted ", result.stdout.str(), re.MULTILINE)) == 1


def test_the_guide_s_other_tests_pass_once_accepted_and_the_report_is_of_this_run_alone(studio):
    studio.path.joinpath("test_more.py").rename(studio.path / "tests/test_more.py")
    run(studio, "tests/test_more.py", "--mrm-accept").assert_outcomes(passed=4)
    assert {name for name in stored(studio) if name.endswith(".exr")} == {
        "more-weights-0.0.exr",
        "more-weights-1.0.exr",
    }
    run(studio, "tests/test_more.py", "-k", "not lamp").assert_outcomes(passed=3, deselected=1)
    cases = json.loads((studio.path / "out/report.json").read_text())["cases"]
    assert {(case["name"], case["truth"], case["verdict"]) for case in cases} == {
        ("more-the_model_itself", "physics", "pass"),
        ("more-weights-0.0", "baseline", "pass"),
        ("more-weights-1.0", "baseline", "pass"),
    }
    assert {case["details"]["test"].partition("::")[0] for case in cases} == {"tests/test_more.py"}
    run(studio, "tests", "-k", "itself")
    (case,) = json.loads((studio.path / "out/report.json").read_text())["cases"]
    assert case["name"] == "more-the_model_itself"


def test_processes_of_xdist_share_the_report(studio):
    studio.path.joinpath("test_more.py").rename(studio.path / "tests/test_more.py")
    result = studio.runpytest_subprocess(
        "--mrm-report=out", "-q", "-n", "2", "--mrm-accept", "tests", "-k", "not itself"
    )
    result.assert_outcomes(passed=4)
    assert len(re.findall(r"^accepted ", result.stdout.str(), re.MULTILINE)) == 3
    assert len(json.loads((studio.path / "out/report.json").read_text())["cases"]) == 3


WRONG = {
    'mrm_render("none.mtlx")': "none.mtlx: no such",
    'mrm_render("tape.mtlx", lights="moon")': "moon",
    'mrm_assert_image(mrm_render("tape.mtlx", mesh="teapot.obj"))': "teapot.obj",
    'mrm_assert_image(mrm_render("tape.mtlx", inputs={"foil/shine": 1.0}))': "no input foil/shine",
    'mrm_assert_image(mrm_render("tape.mtlx"), tolerance={"flip": -1})': "tolerance flip is -1",
    'mrm_assert_image(mrm_render("tape.mtlx"), tolerance={"flop": 1})': "tolerance: no flop",
    'mrm_assert_image(mrm_render("tape.mtlx"), truth="guess")': "truth 'guess'; it is physics or baseline",
    'mrm_assert_image(mrm_render("tape.mtlx", backend="metal"))': "unknown backend metal",
}


def test_a_wrong_request_is_told_without_our_own_lines(studio):
    tests = [
        f"def test_{number}(mrm_render, mrm_assert_image):\n    {line}\n" for number, line in enumerate(WRONG)
    ]
    studio.path.joinpath("tests/test_wrong.py").write_text("\n".join(tests))
    result = run(studio, "tests/test_wrong.py")
    result.assert_outcomes(failed=len(WRONG))
    text = result.stdout.str()
    for complaint in WRONG.values():
        assert complaint in text
    assert "mrm_nodes/" not in text


def test_two_tests_cannot_share_a_name(studio):
    body = 'mrm_assert_image(mrm_render("tape.mtlx", size=(8, 8)), "same")'
    text = f"def test_{{}}(mrm_render, mrm_assert_image):\n    {body}\n"
    studio.path.joinpath("tests/test_names.py").write_text(text.format("a") + text.format("b"))
    result = run(studio, "tests/test_names.py", "--mrm-accept")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*two tests call their picture same: *::test_a and *::test_b"])


def test_two_tests_of_two_processes_cannot_share_a_name_either(studio):
    line = 'mrm_assert_image(mrm_render("tape.mtlx", size=(8, 8)), name)'
    for which, name in (("a", "Same"), ("b", "same")):
        text = f"def test_{which}(mrm_render, mrm_assert_image):\n    name = '{name}'\n    {line}\n"
        studio.path.joinpath(f"tests/test_{which}.py").write_text(text)
    result = studio.runpytest_subprocess(
        "--mrm-report=out",
        "-q",
        "-n",
        "2",
        "--dist=loadfile",
        "--mrm-accept",
        "tests",
        "-k",
        "test_a or test_b",
    )
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*two tests call their picture [sS]ame: *::test_[ab] and *::test_[ab]"])
    assert len([name for name in stored(studio) if name.endswith(".exr")]) == 1


def test_an_acceptance_that_another_run_forestalled_fails_its_test_and_is_not_counted(studio):
    studio.path.joinpath("tests/test_late.py").write_text(
        """
from mrm_nodes.regression.cases.baseline import Store

def test_late(mrm_render, mrm_assert_image, monkeypatch):
    standing = Store.standing

    def looked(store, name):
        seen = standing(store, name)
        monkeypatch.undo()
        other = mrm_render("tape.mtlx", size=(9, 9))
        from mrm_nodes.render import write_exr
        write_exr(store.folder.parent / "other.exr", other.image)
        store.accept(name, store.folder.parent / "other.exr", {"inputs": "another's"}, "quicker")
        return seen

    monkeypatch.setattr(Store, "standing", looked)
    mrm_assert_image(mrm_render("tape.mtlx", size=(8, 8)), "late")
"""
    )
    result = run(studio, "tests/test_late.py", "--mrm-accept")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "*not accepted: late: * accepted another image meanwhile (*): look at that image*",
            "1 error, 0 accepted;*",
        ]
    )
    assert json.loads(stored(studio)["late.json"])["accepted"]["why"] == "quicker"


@pytest.mark.parametrize("held", ["notes.txt", "outcomes", "index.html", "report.json"])
def test_a_folder_that_holds_anything_else_is_refused_by_name_and_left_as_it_is(studio, held):
    folder = studio.path / "precious"
    folder.mkdir()
    if held == "outcomes":
        (folder / held).mkdir()
        (folder / held / "measured.json").write_text("{}")
    else:
        (folder / held).write_text("{}")
    before = sorted((path, path.is_file() and path.read_bytes()) for path in folder.rglob("*"))
    result = studio.runpytest_subprocess("--mrm-report=precious", "-q", "tests")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(
        [f"*--mrm-report: {folder} holds {held}, which is no report of the tests; name *"]
    )
    assert sorted((path, path.is_file() and path.read_bytes()) for path in folder.rglob("*")) == before


def test_collecting_writes_nothing(studio):
    assert studio.runpytest_subprocess("--mrm-report=out", "--collect-only", "tests").ret == 0
    assert not (studio.path / "out").exists()
    run(studio, "tests")
    before = {path: path.stat().st_mtime_ns for path in (studio.path / "out").rglob("*")}
    assert studio.runpytest_subprocess("--mrm-report=out", "--collect-only", "tests").ret == 0
    assert {path: path.stat().st_mtime_ns for path in (studio.path / "out").rglob("*")} == before


def test_a_session_removes_its_own_outcomes_and_no_other_s(studio):
    other = studio.path / "out" / "outcomes" / "other"
    run(studio, "tests")
    other.mkdir()
    (other / "a.json").write_text("{}")
    run(studio, "tests").assert_outcomes(failed=1)
    assert [path.name for path in (studio.path / "out" / "outcomes").iterdir()] == ["other"]
    assert (other / "a.json").is_file()
    os.utime(other, (0, 0))  # it was killed long ago
    run(studio, "tests").assert_outcomes(failed=1)
    assert not list((studio.path / "out" / "outcomes").iterdir())


def test_a_report_that_cannot_be_written_leaves_no_outcomes(studio):
    folder = studio.path / "out"
    run(studio, "tests")
    for name in ("report.json", "index.html"):
        (folder / name).unlink()
        (folder / name).mkdir()
    result = run(studio, "tests")
    result.stdout.fnmatch_lines(["no report: *report.json: cannot be written: Is a directory"])
    assert not list((folder / "outcomes").iterdir())


def test_a_disk_that_is_full_as_a_name_is_claimed_is_one_line(studio, monkeypatch):
    def full(*arguments):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("mrm_nodes.regression.testing.Session._claim", full)
    result = run(studio, "tests")
    result.stdout.fnmatch_lines(["*out: cannot be written: No space left on device"])
    assert "testing.py" not in result.stdout.str()


def test_without_pytest_s_cache_the_report_has_a_fresh_private_folder(studio, monkeypatch):
    place = studio.path / "tmp"
    place.mkdir()
    monkeypatch.setenv("TMPDIR", str(place))
    for _ in range(2):
        studio.runpytest_subprocess("-p", "no:cacheprovider", "-q", "tests").assert_outcomes(failed=1)
    folders = list(place.glob("mrm-report-*"))
    assert len(folders) == 2
    assert all(folder.stat().st_mode & 0o777 == 0o700 for folder in folders)


def test_a_run_without_pictures_says_nothing(pytester):
    pytester.makepyfile("def test_it(): pass")
    result = pytester.runpytest_inprocess("-q")
    assert "images of materials" not in result.stdout.str()
    assert not (pytester.path / ".pytest_cache/mrm-report").exists()


def test_the_plugin_comes_with_the_package_and_weighs_nothing():
    (point,) = [each for each in importlib.metadata.entry_points(group="pytest11") if each.name == "mrm"]
    assert point.value == "mrm_nodes.pytest_plugin"
    code = "import sys, mrm_nodes.pytest_plugin; print(*sorted({name.partition('.')[0] for name in sys.modules}))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert {"numpy", "MaterialX", "numba", "OpenImageIO", "moderngl", "rich", "jinja2"}.isdisjoint(loaded)
