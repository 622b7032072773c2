"""The command line: parses, calls, prints. Heavy imports wait until a command needs them."""

from __future__ import annotations

import errno
import os
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import version
from typing import Any, NoReturn

import click

from mrm_nodes.allowance import out_of_memory
from mrm_nodes.commands.baseline import baseline
from mrm_nodes.commands.bench import bench
from mrm_nodes.commands.evaluator import figures, vectors
from mrm_nodes.commands.fit import fit
from mrm_nodes.commands.generate import generate
from mrm_nodes.commands.helptext import Sections, as_wide_as_the_terminal
from mrm_nodes.commands.install import install, uninstall
from mrm_nodes.commands.machine import doctor, targets, warmup
from mrm_nodes.commands.material import material
from mrm_nodes.commands.materials import materials
from mrm_nodes.commands.options import OWN_PROCESS
from mrm_nodes.commands.photometry import photometry
from mrm_nodes.commands.regress import merge, regress
from mrm_nodes.commands.render import render
from mrm_nodes.commands.retrofit import parse_setting as parse_setting
from mrm_nodes.commands.retrofit import retrofit
from mrm_nodes.commands.scene import scene
from mrm_nodes.commands.suite import suite
from mrm_nodes.errors import MrmError, MrmWarning

TRACEBACK_VARIABLE = "MRM_TRACEBACK"
"""Set it to see where an unexpected error came from."""

FAILED, AT_FAULT, INTERRUPTED = 1, 2, 130
"""Exit status: a comparison failed; the request or the machine was at fault; Ctrl-C."""


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit with its status; a fault is one line on stderr, never a traceback.

    arguments: by default those of this process, which is then nobody else's.
    """
    warnings.showwarning = _each_warning_once()
    warnings.simplefilter("always", MrmWarning)
    try:
        own = OWN_PROCESS if arguments is None else None
        status = cli.main(arguments, prog_name="mrm-nodes", standalone_mode=False, obj=own)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = AT_FAULT
    except click.ClickException as error:
        status = _complain(error.format_message())
    except (KeyboardInterrupt, click.Abort):
        status = INTERRUPTED
    except MrmError as error:
        status = _complain(str(error))
    except MemoryError:
        status = _complain(out_of_memory())
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        where = f"{TRACEBACK_VARIABLE}=1 shows where"
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            status = _complain(f"{error.filename or 'a file or stdout'}: {error.strerror} ({where})")
        else:
            status = _complain(f"unexpected {type(error).__name__}: {error} ({where})")
    sys.exit(status or 0)


def _complain(message: str) -> int:
    click.echo(f"mrm-nodes: {_one_line(message)}", err=True)
    return AT_FAULT


def _each_warning_once() -> Callable[..., None]:
    """Print warnings, each the first time: what is generated for eight targets has the same ones in each."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **others: Any) -> None:
        line = f"warning: {_one_line(str(message))}"
        if issubclass(category, MrmWarning) and line not in told:
            told.add(line)
            click.echo(line, err=True)

    return show


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _say_version(context: click.Context, parameter: click.Parameter, asked: bool) -> None:
    if asked and not context.resilient_parsing:
        python = ".".join(map(str, sys.version_info[:3]))
        click.echo(f"mrm-nodes {version('mrm-nodes')}, MaterialX {version('MaterialX')}, Python {python}")
        context.exit()


@click.group(cls=Sections, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_say_version,
    help="Print the versions of mrm-nodes, MaterialX and Python.",
)
def cli() -> None:
    """Retroreflective materials for MaterialX: draw them, generate their code, test them.

    A command's own help has its options and examples: mrm-nodes render --help
    """


cli.add_section("Draw", "mrm-nodes render traffic_cone -o cone.png", materials, render, scene)
cli.add_section(
    "Use the nodes",
    "mrm-nodes generate traffic_cone -o shaders",
    generate,
    install,
    uninstall,
    retrofit,
)
cli.add_section(
    "Standards and measurements",
    "mrm-nodes material --class RA2 --colour yellow -o sign.mtlx",
    material,
    photometry,
    fit,
)
cli.add_section("Test your materials", "mrm-nodes suite init", suite, regress, merge, baseline)
cli.add_section("Compare with the evaluator", "mrm-nodes vectors -o vectors.json", vectors, figures)
cli.add_section("This machine", "mrm-nodes doctor", doctor, warmup, targets, bench)
as_wide_as_the_terminal(cli)
