"""The report of a run: report.json for machines, index.html for people."""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from mrm_nodes.files import write_text
from mrm_nodes.regression.cloud import DECADES
from mrm_nodes.regression.compare import FLOOR, VERDICTS
from mrm_nodes.regression.outcome import STAGES, Outcome, as_record
from mrm_nodes.regression.pictures import HEAT_DECADES, HEAT_OVER, HEAT_STOPS

TEMPLATES = Path(__file__).with_name("templates")
SCRIPTS = ("pixels.js", "wall.js", "case.js", "main.js")
"""In this order one script of the page."""


def summarise(records: Iterable[Mapping[str, Any]], seconds: float) -> dict[str, Any]:
    """The counts of each verdict, and the seconds of the whole run."""
    counts = Counter(record["verdict"] for record in records)
    return {
        "total": sum(counts.values()),
        "passed": counts["pass"],
        "failed": counts["fail"],
        "undecided": counts["undecided"],
        "errors": counts["error"],
        "skipped": counts["skipped"],
        "seconds": seconds,
    }


def worst_first(records: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """By verdict, the gravest first, then by the share of the bound that was used."""

    def rank(record: Mapping[str, Any]) -> tuple[int, float, str, str]:
        used = record.get("used", 0.0)
        gravity = VERDICTS.index(record["verdict"])
        return gravity, -math.inf if used is None else -used, record["name"], record["backend"]

    return sorted(records, key=rank)


def write_report(
    folder: Path, environment: Mapping[str, Any], outcomes: Sequence[Outcome], seconds: float
) -> dict[str, Any]:
    """Write report.json and index.html into a folder and return what report.json holds.

    Each file appears complete or not at all. Raises MrmError where the folder cannot be written.
    """
    return write_records(folder, environment, [as_record(outcome) for outcome in outcomes], seconds)


def write_records(
    folder: Path, environment: Mapping[str, Any], records: Sequence[Mapping[str, Any]], seconds: float
) -> dict[str, Any]:
    """As `write_report`, from outcomes as `as_record` has them."""
    ordered = worst_first(records)
    report = {"environment": dict(environment), "cases": ordered, "summary": summarise(ordered, seconds)}
    text = report_text(report)
    write_text(folder / "report.json", text)
    write_text(folder / "index.html", page(report, text))
    return report


def report_text(report: Mapping[str, Any]) -> str:
    """What report.json holds: JSON with a line for each case, so that two reports can be compared line by line."""
    cases = ",\n".join(map(_compact, report["cases"]))
    environment, summary = _compact(report["environment"]), _compact(report["summary"])
    return f'{{"environment": {environment},\n"cases": [\n{cases}\n],\n"summary": {summary}}}\n'


def page(report: Mapping[str, Any], text: str) -> str:
    """The page of a report, whose `report_text` is given: style, script and data are inside, pictures and numbers
    beside it.

    It runs no other script than its own and those of its cases, and can reach no network: its Content-Security-Policy
    says so.
    """
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    heat = {"stops": HEAT_STOPS, "over": HEAT_OVER, "decades": HEAT_DECADES}
    style = environment.get_template("report.css").render(heat=heat)
    script = "\n".join((TEMPLATES / name).read_text("utf-8") for name in SCRIPTS)
    settings = _compact({"heat": heat, "floor": FLOOR, "stages": STAGES, "decades": DECADES})
    return environment.get_template("index.html.j2").render(
        report=report,
        style=Markup(style),
        style_hash=_source_hash(style),
        script=Markup(script),
        script_hash=_source_hash(script),
        data=_in_html(f'{settings[:-1]},"report":{text}}}'),
    )


def _compact(value: Any) -> str:
    # Without an indent, which costs ten times the time.
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


def _in_html(text: str) -> Markup:
    """JSON that no text in it can end the element of."""
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


def _source_hash(text: str) -> str:
    """What a Content-Security-Policy knows an inline element by."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def figure(value: float | None) -> str:
    """A measured number with two digits: 3.2e-06 as 3.2e-6."""
    if value is None:
        return "not finite"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def share(value: float | None) -> str:
    """A share of a bound: in percent, or as so many times it."""
    if value is None or value == float("inf"):
        return "not finite"
    if value >= 10:
        return f"{value:.0f} ×"
    return f"{100 * value:.0f} %" if value >= 0.0095 else f"{100 * value:.1g} %"
