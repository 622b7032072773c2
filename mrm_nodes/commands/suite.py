"""`mrm-nodes suite`: check, list and begin suites of one's own materials."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from mrm_nodes.commands.helptext import Group
from mrm_nodes.commands.options import external_option
from mrm_nodes.errors import MrmError

AT_FAULT = 2


@click.group(cls=Group)
def suite() -> None:
    """Check, list and begin suites: TOML files that name materials and how they are looked at."""


@suite.command()
@click.argument("file", type=Path)
@external_option
def check(file: Path, allow_external: bool) -> int:
    """Say what is wrong with a suite, one line for each fault, or how many cases it has.

    \b
    mrm-nodes suite check suite.toml
    """
    from mrm_nodes.regression.suites.suitefile import load
    from mrm_nodes.regression.suites.suitetable import SuiteError

    try:
        found = load(file, allow_external)
        faults: Sequence[str] = found.broken
    except SuiteError as error:
        faults = error.faults
    if faults:
        for fault in faults:
            click.echo(f"mrm-nodes: {fault}", err=True)
        return AT_FAULT
    physics = sum(case.truth == "physics" for case in found.cases)
    click.echo(
        f"{file}: {len(found.cases)} cases, {physics} by physics, {len(found.cases) - physics} by baseline"
    )
    return 0


@suite.command("list")
@click.argument("file", type=Path)
@click.option(
    "--filter", "expression", metavar="EXPR", help="Only cases whose name has this part or pattern."
)
@external_option
def list_cases(file: Path, expression: str | None, allow_external: bool) -> None:
    """Print a suite's cases, what each is compared with, and why.

    \b
    mrm-nodes suite list suite.toml
    """
    from mrm_nodes.regression.suites import selection as suites
    from mrm_nodes.regression.suites.suitefile import load

    cases = suites.choose(load(file, allow_external).cases, expression)
    rows = [("case", "material", "mesh", "size", "truth", "why")]
    for case in cases:
        size = "x".join(map(str, case.size))
        truth = "none: broken" if case.broken else case.truth
        rows.append((case.name, case.material, case.mesh, size, truth, case.reason))
    # Plain lines: a table of ten thousand rows took half as long to draw as its suite to read.
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)
    click.echo("\n".join(lines))
    click.echo(f"{len(cases)} case{'s' if len(cases) != 1 else ''}")


@suite.command()
@click.argument("folder", type=Path, metavar="DIR", default=Path())
def init(folder: Path) -> None:
    """Write a commented suite and a material to DIR, ready to run.

    \b
    mrm-nodes suite init
    """
    from mrm_nodes.files import prepare_folder, write_text
    from mrm_nodes.library import materials_path

    material = "hi_vis_tape.mtlx"
    files = {
        folder / "materials" / material: (materials_path() / material).read_text(encoding="utf-8"),
        folder / "suite.toml": TEMPLATE.read_text(encoding="utf-8"),
    }
    for path, text in files.items():
        # The suite comes last: without it, the rest was cut short.
        is_ours = path.name == material and path.is_file() and path.read_bytes() == text.encode()
        if path.exists() and not is_ours:
            raise MrmError(f"{path}: exists; move it away, or name another folder")
    for path, text in files.items():
        prepare_folder(path.parent)
        write_text(path, text)
        click.echo(path)
    click.echo(f"run it with: mrm-nodes regress --suite {folder / 'suite.toml'}")


TEMPLATE = Path(__file__).parents[1] / "regression" / "suites" / "suite.toml"
