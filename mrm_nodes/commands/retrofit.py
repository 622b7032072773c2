"""`mrm-nodes retrofit`: documents moved over to our surfaces."""

from __future__ import annotations

from pathlib import Path

import click

from mrm_nodes.commands.options import external_option, material_argument, within_limits
from mrm_nodes.errors import MrmError


@click.command()
@material_argument
@click.option("-o", "--output", type=Path, required=True, help="Document to write.")
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="INPUT=WEIGHT",
    help="specular_retroreflectivity (OpenPBR, Standard Surface) or retroreflection (glTF): a number from 0 to 1, "
    "a node beside the surface, or an image file.",
)
@external_option
@within_limits
def retrofit(file: Path, output: Path, settings: tuple[str, ...], allow_external: bool) -> None:
    """Make a document's surfaces retroreflective: OpenPBR, glTF and Standard Surface become ours.

    MATERIAL is a .mtlx, .gltf or .glb file, or a name that `mrm-nodes materials` lists.
    A .gltf or .glb becomes a .mtlx, KHR_materials_retroreflection included; such a .mtlx becomes glTF again.

    \b
    mrm-nodes retrofit vest.mtlx -o retro.mtlx --set specular_retroreflectivity=0.8
    mrm-nodes retrofit cone.gltf -o cone.mtlx
    """
    from mrm_nodes.surfaces.convert import convert
    from mrm_nodes.surfaces.rewrite import at_zero

    changed = convert(file, output, dict(parse_setting(setting) for setting in settings), allow_external)
    click.echo(f"{output}: {', '.join(changed) or 'nothing changed'}")
    unset = at_zero(output.read_bytes(), str(output)) if output.suffix.lower() == ".mtlx" else []
    if unset:
        example = " or ".join(f"--set {name}=0.8" for name in unset)
        click.echo(f"hint: every weight is 0, which changes nothing yet: {example}", err=True)


def parse_setting(text: str) -> tuple[str, float | str]:
    """Name and value from `INPUT=WEIGHT`: a number, or text that names what drives the input.

    Raises:
        MrmError: there is no name, or no value.
    """
    name, _, value = text.partition("=")
    if not (name and value):
        raise MrmError(
            f"--set {text}: write it as INPUT=WEIGHT: a number from 0 to 1, a node, or an image file"
        )
    try:
        return name, float(value)
    except ValueError:
        return name, value
