"""Progress of a command that takes steps: nothing in the first second, then a bar; a line now and then elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

PATIENCE, QUIET = 1.0, 10.0
"""Seconds until a bar appears on a terminal, and between two lines where there is none."""


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[], None]]:
    """Show progress for as long as the block lasts; yields what to call after each of `total` steps."""
    with (_bar if sys.stderr.isatty() else _lines)(what, total) as step:
        yield step


@contextmanager
def _lines(what: str, total: int) -> Iterator[Callable[[], None]]:
    done, told = 0, time.monotonic()

    def step() -> None:
        nonlocal done, told
        done += 1
        if done < total and time.monotonic() - told >= QUIET:
            told = time.monotonic()
            click.echo(f"{what}: {done} of {total}", err=True)

    yield step


@contextmanager
def _bar(what: str, total: int) -> Iterator[Callable[[], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        transient=True,
    )
    row = bar.add_task(what, total=total)
    timer = threading.Timer(PATIENCE, bar.start)
    timer.daemon = True
    timer.start()
    try:
        yield lambda: bar.advance(row)
    finally:
        timer.cancel()
        timer.join()
        bar.stop()
