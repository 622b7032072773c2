"""What a suite of thousands costs: to list, to take over, to take from the cache, and to look at."""

from __future__ import annotations

import contextlib
import importlib
import json
import math
import multiprocessing
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mrm_nodes.errors import MrmError
from mrm_nodes.library import materials_path
from mrm_nodes.regression.run.cache import Cache
from mrm_nodes.regression.run.cluster import Cluster, Order, Result
from mrm_nodes.regression.run.runner import run_suite
from mrm_nodes.regression.suites.selection import suite
from mrm_nodes.regression.verdict.outcome import as_record

CASES_EACH = 5
"""Cases of a material: five lights, or five values of one input."""

SIZE = 32

_SURFACES: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "open_pbr_surface": ("specular_roughness", {"base_color": "color3", "base_metalness": "float"}),
    "mrm_open_pbr_surface": (
        "specular_retroreflectivity",
        {"base_color": "color3", "specular_roughness": "float"},
    ),
    "mrm_gltf_pbr": (
        "retroreflection",
        {"base_color": "color3", "roughness": "float", "metallic": "float"},
    ),
    "standard_surface": ("specular_roughness", {"base_color": "color3", "metalness": "float"}),
}
"""Whole surfaces: the input that the cases vary, and those that the documents do, with their types."""


def write_suite(folder: Path, count: int) -> Path:
    """Write a suite of so many cases, five of each material, and return its file.

    No two documents are equal: the finished materials with a colour of their own, and whole surfaces, as an exporter
    writes them from its templates.
    """
    rng = random.Random(0)
    finished = {file.stem: file.read_text("utf-8") for file in sorted(materials_path().glob("*.mtlx"))}
    kinds = [*finished, *_SURFACES]
    lights = ", ".join(f'"directional:{x / 10:g},-0.2,-1"' for x in range(-2, CASES_EACH - 2))
    values = ", ".join(f"{(n + 1) / (CASES_EACH + 1):.2f}" for n in range(CASES_EACH))
    lines = [f"[defaults]\nsize = {SIZE}\n"]
    for number in range(math.ceil(count / CASES_EACH)):
        kind, name = kinds[number % len(kinds)], f"{kinds[number % len(kinds)]}_{number:05}"
        blue = f"{rng.uniform(0.1, 0.9):.4f}"
        if kind in finished:
            text = finished[kind].replace(f'surfacematerial name="{kind}"', f'surfacematerial name="{name}"')
            text = re.sub(r'(color" type="color3" value=")[^"]*', rf"\g<1>0.4, 0.3, {blue}", text, count=1)
        else:
            text = _surface(kind, name, blue)
        (folder / kind).mkdir(parents=True, exist_ok=True)
        (folder / kind / f"{name}.mtlx").write_text(text, "utf-8")
    for kind in kinds:
        if (folder / kind).is_dir():
            axis = (
                f"light = [{lights}]" if kind in finished else f'"input:SR/{_SURFACES[kind][0]}" = [{values}]'
            )
            lines.append(f'[[case]]\nmaterial = "{kind}/*.mtlx"\n[case.matrix]\n{axis}\n')
    (folder / "suite.toml").write_text("\n".join(lines), "utf-8")
    return folder / "suite.toml"


def _surface(node: str, name: str, blue: str) -> str:
    inputs = "".join(
        f'    <input name="{port}" type="{kind}" value="{blue if kind == "float" else f"0.5, 0.4, {blue}"}" />\n'
        for port, kind in _SURFACES[node][1].items()
    )
    return (
        f'<?xml version="1.0"?>\n<materialx version="1.39">\n  <{node} name="SR" type="surfaceshader">\n{inputs}'
        f'  </{node}>\n  <surfacematerial name="{name}" type="material">\n'
        '    <input name="surfaceshader" type="surfaceshader" nodename="SR" />\n  </surfacematerial>\n</materialx>\n'
    )


@dataclass(frozen=True)
class Step:
    """One step in a process of its own."""

    step: str
    cases: int
    seconds: float
    cpu: float
    """Seconds of processor time of all processes together: what other programs disturb least."""
    megabytes: float
    """Peak memory of the process."""
    worker_megabytes: float
    """Peak memory of the largest process that it started."""
    told: dict[str, float]
    """What else is known: seconds by stage of all cases together, or sizes in megabytes."""


