"""`mrm-nodes render`: draw a material on a mesh, as numbers and as pictures."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mrm_nodes.commands.options import (
    external_option,
    material_argument,
    parse_size,
    refuse_folder,
    say_what_is_of_pictures_only,
    within_limits,
)
from mrm_nodes.errors import MrmError

if TYPE_CHECKING:
    from mrm_nodes.render.renderer import RenderedImage
    from mrm_nodes.render.sweep import Frame


@click.command()
@material_argument
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
    help="camera[:colour], directional:x,y,z[:colour], point:x,y,z[:colour] or spot:x,y,z:dx,dy,dz[:colour], where a "
    "colour is r,g,b or one number; may be repeated.  [default: camera, or none with --env]",
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

    MATERIAL is a .mtlx file, or a name that `mrm-nodes materials` lists; a file wins where it has such a name.

    \b
    mrm-nodes render traffic_cone -o cone.png
    mrm-nodes render tape.mtlx -o tape.png --light camera
    mrm-nodes render tape.mtlx -o tape.exr -o tape.png --env sky.hdr
    mrm-nodes render tape.mtlx -o tape.png -o tape.webp --light-sweep 16
    """
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import prepare_folder, write_together
    from mrm_nodes.render.antialias import DEFAULT_SAMPLES, sample_offsets
    from mrm_nodes.render.environment import find_environment
    from mrm_nodes.render.meshfile import load_mesh
    from mrm_nodes.render.picture import Development
    from mrm_nodes.render.renderer import draws_of, shared_renderer
    from mrm_nodes.render.renderer import render as render_material
    from mrm_nodes.render.scene import parse_camera, parse_light
    from mrm_nodes.render.sweep import frames_of
    from mrm_nodes.shadergen import generate_shader, room_for

    moves = _motion(turntable, light_sweep, lights)
    files = _planned(outputs, moves)
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
    _check_size(outputs, pixels)
    say_what_is_of_pictures_only(outputs, look)
    lit = lights or (() if around else ("camera",))
    room = room_for(len(lit))
    shader = generate_shader(file, element=element, allow_external=allow_external, max_lights=room)
    shape = load_mesh(mesh)
    parsed_lights = [parse_light(light) for light in lit]
    parsed_camera = None if camera is None else parse_camera(camera)
    frames = frames_of(*moves, shape, camera, lit, around, pixels[0] / pixels[1]) if moves else []
    shared_renderer(backend).checked_size(pixels)
    for output in outputs:
        prepare_folder(output.parent)
    wanted = any(output.suffix.lower() != ".exr" for output in outputs)
    draw = functools.partial(render_material, shader, shape, size=pixels, backend=backend, picture=wanted)
    if moves is None:
        with progress("render", draws_of(count)) as step:
            rendered = draw(
                camera=parsed_camera,
                lights=parsed_lights,
                environment=around,
                samples=count,
                drawn=step,
                **look,
            )
        write_together({output: rendered.file_bytes(output) for output in outputs})
        shown = rendered.picture.summary() if wanted else ""
    else:
        shown = _write_frames(draw, frames, moves[0], files, count, look, wanted)
    if wanted:
        click.echo(shown, err=True)
    for path in _in_order(files):
        click.echo(path)


def _motion(turntable: int | None, light_sweep: int | None, lights: Sequence[str]) -> Motion | None:
    from mrm_nodes.render.sweep import check_count

    if turntable is not None and light_sweep is not None:
        raise MrmError("--turntable and --light-sweep: one of them at a time")
    if light_sweep is not None and lights:
        raise MrmError("--light-sweep moves a light of its own: leave out --light")
    if turntable is None and light_sweep is None:
        return None
    moves = ("turntable", turntable) if turntable is not None else ("light sweep", light_sweep or 0)
    check_count(moves[1], moves[0])
    return moves


Motion = tuple[str, int]
"""What moves, and in how many frames."""


@dataclass(frozen=True)
class _Files:
    """What is written for one output."""

    output: Path
    frames: Sequence[Path]
    """One for each frame, or none."""
    is_whole: bool
    """Whether the output itself is written: the picture, the sheet or the animation."""


