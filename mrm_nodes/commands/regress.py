"""`mrm-nodes regress`: run a suite and write its report."""

from __future__ import annotations

from pathlib import Path

import click

FAILED = 1
"""Exit status where a comparison failed or ended in an error."""


@click.command()
@click.option(
    "-o",
    "--output",
    "folder",
    type=Path,
    default=Path("report"),
    show_default=True,
    help="Folder of the report.",
)
@click.option("--suite", default="default", show_default=True, help="Which suite to run.")
@click.option(
    "--backend", default="auto", show_default=True, help="egl, osmesa, auto (the first that works) or all."
)
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    default=2,
    show_default=True,
    help="Worker processes, a GL context each.",
)
@click.option(
    "--filter",
    "expression",
    metavar="EXPR",
    help="Only cases whose name has this part, or matches this pattern.",
)
@click.option(
    "--configurations",
    type=click.IntRange(0),
    default=1_000_000,
    show_default=True,
    help="Random configurations of each node; 0 for images only.",
)
def regress(
    folder: Path, suite: str, backend: str, jobs: int, expression: str | None, configurations: int
) -> int:
    """Render the suite, compare each pixel with the evaluator, and write report.json and index.html."""
    from mrm_nodes.regression import suites, terminal
    from mrm_nodes.regression.run import run_suite

    tasks = suites.choose(suites.suite(suite, configurations), expression)
    with terminal.progress() as on_outcome:
        report = run_suite(tasks, folder, backend, jobs, on_outcome)
    terminal.print_summary(report, folder / "index.html")
    return FAILED if report["summary"]["failed"] or report["summary"]["errors"] else 0
