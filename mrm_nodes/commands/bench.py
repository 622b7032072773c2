"""`mrm-nodes bench`: what the nodes, the evaluator and a regression run cost."""

from __future__ import annotations

from pathlib import Path

import click

from mrm_nodes.commands.bench_regress import regress, scale
from mrm_nodes.commands.helptext import Group

_BENCH_COLUMNS = "  (b)/(a)  0.5/(b)    0/(a)    1/(a)  SPIR-V instructions of (a), (b), 0.5"


@click.group(cls=Group)
def bench() -> None:
    """Measure what the nodes and the evaluator cost."""


bench.add_command(regress)
bench.add_command(scale)


@bench.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option("--size", type=click.IntRange(16, 4096), default=256, show_default=True, help="Pixels a side.")
@click.option("--rounds", type=click.IntRange(3, 1000), default=21, show_default=True, help="Frames of each.")
@click.option("--surfaces", is_flag=True, help="Time the whole surfaces instead of the nodes.")
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def shader(backend: str, size: int, rounds: int, surfaces: bool, output: Path | None) -> None:
    """Time the blended nodes beside MaterialX's own node (a) and its mix of two (b).

    \b
    mrm-nodes bench shader --size 128
    """
    import json

    from mrm_nodes.bench import shader as shader_bench
    from mrm_nodes.files import write_text

    if surfaces:
        from mrm_nodes.bench.surfaces import print_table

        return print_table(backend, size, rounds, output)
    machine = shader_bench.describe_machine(backend)
    for what, value in machine.items():
        click.echo(f"{what:<10} {value}")
    click.echo(f"{'node':<28} {'light':<7} {'interface':<9} {'film':<4} {'(a) ms':>8} " + _BENCH_COLUMNS)
    rows = []
    for row in shader_bench.bench_shaders(backend, size, rounds, instructions=True):
        ratios = " ".join(f"{value:>8.2f}" for value in row.ratios.values())
        counts = " ".join(f"{row.instructions.get(name, 0):>6}" for name in ("single", "mix", "ours 0.5"))
        film = "on" if row.film else "off"
        place = f"{row.node:<28} {row.light:<7} {row.interface:<9} {film:<4}"
        click.echo(f"{place} {row.milliseconds['single']:>8.2f} {ratios} {counts}")
        rows.append(row)
    if output is not None:
        write_text(output, json.dumps(shader_bench.as_json(rows, machine), indent=2) + "\n")


@bench.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option("--size", type=click.IntRange(1, 4096), default=128, show_default=True, help="Pixels a side.")
@click.option("--count", type=click.IntRange(1), default=40, show_default=True, help="Renders a round.")
@click.option("--rounds", type=click.IntRange(1), default=5, show_default=True, help="Of each, in turns.")
def threads(backend: str, size: int, count: int, rounds: int) -> None:
    """Time renders from four threads beside the same from one.

    \b
    mrm-nodes bench threads
    """
    from statistics import median

    from mrm_nodes.bench.shader import bench_threads

    one, four = (median(seconds) for seconds in bench_threads(backend, size, count, rounds).values())
    click.echo(f"{count} renders at {size} x {size}: {one:.2f} s from one thread, {four:.2f} s from four")
    click.echo(f"four threads take {four / one:.2f} of the time of one")


@bench.command()
@click.option(
    "--count", type=click.IntRange(1), default=1 << 20, show_default=True, help="Evaluations a call."
)
@click.option("--growth", is_flag=True, help="Also time a conductor from 10^5 to 10^8 evaluations.")
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def reference(count: int, growth: bool, output: Path | None) -> None:
    """Time the evaluator beside NumPy and, where it is installed, Mitsuba's LLVM variant.

    \b
    mrm-nodes bench reference
    """
    import json
    from dataclasses import asdict
    from itertools import chain

    from mrm_nodes.bench import reference as evaluator_bench
    from mrm_nodes.files import write_text

    click.echo(
        f"{'subject':<28} {'question':<8} {'lobe':<22} {'cores':>5} {'count':>10} {'seconds':>8} "
        f"{'million/s':>10} {'/Mitsuba':>8} {'peak MiB':>8}"
    )
    rows = []
    for row in chain(evaluator_bench.measure(count), evaluator_bench.growth() if growth else ()):
        rows.append(row)
        place = f"{row.subject:<28} {row.question:<8} {row.lobe:<22} {row.cores:>5} {row.count:>10}"
        ratio = "" if row.of_mitsuba is None else f"{row.of_mitsuba:.2f}"
        peak = "" if row.peak is None else f"{row.peak:.0f}"
        click.echo(f"{place} {row.seconds:>8.4f} {row.rate / 1e6:>10.4g} {ratio:>8} {peak:>8}")
    if output is not None:
        write_text(output, json.dumps([asdict(row) | {"rate": row.rate} for row in rows], indent=2) + "\n")
