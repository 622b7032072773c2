"""A run as JUnit XML: what continuous-integration systems show of tests.

A suite for each backend, a test for each case; a shard that `merge` misses is an error of a suite of their own.
`undecided` is a test that was skipped with its reason, and under
`--strict` a failure. The file is sound by both schemas that are in use, Jenkins' (junit-10.xsd of its xunit plugin) and
the stricter one of Ant's format (JUnit.xsd of Windy Road).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any
from xml.etree import ElementTree as ET

from mrm_nodes.regression.report.page import figure, share

_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""What XML 1.0 cannot hold, escaped or not."""


def junit_xml(report: Mapping[str, Any], strict: bool = False) -> str:
    """The XML of a report as report.json has it."""
    by_backend: dict[str, list[Mapping[str, Any]]] = {}
    for case in report["cases"]:
        by_backend.setdefault(case["backend"], []).append(case)
    for shard in report["environment"].get("missing", ()):
        by_backend.setdefault("shards", []).append(_missing(shard))
    root = ET.Element("testsuites")
    for number, (backend, cases) in enumerate(by_backend.items()):
        root.append(_suite(backend, number, cases, report["environment"], strict))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _missing(shard: str) -> dict[str, Any]:
    """A shard that did not come, as a case."""
    message = f"shard {shard} is missing: its cases were not run, or its report was not given to merge"
    place = {"backend": "shards", "target": "merge", "node": "shard"}
    return {**place, "name": f"shard {shard}", "verdict": "error", "message": message, "seconds": {}}


def _suite(
    backend: str,
    number: int,
    cases: Sequence[Mapping[str, Any]],
    environment: Mapping[str, Any],
    strict: bool,
) -> ET.Element:
    tests = [_test(case, strict) for case in cases]
    counts = {
        name: sum(test.find(child) is not None for test in tests)
        for name, child in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped"))
    }
    seconds = sum(sum(case["seconds"].values()) for case in cases)
    suite = ET.Element(
        "testsuite",
        {
            "name": _text(backend),
            "package": "mrm-nodes",
            "id": str(number),
            "tests": str(len(tests)),
            **{name: str(count) for name, count in counts.items()},
            "time": f"{seconds:.3f}",
            "timestamp": _timestamp(str(environment.get("date", ""))),
            "hostname": "localhost",
        },
    )
    known = {
        "driver": environment.get("backends", {}).get(backend),
        "platform": environment.get("platform"),
        **environment.get("versions", {}),
        "partial": environment.get("partial"),
    }
    properties = ET.SubElement(suite, "properties")
    for name, value in known.items():
        if value:
            ET.SubElement(properties, "property", {"name": _text(name), "value": _text(value)})
    suite.extend(tests)
    told = [f"{case['name']}: {words}\n" for case in cases if (words := in_words(case))]
    ET.SubElement(suite, "system-out").text = _text("".join(told))
    ET.SubElement(suite, "system-err")
    return suite


def _test(case: Mapping[str, Any], strict: bool) -> ET.Element:
    test = ET.Element(
        "testcase",
        {
            "classname": _text(f"{case['backend']}.{case['target']}.{case['node']}"),
            "name": _text(case["name"]),
            "time": f"{sum(case['seconds'].values()):.3f}",
        },
    )
    figures = in_words(case)
    message = case["message"] or figures
    verdict = case["verdict"]
    if verdict == "undecided":
        child, message = ("failure" if strict else "skipped"), f"undecided: {message}"
    else:
        child = {"fail": "failure", "error": "error", "skipped": "skipped"}.get(verdict, "")
    if child:
        attributes = {"message": _text(message)}
        if child != "skipped":
            attributes["type"] = verdict
        ET.SubElement(test, child, attributes).text = _text(figures) or None
    return test


def in_words(case: Mapping[str, Any]) -> str:
    """The figures of a case in a line; empty where nothing was compared."""
    if "used" not in case:
        return ""
    told = [f"{share(case['used'])} of its bound"]
    for name in ("max_rel", "p999_rel", "rmse", "flip", "hdr_flip"):
        if name in case and not (case[name] is None and name.endswith("flip")):
            bound = case["tolerance"].get(name)
            told.append(f"{name} {figure(case[name])}" + (f" (bound {figure(bound)})" if bound else ""))
    return ", ".join(told)


def _timestamp(date: str) -> str:
    """ISO 8601, in whole seconds and without a zone, as the schema wants it."""
    try:
        return datetime.strptime(date, "%Y-%m-%d %H:%M UTC").isoformat()
    except ValueError:
        return "1970-01-01T00:00:00"


def _text(value: Any) -> str:
    return _NOT_XML.sub("\ufffd", str(value))
