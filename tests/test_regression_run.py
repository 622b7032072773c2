"""A run knows its backends and which task comes next."""

from types import SimpleNamespace

import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.run import _next_task, plan_backends, run_suite
from mrm_nodes.render.context import BackendReport

EGL = BackendReport("egl", True, "Mesa", "llvmpipe", "4.5")
OSMESA = BackendReport("osmesa", True, "Mesa", "llvmpipe", "4.5")
NO_OSMESA = BackendReport("osmesa", False, reason="libOSMesa is not installed", hint="install libosmesa6")
NO_EGL = BackendReport("egl", False, reason="no device", hint="install libegl1")


def test_auto_takes_the_first_that_works():
    assert list(plan_backends("auto", [EGL, OSMESA]).drivers) == ["egl"]
    assert list(plan_backends("auto", [NO_EGL, OSMESA]).drivers) == ["osmesa"]


def test_all_skips_what_is_missing_and_says_why():
    plan = plan_backends("all", [EGL, NO_OSMESA])
    assert plan.drivers == {"egl": "llvmpipe, OpenGL 4.5"}
    assert plan.skipped == {"osmesa": "libOSMesa is not installed; install libosmesa6"}


@pytest.mark.parametrize(
    ("request_", "probes", "required", "message"),
    [
        ("osmesa", [EGL, NO_OSMESA], (), "backend osmesa does not work here: libOSMesa is not installed"),
        ("all", [EGL, NO_OSMESA], ("egl", "osmesa"), "backend osmesa does not work here"),
        ("all", [NO_EGL, NO_OSMESA], (), "backend egl does not work here: no device; install libegl1"),
        ("auto", [NO_EGL, NO_OSMESA], (), "backend egl does not work here"),
        ("glx", [EGL, OSMESA], (), "unknown backend glx; known: auto, all, egl, osmesa"),
        ("all", [EGL, OSMESA], ("metal",), "MRM_REQUIRE_BACKENDS names metal; known: egl, osmesa"),
    ],
)
def test_a_backend_that_is_asked_for_and_missing_is_an_error(request_, probes, required, message):
    with pytest.raises(MrmError, match=message):
        plan_backends(request_, probes, required)


def test_a_worker_gets_what_it_has_shaders_for_and_then_what_nobody_has():
    waiting = [SimpleNamespace(structure=name) for name in ("b", "c", "a")]
    mine, other = SimpleNamespace(structures={"a"}), SimpleNamespace(structures={"b"})
    assert _next_task(waiting, mine, [mine, other]) == 2
    assert _next_task(waiting[:2], mine, [mine, other]) == 1
    assert _next_task(waiting[:1], mine, [mine, other]) == 0


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(MrmError, match="cannot be written"):
        run_suite([], tmp_path / "file" / "report")
    assert (tmp_path / "file").read_text() == "kept"
