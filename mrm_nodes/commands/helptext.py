"""Help that is never cut off: commands in sections, as wide as the terminal, whatever that is."""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Sequence
from typing import Any

import click

WIDEST, NARROW = 100, 60
"""Columns: of help on a wide terminal, and below which an option has a line of its own."""


class _Formatter(click.HelpFormatter):
    def write_dl(self, rows: Iterable[tuple[str, str]], col_max: int = 30, col_spacing: int = 2) -> None:
        super().write_dl(rows, col_max if self.width >= NARROW else 4, col_spacing)


class _Context(click.Context):
    formatter_class = _Formatter


class Group(click.Group):
    """A group whose help has the whole first sentence of each command."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if parent is None:
            extra.setdefault("terminal_width", min(shutil.get_terminal_size().columns, WIDEST))
        return super().make_context(info_name, args, parent, **extra)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(_rows(self.commands.values()))


class Sections(Group):
    """A group whose commands are in sections, each with an example."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.sections: dict[str, tuple[str, Sequence[click.Command]]] = {}
        """By title: an example, and the commands."""

    def add_section(self, title: str, example: str, *commands: click.Command) -> None:
        """Add commands under a title."""
        self.sections[title] = example, commands
        for command in commands:
            self.add_command(command)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, (example, commands) in self.sections.items():
            with formatter.section(title):
                formatter.write_dl(_rows(commands))
                formatter.write(f"\n{'':{formatter.current_indent}}{example}\n")


def _rows(commands: Iterable[click.Command]) -> list[tuple[str, str]]:
    return [(each.name or "", each.get_short_help_str(1000)) for each in commands if not each.hidden]


def as_wide_as_the_terminal(command: click.Command) -> None:
    """Have the help of a command, and of all below it, fit narrow terminals too."""
    command.context_class = _Context
    for each in command.commands.values() if isinstance(command, click.Group) else ():
        as_wide_as_the_terminal(each)
