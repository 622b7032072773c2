"""What the pytest plugin does: a material rendered, compared with its truth, and its render accepted.

It is the same as a suite's case; see `material_case`.
"""

from __future__ import annotations

import functools
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from mrm_nodes import documents, external, shadergen
from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.files import ABANDONED, clear, lock, write_text
from mrm_nodes.regression.cases import baseline
from mrm_nodes.regression.cases.digests import versions
from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase, Truth, read, with_values
from mrm_nodes.regression.report.junit import in_words
from mrm_nodes.regression.report.page import write_report
from mrm_nodes.regression.run.runner import Plan, describe_environment
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites.suitefile import DEFAULT_LIGHTS, materials_of
from mrm_nodes.regression.testfolder import MARK, OUTCOMES
from mrm_nodes.regression.verdict.outcome import Outcome, as_record, from_record
from mrm_nodes.regression.verdict.tolerance import Tolerance
from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS
from mrm_nodes.render.mesh import BUILT_IN
from mrm_nodes.render.renderer import RenderedImage
from mrm_nodes.render.renderer import render as render_shader
from mrm_nodes.render.scene import Framing, Light, parse_camera, parse_light


@dataclass(frozen=True)
class RenderedMaterial:
    """A material as it is to be rendered; drawn when it is looked at."""

    case: MaterialCase
    backend: str = "auto"

    @functools.cached_property
    def drawn(self) -> RenderedImage:
        """The image and its geometry: see `RenderedImage`.

        Raises:
            MrmError: as `render.renderer.render`.
        """
        case = self.case
        document = with_values(read(case), case.inputs, case.material)
        around = case.environment
        lit: str | Path | None = None
        if around is not None:
            lit = around.name if around.name in BUILT_IN_ENVIRONMENTS else case.root / around.name
        drawn = render_shader(
            shadergen.generate_shader(document, element=case.element, max_lights=case.room),
            case.mesh if case.mesh in BUILT_IN else case.root / case.mesh,
            case.camera,
            case.lights,
            case.size,
            self.backend,
            environment=lit,
        )
        for array in (drawn.image, drawn.mask):
            array.flags.writeable = False
        return drawn

    @property
    def image(self) -> NDArray[np.float32]:
        """`(h, w, 3)` linear radiance, row 0 at the top."""
        return self.drawn.image

    @property
    def mask(self) -> NDArray[np.bool_]:
        """`(h, w)`, true where the mesh is."""
        return self.drawn.mask


def picture(
    folder: Path,
    material: str | os.PathLike[str],
    mesh: str | os.PathLike[str] = "sphere",
    camera: str | Framing | None = None,
    lights: Sequence[str | Light] | str | Light | None = None,
    environment: str | os.PathLike[str] | None = None,
    size: tuple[int, int] = (256, 256),
    inputs: Mapping[str, Any] | None = None,
    element: str | None = None,
    backend: str = "auto",
    allow_external: bool = False,
) -> RenderedMaterial:
    """A material on a mesh; file names are relative to `folder`, and arguments as those of `mrm_nodes.render`.

    Args:
        lights: by default those of a suite's cases, or none in an environment.
        inputs: values in place of the document's, by the path of an input (`node/input`).
        element: which material, where the document has several.

    Raises:
        MrmError: any of these is missing, unknown or unreadable.
    """
    listed = [lights] if isinstance(lights, str | Light) else lights
    if listed is None:
        listed = DEFAULT_LIGHTS if environment is None else ()
    case = MaterialCase(
        name="picture",
        root=folder,
        material=_beside(folder, material),
        element=element or "",
        truth="baseline",
        reason="the test says so",
        inputs={name: _value(value) for name, value in (inputs or {}).items()},
        mesh=os.fspath(mesh) if mesh in BUILT_IN else _beside(folder, mesh),
        camera=parse_camera(camera) if isinstance(camera, str) else camera or Framing(),
        lights=tuple(parse_light(each) if isinstance(each, str) else each for each in listed),
        environment=None if environment is None else EnvironmentMap(_map(folder, environment)),
        size=size,
        allow_external=allow_external,
    )
    document = read(case)
    known = materials_of(document, case.material)
    if element is None and len(known) > 1:
        raise MrmError(f"{case.material} has several materials; name one: element={' or '.join(known)}")
    with_values(document, case.inputs, case.material)
    external.check_files(document, folder / case.material, allow_external)
    files = documents.files_of(folder / case.material, document)
    depends = tuple(os.path.relpath(path, folder) for path in files)
    return RenderedMaterial(replace(case, element=element or known[0], depends=depends), backend)


