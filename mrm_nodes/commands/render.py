"""`mrm-nodes render`: draw a material on a mesh, as numbers and as pictures."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrm_nodes.commands.options import external_option, parse_size, within_limits
from mrm_nodes.errors import MrmError, MrmWarning

if TYPE_CHECKING:
    from mrm_nodes.render.environment import Environment
    from mrm_nodes.render.renderer import RenderedImage


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
    "repeated. Of frames: .exr (each), .png (each, and a contact sheet), .webp or .apng (animated).",
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
@click.option("--turntable", type=int, metavar="N", help="Draw N frames in which the mesh turns once.")
@click.option(
    "--light-sweep",
    type=int,
    metavar="N",
    help="Draw N frames in which the light goes from the camera to 60 degrees beside it.",
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
    turntable: int | None,
    light_sweep: int | None,
    element: str | None,
    backend: str,
    allow_external: bool,
) -> None:
    """Render a material on a mesh.

    \b
    mrm-nodes render tape.mtlx -o tape.png --light camera
    mrm-nodes render tape.mtlx -o tape.exr -o tape.png --env sky.hdr
    mrm-nodes render tape.mtlx -o tape.png -o tape.webp --light-sweep 16
    """
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder, write_together
    from mrm_nodes.render.antialias import DEFAULT_SAMPLES, sample_offsets
    from mrm_nodes.render.environment import find_environment
    from mrm_nodes.render.picture import Development
    from mrm_nodes.render.renderer import draws_of
    from mrm_nodes.render.renderer import render as render_material
    from mrm_nodes.shadergen import generate_shader

    moves = _motion(turntable, light_sweep, lights)
    _check_names(outputs, moves is not None)
    chosen = {"exposure": exposure, "tonemap": tonemap, "background": background}
    look: dict[str, Any] = {name: value for name, value in chosen.items() if value is not None}
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
    _say_what_is_of_pictures_only(outputs, look)
    shader = generate_shader(file, element=element, allow_external=allow_external)
    lit = lights or (() if around else ("camera",))
    draw = functools.partial(render_material, shader, size=pixels, backend=backend)
    if moves is None:
        with progress("render", draws_of(count)) as step:
            rendered = draw(
                mesh, camera=camera, lights=lit, environment=around, samples=count, drawn=step, **look
            )
        write_together({output: rendered.file_bytes(output) for output in outputs})
        written, shown = list(outputs), rendered.picture.summary()
    else:
        written, shown = _write_frames(draw, mesh, camera, lit, around, moves, outputs, count, look, pixels)
    if any(output.suffix.lower() != ".exr" for output in outputs):
        click.echo(shown, err=True)
    for path in written:
        click.echo(path)


def _motion(turntable: int | None, light_sweep: int | None, lights: Sequence[str]) -> Motion | None:
    if turntable is not None and light_sweep is not None:
        raise MrmError("--turntable and --light-sweep: one of them at a time")
    if light_sweep is not None and lights:
        raise MrmError("--light-sweep moves a light of its own: leave out --light")
    if turntable is None and light_sweep is None:
        return None
    return ("turntable", turntable) if turntable is not None else ("light sweep", light_sweep or 0)


Motion = tuple[str, int]
"""What moves, and in how many frames."""


def _check_names(outputs: Sequence[Path], moves: bool) -> None:
    from mrm_nodes.render.renderer import IMAGE_ENDINGS, unknown_ending
    from mrm_nodes.render.sheet import ANIMATED

    endings = (*IMAGE_ENDINGS, *(ANIMATED if moves else ()))
    for output in outputs:
        if output.suffix.lower() not in endings:
            alone = not moves and output.suffix.lower() in ANIMATED
            hint = ", or name frames with --turntable or --light-sweep" if alone else ""
            raise MrmError(unknown_ending(output, endings) + hint)
        if outputs.count(output) > 1:
            raise MrmError(f"{output}: named twice with -o")


def _say_what_is_of_pictures_only(outputs: Sequence[Path], look: dict[str, Any]) -> None:
    if look and all(output.suffix.lower() == ".exr" for output in outputs):
        named = " and ".join(f"--{name}" for name in look)
        message = f"{named}: an .exr has linear light and alpha, whatever they say; they are for a .png"
        warnings.warn(message, MrmWarning, stacklevel=2)


def _write_frames(
    draw: Callable[..., RenderedImage],
    mesh: str,
    camera: str | None,
    lights: Sequence[str],
    environment: Environment | None,
    moves: Motion,
    outputs: Sequence[Path],
    samples: int,
    look: dict[str, Any],
    size: tuple[int, int],
) -> tuple[list[Path], str]:
    """Draw frames at one exposure and write them together; the files, and how they are shown."""
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import write_together
    from mrm_nodes.render.images import png_bytes
    from mrm_nodes.render.meshfile import load_mesh
    from mrm_nodes.render.renderer import draws_of
    from mrm_nodes.render.sheet import ANIMATED, animation, contact_sheet
    from mrm_nodes.render.sweep import frames_of

    kind, count = moves
    shape = load_mesh(mesh)
    frames = frames_of(kind, count, shape, camera, lights, environment, size[0] / size[1])
    is_auto = look.get("exposure", "auto") == "auto"
    endings = {output.suffix.lower() for output in outputs}
    files: dict[Path, bytes] = {}
    shown = []
    with progress(kind, count * (draws_of(samples) + is_auto)) as step:
        options = [
            {"camera": each.camera, "lights": each.lights, "environment": each.environment, "drawn": step}
            for each in frames
        ]
        if is_auto:
            # Of the brightest frame: in no other more is clipped.
            look = look | {"exposure": min(draw(shape, **each, **look).picture.exposure for each in options)}
        for number, each in enumerate(options, start=1):
            rendered = draw(shape, **each, samples=samples, **look)
            for output in outputs:
                if output.suffix.lower() not in ANIMATED:
                    path = output.with_stem(f"{output.stem}.{number:0{max(2, len(str(count)))}}")
                    files[path] = rendered.file_bytes(path)
            if endings != {".exr"}:
                shown.append(rendered.picture)
    codes = [picture.codes() for picture in shown]
    for output in outputs:
        ending = output.suffix.lower()
        if ending == ".png":
            sheet = contact_sheet(codes, [each.label for each in frames])
            files[output] = png_bytes(sheet, shown[0].said(), str(output))
        elif ending in ANIMATED:
            files[output] = animation(codes, ending, there_and_back=kind == "light sweep")
    write_together(files)
    most = max(shown, key=lambda picture: picture.clipped, default=None)
    return list(files), "" if most is None else f"{count} frames: {most.summary()} at most"
