"""`mrm-nodes scene`: draw one of the scenes."""

from __future__ import annotations

from pathlib import Path

import click

from mrm_nodes.errors import MrmError


@click.command()
@click.argument("name", metavar="torch|cone|vest|road|figure3|figure5")
@click.option("-o", "--output", type=Path, required=True, help="Image to write: .png.")
@click.option(
    "--mesh", help="For the figures: sphere, plane, baluster, or an .obj, .gltf or .glb file of yours."
)
@click.option(
    "--scale", type=click.FloatRange(0.05, 8.0), default=1.0, show_default=True, help="Size of the picture."
)
@click.option(
    "--samples",
    type=click.IntRange(1, 8),
    default=2,
    show_default=True,
    help="A pixel has the square of this many.",
)
@click.option(
    "--exposure",
    default="0",
    show_default=True,
    metavar="STOPS",
    help="Beyond what each picture has of its own.",
)
@click.option(
    "--tonemap",
    default="neutral",
    show_default=True,
    metavar="none|neutral|VIEW",
    help="As of `mrm-nodes render`.",
)
def scene(
    name: str, output: Path, mesh: str | None, scale: float, samples: int, exposure: str, tonemap: str
) -> None:
    """Draw a scene: a torch at the eye and aside, traffic cones, a safety vest, a road, the paper's Figure 3 or 5."""
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.render import write_png
    from mrm_nodes.render.exposure import parse_exposure
    from mrm_nodes.render.tonemap import find_tonemap
    from mrm_nodes.scenes import TITLES, draw

    if output.suffix.lower() != ".png":
        raise MrmError(f"{output}: unknown image ending {output.suffix or '(none)'}; use .png")
    if exposure == "auto":
        raise MrmError("exposure auto: a scene's pictures have their own; write the stops beyond those")
    stops = parse_exposure(exposure) or 0.0
    find_tonemap(tonemap)
    if name in TITLES:
        prepare_folder(output.parent)
    picture = draw(
        name,
        mesh,
        scale,
        samples,
        exposure=stops,
        tonemap=tonemap,
        progress=lambda steps: progress(name, steps),
    )
    write_png(output, picture)
    click.echo(output)
