"""The one error that a user's request or machine can cause, and the one warning."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class MrmError(Exception):
    """The request or the machine is at fault: says what, where, and what to do.

    The command line prints it as one line on stderr and exits with status 2.
    """


class MrmWarning(UserWarning):
    """Something was changed on the user's behalf (a value clamped, normals made) and the work went on."""


def suggestion(name: str, known: Iterable[str]) -> str:
    """What to say of a name that is unknown: those that are like it, else all there are."""
    names = sorted(set(known))
    close = difflib.get_close_matches(name, names, n=3)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"known: {', '.join(names)}" if names else "there is none"