def _value(value: Any) -> Any:
    """As a case has it: lists and arrays as tuples."""
    plain = value.tolist() if isinstance(value, np.ndarray | np.generic) else value
    return tuple(plain) if isinstance(plain, list) else plain


def _beside(folder: Path, file: str | os.PathLike[str]) -> str:
    return os.path.relpath(folder / file, folder)


def _map(folder: Path, environment: str | os.PathLike[str]) -> str:
    return os.fspath(environment) if environment in BUILT_IN_ENVIRONMENTS else _beside(folder, environment)


@dataclass(frozen=True)
class Session:
    """One run of tests: where its report lies, which run it is, and whether renders are accepted."""

    folder: Path
    number: str
    accept: bool = False
    reason: str = ""
    """Why renders are accepted."""

    def judge(
        self,
        seen: RenderedMaterial,
        name: str,
        test: str,
        truth: Truth = "baseline",
        tolerance: Tolerance | Mapping[str, float] | None = None,
    ) -> str:
        """Compare a picture with its truth; return why a test has to fail, or nothing.

        test: what it is told apart by, and run again with.

        Raises:
            MrmError: another test has used the name, or the report or a baseline cannot be written.
        """
        if truth not in get_args(Truth):
            raise MrmError(f"truth {truth!r}; it is {' or '.join(get_args(Truth))}")
        name = safe(name)
        self._prepare()
        try:
            self._claim(name, test)
        except OSError as error:
            raise MrmError(f"{self.folder}: cannot be written: {error.strerror}") from None
        asked = tolerance if isinstance(tolerance, Tolerance) else _tolerance(tolerance or {})
        case = replace(seen.case, name=name, truth=truth, tolerance=asked)
        standing = case.store.standing(name)
        outcome = _worker(seen.backend).run(case, self.folder)
        if truth == "baseline" and not standing and outcome.files:
            outcome.message = f"no baseline yet in {case.store.folder}"
        complaint = self._accept(case, outcome, standing) if self.accept else _complaint(case, outcome)
        outcome.details = {**outcome.details, "test": test, "driver": _driver(outcome.backend)}
        self._keep(outcome)
        place = outcome.files.get("render")
        more = [complaint]
        if complaint and place:
            more.append(f"pictures: {(self.folder / str(place)).parent}")
        if complaint:
            more.append(f"report: {self.folder / 'index.html'}, which the end of the run writes")
        if complaint and truth == "baseline" and place:
            more.append(f"if this render is right: pytest --mrm-accept '{test}'")
        return "\n".join(more)

    def _accept(self, case: MaterialCase, outcome: Outcome, standing: str) -> str:
        """Make the render the baseline where it is not; what has no render fails as ever."""
        if outcome.verdict == "pass":
            return ""
        if case.truth != "baseline" or "render_data" not in outcome.files:
            return _complaint(case, outcome)
        provenance = {
            "inputs": baseline.fingerprint(case),
            "setup": case.describe(),
            "tolerance": case.tolerance.limits(),
            "backend": outcome.backend,
            "driver": _driver(outcome.backend),
            "versions": versions(),
        }
        image = self.folder / str(outcome.files["render_data"])
        plain = json.loads(json.dumps(provenance))
        try:
            case.store.accept(case.name, image, plain, self.reason or "pytest --mrm-accept", standing)
        except MrmError as error:
            outcome.verdict, outcome.message = "error", f"not accepted: {error}"
            return outcome.message
        before = f"it differed: {in_words(as_record(outcome))}" if outcome.figures else "it is the first"
        if standing and not outcome.figures:
            before = f"the one before could not be compared: {outcome.message}"
        accepted = {"accepted": os.fspath(case.store.paths(case.name)[0]), "before": before}
        outcome.details = {**outcome.details, **accepted}
        outcome.verdict, outcome.message = "skipped", f"accepted as the new baseline; {before}"
        return ""

    @property
    def _outcomes(self) -> Path:
        return self.folder / OUTCOMES / self.number

    def _prepare(self) -> None:
        """Make the folder, marked as ours: whoever runs tests in a folder of another's must not find out too late.

        Raises:
            MrmError: it cannot be made.
        """
        try:
            # In a folder of everybody's, nobody but this user has to see it.
            private = self.folder.parent == Path(tempfile.gettempdir())
            self.folder.mkdir(0o700 if private else 0o777, parents=True, exist_ok=True)
            (self.folder / MARK).touch()
            self._outcomes.mkdir(parents=True, exist_ok=True)
            clear(self.folder, ABANDONED)
            for left in (self.folder / OUTCOMES).iterdir():  # of sessions that were killed
                if left.stat().st_mtime < time.time() - ABANDONED:
                    shutil.rmtree(left, ignore_errors=True)
        except OSError as error:
            raise MrmError(f"{self.folder}: cannot be written: {error.strerror}") from None

    def _claim(self, name: str, test: str) -> None:
        """Have no other test of this session use a name, in whatever process it runs.

        Raises:
            MrmError: one has.
        """
        # Names that differ in case alone are one file to some who check the baselines out.
        claims = self._outcomes / "names"
        with claims.open("a+", encoding="utf-8") as file:
            lock(file.fileno(), baseline.PATIENCE)
            file.seek(0)
            taken = dict(json.loads(line) for line in file)
            user = taken.get(name.casefold(), test)
            if user != test:
                raise MrmError(f"two tests call their picture {name}: {user} and {test}")
            if name.casefold() not in taken:
                file.write(json.dumps([name.casefold(), test]) + "\n")

    def _keep(self, outcome: Outcome) -> None:
        text = json.dumps(as_record(outcome), allow_nan=False)
        write_text(self._outcomes / f"{outcome.name}.json", text)


