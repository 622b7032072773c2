"""The command line: parses, calls, prints. Heavy imports wait until a command needs them."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from mrm_nodes.allowance import out_of_memory
from mrm_nodes.commands.baseline import baseline
from mrm_nodes.commands.bench_regress import regress as bench_regress
from mrm_nodes.commands.bench_regress import scale as bench_scale
from mrm_nodes.commands.fit import fit
from mrm_nodes.commands.material import material
from mrm_nodes.commands.materials import materials
from mrm_nodes.commands.options import OWN_PROCESS, external_option, material_argument, within_limits
from mrm_nodes.commands.photometry import photometry
from mrm_nodes.commands.regress import merge, regress
from mrm_nodes.commands.render import render
from mrm_nodes.commands.scene import scene
from mrm_nodes.commands.suite import suite
from mrm_nodes.errors import MrmError, MrmWarning

if TYPE_CHECKING:
    from mrm_nodes.host import Environment

TRACEBACK_VARIABLE = "MRM_TRACEBACK"
"""Set it to see where an unexpected error came from."""

FAILED, AT_FAULT, INTERRUPTED = 1, 2, 130
"""Exit status: a comparison failed; the request or the machine was at fault; Ctrl-C."""

SUFFIXES = {"vulkan": "glsl", "essl": "glsl", "msl": "metal"}
"""Endings of shader files whose target's own name is not its ending."""


