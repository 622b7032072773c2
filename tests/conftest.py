"""Tests that stand for a client of the node library say so: their results make the table of clients.

Runs that tests start keep their results to themselves. Every draw is checked for left-over state.
Mesa's cache of compiled shaders is the user's own: `make regress` and each process of xdist fill it for the others.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Callable
from typing import Any

import pytest

from mrm_nodes import cachefolder, cli
from mrm_nodes.errors import MrmError
from mrm_nodes.render.checks import CHECK_VARIABLE
from mrm_nodes.render.context import get_context


def pytest_configure(config: pytest.Config) -> None:
    cache = tempfile.TemporaryDirectory(prefix="mrm-nodes-tests-", ignore_cleanup_errors=True)
    config.add_cleanup(cache.cleanup)
    os.environ.setdefault("MESA_SHADER_CACHE_DIR", str(cachefolder.of_user("") or cache.name))
    os.environ["XDG_CACHE_HOME"] = cache.name
    os.environ[CHECK_VARIABLE] = "1"
    # A shell's background jobs begin with it ignored, and so would the commands that tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    config.addinivalue_line(
        "markers", "client(name): a row of the table of clients; {x} in it stands for the test's parameter x"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        for mark in item.iter_markers("client"):
            item.user_properties.append(("client", mark.args[0].format(**parameters)))


_FIRST_STATES: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def _same_draws(request: pytest.FixtureRequest) -> None:
    """A test that draws from its module's RNG draws the same numbers whatever ran before, and in whichever process."""
    if rng := getattr(request.module, "RNG", None):
        rng.bit_generator.state = _FIRST_STATES.setdefault(request.module.__name__, rng.bit_generator.state)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Run a command: exit status, stdout, stderr."""

    def call(*arguments: Any) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            cli.main([str(each) for each in arguments])
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return call


@pytest.fixture(scope="session")
def gl() -> None:
    """Skip where there is no OpenGL, unless this machine must have it."""
    try:
        get_context("auto")
    except MrmError as error:
        if os.environ.get("MRM_REQUIRE_BACKENDS"):
            raise
        pytest.skip(str(error))
