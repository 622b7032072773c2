"""Documents on which MaterialX would go round without end are refused, whichever way their size is found out."""

import MaterialX as mx
import pytest

from mrm_nodes import cycles
from mrm_nodes.errors import MrmError
from mrm_nodes.library import shared_library


def document() -> mx.Document:
    made = mx.createDocument()
    made.setDataLibrary(shared_library())
    return made


def chain(of: mx.Document | mx.NodeGraph, length: int) -> None:
    for number in range(length):
        node = of.addNode("sin", f"n{number}", "float")
        if number:
            node.addInput("in", "float").setNodeName(f"n{number - 1}")


def test_so_many_nodes_may_follow_each_other_and_no_more():
    longest = document()
    chain(longest, cycles.LONGEST_CHAIN + 1)  # the first is the source of a thousand
    cycles.check_cycles(longest, "it")
    chain(longest.addNodeGraph("graph"), 5)  # more nodes, none of which follows those
    cycles.check_cycles(longest, "it")
    longer = document()
    chain(longer, cycles.LONGEST_CHAIN + 2)
    with pytest.raises(MrmError, match=r"n1001: more than 1000 nodes, each the source of the one before"):
        cycles.check_cycles(longer, "it")


def defined(own: mx.Document, name: str, by_implementation: bool) -> mx.NodeGraph:
    definition = own.addNodeDef(f"ND_{name}", "float", name)
    graph = own.addNodeGraph(f"NG_{name}")
    if by_implementation:
        implementation = own.addImplementation(f"IM_{name}")
        implementation.setAttribute("nodedef", definition.getName())
        implementation.setAttribute("nodegraph", graph.getName())
    else:
        graph.setNodeDefString(definition.getName())
    return graph


@pytest.mark.parametrize("by_implementation", [False, True])
def test_a_document_of_a_dozen_graphs_may_come_to_too_many_nodes(by_implementation: bool):
    own = document()
    for level in range(15):
        graph = defined(own, f"level{level}", by_implementation)
        for number in range(2 * (level > 0)):
            graph.addNode(f"level{level - 1}", f"n{number}", "float")
    with pytest.raises(MrmError, match="NG_level14: becomes more than 20000 nodes"):
        cycles.check_cycles(own, "it")


def test_the_library_s_nodes_may_be_too_many_too():
    own = document()
    graph = own.addNodeGraph("graph")
    for number in range(700):
        graph.addNode("tiledcloverleafs", f"n{number}", "color3")
    with pytest.raises(MrmError, match="graph: becomes more than 20000 nodes"):
        cycles.check_cycles(own, "it")


def test_a_graph_named_as_one_of_the_library_is_looked_at():
    own = document()
    own.addNodeGraph("NG_tiledcloverleafs_color3").addNode("tiledcloverleafs", "n", "color3")
    with pytest.raises(MrmError, match="NG_tiledcloverleafs_color3: the graph of a node contains that node"):
        cycles.check_cycles(own, "it")
