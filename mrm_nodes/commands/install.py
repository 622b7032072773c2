"""`mrm-nodes install` and `uninstall`: the node library in somebody's `libraries` folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from mrm_nodes.commands.options import one_of

if TYPE_CHECKING:
    from mrm_nodes.host import Environment


@click.command()
@click.argument("folder", type=Path, metavar="DIR")
@click.option(
    "--environment",
    **one_of("any", "fis", "prefilter"),
    default="any",
    show_default=True,
    help="The method of image light of the programs that will use it, where all have one: the nodes cost less.",
)
def install(folder: Path, environment: Environment) -> None:
    """Copy the node library, GLSL included, to DIR/mrm, where DIR is a MaterialX `libraries` folder.

    \b
    mrm-nodes install path/to/libraries
    mrm-nodes install path/to/libraries --environment fis
    """
    from mrm_nodes.library import install as install_library

    files = install_library(folder, environment)
    click.echo(f"{len(files)} files in {folder / 'mrm'}")


@click.command()
@click.argument("folder", type=Path, metavar="DIR")
def uninstall(folder: Path) -> None:
    """Remove from DIR/mrm exactly what `install` wrote there.

    \b
    mrm-nodes uninstall path/to/libraries
    """
    from mrm_nodes.library import uninstall as uninstall_library

    removed, kept = uninstall_library(folder)
    click.echo(f"{len(removed)} files removed from {folder / 'mrm'}")
    for file in kept:
        click.echo(f"kept {file}: added or changed since the installation")