def measure(count: int, backend: str = "auto", jobs: int = 0) -> Iterator[Step]:
    """Measure a suite of so many cases: listed, run, run again from the cache, its page opened.

    Args:
        jobs: worker processes that draw the cases. With 0 one case is drawn, and its outcome and files stand for
            every other's: what is left is the run's own work.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = write_suite(folder / "suite", count)
        yield _apart("list", _list, file)
        drawn = None if jobs else _fresh(_draw, file, backend)
        how = f"run, {jobs} jobs" if jobs else "take over"
        yield _apart(how, _run, file, folder, backend, jobs, drawn)
        yield _apart("from the cache", _run, file, folder, backend, jobs, drawn)
        with contextlib.suppress(MrmError):
            yield _apart("page in a browser", _open, folder / "report" / "index.html")


def _apart(step: str, function: Callable[..., Any], *arguments: Any) -> Step:
    found: Step = _fresh(_measured, step, function, *arguments)
    return found


def _fresh(function: Callable[..., Any], *arguments: Any) -> Any:
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as process:
        return process.submit(function, *arguments).result()


def _measured(step: str, function: Callable[..., tuple[int, dict[str, float]]], *arguments: Any) -> Step:
    start = time.perf_counter()
    count, told = function(*arguments)
    seconds = time.perf_counter() - start
    own, others = (resource.getrusage(whose) for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    cpu = own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime
    return Step(step, count, seconds, cpu, own.ru_maxrss / 1024, others.ru_maxrss / 1024, told)


def _list(file: Path) -> tuple[int, dict[str, float]]:
    listed = [sys.executable, "-m", "mrm_nodes", "suite", "list", str(file)]
    shown = subprocess.run(listed, check=True, capture_output=True, text=True)
    return int(shown.stdout.split()[-2]), {}


def _run(
    file: Path, folder: Path, backend: str, jobs: int, drawn: _Drawn | None
) -> tuple[int, dict[str, float]]:
    start = time.perf_counter()
    tasks = suite(str(file))
    listed = time.perf_counter() - start
    cache = Cache(folder / "cache", limit=1 << 40)
    report = folder / "report"
    shutil.rmtree(report, ignore_errors=True)
    cluster = None if drawn is None else Cluster(_Answers(drawn))
    found = run_suite(tasks, report, backend, jobs or 1, cache=cache, cluster=cluster)
    told = {
        stage: sum(case["seconds"][stage] for case in found["cases"])
        for stage in found["cases"][0]["seconds"]
    }
    pieces = sum(piece.stat().st_size for piece in report.glob("cases/records/*.js"))
    sizes = {
        "of which listing s": listed,
        "report.json MB": (report / "report.json").stat().st_size / 1e6,
        "page MB": (report / "index.html").stat().st_size / 1e6,
        "records MB": pieces / 1e6,
        "cached": float(found["environment"].get("cached", 0)),
        "passed": float(found["summary"]["passed"]),
    }
    return len(found["cases"]), {**(told if jobs else {}), **sizes}


@dataclass(frozen=True)
class _Drawn:
    """One case's outcome as a record, the folder of its files in a report, and the files."""

    record: Mapping[str, Any]
    folder: str
    files: Mapping[str, bytes]


def _draw(file: Path, backend: str) -> _Drawn:
    """Judge the first case of a suite."""
    from mrm_nodes.regression.run.worker import Worker
    from mrm_nodes.render.context import get_context

    with tempfile.TemporaryDirectory() as name:
        outcome = Worker(get_context(backend).backend).run(suite(str(file))[0], Path(name))
        folder = f"cases/{outcome.backend}/{outcome.name}"
        files = {each.name: each.read_bytes() for each in (Path(name) / folder).iterdir()}
        return _Drawn(as_record(outcome), folder, files)


class _Answers(Executor):
    """Has one case's outcome and files for every other's."""

    def __init__(self, drawn: _Drawn) -> None:
        self._drawn = drawn

    def submit(self, function: Any, /, order: Order, *_: Any, **__: Any) -> Future[Any]:  # type: ignore[override]
        place = f"cases/{order.backend}/{order.task.name}"
        names = {
            what: file.replace(self._drawn.folder, place) if isinstance(file, str) else file
            for what, file in self._drawn.record["files"].items()
        }
        own = {"name": order.task.name, "node": order.task.node, "backend": order.backend, "files": names}
        future: Future[Any] = Future()
        files = {f"{place}/{name}": contents for name, contents in self._drawn.files.items()}
        future.set_result(Result({**self._drawn.record, **own}, files))
        return future


def _open(page: Path) -> tuple[int, dict[str, float]]:
    """Open a report's page, and the first case.

    Raises:
        MrmError: there is no browser.
    """
    from mrm_nodes.render.webgl import INSTALL, find_browser

    try:
        playwright_api: Any = importlib.import_module("playwright.sync_api")
    except ImportError:
        raise MrmError(INSTALL) from None
    browser = find_browser()
    if browser is None:
        raise MrmError(INSTALL)
    with playwright_api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        opened = chromium.new_page()
        asked: list[str] = []
        opened.on("request", lambda request: asked.append(request.url))
        start = time.perf_counter()
        opened.goto(page.as_uri())
        opened.wait_for_selector("html[data-ready]")
        opened.wait_for_selector(".card")
        usable = time.perf_counter() - start
        start = time.perf_counter()
        opened.keyboard.press("Home")
        opened.keyboard.press("Enter")
        opened.wait_for_selector("#facts .set-up")
        case = time.perf_counter() - start
        count = int(re.sub(r"\D", "", str(opened.locator("#shown").text_content()).rpartition("of")[2]))
        start = time.perf_counter()
        opened.keyboard.press("Escape")
        opened.locator("#search").fill("directional")
        opened.wait_for_selector("#shown:not(:text('…'))")
        searched = time.perf_counter() - start
        scripts = float(sum(url.endswith(".js") for url in asked))
        chromium.close()
    return count, {"usable s": usable, "first case s": case, "search s": searched, "scripts": scripts}


def as_json(rows: list[Step]) -> str:
    """Measurements as JSON."""
    return json.dumps([asdict(row) for row in rows], indent=2) + "\n"
