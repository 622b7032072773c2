"""`mrm-nodes material`: write the material of a class, or of the one number that OpenMATERIAL has."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrm_nodes.commands.options import one_of, within_limits
from mrm_nodes.commands.photometry import parse_geometry, rows_table
from mrm_nodes.errors import MrmError

if TYPE_CHECKING:
    from mrm_nodes.photometry import Design
    from mrm_nodes.photometry.openmaterial import XompAsset

ENDINGS = (".mtlx", ".xomp")


@click.command()
@click.option("--class", "name", help="RA2, ISO 20471, D4956 III, number plate, EN 1436 dry, ...")
@click.option("--colour", "--color", help="Colour of the class.")
@click.option(
    "-o", "--output", type=Path, required=True, help="Document to write: .mtlx, or .xomp (OpenMATERIAL)."
)
@click.option(
    "--margin", type=float, default=0.0, show_default=True, help="Share by which to be above each minimum."
)
@click.option(
    "--as",
    "form",
    **one_of("nodes", "open_pbr"),
    default="nodes",
    show_default=True,
    help="BSDF nodes, or mrm_open_pbr_surface.",
)
@click.option("--from", "asset", type=Path, help=".xomp of OpenMATERIAL, whose coefficient it gets.")
@click.option(
    "--geometry",
    metavar="OBSERVATION,ENTRANCE",
    help="Degrees at which the .xomp file's coefficient holds, such as 0.2,-4.",
)
@within_limits
def material(
    name: str | None,
    colour: str | None,
    output: Path,
    margin: float,
    form: str,
    asset: Path | None,
    geometry: str | None,
) -> None:
    """Write a retroreflector that is nowhere below a class's minima and little above, and print what it has.

    With --from it has the coefficient of an OpenMATERIAL file, and the width and falloff of a class (RA2).
    Design help, no certification: that takes a laboratory and the standard itself.

    \b
    mrm-nodes material --class RA2 --colour yellow -o sign.mtlx
    mrm-nodes material --from asset.xomp --geometry 0.2,-4 --colour white -o sign.mtlx
    """
    if output.suffix.lower() not in ENDINGS:
        raise MrmError(f"{output}: unknown ending {output.suffix or '(none)'}; use {' or '.join(ENDINGS)}")
    if asset is not None:
        if margin or form != "nodes":
            raise MrmError("--margin and --as are of a class's material: --from has a value of its own")
        _from_asset(asset, name or "RA2", colour, geometry, output)
    elif name is None:
        raise MrmError("name a class with --class, or an OpenMATERIAL file with --from")
    elif geometry is not None:
        raise MrmError("--geometry is that of --from: a class has its own")
    else:
        _of_class(name, colour, margin, form, output)


def _of_class(name: str, colour: str | None, margin: float, form: str, output: Path) -> None:
    from rich.console import Console

    from mrm_nodes.photometry import find_class, material_for
    from mrm_nodes.photometry.openmaterial import asset_text
    from mrm_nodes.photometry.openpbr import open_pbr_surface

    as_asset = output.suffix.lower() == ".xomp"
    if as_asset and form != "nodes":
        raise MrmError(f"{output}: OpenMATERIAL has a coefficient and no surface: leave --as out")
    if as_asset and find_class(name).of(colour)[0].quantity != "R_A":
        raise MrmError(f"{output}: OpenMATERIAL has R_A, which {find_class(name).name} does not ask for")
    design = material_for(name, colour, margin)
    stem, rows, lost = output.stem, design.rows, list[str]()
    if as_asset:
        text = asset_text(stem, design.bsdf, design.colour, f"material of {design.retro_class.name}")
    elif form == "open_pbr":
        text, rows, lost = open_pbr_surface(design, stem, about(design))
    else:
        text = design.bsdf.markup(stem, about(design))
    _write(output, text)
    Console(markup=False, width=100).print(rows_table(rows))
    found = design.retro_class
    parameters = "mrm_open_pbr_surface" if form == "open_pbr" else _parameters(design.bsdf)
    click.echo(f"{output}: {found.name}, {design.colour}: {parameters}")
    if form == "nodes":
        click.echo(
            f"excess: {design.rms:.3f} rms of ln(value / minimum), at most {design.worst.margin:.0%} "
            f"({design.worst.requirement.geometry})"
        )
    click.echo(f"values of {found.name} ({found.standing}): {found.source}")
    for each in lost:
        click.echo(f"not carried by OpenPBR: {each}")


def about(design: Design) -> str:
    """What a document says of itself."""
    found = design.retro_class
    return (
        f"{found.name}, {design.colour}: {found.title}. No value is below its minimum. "
        "Design help, no certification. Made with mrm-nodes."
    )


def _from_asset(path: Path, name: str, colour: str | None, geometry: str | None, output: Path) -> None:
    from mrm_nodes.photometry import find_class, luminance, retroreflection
    from mrm_nodes.photometry.openmaterial import asset_text, material_of, read_asset

    found = read_asset(path)
    angles = (
        parse_geometry(geometry) if geometry is not None else found.geometry or _asked_geometry(path, found)
    )
    like = find_class(name)
    colour = like.resolve(colour or found.colour or _asked_colour(path))
    bsdf = material_of(found.coefficient, angles, colour, name)
    if output.suffix.lower() == ".xomp":
        text = asset_text(found.name, bsdf, colour, f"from {path.name}: {found.coefficient:g}", found)
    else:
        text = bsdf.markup(output.stem, f"{found.name}, {colour}: R_A {found.coefficient:g} of {path.name}.")
    _write(output, text)
    value = float(luminance(retroreflection(bsdf, *angles)))
    click.echo(f"{output}: {found.name}, {colour}, shaped as {like.name}: {_parameters(bsdf)}")
    click.echo(f"R_A {value:.6g} cd/(lx m²) at observation {angles[0]:g}°, entrance {angles[1]:g}°")


def _asked_geometry(path: Path, found: XompAsset) -> tuple[float, ...]:
    _check_asked(path, "--geometry 0.2,-4")
    said = f" Its sources: {found.sources}." if found.sources else ""
    question = f"{path}: OpenMATERIAL does not say at which angles {found.coefficient:g} holds.{said}"
    return parse_geometry(click.prompt(f"{question}\nobservation,entrance", default="0.2,-4", err=True))


def _asked_colour(path: Path) -> str:
    _check_asked(path, "--colour white")
    return str(
        click.prompt(
            f"{path}: OpenMATERIAL does not say which colour it has.\ncolour", default="white", err=True
        )
    )


def _check_asked(path: Path, option: str) -> None:
    """Ask only where somebody is there to answer."""
    if not sys.stdin.isatty():
        raise MrmError(
            f"{path}: OpenMATERIAL's coefficient has no angles and no colour: say what they are, as in {option}"
        )


def _parameters(bsdf: Any) -> str:
    import numpy as np

    colour = ", ".join(f"{each:.4g}" for each in np.broadcast_to(np.asarray(bsdf.f0), 3))
    falloff = "" if bsdf.falloff is None else f", falloff {float(np.asarray(bsdf.falloff)):.4g}"
    return f"alpha {float(np.asarray(bsdf.alpha)):.4g}, F0 {colour}{falloff}"


def _write(output: Path, text: str) -> None:
    from mrm_nodes.files import prepare_folder, write_text

    prepare_folder(output.parent)
    write_text(output, text)
