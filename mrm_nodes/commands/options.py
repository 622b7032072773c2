"""Options that several commands share."""

from __future__ import annotations

import functools
import math
import os
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import CompletionItem

from mrm_nodes import shipped
from mrm_nodes.errors import MrmError, MrmWarning, unknown


def _completed_material(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    names = [each for each in shipped.materials() if each.startswith(incomplete)]
    # The shell completes files where nothing else comes.
    return [CompletionItem(incomplete, type="file"), *map(CompletionItem, names)]


material_argument = click.argument(
    "file",
    metavar="MATERIAL",
    callback=lambda context, parameter, value: shipped.material_file(value),
    shell_complete=_completed_material,
)
"""A .mtlx file or a name that `mrm-nodes materials` lists; a file wins where it has such a name."""

external_option = click.option(
    "--allow-external",
    is_flag=True,
    help="Let materials read files outside of their folder and the node libraries.",
)


def parse_limit(context: object, parameter: object, value: float) -> float:
    """Seconds, which click lets be NaN."""
    if math.isnan(value):
        raise MrmError("--time-limit nan: write the seconds that it may take")
    return value


def time_option(what: str) -> Callable[[Any], Any]:
    """How long something may take."""
    return click.option(
        "--time-limit",
        type=click.FloatRange(0, 1e9, min_open=True),
        callback=parse_limit,
        default=600.0,
        show_default=True,
        metavar="SECONDS",
        help=f"What {what} may take.",
    )


def memory_option(what: str) -> Callable[[Any], Any]:
    """How much memory something may take."""
    return click.option(
        "--memory-limit",
        type=click.IntRange(256, 1 << 30),
        envvar="MRM_MEMORY_LIMIT",
        metavar="MB",
        help=f"Memory that {what} may take.  [default: three quarters of the machine's]",
    )


def within_limits(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options, and have the command work in a process of its own that keeps to them.

    Where the command line is called by another program, it works in that one's process, without limits.
    """

    @functools.wraps(command)
    def within(*, time_limit: float, memory_limit: int | None, **given: Any) -> Any:
        from mrm_nodes.allowance import go_on_within

        if click.get_current_context().find_root().obj is OWN_PROCESS:
            status = go_on_within(time_limit, memory_limit)
            if status is not None:
                return status
        return command(**given)

    limited: Callable[..., Any] = time_option("it")(memory_option("it")(within))
    return limited


OWN_PROCESS = "own process"
"""What the context of a command line holds that nobody called but its own process."""


def keep_memory_limit(megabytes: int | None) -> None:
    """Have worker processes that start from now on take no more."""
    from mrm_nodes.allowance import MEMORY_VARIABLE

    if megabytes is not None:
        os.environ[MEMORY_VARIABLE] = str(megabytes)


def one_of(*names: str) -> dict[str, Any]:
    """Arguments of an option that takes one of some names; another one is told those that are like it."""

    def check(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
        if value is not None and value not in names:
            raise MrmError(unknown(f"{parameter.opts[0]}", value, names))
        return value

    def complete(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
        return [each for each in names if each.startswith(incomplete)]

    return {"metavar": "|".join(names), "callback": check, "shell_complete": complete}


def say_what_is_of_pictures_only(outputs: Sequence[Path], look: Iterable[str]) -> None:
    """Warn (MrmWarning) of options, by name without the dashes, that no output takes: an .exr has linear light."""
    named = " and ".join(f"--{name}" for name in look)
    if named and all(output.suffix.lower() == ".exr" for output in outputs):
        message = f"{named}: an .exr has linear light and alpha, whatever they say; they are for a .png"
        warnings.warn(message, MrmWarning, stacklevel=2)


def refuse_folder(output: Path) -> None:
    """Refuse to write where a folder is.

    Raises:
        MrmError: there is one.
    """
    if output.is_dir():
        raise MrmError(f"{output}: is a folder; name a file with -o")


def parse_size(text: str) -> tuple[int, int]:
    """Width and height from `WxH`, or from one number that is both.

    Raises:
        MrmError: anything else, or a side outside 1 to 16384.
    """
    sides = text.lower().replace("×", "x").split("x")
    if len(sides) > 2 or not all(side.isascii() and side.isdigit() and len(side) < 100 for side in sides):
        raise MrmError(f"size {text}: write width and height as 640x480, or one number for both")
    width, height = int(sides[0]), int(sides[-1])
    if not (1 <= width <= 16384 and 1 <= height <= 16384):
        raise MrmError(f"size {text}: each side is 1 to 16384 pixels")
    return width, height
