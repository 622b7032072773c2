"""The one error that a user's request or machine can cause, and the one warning."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_MANY = 20
"""More names than this are not listed."""
_LONGEST = 100
"""Letters of a name that is compared with others, which takes its square in time."""


class MrmError(Exception):
    """The request or the machine is at fault: says what, where, and what to do.

    The command line prints it as one line on stderr and exits with status 2.
    """


class MrmWarning(UserWarning):
    """Something was changed on the user's behalf (a value clamped, normals made) and the work went on."""


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """What to say of a name that is none of those known, such as `unknown target xyz; known: glsl`."""
    return f"unknown {what} {name}; {suggestion(name, known)}"


def suggestion(name: str, known: Iterable[str]) -> str:
    """What to say of a name that is unknown: those that are like it, else all there are, or the nearest of many."""
    names = sorted(set(known))
    sought = name[:_LONGEST]
    close = difflib.get_close_matches(sought, names, n=3)
    if not close and len(names) > _MANY:
        close = difflib.get_close_matches(sought, names, n=3, cutoff=0)
    if close:
        return f"did you mean {' or '.join(close)}?"
    return f"known: {', '.join(names)}" if names else "there is none"
