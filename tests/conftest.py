"""Tests that stand for a client of the node library say so: their results make the table of clients."""

from __future__ import annotations

import pytest


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers", "client(name): a row of the table of clients; {x} in it stands for the test's parameter x"
    )


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        parameters = item.callspec.params if hasattr(item, "callspec") else {}
        for mark in item.iter_markers("client"):
            item.user_properties.append(("client", mark.args[0].format(**parameters)))
