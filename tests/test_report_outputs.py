"""What a run leaves besides its page: JUnit XML, JSON, a summary on the terminal, an exit status."""

import io
import json
import re
import warnings
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from mrm_nodes import cli
from mrm_nodes.commands.regress import regress
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.report.junit import junit_xml
from mrm_nodes.regression.report.page import summarise
from mrm_nodes.regression.report.terminal import print_summary
from mrm_nodes.regression.run import runner as run
from mrm_nodes.regression.verdict.compare import Figures
from mrm_nodes.regression.verdict.outcome import as_record, outcome_of

ENVIRONMENT = {
    "date": "2026-07-01 12:34 UTC",
    "platform": "Linux",
    "backends": {"egl": "llvmpipe"},
    "versions": {"MaterialX": "1.39.5"},
}
EVIL = "]]> <b attr=\"'&amp;\x00\x1b\ud800\uffff\N{PILE OF POO}\n"


def report(*verdicts, message="", **environment):
    cases = default_suite()
    told = []
    for verdict, case in zip(verdicts, cases * (1 + len(verdicts) // len(cases)), strict=False):
        outcome = outcome_of(case, "osmesa" if verdict == "skipped" else "egl", verdict, message=message)
        if verdict in ("pass", "fail"):
            outcome.figures = Figures(1e-3, 2e-4, 1e-5, 1e-6, 0.5 if verdict == "pass" else 2.0, 10, 9)
            outcome.tolerance = {"max_rel": 1e-4}
        outcome.seconds["render"] = 0.25
        told.append(outcome)
    return {
        "environment": {**ENVIRONMENT, **environment},
        "cases": [as_record(each) for each in told],
        "summary": summarise(map(as_record, told), 12.0),
    }


EVERY = ("fail", "error", "undecided", "pass", "pass", "skipped")

# JUnit. What Ant's schema (https://github.com/windyroad/JUnit-Schema) asks for and Jenkins' allows.

ATTRIBUTES = {
    "testsuites": set(),
    "testsuite": {
        "name", "package", "id", "tests", "failures", "errors", "skipped", "time", "timestamp", "hostname",
    },
    "properties": set(),
    "property": {"name", "value"},
    "testcase": {"classname", "name", "time"},
    "failure": {"message", "type"},
    "error": {"message", "type"},
    "skipped": {"message"},
    "system-out": set(),
    "system-err": set(),
}  # fmt: skip
CHILDREN = {
    "testsuites": r"(testsuite )*",
    "testsuite": r"properties (testcase )*system-out system-err ",
    "properties": r"(property )*",
    "testcase": r"((skipped|error|failure) )?",
}


def parsed(text):
    """The tree, once it has the elements, attributes and order of the schema, and counts that add up."""
    root = ET.fromstring(text.encode())
    for element in root.iter():
        assert set(element.attrib) == ATTRIBUTES[element.tag]
        children = "".join(f"{child.tag} " for child in element)
        assert re.fullmatch(CHILDREN.get(element.tag, ""), children)
    for number, suite in enumerate(root):
        assert int(suite.get("id")) == number
        assert int(suite.get("tests")) == len(suite.findall("testcase"))
        for name, child in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.get(name)) == len(suite.findall(f"testcase/{child}"))
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", suite.get("timestamp"))
        for element in (suite, *suite.iter("testcase")):
            assert re.fullmatch(r"\d+\.\d{3}", element.get("time"))
    return root


def test_another_s_reader_finds_names_counts_times_and_verdicts():
    junitparser = pytest.importorskip("junitparser")
    told = report(*EVERY, message="why", partial="it was interrupted")
    egl, osmesa = junitparser.JUnitXml.fromstring(junit_xml(told).encode())
    assert (egl.name, egl.tests, egl.failures, egl.errors, egl.skipped) == ("egl", 5, 1, 1, 1)
    assert (osmesa.name, osmesa.tests, osmesa.failures, osmesa.errors, osmesa.skipped) == (
        "osmesa",
        1,
        0,
        0,
        1,
    )
    counted = junitparser.TestSuite.fromelem(egl._elem)
    counted.update_statistics()
    assert (counted.tests, counted.failures, counted.errors, counted.skipped) == (5, 1, 1, 1)
    assert counted.time == pytest.approx(1.25)
    tests = [*egl, *osmesa]
    assert [test.name for test in tests] == [case["name"] for case in told["cases"]]
    assert [test.time for test in tests] == [0.25] * 6
    kinds = ("is_failure", "is_error", "is_skipped", "is_passed", "is_passed", "is_skipped")
    for test, kind in zip(tests, kinds, strict=True):
        assert [each for each in sorted(set(kinds)) if getattr(test, each)] == [kind]
    (properties,) = egl.iterchildren(junitparser.Properties)
    known = {each.name: each.value for each in properties}
    assert known["driver"] == "llvmpipe" and known["partial"] == "it was interrupted"


def test_every_verdict_has_its_place():
    root = parsed(junit_xml(report(*EVERY, message="why")))
    egl, osmesa = root
    kinds = [[child.tag for child in test] for test in egl.findall("testcase")]
    assert kinds == [["failure"], ["error"], ["skipped"], [], []]
    names = [test.get("name") for test in egl.findall("testcase")]
    assert [line.partition(":")[0] for line in egl.find("system-out").text.splitlines()] == [
        names[0],
        *names[3:],
    ]
    assert [test[0].get("message") for test in egl.findall("testcase")[1:3]] == ["why", "undecided: why"]
    assert osmesa.find("testcase/skipped").get("message") == "why"
    assert egl.get("timestamp") == "2026-07-01T12:34:00"
    assert float(egl.get("time")) == pytest.approx(1.25)


def test_a_failure_tells_its_figures():
    (failure,) = parsed(junit_xml(report("fail"))).iter("failure")
    assert (
        failure.get("message")
        == "200 % of its bound, max_rel 2.0e-4 (bound 1.0e-4), p999_rel 1.0e-5, rmse 1.0e-6"
    )
    assert failure.get("type") == "fail"


def test_strict_makes_undecided_a_failure():
    assert parsed(junit_xml(report("undecided"), strict=True)).find(".//failure").get("type") == "undecided"


def test_what_xml_cannot_hold_is_replaced():
    wild = report("error", message=EVIL, partial=EVIL)
    wild["cases"][0]["name"] = EVIL
    root = parsed(junit_xml(wild))
    clean = (
        EVIL.replace("\x00", "\ufffd")
        .replace("\x1b", "\ufffd")
        .replace("\ud800", "\ufffd")
        .replace("\uffff", "\ufffd")
    )
    assert root.find(".//error").get("message") == clean
    assert root.find(".//testcase").get("name") == clean


def test_a_run_without_cases_is_xml():
    assert len(parsed(junit_xml(report()))) == 0


# The terminal


def printed(told, width=80):
    stream = io.StringIO()
    print_summary(told, Path("/tmp/a report/index.html"), Console(file=stream, width=width, highlight=False))
    return stream.getvalue()


def test_the_summary_is_one_screen_of_80_columns():
    verdicts = ["fail"] * 30 + ["error"] * 3 + ["skipped"] * 9 + ["pass"] * 100
    text = printed(report(*verdicts, message="GLSL: 0:1(1): error: " + 40 * "long "))
    lines = text.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    assert lines[0] == "100 passed, 30 failed, 3 errors, 9 skipped of 142 in 12 s"
    assert sum(line.startswith("fail ") for line in lines) == 5
    assert lines[-1] == "report: /tmp/a report/index.html"


def test_the_summary_counts_by_node():
    row = next(
        line for line in printed(report(*EVERY * 20)).splitlines() if line.startswith("mrm_dielectric")
    )
    counts = [
        case["verdict"] for case in report(*EVERY * 20)["cases"] if case["node"] == "mrm_dielectric_bsdf"
    ]
    wanted = [counts.count(verdict) for verdict in ("pass", "fail", "error", "undecided", "skipped")]
    assert [int(number) for number in row.split()[2:]] == [count for count in wanted if count]


def test_a_message_is_no_markup_and_a_long_path_is_not_broken():
    assert "[red]x[/] [bold" in printed(report("error", message="[red]x[/] [bold"))
    assert "report: /tmp/a report/index.html" in printed(report("pass"), width=20)


def test_the_worst_of_a_run_that_passed_is_named():
    told = report("pass", "pass")
    told["cases"][1]["used"] = 0.75
    told["cases"][0]["used"] = 0.0
    assert "75 % of its bound" in printed(told)
    assert "0 % of its bound" not in printed(told).replace("75 %", "")


def test_a_partial_run_says_so():
    assert printed(report("pass", partial="it was interrupted")).startswith("partial: it was interrupted")


# The command


def invoke(monkeypatch, told, *arguments):
    monkeypatch.setattr(run, "run_suite", lambda *given, **others: told)
    with_folder = ["--no-cache", "--configurations", "0", *map(str, arguments)]
    return CliRunner().invoke(regress, with_folder, standalone_mode=False)


@pytest.mark.parametrize(
    ("verdicts", "strict", "status"),
    [
        (("pass", "skipped"), True, 0),
        (("undecided",), False, 0),
        (("undecided",), True, 1),
        (("fail",), False, 1),
        (("error",), False, 1),
    ],
)
def test_the_exit_status_follows_the_verdicts(monkeypatch, verdicts, strict, status):
    result = invoke(monkeypatch, report(*verdicts), *(["--strict"] if strict else []))
    assert result.return_value == status


def test_junit_and_json_are_written_where_they_are_asked_for(monkeypatch, tmp_path):
    told = report(*EVERY)
    junit, copy = tmp_path / "new" / "junit.xml", tmp_path / "copy.json"
    result = invoke(monkeypatch, told, "--junit", junit, "--json", copy)
    assert result.return_value == 1
    assert len(parsed(junit.read_text("utf-8")).findall("testsuite/testcase")) == 6
    assert json.loads(copy.read_text()) == told


def test_a_run_that_is_ended_writes_them_too(monkeypatch, tmp_path):
    told = report("pass", "skipped", partial="it was interrupted")

    def ended(*given, on_partial, **others):
        on_partial(told)
        raise KeyboardInterrupt

    junit, copy = tmp_path / "junit.xml", tmp_path / "copy.json"
    monkeypatch.setattr(run, "run_suite", ended)
    with pytest.raises(SystemExit, match="130"):
        cli.main(
            ["regress", "--no-cache", "--configurations", "0", "--junit", str(junit), "--json", str(copy)]
        )
    (suite, other) = parsed(junit.read_text("utf-8"))
    assert suite.find("properties/property[@name='partial']").get("value") == "it was interrupted"
    assert other.get("skipped") == "1"
    assert json.loads(copy.read_text()) == told


def test_files_of_an_earlier_run_are_gone_when_one_begins(monkeypatch, tmp_path):
    """After kill -9 they would be taken for its own."""
    files = [tmp_path / "junit.xml", tmp_path / "copy.json"]
    for file in files:
        file.write_text("earlier")
    monkeypatch.setattr(run, "run_suite", lambda *given, **others: seen.extend(map(Path.exists, files)))
    seen = []
    arguments = ["--no-cache", "--configurations", "0", "--junit", str(files[0]), "--json", str(files[1])]
    CliRunner().invoke(regress, arguments, standalone_mode=False)
    assert seen == [False, False]


def test_a_warning_that_comes_from_several_places_is_one_line(monkeypatch, tmp_path, capsys):
    def warning(*given, **others):
        for level in (1, 2, 1):
            warnings.warn(f"{tmp_path}: the mesh has no normals", MrmWarning, stacklevel=level)
        return report("pass")

    monkeypatch.setattr(run, "run_suite", warning)
    with pytest.raises(SystemExit, match="0"):
        cli.main(["regress", "--no-cache", "--configurations", "0"])
    assert capsys.readouterr().err == f"warning: {tmp_path}: the mesh has no normals\n"


def test_json_on_stdout_is_alone_there(monkeypatch):
    told = report(*EVERY)
    result = invoke(monkeypatch, told, "--json", "-")
    assert json.loads(result.stdout) == told
    assert "2 passed" in result.stderr


def test_a_file_that_cannot_be_written_is_told_before_the_run(monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(run, "run_suite", lambda *given, **others: pytest.fail("it ran"))
    for place, message in (
        (tmp_path / "file" / "junit.xml", "cannot be written"),
        (tmp_path, "this is a folder"),
    ):
        result = CliRunner().invoke(regress, ["--junit", str(place)], standalone_mode=False)
        assert isinstance(result.exception, MrmError)
        assert message in str(result.exception)


def test_figures_that_are_not_finite_are_told():
    broken = report("fail")
    outcome = outcome_of(
        default_suite()[0], "egl", "fail", figures=Figures(np.inf, np.inf, np.inf, np.inf, np.inf, 1, 1)
    )
    broken["cases"] = [as_record(outcome)]
    assert "not finite" in printed(broken)
    assert "max_rel not finite" in junit_xml(broken)
