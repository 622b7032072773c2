"""Documents on which MaterialX would go round without end, or nearly so: what contains itself, or too much."""

from __future__ import annotations

from collections.abc import Iterator

import MaterialX as mx

from mrm_nodes.errors import MrmError

DEEPEST = 100
"""Graphs that implement nodes of graphs that implement nodes, and so on."""
MOST_NODES = 20_000
"""Nodes that one graph may come to."""
MOST_LIBRARIES = 8
"""Libraries of which is known what their graphs come to."""


def check_cycles(document: mx.Document, where: str) -> None:
    """Check that nothing inherits from itself, and that no node's graph contains the node or a vast number of others.

    Connections that go round are found by whoever follows them.

    Raises:
        MrmError: something does.
    """
    for element in document.traverseTree():
        if element.hasAttribute("inherit") and _raises(element):
            raise MrmError(f"{where}: {element.getNamePath()}: inherits from itself")
    graphs = _graphs_of(document)
    known = _sizes(document.getDataLibrary()) if document.hasDataLibrary() else {}
    sizes = {name: size for name, size in known.items() if name not in graphs}
    for name in graphs:
        _measure(name, graphs, sizes, (), where)


#: By a library's identity: documents have no hash. A library that is kept here keeps its identity.
_LIBRARIES: dict[int, tuple[mx.Document, dict[str, int]]] = {}


def _sizes(library: mx.Document) -> dict[str, int]:
    """What the graphs of a library come to, measured once: no document that refers to it changes them."""
    kept, sizes = _LIBRARIES.get(id(library), (None, {}))
    if kept is not library:
        graphs = _graphs_of(library)
        for name in graphs:
            _measure(name, graphs, sizes, (), "the node library")
        if len(_LIBRARIES) >= MOST_LIBRARIES:
            _LIBRARIES.clear()
        _LIBRARIES[id(library)] = library, sizes
    return sizes


def _graphs_of(document: mx.Document) -> dict[str, mx.NodeGraph]:
    """A document's own graphs, by name; those of its data library are that library's."""
    return {each.getName(): each for each in document.getChildren() if isinstance(each, mx.NodeGraph)}


def _raises(element: mx.Element) -> bool:
    try:
        for _ in element.traverseInheritance():
            pass
    except LookupError:  # what MaterialX's exception for cycles is in Python
        return True
    return False


def _measure(
    name: str, graphs: dict[str, mx.NodeGraph], sizes: dict[str, int], above: tuple[str, ...], where: str
) -> int:
    """How many nodes a graph becomes once each node in it is replaced by its own graph."""
    if name in above:
        raise MrmError(f"{where}: {name}: the graph of a node contains that node")
    if len(above) > DEEPEST:
        raise MrmError(f"{where}: {name}: more than {DEEPEST} graphs within each other")
    if name not in sizes:
        inner = [each for each in _graphs_within(graphs[name]) if each in graphs or each in sizes]
        sizes[name] = 1 + sum(_measure(each, graphs, sizes, (*above, name), where) for each in inner)
        if sizes[name] > MOST_NODES:
            raise MrmError(f"{where}: {name}: becomes more than {MOST_NODES} nodes")
    return sizes[name]


def _graphs_within(graph: mx.NodeGraph) -> Iterator[str]:
    """Names of the graphs that implement a graph's nodes, for any target."""
    document = graph.getDocument()
    for node in graph.getNodes():
        definition = node.getNodeDef()
        if definition is not None:
            for found in document.getMatchingImplementations(definition.getName()):
                yield found.getName() if isinstance(found, mx.NodeGraph) else found.getAttribute("nodegraph")
