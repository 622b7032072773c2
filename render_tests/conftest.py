"""One worker per backend and session; a backend that is missing skips its tests, or fails them where it is required."""

import os
import signal
import tempfile

import pytest

from mrm_nodes import cachefolder
from mrm_nodes.regression.run.runner import required_backends
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.render.context import BACKENDS, probe_backends


def pytest_configure(config):
    """Runs that tests start know no results of earlier ones; Mesa knows the shaders that it has compiled."""
    cache = tempfile.TemporaryDirectory(prefix="mrm-nodes-tests-", ignore_cleanup_errors=True)
    config.add_cleanup(cache.cleanup)
    os.environ.setdefault("MESA_SHADER_CACHE_DIR", str(cachefolder.of_user("") or cache.name))
    os.environ["XDG_CACHE_HOME"] = cache.name
    # A shell's background jobs begin with it ignored, and so would the commands that tests interrupt.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session", params=BACKENDS)
def worker(request):
    """A worker on each backend in turn."""
    probe = next(each for each in probe_backends() if each.backend == request.param)
    if not probe.works:
        reason = f"{probe.backend}: {probe.reason}; {probe.hint}"
        (pytest.fail if probe.backend in required_backends() else pytest.skip)(reason)
    return Worker(request.param)


@pytest.fixture(scope="session")
def working_backend():
    """The first backend that works."""
    for probe in probe_backends():
        if probe.works:
            return probe.backend
    if required_backends():
        pytest.fail("no backend works")
    return pytest.skip("no backend works")
