"""The report of a run: report.json for machines, index.html for people."""

from __future__ import annotations

import base64
import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from mrm_nodes.regression.cloud import DECADES
from mrm_nodes.regression.compare import FLOOR, VERDICTS
from mrm_nodes.regression.files import write_text
from mrm_nodes.regression.outcome import STAGES, Outcome, as_record
from mrm_nodes.regression.pictures import HEAT_DECADES, HEAT_OVER, HEAT_STOPS

TEMPLATES = Path(__file__).with_name("templates")
SCRIPTS = ("pixels.js", "wall.js", "case.js", "main.js")
"""In this order one script of the page."""


def summarise(outcomes: Iterable[Outcome], seconds: float) -> dict[str, Any]:
    """The counts of each verdict, and the seconds of the whole run."""
    counts = Counter(outcome.verdict for outcome in outcomes)
    return {
        "total": sum(counts.values()),
        "passed": counts["pass"],
        "failed": counts["fail"],
        "undecided": counts["undecided"],
        "errors": counts["error"],
        "skipped": counts["skipped"],
        "seconds": seconds,
    }


def worst_first(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """By verdict, the gravest first, then by the share of the bound that was used."""
    return sorted(
        outcomes,
        key=lambda each: (
            VERDICTS.index(each.verdict),
            -(each.figures.used if each.figures else 0.0),
            each.name,
            each.backend,
        ),
    )


def write_report(
    folder: Path, environment: Mapping[str, Any], outcomes: Sequence[Outcome], seconds: float
) -> dict[str, Any]:
    """Write report.json and index.html into a folder and return what report.json holds.

    Each file appears complete or not at all. Raises MrmError where the folder cannot be written.
    """
    ordered = worst_first(outcomes)
    report = {
        "environment": dict(environment),
        "cases": [as_record(outcome) for outcome in ordered],
        "summary": summarise(ordered, seconds),
    }
    write_text(folder / "report.json", json.dumps(report, indent=1, allow_nan=False) + "\n")
    write_text(folder / "index.html", page(report))
    return report


def page(report: Mapping[str, Any]) -> str:
    """The page of a report as report.json has it: style, script and data are inside, pictures and numbers beside it.

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
    data = {
        "report": report,
        "heat": heat,
        "floor": FLOOR,
        "stages": STAGES,
        "decades": DECADES,
    }
    return environment.get_template("index.html.j2").render(
        report=report,
        style=Markup(style),
        style_hash=_source_hash(style),
        script=Markup(script),
        script_hash=_source_hash(script),
        data=_json_in_html(data),
    )


def _json_in_html(value: Any) -> Markup:
    """JSON that no text in it can end the element of."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
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
