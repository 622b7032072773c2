"""`mrm-nodes scene`: draw one of the scenes."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import click

from mrm_nodes.commands.options import refuse_folder, say_what_is_of_pictures_only
from mrm_nodes.errors import MrmError, unknown


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
    metavar="STOPS",
    help="Beyond what each picture has of its own; of classes, auto or of 1 cd/m².  [default: 0, auto]",
)
@click.option(
    "--tonemap",
    metavar="none|neutral|VIEW",
    help="As of `mrm-nodes render`.  [default: neutral]",
)
@click.option(
    "--class",
    "classes",
    multiple=True,
    metavar="[KIND=]CLASS",
    help="Of the road by night: what signs, cones and posts are made of, or sign=, cone=, post=, vest=, paint=; may be "
    "repeated. The luminances are shown in false colours, in cd/m².",
)
@click.option(
    "--headlamp",
    metavar="CD|FILE.csv",
    help="Of the road by night: its largest intensity, or a table by angles.  [default: 20000]",
)
def scene(
    name: str,
    output: Path,
    mesh: str | None,
    scale: float,
    samples: int,
    exposure: str | None,
    tonemap: str | None,
    classes: tuple[str, ...],
    headlamp: str | None,
) -> None:
    """Draw a scene: a torch at the eye and aside, traffic cones, a safety vest, a road, the paper's Figure 3 or 5.

    \b
    mrm-nodes scene torch -o torch.png
    mrm-nodes scene road -o road.png --class RA2 --class "vest=ISO 20471" --headlamp 15000
    """
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.render import write_png
    from mrm_nodes.render.exposure import parse_exposure
    from mrm_nodes.render.tonemap import find_tonemap
    from mrm_nodes.scenes import draw

    endings = (".png", ".exr") if classes else (".png",)
    if output.suffix.lower() not in endings:
        raise MrmError(
            f"{output}: unknown image ending {output.suffix or '(none)'}; use {' or '.join(endings)}"
        )
    refuse_folder(output)
    given = {"exposure": exposure, "tonemap": tonemap}
    tonemap = "neutral" if tonemap is None else tonemap
    find_tonemap(tonemap)
    if classes:
        stops = None if exposure is None else parse_exposure(exposure)
        say_what_is_of_pictures_only([output], [each for each, text in given.items() if text is not None])
        _draw_road_of_classes(name, output, mesh, scale, samples, stops, tonemap, classes, headlamp)
    else:
        if headlamp is not None:
            raise MrmError("--headlamp lights a road of classes: name some with --class")
        if exposure == "auto":
            raise MrmError("exposure auto: a scene's pictures have their own; write the stops beyond those")
        stops = parse_exposure("0" if exposure is None else exposure)

        def begin(steps: int) -> AbstractContextManager[Callable[[], None]]:
            # What is asked for has been checked by now.
            prepare_folder(output.parent)
            return progress(name, steps)

        picture = draw(
            name,
            mesh,
            scale,
            samples,
            exposure=stops or 0.0,
            tonemap=tonemap,
            progress=begin,
        )
        write_png(output, picture)
    click.echo(output)


def _draw_road_of_classes(
    name: str,
    output: Path,
    mesh: str | None,
    scale: float,
    samples: int,
    exposure: float | None,
    tonemap: str,
    classes: tuple[str, ...],
    headlamp: str | None,
) -> None:
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder
    from mrm_nodes.render import write_exr, write_png
    from mrm_nodes.render.exposure import stops_text
    from mrm_nodes.scenes import TITLES, night
    from mrm_nodes.scenes.compose import steps
    from mrm_nodes.scenes.headlamp import dipped, find_headlamp

    if name not in TITLES:
        raise MrmError(unknown("scene", name, TITLES))
    if name != "road" or mesh is not None:
        raise MrmError(
            "--class is for the road, which has its own geometry: mrm-nodes scene road --class RA2"
        )
    made_of = night.parse_classes(classes)
    lamp = dipped() if headlamp is None else find_headlamp(headlamp)
    prepare_folder(output.parent)
    road = night.night_road(made_of, lamp)
    with progress("road", steps(road)) as step:
        seen = night.seen_of(road, scale, samples, exposure=exposure, tonemap=tonemap, drawn=step)
    if output.suffix.lower() == ".exr":
        write_exr(output, seen.luminance)
    else:
        write_png(output, night.with_legend(seen))
    click.echo(
        f"{', '.join(f'{kind} {each}' for kind, each in made_of.items())}; headlamps of {lamp.candela.max():g} cd: "
        f"up to {seen.luminance.max():.3g} cd/m²; exposure {stops_text(seen.exposure, '+')} stops",
        err=True,
    )
