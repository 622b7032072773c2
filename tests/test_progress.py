"""Progress of a command: nothing where it is quick, a line now and then where there is no terminal, a bar on one."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

import pytest

from mrm_nodes.commands import progress as module
from mrm_nodes.commands.progress import progress

SLOW = (
    "import time; from mrm_nodes.commands import progress as p; p.PATIENCE = {patience}\n"
    "with p.progress('sweep', 3) as step:\n"
    "    for _ in range(3): time.sleep(0.2); step()\n"
)


def on_a_terminal(patience: float) -> bytes:
    main, terminal = pty.openpty()
    child = subprocess.Popen([sys.executable, "-c", SLOW.format(patience=patience)], stderr=terminal)
    os.close(terminal)
    shown = b""
    while True:
        try:
            part = os.read(main, 4096)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(main)
    assert child.wait() == 0
    return shown


def test_a_bar_comes_after_a_while_and_goes_again() -> None:
    assert b"sweep" in on_a_terminal(0.0)
    assert b"sweep" not in on_a_terminal(60.0)


def test_lines_come_now_and_then_elsewhere(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for quiet, lines in ((0.0, ["sweep: 1 of 3", "sweep: 2 of 3"]), (60.0, [])):
        monkeypatch.setattr(module, "QUIET", quiet)
        with progress("sweep", 3) as step:
            for _ in range(3):
                step()
        assert capsys.readouterr().err.splitlines() == lines


def test_what_goes_wrong_ends_the_bar() -> None:
    with pytest.raises(RuntimeError), progress("sweep", 3):
        raise RuntimeError
