"""`mrm-nodes generate`: a material's shader code for a target, or for all."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import click

from mrm_nodes.commands.options import external_option, material_argument, one_of, within_limits
from mrm_nodes.errors import MrmError, MrmWarning, unknown

FAILED = 1

ALL = "all"
"""Every target that the installed MaterialX has."""

ENDINGS = {"vulkan": "vulkan.glsl", "essl": "essl.glsl", "msl": "metal"}
"""Endings of shader files that are not their target's own name; no two targets share one."""


@click.command()
@material_argument
@click.option(
    "--target",
    help="glsl, essl, vulkan, wgsl, msl, slang, osl, mdl, or all.  [default: glsl; all with --check]",
)
@click.option("-o", "--output", "folder", type=Path, help="Folder for the shader's files.")
@click.option("--element", help="Material to generate, where the file has several.")
@click.option(
    "--environment",
    **one_of("fis", "prefilter", "none"),
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

    \b
    mrm-nodes generate traffic_cone -o shaders
    mrm-nodes generate traffic_cone --target all -o shaders
    mrm-nodes generate traffic_cone --check
    """
    from mrm_nodes import documents, shadergen

    if folder is None and not check:
        raise MrmError("name a folder for the shader's files with -o, or say --check")
    if target is None:
        target = ALL if check else "glsl"
    supported = shadergen.supported_targets()
    if target not in (*supported, ALL):
        raise MrmError(unknown("target", target, (*supported, ALL)))
    targets = supported if target == ALL else [target]
    document = documents.read_document(file, libraries, allow_external)
    _say_what_is_ignored(document, file, element, targets, environment, libraries, strict)
    options: dict[str, Any] = {
        "environment": environment,
        "libraries": libraries,
        "allow_external": allow_external,
    }
    if folder is not None:
        from mrm_nodes.files import prepare_folder, write_together

        shaders = [shadergen.generate_shader(file, each, element, **options) for each in targets]
        prepare_folder(folder)
        contents = {folder / name: text for shader in shaders for name, text in shader_files(shader).items()}
        write_together({path: text.encode() for path, text in contents.items()})
        for path in contents:
            click.echo(path)
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


def shader_files(shader: Any) -> dict[str, str]:
    """The files of a shader, by name: one for each stage, which is in the name where there are two."""
    ending = ENDINGS.get(shader.target, shader.target)
    stages = {"vertex": shader.vertex, "pixel": shader.pixel}
    written = {stage: text for stage, text in stages.items() if text}
    if len(written) == 1:
        return {f"{shader.name}.{ending}": text for text in written.values()}
    return {f"{shader.name}.{stage}.{ending}": text for stage, text in written.items()}


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
