"""Tests that stand for a client of the node library say so: their results make the table of clients.

Runs that tests start keep their results to themselves. Every draw is checked for left-over state.
"""

from __future__ import annotations

import os
import tempfile

import pytest

from mrm_nodes.render.checks import CHECK_VARIABLE


def pytest_configure(config: pytest.Config) -> None:
    cache = tempfile.TemporaryDirectory(prefix="mrm-nodes-tests-", ignore_cleanup_errors=True)
    config.add_cleanup(cache.cleanup)
    os.environ["XDG_CACHE_HOME"] = cache.name
    os.environ[CHECK_VARIABLE] = "1"
    config.addinivalue_line(
        "markers", "client(name): a row of the table of clients; {x} in it stands for the test's parameter x"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        for mark in item.iter_markers("client"):
            item.user_properties.append(("client", mark.args[0].format(**parameters)))
