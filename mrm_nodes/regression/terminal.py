"""What a run shows on the terminal: a progress bar on one, a few quiet lines elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from mrm_nodes.regression.outcome import Outcome
from mrm_nodes.regression.report import figure, share

COLORS = {"pass": "green", "fail": "bold red", "error": "magenta", "undecided": "yellow", "skipped": "dim"}


@contextmanager
def progress(console: Console | None = None) -> Iterator[Callable[[Outcome, int, int], None]]:
    """A function to call with each outcome: it moves the bar, and names each case that did not pass."""
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
    with bar:
        row = bar.add_task("regression", total=None, name="")

        def show(outcome: Outcome, done: int, total: int) -> None:
            bar.update(row, completed=done, total=total, name=f"{outcome.backend} {outcome.name}")
            if outcome.verdict in ("fail", "error"):
                console.print(
                    f"{_pill(outcome.verdict)} {outcome.backend} {outcome.name} {escape(_why(outcome))}"
                )

        yield show


def _why(outcome: Outcome) -> str:
    if outcome.figures is None:
        return outcome.message
    return f"{figure(outcome.figures.max_rel)} at most, {share(outcome.figures.used)} of its bound"


def _pill(verdict: str) -> str:
    return f"[{COLORS[verdict]}]{verdict}[/]"


def print_summary(report: Mapping[str, Any], page: Path, console: Console | None = None) -> None:
    """The counts, the worst case that was compared, the time, and where the page is."""
    console = console or Console(highlight=False, soft_wrap=True)
    summary = report["summary"]
    counts = [
        f"[{COLORS[verdict]}]{summary[key]} {word}[/]"
        for key, verdict, word in (
            ("passed", "pass", "passed"),
            ("failed", "fail", "failed"),
            ("errors", "error", "errors"),
            ("undecided", "undecided", "undecided"),
            ("skipped", "skipped", "skipped"),
        )
        if summary[key] or key == "passed"
    ]
    console.print(f"{', '.join(counts)} of {summary['total']} in {summary['seconds']:.0f} s")
    for name, reason in {
        case["backend"]: case["message"] for case in report["cases"] if case["verdict"] == "skipped"
    }.items():
        console.print(f"skipped {name}: {escape(reason)}")
    compared = [case for case in report["cases"] if case.get("used") is not None]
    if compared:
        worst = max(compared, key=lambda case: case["used"])
        console.print(
            f"worst: {worst['backend']} {worst['name']}, {figure(worst['max_rel'])} at most, "
            f"{share(worst['used'])} of its bound"
        )
    console.print(f"report: {escape(str(page))}")
