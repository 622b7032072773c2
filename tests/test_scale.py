"""What grows with a suite grows no faster than the suite: counted, not timed."""

from __future__ import annotations

import MaterialX as mx
import pytest

from mrm_nodes import documents, elements, library
from mrm_nodes.bench import scale as bench_scale
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.regression.truth import closure

SURFACES = ("standard_surface", "open_pbr_surface", "gltf_pbr")


def surface(node: str, *inputs: str) -> str:
    """A document with one whole surface."""
    return (
        f'<materialx version="1.39"><{node} name="SR" type="surfaceshader">{"".join(inputs)}</{node}>'
        '<surfacematerial name="m" type="material">'
        '<input name="surfaceshader" type="surfaceshader" nodename="SR" /></surfacematerial></materialx>'
    )


@pytest.fixture
def suite(tmp_path):
    """Writes so many materials, each with four cases in two tables, and returns the suite's file."""

    def write(count: int):
        for number in range(count):
            (tmp_path / f"{number}.mtlx").write_text(surface(SURFACES[number % 3]))
        lines = ['[[case]]\nmaterial = "*.mtlx"\n[case.matrix]\nmesh = ["sphere", "plane"]\n'] * 2
        lines[1] = lines[1].replace(
            "[case.matrix]", 'name = "{material}-{mesh}-small"\nsize = 8\n[case.matrix]'
        )
        (tmp_path / "suite.toml").write_text("".join(lines))
        return tmp_path / "suite.toml"

    return write


def counted(monkeypatch, module, name: str) -> list[object]:
    """The first arguments of a function's calls from now on."""
    calls: list[object] = []
    function = getattr(module, name)

    def count(*arguments, **others):
        calls.append(arguments[0])
        return function(*arguments, **others)

    monkeypatch.setattr(module, name, count)
    return calls


def test_a_suite_keeps_few_documents_in_memory_and_reads_each_once(monkeypatch, suite):
    count = suitefile._KEPT + 5
    file = suite(count)
    read = counted(monkeypatch, documents, "read_with_files")
    makers = counted(monkeypatch, suitefile._Maker, "suite")
    assert len(suitefile.load(file).cases) == 4 * count
    assert len(read) == count
    assert makers[0]._as_read.cache_info().currsize <= suitefile._KEPT


@pytest.mark.parametrize("name", ["hi_vis_tape", "number_plate", "traffic_cone"])
def test_connections_that_are_plainly_sound_are_not_validated(monkeypatch, name):
    """MaterialX looks a graph's definition up among all that there are, a millisecond each."""
    file = library.materials_path() / f"{name}.mtlx"
    document = documents.read_document(file)
    validated = counted(monkeypatch, mx.Element, "validate")
    elements.check_document(document, str(file), None, "genglsl")
    assert validated == []


CONNECTIONS = {
    "a node": ('<constant name="c" type="float" />', 'nodename="c"', True),
    "no node": ("", 'nodename="c"', False),
    "a node of another type": ('<constant name="c" type="color3" />', 'nodename="c"', False),
    "an output": ('<separate2 name="c" type="multioutput" />', 'nodename="c" output="outx"', True),
    "no output": ('<separate2 name="c" type="multioutput" />', 'nodename="c" output="outz"', False),
    "one output by name": ('<constant name="c" type="float" />', 'nodename="c" output="out"', False),
    "no one output": ('<separate2 name="c" type="multioutput" />', 'nodename="c"', True),
    "a graph": (
        '<nodegraph name="g"><constant name="c" type="float" /><output name="o" type="float" nodename="c" />'
        "</nodegraph>",
        'nodegraph="g" output="o"',
        True,
    ),
    "a graph without the output": (
        '<nodegraph name="g"><constant name="c" type="float" /><output name="o" type="float" nodename="c" />'
        "</nodegraph>",
        'nodegraph="g" output="p"',
        False,
    ),
    "a graph of another type": (
        '<nodegraph name="g"><constant name="c" type="color3" /><output name="o" type="color3" nodename="c" />'
        "</nodegraph>",
        'nodegraph="g" output="o"',
        False,
    ),
}


@pytest.mark.parametrize("kind", CONNECTIONS)
def test_a_connection_is_what_materialx_s_validation_says(tmp_path, kind):
    source, connection, is_sound = CONNECTIONS[kind]
    port = f'<input name="specular_roughness" type="float" {connection} />'
    file = tmp_path / "m.mtlx"
    file.write_text(surface("standard_surface", port).replace('1.39">', f'1.39">{source}'))
    document = documents.read_document(file)
    found = document.getDescendant("SR/specular_roughness")
    assert ("port connection" not in found.validate()[1]) == is_sound
    if is_sound:
        elements.check_document(document, "m", document.getChild("m"), "genglsl")
    else:
        with pytest.raises(MrmError, match="does not exist here or is no float"):
            elements.check_document(document, "m", document.getChild("m"), "genglsl")


def test_a_graph_that_defines_a_node_is_left_to_materialx(tmp_path):
    """It refuses the output's name of a definition with one output."""
    defined = (
        '<nodedef name="ND_x" node="x"><output name="o" type="float" /></nodedef>'
        '<nodegraph name="g"{}><constant name="c" type="float" />'
        '<output name="o" type="float" nodename="c" /></nodegraph>{}'
    )
    by_itself = defined.format(' nodedef="ND_x"', "")
    by_another = defined.format("", '<implementation name="IM_x" nodedef="ND_x" nodegraph="g" />')
    port = '<input name="specular_roughness" type="float" nodegraph="g" output="o" />'
    for number, source in enumerate((by_itself, by_another)):
        file = tmp_path / f"{number}.mtlx"
        file.write_text(surface("standard_surface", port).replace('1.39">', f'1.39">{source}'))
        document = documents.read_document(file)
        says = document.getDescendant("SR/specular_roughness").validate()[1]
        if "port connection" in says:
            with pytest.raises(MrmError, match="connected to g/o"):
                elements.check_document(document, "m", document.getChild("m"), "genglsl")
        else:
            elements.check_document(document, "m", document.getChild("m"), "genglsl")


def test_only_what_holds_a_whole_surface_is_flattened(monkeypatch, tmp_path):
    file = tmp_path / "m.mtlx"
    file.write_text(surface("standard_surface"))
    flattened = counted(monkeypatch, mx.GraphElement, "flattenSubgraphs")
    closure.closure_of(documents.read_document(file), "m")
    assert [type(each) for each in flattened] == [mx.Document]
    closure.closure_of(documents.read_document(library.materials_path() / "road_paint.mtlx"), "road_paint")
    assert len(flattened) == 1


def test_the_bench_s_suite_has_as_many_cases_and_no_two_alike(tmp_path):
    file = bench_scale.write_suite(tmp_path, 100)
    suite = suitefile.load(file)
    assert len(suite.cases) == 100 and not suite.broken
    materials = {case.material for case in suite.cases}
    assert len(materials) == 20 == len({(tmp_path / name).read_text() for name in materials})
    assert {case.truth for case in suite.cases} == {"physics"}
