"""Matplotlib's figures as files: what can be drawn, and the same figure as the same bytes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

from mrm_nodes.errors import MrmError

ENDINGS = (".svg", ".png", ".pdf")
_DATES = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}


def check_plot(path: Path) -> None:
    """Check that a plot can be drawn for a file of this name.

    Raises:
        MrmError: another ending; Matplotlib is not installed.
    """
    if path.suffix.lower() not in ENDINGS:
        raise MrmError(
            f"{path}: unknown ending {path.suffix or '(none)'} of a plot; use {', '.join(ENDINGS)}"
        )
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        raise MrmError("a plot needs Matplotlib: pip install 'mrm-nodes[figures]'") from None


def figure_bytes(figure: Any, path: Path) -> bytes:
    """The contents of a figure's file, by the ending of its name; without a date, and with names that do not change."""
    import matplotlib

    ending, drawn = path.suffix.lower(), io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "mrm-nodes"}):
        figure.savefig(drawn, format=ending[1:], dpi=150, metadata=_DATES.get(ending, {}))
    return drawn.getvalue()
