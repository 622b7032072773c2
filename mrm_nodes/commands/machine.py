"""`mrm-nodes doctor`, `warmup` and `targets`: what is installed here, and whether it works."""

from __future__ import annotations

import click

from mrm_nodes.errors import MrmError


@click.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
def doctor(backend: str) -> int:
    """Say which compilers and OpenGL were found, whether a render works, and how to mend what does not.

    \b
    mrm-nodes doctor
    """
    from mrm_nodes.doctor import examine

    return examine(backend)


@click.command()
def warmup() -> None:
    """Compile the evaluator now, once for this installation, so that no first run waits for it.

    \b
    mrm-nodes warmup
    """
    from mrm_nodes.reference.warmup import folder, warm_up
    from mrm_nodes.regression.report import terminal

    with terminal.progress() as shown:
        count = warm_up(lambda name, done, total: shown.compiled(done, total))
    place = folder()
    if place is None:
        raise MrmError(
            "what is compiled can be kept nowhere; set NUMBA_CACHE_DIR to a folder that can be written"
        )
    click.echo(f"{f'{count} loops compiled' if count else 'nothing to compile'}: they are kept in {place}")


@click.command()
@click.option(
    "--configurations",
    type=click.IntRange(100),
    default=50_000,
    show_default=True,
    help="Random configurations of each node, wherever a target can be run.",
)
def targets(configurations: int) -> None:
    """Compile and run the nodes in every target, and print what did it and the worst errors.

    \b
    mrm-nodes targets --configurations 1000
    """
    from rich.console import Console
    from rich.table import Table

    from mrm_nodes.regression.targets import table

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.2g}"

    printed = Table("target", "compiled by", "run on", "of its bound", "with film", "error, alpha >= 0.1")
    for row in table(configurations):
        errors = (number(value) for value in (row.used, row.used_film, row.error))
        printed.add_row(row.target, row.compiled_by, row.run_on, *errors)
    Console(markup=False, width=140).print(printed)
