"""`mrm-nodes scene`: draw one of the scenes."""

from __future__ import annotations

from pathlib import Path

import click

from mrm_nodes.errors import MrmError


@click.command()
@click.argument("name", metavar="cone|vest|road|figure3|figure5")
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
def scene(name: str, output: Path, mesh: str | None, scale: float, samples: int) -> None:
    """Draw a scene: traffic cones, a safety vest, a road, or the paper's Figure 3 or 5."""
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.render import write_png
    from mrm_nodes.scenes import draw

    if output.suffix.lower() != ".png":
        raise MrmError(f"{output}: unknown image ending {output.suffix or '(none)'}; use .png")
    picture = draw(name, mesh, scale, samples)
    prepare_folder(output.parent)
    write_png(output, picture)
