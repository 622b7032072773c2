"""`mrm-nodes materials`: what comes with the package and is taken by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import click

from mrm_nodes import shipped
from mrm_nodes.errors import MrmError, unknown


@click.command()
@click.argument("name", required=False)
def materials(name: str | None) -> None:
    """List the finished materials, meshes and environments that commands take by name, and where they lie.

    With NAME, print the file of that material alone.

    \b
    mrm-nodes materials
    mrm-nodes render traffic_cone -o cone.png --mesh baluster --env sky
    cp $(mrm-nodes materials traffic_cone) cone.mtlx
    """
    known = shipped.materials()
    if name is not None:
        if name not in known:
            raise MrmError(unknown("material", name, known))
        click.echo(known[name])
        return
    from mrm_nodes.render.environment import BUILT_IN_ENVIRONMENTS
    from mrm_nodes.render.mesh import BUILT_IN

    _list(
        f"materials, in {shipped.materials_path()}",
        {each: shipped.about(file) for each, file in known.items()},
    )
    _list("meshes, for --mesh", _described(BUILT_IN))
    _list("environments, for --env", _described(BUILT_IN_ENVIRONMENTS))


def _described(makers: Mapping[str, Callable[[], Any]]) -> dict[str, str]:
    """The first line of what each maker says of itself, as a sentence."""
    lines = {name: (make.__doc__ or "").strip().splitlines()[0] for name, make in makers.items()}
    said = {name: line.removeprefix("Return ").partition(": ")[0].rstrip(".") for name, line in lines.items()}
    return {name: f"{line[:1].upper()}{line[1:]}." for name, line in said.items()}


def _list(title: str, lines: Mapping[str, str]) -> None:
    width = max(map(len, lines))
    click.echo(f"{title}:")
    for name, line in lines.items():
        click.echo(f"  {name:<{width}}  {line}")
