"""The pytest plugin: `mrm_render` and `mrm_assert_image`, for tests of one's own materials. See docs/pytest.md.

Nothing heavy is imported before a test uses it.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from mrm_nodes.regression.testfolder import OUTCOMES, check_own

if TYPE_CHECKING:
    from mrm_nodes.regression.testing import RenderedMaterial, Session

_PLACE = pytest.StashKey[tuple[Path, str]]()
"""The folder of the report, and the number of the session: what its processes share."""
_START = pytest.StashKey[float]()


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("mrm", "images of materials (mrm-nodes)")
    group.addoption(
        "--mrm-accept",
        action="store_true",
        help="Make the render of each test that is run its new baseline, where it differs or has none.",
    )
    group.addoption(
        "--mrm-reason",
        default="",
        metavar="TEXT",
        help="Why, which is recorded with what --mrm-accept accepts.",
    )
    group.addoption("--mrm-report", metavar="DIR", help="Folder of the report on all pictures.")
    group.addoption(
        "--mrm-backend", default="auto", metavar="NAME", help="OpenGL: egl, osmesa or auto. [default: auto]"
    )


def pytest_configure(config: pytest.Config) -> None:
    config.stash[_START] = time.perf_counter()
    shared = getattr(config, "workerinput", {}).get("mrm_place")  # of pytest-xdist
    if shared:
        config.stash[_PLACE] = Path(shared[0]), shared[1]
        return
    number = uuid.uuid4().hex
    folder = config.stash[_PLACE] = _report_folder(config, number), number
    try:
        check_own(folder[0])
    except ValueError as error:
        raise pytest.UsageError(f"--mrm-report: {error}; name a new or an empty folder") from None


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    folder, number = node.config.stash[_PLACE]
    node.workerinput["mrm_place"] = (str(folder), number)


def _report_folder(config: pytest.Config, number: str) -> Path:
    given = config.getoption("mrm_report")
    if given:
        return Path(config.invocation_params.dir, given).resolve()
    try:
        cache = config.getini("cache_dir")
    except ValueError:  # -p no:cacheprovider
        return Path(tempfile.gettempdir()) / f"mrm-report-{number}"
    return Path(config.rootpath, cache, "mrm-report")


@pytest.fixture(scope="session")
def _mrm_session(pytestconfig: pytest.Config) -> Session:
    from mrm_nodes.regression.testing import Session

    folder, number = pytestconfig.stash[_PLACE]
    return Session(folder, number, pytestconfig.getoption("mrm_accept"), pytestconfig.getoption("mrm_reason"))


@pytest.fixture
def mrm_render(request: pytest.FixtureRequest) -> Callable[..., RenderedMaterial]:
    """A material rendered: `mrm_render("tape.mtlx", mesh=…, camera=…, lights=…, environment=…, size=…, inputs=…)`.

    File names are relative to the test's own file. The result has `image` (h, w, 3) and `mask` (h, w).
    """

    def render(material: Any, mesh: Any = "sphere", **options: Any) -> RenderedMaterial:
        __tracebackhide__ = True
        from mrm_nodes.regression.testing import picture

        options.setdefault("backend", request.config.getoption("mrm_backend"))
        with _told_in_one_line():
            return picture(request.path.parent, material, mesh, **options)

    return render


@pytest.fixture
def mrm_assert_image(request: pytest.FixtureRequest, _mrm_session: Session) -> Callable[..., None]:
    """Fails a test whose picture is wrong: `mrm_assert_image(picture, name=None, tolerance=…, truth=…)`.

    The truth is `baseline`, an image that was accepted and lies in `baselines` beside the test's file, or
    `physics`, the evaluator. A tolerance is a dict of `max_rel`, `p999_rel`, `rmse`, `flip` and `hdr_flip`. The
    name is by default the test's.
    """
    count = 0

    def check(
        seen: RenderedMaterial,
        name: str | None = None,
        tolerance: Mapping[str, float] | None = None,
        truth: Any = "baseline",
    ) -> None:
        __tracebackhide__ = True
        nonlocal count
        if name is None:
            count += 1
            parts = [request.path.stem, request.node.name]
            name = "-".join(part.removeprefix("test_") for part in parts) + (f"-{count}" if count > 1 else "")
        with _told_in_one_line():
            complaint = _mrm_session.judge(seen, name, request.node.nodeid, truth, tolerance)
        if complaint:
            pytest.fail(complaint)

    return check


@contextlib.contextmanager
def _told_in_one_line() -> Iterator[None]:
    """A fault of the request or the machine fails the test with its message alone."""
    from mrm_nodes.errors import MrmError

    try:
        yield
    except MrmError as error:
        pytest.fail(str(error), pytrace=False)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    folder, number = config.stash[_PLACE]
    if hasattr(config, "workerinput") or not (folder / OUTCOMES / number).is_dir():
        return
    from mrm_nodes.errors import MrmError
    from mrm_nodes.regression.testing import conclude

    terminalreporter.section("images of materials")
    try:
        outcomes = conclude(folder, number, time.perf_counter() - config.stash[_START])
    except MrmError as error:
        terminalreporter.line(f"no report: {error}", red=True)
        return
    accepted = [outcome.details for outcome in outcomes if "accepted" in outcome.details]
    for details in accepted:
        terminalreporter.line(f"accepted {details['accepted']} for {details['test']}; {details['before']}")
    counts = Counter(outcome.verdict for outcome in outcomes if "accepted" not in outcome.details)
    told = ", ".join(
        [*(f"{count} {verdict}" for verdict, count in counts.items()), f"{len(accepted)} accepted"]
    )
    terminalreporter.line(f"{told}; report: {folder / 'index.html'}")
