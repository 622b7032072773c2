"""Options that several commands share."""

from __future__ import annotations

import click

external_option = click.option(
    "--allow-external",
    is_flag=True,
    help="Let materials read files outside of their folder and the node libraries.",
)
