"""How long this process has been compiling machine code, which is nobody's fault but the first one's to need it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

_lock = threading.Lock()
_depth = 0
_began = 0.0
_sum = 0.0
_listener: Callable[[bool, float], None] | None = None


def begin() -> None:
    """Say that a thread compiles, or waits until another process has compiled the same; `end` says that it is done."""
    global _depth, _began
    with _lock:
        _depth += 1
        if _depth == 1:
            _began = time.monotonic()
            if _listener is not None:
                _listener(True, _began)


def end() -> None:
    """End what `begin` began."""
    global _depth, _sum
    with _lock:
        _depth -= 1
        if _depth == 0:
            ended = time.monotonic()
            _sum += ended - _began
            if _listener is not None:
                _listener(False, ended)


def seconds() -> float:
    """Seconds in which any thread of this process was compiling, so far."""
    with _lock:
        return _sum + (time.monotonic() - _began if _depth else 0.0)


def tell(listener: Callable[[bool, float], None]) -> None:
    """Have a function called as compiling begins (true) and when it has ended, with `time.monotonic()`.

    It must neither fail nor compile anything.
    """
    global _listener
    with _lock:
        _listener = listener
