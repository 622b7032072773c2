"""`mrm-nodes vectors` and `figures`: what the evaluator says, for others to compare with."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from mrm_nodes.errors import MrmError


@click.command()
@click.option("-o", "--output", "folder", type=Path, default=Path("figures"), show_default=True)
@click.option(
    "--tape",
    type=Path,
    help="The paper's measurement of yellow tape (ALTA's retro-3M-jaune.dat): draws Figure 4 too.",
)
def figures(folder: Path, tape: Path | None) -> None:
    """Draw the papers' figures from the evaluator: PNG, SVG, and the numbers as CSV.

    \b
    mrm-nodes figures -o figures
    """
    from mrm_nodes.measured import read
    from mrm_nodes.measured.figures import write_figure_4
    from mrm_nodes.reference.figures import write_figures

    measurement = None if tape is None else read(tape)
    with _writing(folder):
        written = write_figures(folder)
        if measurement is not None:
            written += write_figure_4(measurement, folder)
        _say_written(written)


@click.command()
@click.option("-o", "--output", "path", type=Path, default=Path("vectors.json"), show_default=True)
def vectors(path: Path) -> None:
    """Write test vectors for other renderers, their schema, a page on how to use them, and examples.

    The rule: a retroreflective lobe is the forward lobe seen from v' = 2 (n.v) n - v; D, G, F and pdf are of v'.

    \b
    mrm-nodes vectors -o vectors.json
    """
    from mrm_nodes.library import root_path
    from mrm_nodes.reference.vectors import write_vectors

    with _writing(path):
        _say_written(write_vectors(path, root_path() / "docs"))


@contextlib.contextmanager
def _writing(place: Path) -> Iterator[None]:
    """Turn what can go wrong with a folder, or with a package that is not installed, into one line."""
    try:
        yield
    except ImportError as error:
        raise MrmError(str(error)) from None
    except OSError as error:
        raise MrmError(f"{place}: cannot be written: {error.strerror}; choose another with -o") from None


def _say_written(files: Sequence[Path]) -> None:
    for file in files:
        click.echo(file)