def _planned(outputs: Sequence[Path], moves: Motion | None) -> list[_Files]:
    """What is to be written, before anything is drawn.

    Raises:
        MrmError: an ending that is none; a file that would be written twice, or that is a folder.
    """
    from mrm_nodes.render.renderer import IMAGE_ENDINGS, unknown_ending
    from mrm_nodes.render.sheet import ANIMATED

    endings = (*IMAGE_ENDINGS, *(ANIMATED if moves else ()))
    files = []
    for output in outputs:
        ending = output.suffix.lower()
        if ending not in endings:
            hint = (
                ", or name frames with --turntable or --light-sweep"
                if not moves and ending in ANIMATED
                else ""
            )
            raise MrmError(unknown_ending(output, endings) + hint)
        frames = []
        if moves and ending not in ANIMATED:
            digits = max(2, len(str(moves[1])))
            frames = [output.with_stem(f"{output.stem}.{n:0{digits}}") for n in range(1, moves[1] + 1)]
        files.append(_Files(output, frames, not frames or ending == ".png"))
    taken: dict[Path, str] = {}
    for each in files:
        whole = [(each.output, f"-o {each.output}")] if each.is_whole else []
        for path, named in [*whole, *((frame, f"a frame of {each.output}") for frame in each.frames)]:
            refuse_folder(path)
            # What a link leads to is not written: the file takes its place.
            place = path.parent.resolve() / path.name
            if place in taken and taken[place] == named:
                raise MrmError(f"{path}: named twice with -o")
            if place in taken:
                raise MrmError(f"{path}: would be written twice, as {taken[place]} and as {named}")
            taken[place] = named
    return files


def _in_order(files: Sequence[_Files]) -> list[Path]:
    """Every file, the frames first, each of all outputs after the other."""
    frames = zip(*(each.frames for each in files if each.frames), strict=True)
    return [
        *(path for number in frames for path in number),
        *(each.output for each in files if each.is_whole),
    ]


def _check_size(outputs: Sequence[Path], size: tuple[int, int]) -> None:
    from mrm_nodes.render.sheet import LARGEST

    for output in outputs:
        ending = output.suffix.lower()
        largest = LARGEST.get(ending, max(size))
        if max(size) > largest:
            raise MrmError(
                f"{output}: size {size[0]}x{size[1]}: a {ending} has {largest} pixels a side at most"
            )


def _write_frames(
    draw: Callable[..., RenderedImage],
    frames: Sequence[Frame],
    kind: str,
    files: Sequence[_Files],
    samples: int,
    look: dict[str, Any],
    has_pictures: bool,
) -> str:
    """Draw frames at one exposure and write them together; returns how they are shown, if any is."""
    from mrm_nodes.commands.progress import progress
    from mrm_nodes.files import write_together
    from mrm_nodes.render.images import png_bytes
    from mrm_nodes.render.renderer import draws_of
    from mrm_nodes.render.sheet import animation, contact_sheet

    is_auto = has_pictures and look.get("exposure", "auto") == "auto"
    contents: dict[Path, bytes] = {}
    codes = []
    most, shown, said = -1.0, "", {}
    with progress(kind, len(frames) * (draws_of(samples) + is_auto)) as step:
        options = [
            {"camera": each.camera, "lights": each.lights, "environment": each.environment, "drawn": step}
            for each in frames
        ]
        if is_auto:
            # Of the brightest frame: in no other more is clipped.
            stops = [draw(**each, **look).auto_exposure() for each in options]
            look = look | {"exposure": min((each for each in stops if each is not None), default=0.0)}
        for number, each in enumerate(options):
            rendered = draw(**each, samples=samples, **look)
            for file in files:
                if file.frames:
                    contents[file.frames[number]] = rendered.file_bytes(file.frames[number])
            if has_pictures:
                picture = rendered.picture
                said = picture.said()
                codes.append(picture.codes())
                if picture.clipped > most:
                    most, shown = picture.clipped, picture.summary()
    for file in files:
        ending = file.output.suffix.lower()
        if file.is_whole and ending == ".png":
            sheet = contact_sheet(codes, [each.label for each in frames])
            contents[file.output] = png_bytes(sheet, said, str(file.output))
        elif file.is_whole:
            contents[file.output] = animation(codes, ending, there_and_back=kind == "light sweep")
    write_together(contents)
    return f"{len(frames)} frames: {shown}{' at most' if most > 0.0 else ''}"
