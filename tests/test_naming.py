"""Names in generated code: two nodes of one name are two nodes, wherever they stand, and keep their own values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np
import pytest

from mrm_nodes.documents import read_document
from mrm_nodes.render import probe_backends, render, write_png
from mrm_nodes.render.uniforms import uniforms_of
from mrm_nodes.shadergen import Shader, generate_shader

RED, GREEN = "1, 0, 0", "0, 1, 0"
SHOWN = """<materialx version="1.39">
{0}
<add name="sum" type="color3">
  <input name="in1" type="color3" {1} /><input name="in2" type="color3" {2} />
</add>
<surface_unlit name="s" type="surfaceshader">
  <input name="emission_color" type="color3" nodename="sum" />
</surface_unlit>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""


def valued(name: str, color: str) -> str:
    return f"""<multiply name="{name}" type="color3">
  <input name="in1" type="color3" value="1, 1, 1" /><input name="in2" type="color3" value="{color}" />
</multiply>"""


def pictured(name: str, file: str) -> str:
    return (
        f'<image name="{name}" type="color3"><input name="file" type="filename" value="{file}" />'
        '<input name="filtertype" type="string" value="closest" /></image>'
    )


def graph(name: str, nodes: str, last: str, attributes: str = "") -> str:
    return (
        f'<nodegraph name="{name}" {attributes}>{nodes}'
        f'<output name="out" type="color3" nodename="{last}" /></nodegraph>'
    )


def defined(name: str, nodes: str, last: str) -> str:
    definition = f'<nodedef name="ND_{name}" node="{name}"><output name="out" type="color3" /></nodedef>'
    own = graph(f"NG_{name}", nodes, last, f'nodedef="ND_{name}"')
    return f'{definition}{own}<{name} name="{name}1" type="color3" />'


def passing(name: str, port: str) -> str:
    """A node that gives what it takes."""
    nodes = f'''<multiply name="m" type="color3"><input name="in1" type="color3" interfacename="{port}" />
    <input name="in2" type="color3" value="1, 1, 1" /></multiply>'''
    return f'''<nodedef name="ND_{name}" node="{name}"><input name="{port}" type="color3" value="0, 0, 0" />
    <output name="out" type="color3" /></nodedef>{graph("NG_" + name, nodes, "m", f'nodedef="ND_{name}"')}'''


FROM_GRAPHS = 'nodegraph="a" output="out"', 'nodegraph="b" output="out"'
KINDS = {
    "values of two graphs": (
        graph("a", valued("n", RED), "n") + graph("b", valued("n", GREEN), "n"),
        *FROM_GRAPHS,
    ),
    "images of two graphs": (
        graph("a", pictured("n", "red.png"), "n") + graph("b", pictured("n", "green.png"), "n"),
        *FROM_GRAPHS,
    ),
    "an image and a value": (
        graph("a", pictured("n", "red.png"), "n") + graph("b", valued("n", GREEN), "n"),
        *FROM_GRAPHS,
    ),
    "a graph's and the document's": (
        graph("a", valued("n", RED), "n") + valued("n", GREEN),
        FROM_GRAPHS[0],
        'nodename="n"',
    ),
    "the new name is taken": (
        graph("a", valued("n", RED), "n")
        + graph("b", valued("n", GREEN) + valued("b_n", RED), "n")
        + valued("b_n2", RED),
        *FROM_GRAPHS,
    ),
    "names that join to one": (
        passing("one", "b_c")
        + passing("two", "c")
        + f'<one name="n" type="color3"><input name="b_c" type="color3" value="{RED}" /></one>'
        + f'<two name="n_b" type="color3"><input name="c" type="color3" value="{GREEN}" /></two>',
        'nodename="n"',
        'nodename="n_b"',
    ),
    "two definitions of the document": (
        defined("red", pictured("n", "red.png"), "n") + defined("green", pictured("n", "green.png"), "n"),
        'nodename="red1"',
        'nodename="green1"',
    ),
}


pytestmark = pytest.mark.skipif(
    not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, color in (("red", RED), ("green", GREEN)):
        write_png(tmp_path / f"{name}.png", np.full((4, 4, 3), [float(part) for part in color.split(",")]))
    return tmp_path


def color_of(shader: Shader, uniforms: dict[str, Any] | None = None) -> list[float]:
    image: list[float] = render(shader, lights=[], size=(8, 8), uniforms=uniforms).image[4, 4].tolist()
    return image


@pytest.mark.parametrize("interface", ["complete", "reduced"])
@pytest.mark.parametrize("kind", KINDS)
def test_nodes_of_one_name_keep_their_own_values(folder: Path, kind: str, interface: str) -> None:
    file = folder / "a.mtlx"
    file.write_text(SHOWN.format(*KINDS[kind]))
    assert color_of(generate_shader(file, interface=interface)) == [1, 1, 0]


def test_an_input_is_asked_for_by_the_documents_own_path(folder: Path) -> None:
    file = folder / "a.mtlx"
    file.write_text(SHOWN.format(*KINDS["values of two graphs"]))
    shader = generate_shader(file)
    assert {"a/n/in2", "b/n/in2"} <= {uniform.path for uniform in uniforms_of(shader).values()}
    assert color_of(shader, {"b/n/in2": (0, 0, 0.5)}) == [1, 0, 0.5]
    file.write_text(SHOWN.format(*KINDS["images of two graphs"]))
    assert color_of(generate_shader(file), {"b/n/file": "red.png"}) == [2, 0, 0]


def test_what_is_not_drawn_keeps_its_name(folder: Path) -> None:
    """A document of many materials has the uniforms of the one that is asked for, under their plain names."""
    file = folder / "a.mtlx"
    first, *rest = KINDS["images of two graphs"]
    file.write_text(SHOWN.format(first, rest[0], rest[0]))
    shader = generate_shader(file)
    assert not shader.renamed
    assert "n_file" in uniforms_of(shader)


def test_the_document_given_stays_as_it_is(folder: Path) -> None:
    file = folder / "a.mtlx"
    file.write_text(SHOWN.format(*KINDS["values of two graphs"]))
    document = read_document(file)
    before = mx.writeToXmlString(document)
    generate_shader(document)
    assert mx.writeToXmlString(document) == before
