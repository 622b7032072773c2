"""`mrm-nodes bench regress` and `bench scale`: what a regression run costs."""

from __future__ import annotations

import tempfile
from pathlib import Path

import click

from mrm_nodes.errors import MrmError


@click.command()
@click.option(
    "--count",
    "counts",
    type=click.IntRange(1),
    multiple=True,
    default=(60,),
    show_default=True,
    help="Cases; may be repeated, from small to large.",
)
@click.option("--rounds", type=click.IntRange(1), default=1, show_default=True, help="Of each, in turns.")
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def regress(counts: tuple[int, ...], rounds: int, backend: str, output: Path | None) -> None:
    """Time runs of one and two jobs, cold and from the cache, and beside MaterialX's renderer and idiff.

    Overhead is the share of the workers' time, their start included, that is spent in no stage.

    \b
    mrm-nodes bench regress --count 100
    """
    from mrm_nodes.bench import regress as bench
    from mrm_nodes.files import write_text

    measured = []
    # numba compiles the evaluator once for an installation, which is no run's own cost.
    bench.measure(len(bench.suite()), 2, backend=backend)
    click.echo(
        f"{'cases':>6} {'jobs':>4} {'threads':>7} {'cases/s':>8} {'of 1 job':>8} {'CPU s':>7} {'overhead':>8} "
        f"{'shaders':>7} {'run MB':>7} {'worker MB':>9}  seconds: generate, compile, render, reference, compare"
    )
    for count in counts:
        for _ in range(rounds):
            with tempfile.TemporaryDirectory() as name:
                cache = Path(name)
                one = bench.measure(count, 1, backend=backend)
                rows = [
                    one,
                    bench.measure(count, 2, backend=backend, cache=cache),
                    bench.measure(count, 1, all_threads=True, backend=backend),
                    bench.measure(count, 1, backend=backend, cache=cache),
                ]
            for row in rows:
                threads = "cached" if row.cached else "all" if row.all_threads else "one"
                stages = " ".join(f"{seconds:.1f}" for seconds in row.stages.values())
                overhead = "" if row.cached else f"{row.overhead:.0%}"
                memory = f"{row.run_megabytes:>7.0f} {row.worker_megabytes:>9.0f}"
                click.echo(
                    f"{row.count:>6} {row.jobs:>4} {threads:>7} {row.rate:>8.1f} {row.rate / one.rate:>7.2f}x "
                    f"{row.cpu:>7.1f} {overhead:>8} {row.shaders:>7} {memory}  {stages}"
                )
            measured += rows
    _beside(backend)
    if output is not None:
        write_text(output, bench.as_json(measured))


@click.command()
@click.option(
    "--count",
    "counts",
    type=click.IntRange(1),
    multiple=True,
    default=(100, 1000, 10_000),
    show_default=True,
    help="Cases; may be repeated.",
)
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option(
    "--jobs",
    type=click.IntRange(0, 256),
    default=0,
    show_default=True,
    help="Worker processes that draw every case; with 0 one case stands for all, and the run's own work is left.",
)
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def scale(counts: tuple[int, ...], backend: str, jobs: int, output: Path | None) -> None:
    """Time suites of five cases a material: listed, run, run from the cache, and their page in a browser.

    \b
    mrm-nodes bench scale --count 100
    """
    from mrm_nodes.bench import scale as bench_scale
    from mrm_nodes.files import write_text

    click.echo(f"{'cases':>6} {'step':<18} {'seconds':>8} {'CPU s':>8} {'MB':>6} {'worker MB':>9}")
    rows = []
    for count in counts:
        for row in bench_scale.measure(count, backend, jobs):
            told = ", ".join(f"{name} {value:.3g}" for name, value in row.told.items())
            click.echo(
                f"{row.cases:>6} {row.step:<18} {row.seconds:>8.1f} {row.cpu:>8.1f} {row.megabytes:>6.0f} "
                f"{row.worker_megabytes:>9.0f}  {told}"
            )
            rows.append(row)
    if output is not None:
        write_text(output, bench_scale.as_json(rows))


def _beside(backend: str) -> None:
    from mrm_nodes.bench import regress as bench

    try:
        beside = bench.beside_materialx(backend=backend)
    except MrmError as error:
        click.echo(f"not measured: {error}")
    else:
        click.echo(f"{beside.count} materials, cases/s of each round, one thread:")
        for name in ("theirs", "drawn", "judged"):
            rates = " ".join(f"{beside.count / seconds:.1f}" for seconds in getattr(beside, name))
            label = {"theirs": "MaterialX's GlslRenderer", "drawn": "ours, drawn", "judged": "ours, judged"}[
                name
            ]
            click.echo(f"  {label:<26} {rates}")
    try:
        for row in bench.beside_idiff():
            click.echo(
                f"comparing {row.size}x{row.size}, CPU: idiff {row.command:.1f} ms, its library {row.library:.1f} ms, "
                f"ours {row.ours:.1f} ms; without reading the files, its library {row.library_alone:.1f} ms, "
                f"ours {row.ours_alone:.1f} ms"
            )
    except MrmError as error:
        click.echo(f"not measured: {error}")
