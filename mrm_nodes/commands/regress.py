"""`mrm-nodes regress`: run a suite and write its report."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import click

from mrm_nodes.commands.options import external_option
from mrm_nodes.errors import MrmError

FAILED = 1
"""Exit status where a comparison failed or ended in an error."""


def parse_shard(context: object, parameter: object, text: str | None) -> tuple[int, int]:
    """Number and count from `I/N`; 1/1, all of it, where there is no text.

    Raises:
        MrmError: anything else, or a number outside 1 to N.
    """
    number, _, count = (text or "1/1").partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise MrmError(f"--shard {text}: write it as 2/5, the second of five parts")
    return int(number), int(count)


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
@click.option(
    "--suite",
    default="default",
    show_default=True,
    help="A suite's .toml file, a folder of .mtlx files, or default: the nodes' own.",
)
@external_option
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
@click.option(
    "--time-limit",
    type=click.FloatRange(0, min_open=True),
    default=600.0,
    show_default=True,
    metavar="SECONDS",
    help="What a case may take.",
)
@click.option(
    "--resume", is_flag=True, help="Go on from what an earlier run of the same suite left in the folder."
)
@click.option("--cache", "cache_folder", type=Path, help="Folder of known results.  [default: this user's]")
@click.option("--no-cache", is_flag=True, help="Render every case, and keep no results.")
@click.option("--shard", callback=parse_shard, metavar="I/N", help="Run only part I of N; see `merge`.")
@click.option(
    "--dask",
    "address",
    metavar="ADDRESS",
    help="Run on a Dask cluster: its scheduler's tcp://host:port, or local for one of --jobs workers here.",
)
def regress(
    folder: Path,
    suite: str,
    backend: str,
    jobs: int,
    expression: str | None,
    configurations: int,
    time_limit: float,
    resume: bool,
    cache_folder: Path | None,
    no_cache: bool,
    shard: tuple[int, int],
    address: str | None,
    allow_external: bool,
) -> int:
    """Render the suite, compare each pixel with the evaluator, and write report.json and index.html.

    A case whose inputs did not change since it was last run is not rendered again. Ctrl-C leaves the report of
    what was done; --resume goes on from there, and after a kill.
    """
    from mrm_nodes.regression import cache, cluster, suites, terminal
    from mrm_nodes.regression.run import run_suite

    tasks = suites.choose(suites.suite(suite, configurations, allow_external), expression)
    known = None if no_cache else cache.Cache(cache_folder or cache.default_folder())
    try:
        with contextlib.ExitStack() as stack:
            place = stack.enter_context(cluster.dask_cluster(address, jobs)) if address else None
            on_outcome = stack.enter_context(terminal.progress())
            report = run_suite(
                tasks,
                folder,
                backend,
                jobs,
                on_outcome,
                shard=shard,
                time_limit=time_limit,
                cache=known,
                resume=resume,
                cluster=place,
            )
    except KeyboardInterrupt:
        click.echo(f"interrupted; what was done is in {folder}: go on with --resume", err=True)
        raise
    terminal.print_summary(report, folder / "index.html")
    return _status(report)


@click.command()
@click.argument("parts", type=Path, nargs=-1, required=True, metavar="DIR...")
@click.option("-o", "--output", "folder", type=Path, required=True, help="Folder of the report.")
def merge(parts: tuple[Path, ...], folder: Path) -> int:
    """Make one report of the reports DIR... of `regress --shard 1/N`, 2/N and so on."""
    from mrm_nodes.regression import run, terminal

    report = run.merge(parts, folder)
    terminal.print_summary(report, folder / "index.html")
    return _status(report)


def _status(report: dict[str, Any]) -> int:
    return FAILED if report["summary"]["failed"] or report["summary"]["errors"] else 0
