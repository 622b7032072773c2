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

from mrm_nodes.files import place_in, write_text
from mrm_nodes.regression.cases.cloud import DECADES
from mrm_nodes.regression.cases.pictures import HEAT_DECADES, HEAT_OVER, HEAT_STOPS
from mrm_nodes.regression.verdict.compare import FLOOR, VERDICTS
from mrm_nodes.regression.verdict.outcome import STAGES, Outcome, as_record

MOST_INSIDE = 1000
"""Records that the page holds itself: with more it takes a browser seconds to show."""
PIECES = "cases/records"
PIECE = 100
"""Where the other records lie, and how many in a file."""

_SHOWN = (
    "name",
    "kind",
    "node",
    "target",
    "backend",
    "truth",
    "verdict",
    "message",
    "used",
    "max_rel",
    "notices",
)

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
    lines = list(map(_compact, ordered))
    write_text(folder / "report.json", _text(report, lines))
    _write_pieces(folder, lines)
    # At last: it names the pieces.
    write_text(folder / "index.html", page(report, lines))
    return report


def report_text(report: Mapping[str, Any]) -> str:
    """What report.json holds: JSON with a line for each case, so that two reports can be compared line by line."""
    return _text(report, list(map(_compact, report["cases"])))


def _text(report: Mapping[str, Any], lines: Sequence[str]) -> str:
    cases = ",\n".join(lines)
    environment, summary = _compact(report["environment"]), _compact(report["summary"])
    return f'{{"environment": {environment},\n"cases": [\n{cases}\n],\n"summary": {summary}}}\n'


def _write_pieces(folder: Path, lines: Sequence[str]) -> None:
    """Write the records that the page loads as they are looked at, where it does not hold them itself."""
    wanted = range(0, len(lines), PIECE) if len(lines) > MOST_INSIDE else range(0)
    for stale in (folder / PIECES).glob("*.js"):
        if stale.stem.isdecimal() and int(stale.stem) >= len(wanted):
            stale.unlink(missing_ok=True)
    for number, start in enumerate(wanted):
        place = place_in(folder, f"{PIECES}/{number}.js")
        write_text(place, "mrmCase([\n" + ",\n".join(lines[start : start + PIECE]) + "\n]);\n")


def _brief(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """What the page shows of a case before it is opened; a cloud's figures are in a table of the page."""
    if record["details"].get("decades"):
        return record
    shown = {name: record[name] for name in _SHOWN if name in record}
    files = {name: record["files"][name] for name in ("render", "error") if name in record["files"]}
    # The wall is sorted by it.
    details = {name: value for name, value in record["details"].items() if name == "layering"}
    return {**shown, "seconds": {"all": sum(record["seconds"].values())}, "files": files, "details": details}


def page(report: Mapping[str, Any], lines: Sequence[str]) -> str:
    """The page of a report, whose cases are given as lines of JSON too: style, script and data are inside, pictures
    and numbers beside it, and of more than MOST_INSIDE cases what is not on the wall.

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
    cases = report["cases"]
    seconds = {stage: sum(each["seconds"].get(stage, 0.0) for each in cases) for stage in STAGES}
    is_large = len(cases) > MOST_INSIDE
    pieces = {"folder": PIECES, "size": PIECE if is_large else 0}
    settings = _compact(
        {"heat": heat, "floor": FLOOR, "seconds": seconds, "decades": DECADES, "pieces": pieces}
    )
    text = _text(report, [_compact(_brief(each)) for each in cases] if is_large else lines)
    return environment.get_template("index.html.j2").render(
        report=report,
        decades=DECADES,
        heat=heat,
        thousands=thousands,
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


def thousands(count: int) -> str:
    """A whole number, its digits in groups of three."""
    return f"{count:,}".replace(",", " ")


def figure(value: float | None) -> str:
    """A measured number with two digits: 3.2e-06 as 3.2e-6."""
    if value is None:
        return "not finite"
    if value == 0:
        return "0"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def percent(value: float | None) -> str:
    """A relative difference, two digits of it."""
    if value is None:
        return "not finite"
    return f"{100 * value:.2g} %" if value < 1.0 else f"{thousands(round(100 * value))} %"


def share(value: float | None) -> str:
    """A share of a bound: in percent, or as so many times it; None for more than any number.

    That is so where the error is not finite, and where the bound is 0.
    """
    if value is None or value == float("inf"):
        return "∞ ×"
    if value >= 1e6:
        return f"{figure(value)} ×"
    if value >= 10:
        return f"{thousands(round(value))} ×"
    return f"{100 * value:.0f} %" if value >= 0.0095 else f"{100 * value:.1g} %"
