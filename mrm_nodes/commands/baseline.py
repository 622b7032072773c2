"""`mrm-nodes baseline`: look after the stored images of cases that no model decides."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrm_nodes import jsontext
from mrm_nodes.commands.helptext import Group
from mrm_nodes.commands.options import external_option
from mrm_nodes.errors import MrmError, suggestion
from mrm_nodes.files import read_bytes

if TYPE_CHECKING:
    from mrm_nodes.regression.cases.material_case import MaterialCase

FAILED = 1

TEXTURES_LIT = (0, 2)
"""Before this version a material's texture could be drawn as the light of an environment, where it had none."""


def _options(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options of every command here."""
    for option in (
        click.option(
            "--suite",
            type=Path,
            default=Path("suite.toml"),
            show_default=True,
            help="The suite: a TOML file or a folder.",
        ),
        click.option(
            "--report",
            type=Path,
            default=Path("report"),
            show_default=True,
            help="Folder of the run's report.",
        ),
        click.option("--backend", help="Whose render, where the report has several."),
        external_option,
    ):
        command = option(command)
    return command


@click.group(cls=Group)
def baseline() -> None:
    """Accept, reject and compare the stored images of cases that no model decides."""


@baseline.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--reason", help="Why; it is recorded, and has to be given.")
@_options
def accept(
    cases: tuple[str, ...],
    reason: str | None,
    suite: Path,
    report: Path,
    backend: str | None,
    allow_external: bool,
) -> None:
    """Make a run's renders the baselines of cases, each by its name or a pattern such as 'tape-*'.

    \b
    mrm-nodes baseline accept stop --reason "new dye"
    """
    import json

    from mrm_nodes.regression.cases.baseline import fingerprint

    if not (reason or "").strip():
        raise MrmError(
            'say why these renders are right: --reason "new dye"; it is recorded with the baselines'
        )
    run = _Run(report, backend)
    chosen = _chosen(cases, suite, allow_external)
    renders = [(case, run.record(case.name)) for case in chosen]
    standing = {case.name: case.store.standing(case.name) for case in chosen}
    for case, record in renders:
        if record["details"].get("inputs") != fingerprint(case):
            raise MrmError(
                f"{case.name}: its material, mesh, suite or another input changed since {report} was made; "
                "run regress again and look at the new render"
            )
        run.image(record)
    for case, record in renders:
        image = run.image(record)
        provenance = {
            "inputs": record["details"]["inputs"],
            "setup": record["setup"],
            "tolerance": record["tolerance"],
            "backend": record["backend"],
            "driver": run.environment["backends"].get(record["backend"]),
            "versions": run.environment.get("versions"),
            "platform": run.environment.get("platform"),
            "suite": _suite_digest(suite),
        }
        plain = json.loads(json.dumps(provenance))
        rendered = record["details"].get("render")
        case.store.accept(case.name, image, plain, reason, standing[case.name], rendered)
        click.echo(f"accepted {case.name}: {case.store.paths(case.name)[0]}")


@baseline.command()
@click.argument("cases", nargs=-1, required=True, metavar="CASE...")
@click.option("--reason", help="Why; it is recorded.")
@_options
def reject(
    cases: tuple[str, ...],
    reason: str | None,
    suite: Path,
    report: Path,
    backend: str | None,
    allow_external: bool,
) -> None:
    """Record that a run's renders are wrong; the baselines stay as they are.

    \b
    mrm-nodes baseline reject stop --reason "too bright"
    """
    run = _Run(report, backend)
    for case in _chosen(cases, suite, allow_external):
        case.store.reject(case.name, run.image(run.record(case.name)), reason)
        click.echo(f"rejected {case.name}: the baseline is as it was")


@baseline.command()
@click.argument("cases", nargs=-1, metavar="[CASE...]")
@_options
def diff(cases: tuple[str, ...], suite: Path, report: Path, backend: str | None, allow_external: bool) -> int:
    """Compare a run's renders with the baselines; exit status 1 where one is out of its tolerance.

    \b
    mrm-nodes baseline diff
    """
    from rich.console import Console
    from rich.table import Table

    from mrm_nodes.regression.cases.material_case import BASELINE_TOLERANCE
    from mrm_nodes.regression.verdict.tolerance import compare_images
    from mrm_nodes.render.images import read_image

    run = _Run(report, backend)
    table = Table("case", "verdict", "at most", "99.9 %", "RMSE", "FLIP")
    failed = False
    for case in _chosen(cases or ("*",), suite, allow_external):
        image = read_image(run.image(run.record(case.name)))
        stored = case.store.read(case.name, image.shape)
        tolerance = case.tolerance if case.tolerance.limits() else BASELINE_TOLERANCE
        shown = (image != 0).any(axis=-1) | (stored != 0).any(axis=-1)
        compared = compare_images(image, stored, shown, tolerance)
        figures = (compared.figures.max_rel, compared.figures.p999_rel, compared.figures.rmse)
        flip = "" if compared.figures.flip is None else f"{compared.figures.flip:.2g}"
        table.add_row(case.name, compared.verdict, *(f"{figure:.2g}" for figure in figures), flip)
        failed |= compared.verdict == "fail"
    Console(markup=False, width=140).print(table)
    return FAILED if failed else 0


@baseline.command()
@_options
def status(suite: Path, report: Path, backend: str | None, allow_external: bool) -> int:
    """List the baselines: missing, accepted, of other inputs, damaged; exit status 1 unless all are accepted.

    One to be looked at again was made by a version that could draw such a material wrongly.

    \b
    mrm-nodes baseline status
    """
    from rich.console import Console
    from rich.table import Table

    from mrm_nodes.regression.suites.suitefile import load

    table = Table("case", "state", "made by", "decided by", "when", "why")
    sound = True
    cases = [case for case in load(suite, allow_external).cases if case.truth == "baseline" or case.broken]
    for case in cases:
        state, decision = _state(case)
        sound &= state == "accepted"
        told = [str(decision.get(key) or "") for key in ("version", "who", "when", "why")]
        table.add_row(case.name, state, *told)
    for case_store in {case.store for case in cases}:
        for name in sorted(set(case_store.names()) - {case.name for case in cases}):
            table.add_row(name, "of no case", "", "", "", "")
    Console(markup=False, width=160).print(table)
    return 0 if sound else FAILED


def _state(case: MaterialCase) -> tuple[str, dict[str, Any]]:
    """How a case's baseline stands, and the last decision on it, with the version that made the image."""
    from mrm_nodes.regression.cases.baseline import Missing, fingerprint, made_by

    decisions = [entry for entry in case.store.decisions() if entry.get("case") == case.name]
    last = decisions[-1] if decisions else {}
    if case.broken:
        return "material broken", last
    try:
        record = case.store.provenance(case.name)
        case.store.read(case.name)
    except Missing:
        return "rejected, none accepted" if last.get("what") == "reject" else "missing", last
    except MrmError:
        return "damaged", last
    decision = {**record["accepted"], "version": made_by(record)}
    if record["inputs"] != fingerprint(case):
        return "of other inputs", decision
    if case.environment is None and case.has_textures and _before(made_by(record), TEXTURES_LIT):
        return "to be looked at again", decision
    return "accepted", decision


def _before(version: str, other: tuple[int, int]) -> bool:
    """Whether a version is an earlier one; one that is not known is."""
    numbers = [int(each) for each in re.findall(r"\d+", version)]
    return tuple(numbers[:2]) < other


def _chosen(patterns: Sequence[str], suite: Path, allow_external: bool) -> list[MaterialCase]:
    """The cases of a suite that names or patterns mean.

    Raises:
        MrmError: one means none, or a case that has no baseline.
    """
    from mrm_nodes.regression.suites.suitefile import load

    cases = load(suite, allow_external).cases
    stored = [case for case in cases if case.truth == "baseline" and not case.broken]
    chosen: dict[str, MaterialCase] = {}
    for pattern in patterns:
        matching = [case for case in stored if fnmatchcase(case.name, pattern)]
        if not matching:
            other = next((case for case in cases if case.name == pattern), None)
            if other is not None and other.broken:
                raise MrmError(f"{pattern}: {other.reason}")
            if other is not None:
                raise MrmError(
                    f"{pattern}: its truth is physics, so it has no baseline; "
                    f'give the case truth = "baseline" in {suite} if it should'
                )
            known = [case.name for case in stored]
            raise MrmError(f"no case {pattern} with a baseline in {suite}; {suggestion(pattern, known)}")
        chosen |= {case.name: case for case in matching}
    return list(chosen.values())


def _suite_digest(suite: Path) -> str | None:
    return hashlib.sha256(suite.read_bytes()).hexdigest() if suite.is_file() else None


_TEXTS, _TABLES = ("name", "backend", "verdict", "message"), ("setup", "tolerance", "files", "details")
_FORM: dict[str, type] = {**dict.fromkeys(_TEXTS, str), **dict.fromkeys(_TABLES, dict)}
"""Of a case's record: what is needed of it here."""


def _check_form(record: Mapping[str, Any], form: Mapping[str, type]) -> None:
    """Raises KeyError or TypeError where a record lacks something, or has something else in its place."""
    for name, kind in form.items():
        if not isinstance(record[name], kind):
            raise TypeError(name)


class _Run:
    """What a run left in its report's folder."""

    def __init__(self, folder: Path, backend: str | None) -> None:
        self._folder, self._backend = folder, backend
        path = folder / "report.json"
        try:
            report = jsontext.loads(read_bytes(path))
            records = [dict(record) for record in report["cases"] if record["kind"] == "material"]
            self.environment = dict(report["environment"])
            _check_form(self.environment, {"backends": dict})
            for record in records:
                _check_form(record, _FORM)
        except OSError as error:
            raise MrmError(f"{path}: cannot be read: {error.strerror}; run regress first") from None
        except (ValueError, KeyError, TypeError):
            raise MrmError(f"{path}: damaged; run regress again") from None
        self._records = [record for record in records if backend in (None, record["backend"])]

    def record(self, name: str) -> dict[str, Any]:
        """The record of a case.

        Raises:
            MrmError: the run has none with a render, or several.
        """
        found = [each for each in self._records if each["name"] == name and each["verdict"] != "skipped"]
        if not found:
            known = [each["name"] for each in self._records]
            on = f" on {self._backend}" if self._backend else ""
            raise MrmError(f"{self._folder}: the run has no render of {name}{on}; {suggestion(name, known)}")
        if len(found) > 1:
            backends = ", ".join(each["backend"] for each in found)
            raise MrmError(f"{name} was rendered by several backends: name one with --backend ({backends})")
        return found[0]

    def image(self, record: dict[str, Any]) -> Path:
        """The render of a record, read once to see that it is sound.

        Raises:
            MrmError: there is none, or it is damaged.
        """
        import numpy as np

        from mrm_nodes.render.images import read_image

        name = record["files"].get("render_data")
        if not isinstance(name, str):
            reason = record["message"] or "the case was not rendered"
            raise MrmError(f"{record['name']}: the run has no render of it: {reason}")
        path = self._folder / name
        if not np.isfinite(read_image(path)).all():
            raise MrmError(f"{path}: the render is not finite, and no baseline")
        return path
