"""What a run shows on the terminal: a progress bar on one, a few quiet lines elsewhere."""

from __future__ import annotations

import math
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from mrm_nodes.regression.report.page import figure, percent, share
from mrm_nodes.regression.verdict.outcome import Outcome

COLORS = {"pass": "green", "fail": "bold red", "error": "magenta", "undecided": "yellow", "skipped": "dim"}


WORDS = {
    "pass": "passed",
    "fail": "failed",
    "error": "errors",
    "undecided": "undecided",
    "skipped": "skipped",
}
"""By verdict, its name in a report's summary."""

COMPILING = "compiling the evaluator, once for this installation: a minute or two"

QUIET = 10.0
"""Seconds between two lines where there is no terminal."""

WORST = 5
MOST_GROUPS = 12


@dataclass(frozen=True)
class Shown:
    """What to call so that a run is seen."""

    outcome: Callable[[Outcome, int, int], None]
    """With each outcome: moves the bar, and names each case that did not pass."""
    compiled: Callable[[int, int], None]
    """As the evaluator is compiled, with how many of its loops are, and how many were not."""


@contextmanager
def progress(console: Console | None = None) -> Iterator[Shown]:
    """Show a run for as long as the block lasts."""
    console = console or Console(stderr=True, highlight=False, soft_wrap=True)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[name]}", style="dim"),
        console=console,
        disable=not console.is_terminal,
    )
    told = time.monotonic()

    def tell(what: str, done: int, total: int) -> None:
        """A plain line now and then, where a bar would not be seen."""
        nonlocal told
        if not console.is_terminal and done < total and time.monotonic() - told >= QUIET:
            told = time.monotonic()
            console.print(f"{what}: {done} of {total}")

    with bar:
        row = bar.add_task("regression", total=None, name="")
        compiling: list[TaskID] = []

        def compiled(done: int, total: int) -> None:
            if not compiling:
                console.print(COMPILING)
                compiling.append(bar.add_task("evaluator", total=total, name=""))
            bar.update(compiling[0], completed=done, total=total, visible=done < total)
            tell("evaluator", done, total)

        def show(outcome: Outcome, done: int, total: int) -> None:
            bar.update(row, completed=done, total=total, name=f"{outcome.backend} {outcome.name}")
            if outcome.verdict in ("fail", "error"):
                console.print(
                    f"{_pill(outcome.verdict)} {outcome.backend} {outcome.name} {escape(_why(outcome))}"
                )
            tell("regression", done, total)

        yield Shown(show, compiled)


@contextmanager
def each_warning_once() -> Iterator[None]:
    """Show a warning once for as long as the block lasts: reading a suite and each worker may have the same to say."""
    show, shown = warnings.showwarning, set[str]()

    def show_once(message: Warning | str, *others: Any, **more: Any) -> None:
        if str(message) not in shown:
            shown.add(str(message))
            show(message, *others, **more)

    warnings.showwarning = show_once
    try:
        yield
    finally:
        warnings.showwarning = show


def _why(outcome: Outcome) -> str:
    if outcome.figures is None:
        return outcome.message
    return f"{figure(outcome.figures.max_rel)} at most, {share(outcome.figures.used)} of its bound"


def _pill(verdict: str) -> str:
    return f"[{COLORS[verdict]}]{verdict}[/]"


def print_summary(report: Mapping[str, Any], page: Path, console: Console | None = None) -> None:
    """One screen of 80 columns: the counts, a row for each node where there are few, the worst, and the page."""
    console = console or Console(highlight=False)
    summary, cases = report["summary"], report["cases"]
    partial = report["environment"].get("partial")
    if partial:
        console.print(f"[yellow]partial[/]: {escape(str(partial))}")
    counts = [
        f"[{COLORS[verdict]}]{summary[word]} {word}[/]"
        for verdict, word in WORDS.items()
        if summary[word] or verdict == "pass"
    ]
    console.print(f"{', '.join(counts)} of {summary['total']} in {summary['seconds']:.0f} s")
    reasons = Counter((case["backend"], case["message"]) for case in cases if case["verdict"] == "skipped")
    for (backend, reason), count in reasons.most_common(WORST):
        console.print(f"skipped {count} on {backend}: {escape(reason)}")
    groups = sorted({(case["node"], case["target"]) for case in cases})
    if 1 < len(groups) <= MOST_GROUPS:
        console.print(_by_group(groups, cases))
    worst = [case for case in cases if case["verdict"] in ("fail", "error", "undecided")][:WORST]
    if not worst:
        compared = [case for case in cases if "used" in case]
        worst = sorted(compared, key=lambda case: math.inf if case["used"] is None else case["used"])[-1:]
    if worst:
        console.print("the worst:")
        console.print(_worst(worst))
    line = layering_line(cases)
    if line:
        console.print(escape(line), soft_wrap=True)
    console.print(f"report: {escape(str(page))}", soft_wrap=True)


def layering_line(cases: Sequence[Mapping[str, Any]]) -> str:
    """What the host's rule of layering costs the cases that were to tell it, or nothing."""
    compared = (case for case in cases if case["verdict"] != "error" and "layering" in case["details"])
    told = [(case["details"]["layering"], case["name"]) for case in compared]
    if not told:
        return ""
    most, name = max(told, key=lambda each: math.inf if each[0]["max_rel"] is None else each[0]["max_rel"])
    means = [each["mean_rel"] for each, _ in told if each["mean_rel"] is not None]
    mean = f", mean {percent(sum(means) / len(means))}" if means else ""
    of = "a case" if len(told) == 1 else f"{len(told)} cases"
    differs = f"at most {percent(most['max_rel'])} ({name}){mean}, in {of} with layers"
    return f"MaterialX's layering differs from the exact rule by {differs}"


def _by_group(groups: Sequence[tuple[str, str]], cases: Sequence[Mapping[str, Any]]) -> Table:
    """The counts of each node and target."""
    counts = Counter((case["node"], case["target"], case["verdict"]) for case in cases)
    verdicts = [verdict for verdict in WORDS if any(counts[*group, verdict] for group in groups)]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), width=80, expand=True)
    table.add_column("node", ratio=1, no_wrap=True)
    table.add_column("target", no_wrap=True, max_width=8)
    for verdict in verdicts:
        table.add_column(verdict, justify="right", no_wrap=True)
    for group in groups:
        cells = [(verdict, counts[*group, verdict]) for verdict in verdicts]
        shown = [f"[{COLORS[verdict]}]{count}[/]" if count else "" for verdict, count in cells]
        table.add_row(*(escape(name) for name in group), *shown)
    return table


def _worst(cases: Sequence[Mapping[str, Any]]) -> Table:
    """A row for each case: what it is, and its share of the bound or its message."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), width=80, expand=True, show_header=False)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True, ratio=1, overflow="ellipsis")
    table.add_column(no_wrap=True, max_width=34, overflow="ellipsis")
    for case in cases:
        told = case["message"]
        if not told and "used" in case:
            errors = f"{figure(case['max_rel'])}, {share(case['used'])} of its bound"
            told = "not finite" if case["used"] is None else errors
        table.add_row(
            _pill(case["verdict"]),
            escape(case["backend"]),
            escape(case["name"]),
            escape(" ".join(told.split())),
        )
    return table
