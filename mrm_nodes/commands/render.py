"""`mrm-nodes render`: draw a material on a mesh, as numbers and as pictures."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from mrm_nodes.commands.options import external_option, parse_size, within_limits
from mrm_nodes.errors import MrmError, MrmWarning


@click.command()
@click.argument("file", type=Path)
@click.option(
    "-o",
    "--output",
    "outputs",
    type=Path,
    multiple=True,
    required=True,
    help="Image to write: .exr (float32, linear, colours multiplied with alpha) or .png (sRGB, tone-mapped); may be "
    "repeated.",
)
@click.option(
    "--mesh",
    default="sphere",
    show_default=True,
    help="sphere, plane, baluster, or an .obj, .gltf or .glb file.",
)
@click.option(
    "--light",
    "lights",
    multiple=True,
    help="camera[:r,g,b], directional:x,y,z[:r,g,b], point:x,y,z[:r,g,b] or "
    "spot:x,y,z:dx,dy,dz[:r,g,b]; may be repeated.  [default: camera, or none with --env]",
)
@click.option(
    "--camera",
    help="x,y,z[:tx,ty,tz] or frame:dx,dy,dz, then :fov=, :width= or :up=.  [default: the whole mesh]",
)
@click.option("--env", "environment", help="Environment: sky, studio, or a latitude-longitude .hdr or .exr.")
@click.option("--env-rotation", "rotation", type=float, help="Degrees to turn it about +y, from +z to +x.")
@click.option("--env-layer", "layer", help="Layer of an .exr, where its colours are not what is meant.")
@click.option("--env-samples", "directions", type=int, help="Directions for each lobe.  [default: 64]")
@click.option("--size", default="512", show_default=True, metavar="WxH", help="Pixels; one number is both.")
@click.option(
    "--samples",
    type=int,
    help="Of each pixel: 1 is its middle, more smooth the edges.  [default: 9]",
)
@click.option(
    "--exposure",
    metavar="auto|STOPS",
    help="Of a .png; auto has nine of ten lit pixels below white, and 99 of 100 not clipped.  [default: auto]",
)
@click.option(
    "--tonemap",
    metavar="none|neutral|VIEW",
    help="Of a .png: clipped; Khronos PBR Neutral; a view of OpenColorIO's built-in configuration.  [default: neutral]",
)
@click.option(
    "--background",
    metavar="transparent|environment|COLOUR",
    help="Of a .png; a colour is #RRGGBB, R,G,B or black, grey, white.  [default: the environment, if there is one]",
)
@click.option("--element", help="Material to render, where the file has several.")
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@external_option
@within_limits
def render(
    file: Path,
    outputs: tuple[Path, ...],
    mesh: str,
    lights: tuple[str, ...],
    camera: str | None,
    environment: str | None,
    rotation: float | None,
    layer: str | None,
    directions: int | None,
    size: str,
    samples: int | None,
    exposure: str | None,
    tonemap: str | None,
    background: str | None,
    element: str | None,
    backend: str,
    allow_external: bool,
) -> None:
    """Render a material on a mesh.

    \b
    mrm-nodes render tape.mtlx -o tape.png --light camera
    mrm-nodes render tape.mtlx -o tape.exr -o tape.png --env sky.hdr --background environment
    """
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder, write_together
    from mrm_nodes.render.antialias import DEFAULT_SAMPLES, sample_offsets
    from mrm_nodes.render.environment import find_environment
    from mrm_nodes.render.picture import Development
    from mrm_nodes.render.renderer import IMAGE_ENDINGS, draws_of, unknown_ending
    from mrm_nodes.render.renderer import render as render_material
    from mrm_nodes.shadergen import generate_shader

    for output in outputs:
        if output.suffix.lower() not in IMAGE_ENDINGS:
            raise MrmError(unknown_ending(output))
    chosen = {"exposure": exposure, "tonemap": tonemap, "background": background}
    look: dict[str, Any] = {name: value for name, value in chosen.items() if value is not None}
    _say_what_is_of_pictures_only(outputs, look)
    development = Development(**look)
    count = DEFAULT_SAMPLES if samples is None else samples
    sample_offsets(count)
    given = {"rotation": rotation, "layer": layer, "samples": directions}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if environment is None and options:
        raise MrmError(
            "--env-rotation, --env-layer and --env-samples say how --env is used; name an environment"
        )
    around = None if environment is None else find_environment(environment, **options)
    development.behind(around)
    pixels = parse_size(size)
    for output in outputs:
        prepare_folder(output.parent)
    shader = generate_shader(file, element=element, allow_external=allow_external)
    with progress("render", draws_of(count)) as step:
        rendered = render_material(
            shader,
            mesh=mesh,
            camera=camera,
            lights=lights or (() if around else ("camera",)),
            size=pixels,
            backend=backend,
            environment=around,
            samples=count,
            drawn=step,
            **look,
        )
    write_together({output: rendered.file_bytes(output) for output in outputs})
    if any(output.suffix.lower() == ".png" for output in outputs):
        click.echo(rendered.picture.summary(), err=True)
    for output in outputs:
        click.echo(output)


def _say_what_is_of_pictures_only(outputs: Sequence[Path], look: dict[str, Any]) -> None:
    if look and all(output.suffix.lower() == ".exr" for output in outputs):
        named = " and ".join(f"--{name}" for name in look)
        message = f"{named}: an .exr has linear light and alpha, whatever they say; they are for a .png"
        warnings.warn(message, MrmWarning, stacklevel=2)
