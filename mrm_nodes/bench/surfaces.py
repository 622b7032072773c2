"""What the retrofitted surfaces cost, beside MaterialX's own and the mix of two whole ones that people would write."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import MaterialX as mx

from mrm_nodes.bench.shader import INTERFACES, LIGHTS, _frame_times, describe_machine
from mrm_nodes.errors import MrmError
from mrm_nodes.files import write_text
from mrm_nodes.library import load_library
from mrm_nodes.render.context import get_context
from mrm_nodes.shadergen import Shader, generate_shader
from mrm_nodes.substitution import SWITCH
from mrm_nodes.surfaces import Surface, known_surfaces

#: What is measured: MaterialX's own, its mix of a plain and a retroreflective one, and ours at three weights.
SUBJECTS = ("own", "mix", "ours 0", "ours 0.5", "ours 1")

#: An input of a surface: a number, or a colour.
Value = float | tuple[float, float, float]

#: Inputs in place of the defaults: none, or so that every lobe is there.
LOBES: dict[str, dict[str, dict[str, Value]]] = {
    "default": {},
    "every": {
        "open_pbr_surface": {
            "base_metalness": 0.5,
            "coat_weight": 0.5,
            "fuzz_weight": 0.5,
            "subsurface_weight": 0.5,
            "transmission_weight": 0.5,
            "thin_film_weight": 0.5,
        },
        "gltf_pbr": {
            "metallic": 0.5,
            "transmission": 0.5,
            "clearcoat": 0.5,
            "sheen_color": (0.5, 0.5, 0.5),
            "sheen_roughness": 0.5,
            "iridescence": 0.5,
        },
        "standard_surface": {
            "metalness": 0.5,
            "transmission": 0.5,
            "subsurface": 0.5,
            "sheen": 0.5,
            "coat": 0.5,
            "thin_film_thickness": 400.0,
        },
    },
}


@dataclass(frozen=True)
class SurfaceRow:
    """One configuration: milliseconds a frame by subject."""

    surface: str
    lobes: str
    light: str
    interface: str
    milliseconds: dict[str, float]

    @property
    def ratios(self) -> dict[str, float]:
        """The blend against the mix, and each weight against MaterialX's own."""
        ms = self.milliseconds
        return {
            "0.5 / mix": ms["ours 0.5"] / ms["mix"],
            "0 / own": ms["ours 0"] / ms["own"],
            "0.5 / own": ms["ours 0.5"] / ms["own"],
            "1 / own": ms["ours 1"] / ms["own"],
        }


def bench_surfaces(
    backend: str = "auto",
    size: int = 256,
    rounds: int = 21,
    surfaces: Sequence[str] = tuple(known_surfaces()),
    lobes: Sequence[str] = tuple(LOBES),
    lights: Sequence[str] = tuple(LIGHTS),
    interfaces: Sequence[str] = INTERFACES,
) -> Iterator[SurfaceRow]:
    """Measure every configuration as `bench_shaders` does: the frames of its subjects take turns.

    Raises:
        MrmError: the installed MaterialX has no retroreflective BSDFs to mix.
    """
    context = get_context(backend)
    for node in surfaces:
        surface = known_surfaces()[node]
        library = load_library()
        _add_retroreflective(library, surface)
        for which in lobes:
            values = LOBES[which].get(node, {})
            for light in lights:
                for interface in interfaces:
                    shaders = {
                        subject: _shader(library, surface, values, subject, light, interface)
                        for subject in SUBJECTS
                    }
                    work = functools.partial(_frame_times, context, shaders, light, size, rounds)
                    times = context.run(work)
                    yield SurfaceRow(node, which, light, interface, times)


def _add_retroreflective(library: mx.Document, surface: Surface) -> None:
    """Add the surface with its base specular retroreflective, as a user of MaterialX alone could write it."""
    original = library.getMatchingNodeDefs(surface.node)[0]
    for definition in library.getMatchingNodeDefs("generalized_schlick_bsdf"):
        if definition.getActiveInput(SWITCH) is None:
            raise MrmError(f"MaterialX {mx.getVersionString()} has no retroreflective BSDFs to compare with")
    name = f"{surface.node}_{SWITCH}"
    definition = library.addChildOfCategory("nodedef", f"ND_{name}")
    definition.copyContentFrom(original)
    definition.setNodeString(name)
    graph = library.addNodeGraph(f"NG_{name}")
    graph.copyContentFrom(original.getImplementation())
    graph.setNodeDefString(definition.getName())
    for node in surface.replace:
        graph.getNode(node).setInputValue(SWITCH, True)


def _shader(
    library: mx.Document, surface: Surface, values: dict[str, Value], subject: str, light: str, interface: str
) -> Shader:
    document = mx.createDocument()
    document.setDataLibrary(library)

    def add(category: str, **more: Value) -> mx.Node:
        node = document.addNode(category, document.createValidChildName(category), "surfaceshader")
        for name, value in (values | more).items():
            node.setInputValue(name, mx.Color3(*value) if isinstance(value, tuple) else float(value))
        return node

    if subject == "own":
        shader = add(surface.node)
    elif subject == "mix":
        shader = document.addNode("mix", "blend", "surfaceshader")
        for end, category in (("bg", surface.node), ("fg", f"{surface.node}_{SWITCH}")):
            shader.addInput(end, "surfaceshader").setConnectedNode(add(category))
        shader.setInputValue("mix", 0.5)
    else:
        shader = add(surface.name, **{surface.input: float(subject.split()[1])})
    document.addMaterialNode("material", shader)
    # Room for as many lights as a shader has by default: with room for one, whether a driver unrolls the loop over
    # it decides more than what is in it.
    return generate_shader(document, "glsl", environment=LIGHTS[light][0], interface=interface)


def print_table(backend: str, size: int, rounds: int, output: Path | None) -> None:
    """Measure every configuration, print a line for each, and write them to a JSON file where one is named."""
    machine = describe_machine(backend)
    for what, value in machine.items():
        click.echo(f"{what:<10} {value}")
    click.echo(
        "(a) MaterialX's own, (b) its mix of a plain and a retroreflective one; ours at weight 0, 0.5 and 1"
    )
    columns = ("(a) ms", "0.5/(b)", "0/(a)", "0.5/(a)", "1/(a)")
    click.echo(
        f"{'surface':<17} {'lobes':<7} {'light':<6} {'interface':<9} " + "".join(f"{c:>8}" for c in columns)
    )
    rows = []
    for row in bench_surfaces(backend, size, rounds):
        figures = "".join(f"{value:>8.2f}" for value in (row.milliseconds["own"], *row.ratios.values()))
        click.echo(f"{row.surface:<17} {row.lobes:<7} {row.light:<6} {row.interface:<9} {figures}")
        rows.append(row)
    if output is not None:
        listed = [{**asdict(row), "ratios": row.ratios} for row in rows]
        write_text(output, json.dumps({"machine": machine, "rows": listed}, indent=2) + "\n")