def _complaint(case: MaterialCase, outcome: Outcome) -> str:
    if outcome.verdict in ("pass", "undecided"):
        return ""
    what = "the evaluator" if case.truth == "physics" else "its baseline"
    told = outcome.message or f"differs from {what}: {in_words(as_record(outcome))}"
    return f"{case.name}: {told}"


def _tolerance(thresholds: Mapping[str, float]) -> Tolerance:
    known = [each.name for each in fields(Tolerance)]
    for name in thresholds:
        if name not in known:
            raise MrmError(f"tolerance: no {name}; {suggestion(name, known)}")
    return Tolerance(**thresholds)


@functools.cache
def _worker(backend: str) -> Worker:
    from mrm_nodes.render.context import get_context

    return Worker(get_context(backend).backend)


def _driver(backend: str) -> str:
    from mrm_nodes.render.context import get_context

    return get_context(backend).renderer


def safe(name: str) -> str:
    """A name that is fit for a file: a test's, with its parameters."""
    return re.sub(r"[^\w.+-]+", "-", name, flags=re.ASCII).strip("-.") or "picture"


def conclude(folder: Path, number: str, seconds: float) -> list[Outcome]:
    """Write the report of a session where it compared anything; return its outcomes.

    number: the session's; what its processes left under it is removed.

    Raises:
        MrmError: it cannot be written.
    """
    left = folder / OUTCOMES / number
    try:
        told = [from_record(json.loads(path.read_text("utf-8"))) for path in sorted(left.glob("*.json"))]
        if told:
            plan = Plan({outcome.backend: str(outcome.details["driver"]) for outcome in told}, {})
            write_report(folder, describe_environment(plan), told, seconds)
    finally:
        shutil.rmtree(left, ignore_errors=True)
    return told