def main(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and exit with its status; a fault is one line on stderr, never a traceback.

    arguments: by default those of this process, which is then nobody else's.
    """
    warnings.showwarning = _each_warning_once()
    warnings.simplefilter("always", MrmWarning)
    try:
        own = OWN_PROCESS if arguments is None else None
        status = cli.main(arguments, prog_name="mrm-nodes", standalone_mode=False, obj=own)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message(), err=True)
        status = AT_FAULT
    except click.ClickException as error:
        status = _complain(error.format_message())
    except (KeyboardInterrupt, click.Abort):
        status = INTERRUPTED
    except MrmError as error:
        status = _complain(str(error))
    except MemoryError:
        status = _complain(out_of_memory())
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        where = f"{TRACEBACK_VARIABLE}=1 shows where"
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            status = _complain(f"{error.filename or 'a file or stdout'}: {error.strerror} ({where})")
        else:
            status = _complain(f"unexpected {type(error).__name__}: {error} ({where})")
    sys.exit(status or 0)


def _complain(message: str) -> int:
    click.echo(f"mrm-nodes: {_one_line(message)}", err=True)
    return AT_FAULT


def _each_warning_once() -> Callable[..., None]:
    """Print warnings, each the first time: what is generated for eight targets has the same ones in each."""
    told: set[str] = set()

    def show(message: Warning | str, category: type[Warning], *where: Any, **others: Any) -> None:
        line = f"warning: {_one_line(str(message))}"
        if issubclass(category, MrmWarning) and line not in told:
            told.add(line)
            click.echo(line, err=True)

    return show


def _one_line(text: str) -> str:
    return " ".join(text.split())


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="mrm-nodes")
def cli() -> None:
    """Retroreflective microfacet nodes for MaterialX: check, render, generate, install."""


@cli.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
def doctor(backend: str) -> int:
    """Say which compilers and OpenGL were found, whether a render works, and how to mend what does not."""
    from mrm_nodes.doctor import examine

    return examine(backend)


@cli.command()
def warmup() -> None:
    """Compile the evaluator now, once for this installation, so that no first run waits for it."""
    from mrm_nodes.reference.warmup import folder, warm_up
    from mrm_nodes.regression import terminal

    with terminal.progress() as shown:
        count = warm_up(lambda name, done, total: shown.compiled(done, total))
    place = folder()
    if place is None:
        raise MrmError(
            "what is compiled can be kept nowhere; set NUMBA_CACHE_DIR to a folder that can be written"
        )
    click.echo(f"{f'{count} loops compiled' if count else 'nothing to compile'}: they are kept in {place}")


cli.add_command(baseline)
cli.add_command(fit)
cli.add_command(material)
cli.add_command(materials)
cli.add_command(photometry)
cli.add_command(regress)
cli.add_command(render)
cli.add_command(scene)
cli.add_command(suite)
cli.add_command(merge)


@cli.command()
@material_argument
@click.option("--target", help="glsl, essl, vulkan, wgsl, msl, slang, osl or mdl; every one if only checked.")
@click.option("-o", "--output", "folder", type=Path, help="Folder for the shader's files.")
@click.option("--element", help="Material to generate, where the file has several.")
@click.option(
    "--environment",
    type=click.Choice(["fis", "prefilter", "none"]),
    default="fis",
    show_default=True,
    help="Method of environment light.",
)
@click.option(
    "--libraries", type=Path, help="MaterialX `libraries` folder, in place of the installed MaterialX's."
)
@click.option("--check", is_flag=True, help="Compile what is generated, and print a table.")
@click.option(
    "--strict",
    is_flag=True,
    help="Stop where the target ignores what the material sets: an input, or a colour space.",
)
@external_option
@within_limits
def generate(
    file: Path,
    target: str | None,
    folder: Path | None,
    element: str | None,
    environment: str,
    libraries: Path | None,
    check: bool,
    strict: bool,
    allow_external: bool,
) -> int:
    """Generate a material's shader code and print the files written, or check it with compilers.

    MATERIAL is a .mtlx file, or a name that `mrm-nodes materials` lists; a file wins where it has such a name.
    """
    from mrm_nodes import documents, shadergen

    if target is None and not check:
        raise MrmError(f"name a target with --target: {', '.join(shadergen.supported_targets())}")
    if folder is None and not check:
        raise MrmError("name a folder for the shader's files with -o, or say --check")
    targets = shadergen.supported_targets() if target is None else [target]
    document = documents.read_document(file, libraries, allow_external)
    _say_what_is_ignored(document, file, element, targets, environment, libraries, strict)
    options: dict[str, Any] = {
        "environment": environment,
        "libraries": libraries,
        "allow_external": allow_external,
    }
    if folder is not None:
        from mrm_nodes.files import prepare_folder

        shaders = [shadergen.generate_shader(file, each, element, **options) for each in targets]
        prepare_folder(folder)
        for shader in shaders:
            _write_shader(shader, folder if target else folder / shader.target)
    return _print_checks(file, targets, element, options) if check else 0


def _say_what_is_ignored(
    document: Any,
    file: Path,
    element: str | None,
    targets: list[str],
    environment: str,
    libraries: Path | None,
    strict: bool,
) -> None:
    from mrm_nodes import limits, shadergen, values
    from mrm_nodes.elements import find_renderable
    from mrm_nodes.naming import named_for_code

    ignored: dict[str, None] = {}
    for target in targets:
        name = shadergen.generator_target(target)
        ignored.update(dict.fromkeys(limits.ignored_inputs(document, name, environment, libraries)))
        for message in limits.honoured_inputs(document, name, libraries):
            click.echo(f"{file}: {message}", err=True)
    found = find_renderable(document, str(file), element)
    settled = values.settle(*named_for_code(document, found), str(file))
    ignored |= dict.fromkeys(settled.foreign)
    if strict and ignored:
        raise MrmError(f"{file}: {'; '.join(ignored)}")
    for message in ignored:
        warnings.warn(f"{file}: {message}", MrmWarning, stacklevel=1)


def _write_shader(shader: Any, folder: Path) -> None:
    from mrm_nodes.files import prepare_folder, write_text

    prepare_folder(folder)
    ending = SUFFIXES.get(shader.target, shader.target)
    stages = {"vertex": shader.vertex, "pixel": shader.pixel}
    written = {stage: text for stage, text in stages.items() if text}
    for stage, text in written.items():
        path = folder / (
            f"{shader.name}.{ending}" if len(written) == 1 else f"{shader.name}.{stage}.{ending}"
        )
        write_text(path, text)
        click.echo(path)


def _print_checks(file: Path, targets: list[str], element: str | None, options: dict[str, Any]) -> int:
    from rich.console import Console
    from rich.table import Table

    from mrm_nodes.compilers import check_material

    checks = [check_material(file, target, element, **options) for target in targets]
    table = Table("target", "result", "compiler", "complaints")
    for check in checks:
        table.add_row(check.target, check.status, check.compiler, "\n".join(check.complaints))
    Console(markup=False, width=140).print(table)
    return FAILED if any(check.is_fault for check in checks) else 0


@cli.command()
@click.option(
    "--configurations",
    type=click.IntRange(100),
    default=50_000,
    show_default=True,
    help="Random configurations of each node, wherever a target can be run.",
)
def targets(configurations: int) -> None:
    """Compile and run the nodes in every target, and print what did it and the worst errors."""
    from rich.console import Console
    from rich.table import Table

    from mrm_nodes.regression.targets import table

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:.2g}"

    printed = Table("target", "compiled by", "run on", "of its bound", "with film", "error, alpha >= 0.1")
    for row in table(configurations):
        errors = (number(value) for value in (row.used, row.used_film, row.error))
        printed.add_row(row.target, row.compiled_by, row.run_on, *errors)
    Console(markup=False, width=140).print(printed)


@cli.command()
@click.argument("folder", type=Path, metavar="DIR")
@click.option(
    "--environment",
    type=click.Choice(["any", "fis", "prefilter"]),
    default="any",
    show_default=True,
    help="The method of image light of the programs that will use it, where all have one: the nodes cost less.",
)
def install(folder: Path, environment: Environment) -> None:
    """Copy the node library, GLSL included, to DIR/mrm, where DIR is a MaterialX `libraries` folder."""
    from mrm_nodes.library import install as install_library

    files = install_library(folder, environment)
    click.echo(f"{len(files)} files in {folder / 'mrm'}")


@cli.command()
@click.argument("folder", type=Path, metavar="DIR")
def uninstall(folder: Path) -> None:
    """Remove from DIR/mrm exactly what `install` wrote there."""
    from mrm_nodes.library import uninstall as uninstall_library

    removed, kept = uninstall_library(folder)
    click.echo(f"{len(removed)} files removed from {folder / 'mrm'}")
    for file in kept:
        click.echo(f"kept {file}: added or changed since the installation")


@cli.command()
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
    """
    from mrm_nodes.surfaces.convert import convert
    from mrm_nodes.surfaces.rewrite import at_zero

    changed = convert(file, output, dict(parse_setting(setting) for setting in settings), allow_external)
    click.echo(f"{output}: {', '.join(changed) or 'nothing changed'}")
    unset = at_zero(output.read_bytes(), str(output)) if output.suffix.lower() == ".mtlx" else []
    if unset:
        example = " or ".join(f"--set {name}=0.8" for name in unset)
        click.echo(f"hint: every weight is 0, which changes nothing yet: {example}", err=True)


@cli.group()
def bench() -> None:
    """Measure what the nodes and the evaluator cost."""


bench.add_command(bench_regress)
bench.add_command(bench_scale)


@bench.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option("--size", type=click.IntRange(16, 4096), default=256, show_default=True, help="Pixels a side.")
@click.option("--rounds", type=click.IntRange(3, 1000), default=21, show_default=True, help="Frames of each.")
@click.option("--surfaces", is_flag=True, help="Time the whole surfaces instead of the nodes.")
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def shader(backend: str, size: int, rounds: int, surfaces: bool, output: Path | None) -> None:
    """Time the blended nodes beside MaterialX's own node (a) and its mix of two (b)."""
    import json

    from mrm_nodes import bench as shader_bench
    from mrm_nodes.files import write_text

    if surfaces:
        from mrm_nodes.bench_surfaces import print_table

        return print_table(backend, size, rounds, output)
    machine = shader_bench.describe_machine(backend)
    for what, value in machine.items():
        click.echo(f"{what:<10} {value}")
    click.echo(f"{'node':<28} {'light':<7} {'interface':<9} {'film':<4} {'(a) ms':>8} " + _BENCH_COLUMNS)
    rows = []
    for row in shader_bench.bench_shaders(backend, size, rounds, instructions=True):
        ratios = " ".join(f"{value:>8.2f}" for value in row.ratios.values())
        counts = " ".join(f"{row.instructions.get(name, 0):>6}" for name in ("single", "mix", "ours 0.5"))
        film = "on" if row.film else "off"
        place = f"{row.node:<28} {row.light:<7} {row.interface:<9} {film:<4}"
        click.echo(f"{place} {row.milliseconds['single']:>8.2f} {ratios} {counts}")
        rows.append(row)
    if output is not None:
        write_text(output, json.dumps(shader_bench.as_json(rows, machine), indent=2) + "\n")


@bench.command()
@click.option("--backend", default="auto", show_default=True, help="egl, osmesa or auto.")
@click.option("--size", type=click.IntRange(1, 4096), default=128, show_default=True, help="Pixels a side.")
@click.option("--count", type=click.IntRange(1), default=40, show_default=True, help="Renders a round.")
@click.option("--rounds", type=click.IntRange(1), default=5, show_default=True, help="Of each, in turns.")
def threads(backend: str, size: int, count: int, rounds: int) -> None:
    """Time renders from four threads beside the same from one."""
    from statistics import median

    from mrm_nodes.bench import bench_threads

    one, four = (median(seconds) for seconds in bench_threads(backend, size, count, rounds).values())
    click.echo(f"{count} renders at {size} x {size}: {one:.2f} s from one thread, {four:.2f} s from four")
    click.echo(f"four threads take {four / one:.2f} of the time of one")


@bench.command()
@click.option(
    "--count", type=click.IntRange(1), default=1 << 20, show_default=True, help="Evaluations a call."
)
@click.option("--growth", is_flag=True, help="Also time a conductor from 10^5 to 10^8 evaluations.")
@click.option("-o", "--output", type=Path, help="JSON file to write too.")
def reference(count: int, growth: bool, output: Path | None) -> None:
    """Time the evaluator beside NumPy and, where it is installed, Mitsuba's LLVM variant."""
    import json
    from dataclasses import asdict
    from itertools import chain

    from mrm_nodes.files import write_text
    from mrm_nodes.reference import bench as evaluator_bench

    click.echo(
        f"{'subject':<28} {'question':<8} {'lobe':<22} {'cores':>5} {'count':>10} {'seconds':>8} "
        f"{'million/s':>10} {'/Mitsuba':>8} {'peak MiB':>8}"
    )
    rows = []
    for row in chain(evaluator_bench.measure(count), evaluator_bench.growth() if growth else ()):
        rows.append(row)
        place = f"{row.subject:<28} {row.question:<8} {row.lobe:<22} {row.cores:>5} {row.count:>10}"
        ratio = "" if row.of_mitsuba is None else f"{row.of_mitsuba:.2f}"
        peak = "" if row.peak is None else f"{row.peak:.0f}"
        click.echo(f"{place} {row.seconds:>8.4f} {row.rate / 1e6:>10.4g} {ratio:>8} {peak:>8}")
    if output is not None:
        write_text(output, json.dumps([asdict(row) | {"rate": row.rate} for row in rows], indent=2) + "\n")


@cli.command()
@click.option("-o", "--output", "folder", type=Path, default=Path("figures"), show_default=True)
@click.option(
    "--tape",
    type=Path,
    help="The paper's measurement of yellow tape (ALTA's retro-3M-jaune.dat): draws Figure 4 too.",
)
def figures(folder: Path, tape: Path | None) -> None:
    """Draw the papers' figures from the evaluator: PNG, SVG, and the numbers as CSV."""
    from mrm_nodes.measured import read
    from mrm_nodes.measured.figures import write_figure_4
    from mrm_nodes.reference.figures import write_figures

    measurement = None if tape is None else read(tape)
    with _writing(folder):
        written = write_figures(folder)
        if measurement is not None:
            written += write_figure_4(measurement, folder)
        _say_written(written)


@cli.command()
@click.option("-o", "--output", "path", type=Path, default=Path("vectors.json"), show_default=True)
def vectors(path: Path) -> None:
    """Write test vectors for other renderers, their schema, a page on how to use them, and examples.

    The rule: a retroreflective lobe is the forward lobe seen from v' = 2 (n.v) n - v; D, G, F and pdf are of v'.
    """
    from mrm_nodes.library import root_path
    from mrm_nodes.reference.vectors import write_vectors

    with _writing(path):
        _say_written(write_vectors(path, root_path() / "docs"))


@contextlib.contextmanager
def _writing(place: Path) -> Iterator[None]:
    """Turn what can go wrong with a folder, or with a package that is not installed, into one line."""
    try:
        yield
    except ImportError as error:
        raise MrmError(str(error)) from None
    except OSError as error:
        raise MrmError(f"{place}: cannot be written: {error.strerror}; choose another with -o") from None


def _say_written(files: Sequence[Path]) -> None:
    for file in files:
        click.echo(file)


_BENCH_COLUMNS = "  (b)/(a)  0.5/(b)    0/(a)    1/(a)  SPIR-V instructions of (a), (b), 0.5"


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
