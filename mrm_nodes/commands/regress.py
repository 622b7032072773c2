"""`mrm-nodes regress`: run a suite and write its report."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from mrm_nodes.commands.options import external_option, keep_memory_limit, memory_option, time_option
from mrm_nodes.commands.progress import progress
from mrm_nodes.errors import MrmError, suggestion

FAILED = 1
"""Exit status where a comparison failed or ended in an error."""

STDOUT = Path("-")


def parse_shard(context: object, parameter: object, text: str | None) -> tuple[int, int]:
    """Number and count from `I/N`; 1/1, all of it, where there is no text.

    Raises:
        MrmError: anything else, or a number outside 1 to N.
    """
    number, _, count = (text or "1/1").partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise MrmError(f"--shard {text}: write it as 2/5, the second of five parts")
    return int(number), int(count)


LAYERINGS = ("materialx", "exact")


def parse_layering(context: object, parameter: object, text: str | None) -> str | None:
    """A rule of layering by its name.

    Raises:
        MrmError: there is none of that name.
    """
    if text is not None and text not in LAYERINGS:
        raise MrmError(f"unknown --layering {text}; {suggestion(text, LAYERINGS)}")
    return text


def _results(command: Callable[..., int]) -> Callable[..., int]:
    """The options of what is done with a report."""
    for option in (
        click.option("--strict", is_flag=True, help="Exit status 1 for cases that are undecided too."),
        click.option("--junit", type=Path, metavar="FILE", help="Write the results as JUnit XML too."),
        click.option(
            "--json", "json_file", type=Path, metavar="FILE", help="Copy report.json there too; - is stdout."
        ),
    ):
        command = option(command)
    return command


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
    help="A suite's .toml file, a folder of .mtlx files, default (the nodes' own), or full: more of it.",
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
    "--layering",
    callback=parse_layering,
    metavar="RULE",
    help="exact: tell what MaterialX's rule of layering costs each case; materialx: do not, whatever a suite says.",
)
@time_option("a case")
@memory_option("a worker process")
@click.option(
    "--resume", is_flag=True, help="Go on from what an earlier run of the same suite left in the folder."
)
@click.option("--retry-errors", is_flag=True, help="As --resume, and run again whatever ended in an error.")
@click.option("--cache", "cache_folder", type=Path, help="Folder of known results.  [default: this user's]")
@click.option(
    "--link", is_flag=True, help="Let report and cache share files as hard links, which copies nothing."
)
@click.option("--no-cache", is_flag=True, help="Render every case, and keep no results.")
@click.option("--shard", callback=parse_shard, metavar="I/N", help="Run only part I of N; see `merge`.")
@click.option(
    "--dask",
    "address",
    metavar="ADDRESS",
    help="Run on a Dask cluster: its scheduler's tcp://host:port, or local for one of --jobs workers here.",
)
@click.option(
    "--dask-security",
    "security",
    type=Path,
    metavar="FILE",
    help="For a scheduler at tls://: Dask's configuration (YAML) that names the certificates.",
)
@click.option(
    "--scenes", is_flag=True, help="Draw the scenes, to be shown above the cases: some seconds more."
)
@_results
def regress(
    folder: Path,
    suite: str,
    backend: str,
    jobs: int,
    expression: str | None,
    configurations: int,
    layering: Any,
    time_limit: float,
    memory_limit: int | None,
    resume: bool,
    retry_errors: bool,
    cache_folder: Path | None,
    link: bool,
    no_cache: bool,
    shard: tuple[int, int],
    address: str | None,
    security: Path | None,
    scenes: bool,
    allow_external: bool,
    json_file: Path | None,
    junit: Path | None,
    strict: bool,
) -> int:
    """Render the suite, compare each pixel with the evaluator, and write report.json and index.html.

    A case whose inputs did not change since it was last run is not rendered again. Ctrl-C leaves the report of
    what was done; --resume goes on from there, and after a kill.

    \b
    mrm-nodes regress -o report
    mrm-nodes regress --suite suite.toml --jobs 8 --junit results.xml
    """
    from mrm_nodes.regression.report import terminal
    from mrm_nodes.regression.run import cache, cluster
    from mrm_nodes.regression.run.runner import run_suite
    from mrm_nodes.regression.suites import selection as suites

    click.get_current_context().with_resource(terminal.each_warning_once())
    if security is not None and address is None:
        raise MrmError("--dask-security is for --dask tls://…")
    keep_memory_limit(memory_limit)
    _prepare(folder, json_file, junit)
    tasks = suites.choose(suites.suite(suite, configurations, allow_external, layering), expression)
    known = None if no_cache else cache.Cache(cache_folder or cache.default_folder(), link=link)
    _remove(json_file, junit)
    try:
        with contextlib.ExitStack() as stack:
            place = stack.enter_context(cluster.dask_cluster(address, jobs, security)) if address else None
            shown = stack.enter_context(terminal.progress())
            report = run_suite(
                tasks,
                folder,
                backend,
                jobs,
                shown.outcome,
                shard=shard,
                time_limit=time_limit,
                cache=known,
                resume=resume,
                retry_errors=retry_errors,
                cluster=place,
                gallery=_scene_gallery if scenes else None,
                on_partial=lambda partial: _write(partial, json_file, junit, strict),
                on_compiled=shown.compiled,
            )
    except KeyboardInterrupt:
        click.echo(f"interrupted; what was done is in {folder}: go on with --resume", err=True)
        raise
    return _publish(report, folder, json_file, junit, strict)


def _scene_gallery(folder: Path) -> Sequence[Mapping[str, str]]:
    from mrm_nodes.scenes import scene_gallery

    return scene_gallery(folder)


@click.command()
@click.argument("parts", type=Path, nargs=-1, required=True, metavar="DIR...")
@click.option("-o", "--output", "folder", type=Path, required=True, help="Folder of the report.")
@click.option("--partial", is_flag=True, help="Shards may be missing: only what is there decides.")
@_results
def merge(
    parts: tuple[Path, ...],
    folder: Path,
    partial: bool,
    json_file: Path | None,
    junit: Path | None,
    strict: bool,
) -> int:
    """Make one report of the reports DIR... of `regress --shard 1/N`, 2/N and so on.

    Exit status 1 where one of the N is missing, and an error in the JUnit file for each.

    \b
    mrm-nodes merge -o report part1 part2 part3
    """
    from mrm_nodes.regression.run import runner as run

    _prepare(folder, json_file, junit)
    with progress("merge", len(parts)) as step:
        report = run.merge(parts, folder, partial, step)
    return _publish(report, folder, json_file, junit, strict)


def _prepare(folder: Path, *files: Path | None) -> None:
    """Find out before a long run whether files can be written after it, and that no baseline is in their way."""
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.regression.cases.baseline import holds_baselines

    if holds_baselines(folder):
        raise MrmError(f"{folder}: baselines lie there; choose another folder with -o")
    for file in files:
        if file is not None and file != STDOUT:
            if file.is_dir():
                raise MrmError(f"{file}: this is a folder; name a file")
            if file.exists() and not file.is_file():
                raise MrmError(f"{file}: no ordinary file; name another")
            if holds_baselines(file.parent):
                raise MrmError(f"{file}: baselines lie there; name another file")
            prepare_folder(file.parent, f"name another file than {file}")


def _remove(*files: Path | None) -> None:
    """Remove what an earlier run wrote: after a kill it would be taken for this one's."""
    for file in files:
        if file is not None and file != STDOUT:
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                raise MrmError(f"{file}: cannot be replaced: {error.strerror}; name another file") from None


def _publish(
    report: Mapping[str, Any], folder: Path, json_file: Path | None, junit: Path | None, strict: bool
) -> int:
    """Write and print what is asked for of a report, and return the exit status."""
    from rich.console import Console

    from mrm_nodes.regression.report import terminal

    _write(report, json_file, junit, strict)
    # The report alone is on stdout where it was asked for there.
    console = Console(highlight=False, stderr=json_file == STDOUT)
    terminal.print_summary(report, folder / "index.html", console)
    summary = report["summary"]
    bad = summary["failed"] + summary["errors"] + (summary["undecided"] if strict else 0)
    bad += len(report["environment"].get("missing", ()))
    return FAILED if bad else 0


def _write(report: Mapping[str, Any], json_file: Path | None, junit: Path | None, strict: bool) -> None:
    """Write what is asked for besides the page."""
    from mrm_nodes.files import write_text
    from mrm_nodes.regression.report.junit import junit_xml
    from mrm_nodes.regression.report.page import report_text

    if junit is not None:
        write_text(junit, junit_xml(report, strict))
    if json_file == STDOUT:
        click.echo(report_text(report), nl=False)
    elif json_file is not None:
        write_text(json_file, report_text(report))
