"""The folder in which tests leave their pictures and their report, and how it is told from anybody else's."""

from __future__ import annotations

from pathlib import Path

from mrm_nodes import jsontext

MARK = ".mrm-report"
"""A file in each such folder."""

OUTCOMES = "outcomes"
"""Folder of the outcomes of each session, a file each: its processes share nothing else."""


def check_own(folder: Path) -> None:
    """Check that a folder holds nothing else, by a look alone: a run may merely collect its tests.

    Raises:
        ValueError: it does, or cannot be read.
    """
    try:
        held = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    except OSError as error:
        raise ValueError(f"{folder}: {error.strerror}") from None
    if held and MARK not in held and not _is_older(folder, held):
        more = f" and {len(held) - 3} more" if len(held) > 3 else ""
        raise ValueError(f"{folder} holds {', '.join(held[:3])}{more}, which is no report of the tests")


def _is_older(folder: Path, held: list[str]) -> bool:
    """Whether a folder is such a one from before they were marked."""
    if not {OUTCOMES, "report.json", "index.html"} <= set(held):
        return False
    try:
        return set(jsontext.loads((folder / "report.json").read_bytes())) == {
            "environment",
            "cases",
            "summary",
        }
    except (OSError, ValueError, TypeError):
        return False
