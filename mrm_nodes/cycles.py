"""Documents on which MaterialX would go round without end, or nearly so: what contains itself, or too much."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import MaterialX as mx

from mrm_nodes.errors import MrmError

DEEPEST = 100
"""Graphs that implement nodes of graphs that implement nodes, and so on."""
LONGEST_CHAIN = 1000
"""Nodes each of which is the source of the one before: MaterialX's own code has no limit but the stack."""
MOST_NODES = 20_000
"""Nodes that one graph may come to."""
MOST_LIBRARIES = 8
"""Libraries of which is known what their graphs come to."""


def check_cycles(document: mx.Document, where: str) -> None:
    """Check that nothing inherits from itself, no node's graph contains the node or a vast number of others, and no
    chain of nodes is too long.

    Connections that go round are found by whoever follows them.

    Raises:
        MrmError: something does.
    """
    elements = list(document.traverseTree())
    for element in elements:
        if element.hasAttribute("inherit") and _raises(element):
            raise MrmError(f"{where}: {element.getNamePath()}: inherits from itself")
    _check_graphs(document, elements, where)
    # As many nodes as there are follow each other at most.
    if sum(isinstance(each, mx.Node) for each in elements) > LONGEST_CHAIN:
        _check_chains(elements, where)


def _check_graphs(document: mx.Document, elements: Sequence[mx.Element], where: str) -> None:
    """Check what the graphs come to once each node in them is replaced by its own graph."""
    graphs = _graphs_of(document)
    known = _sizes(document.getDataLibrary()) if document.hasDataLibrary() else {}
    is_defining = any(
        isinstance(each, mx.Implementation) or each.hasAttribute("nodedef") for each in elements
    )
    if not (is_defining or graphs.keys() & known.keys()):
        # All of their nodes are the library's.
        most = len(graphs) + len(elements) * max(known.values(), default=1)
        if most <= MOST_NODES:
            return
    sizes = {name: size for name, size in known.items() if name not in graphs}
    for name in graphs:
        _measure(name, graphs, sizes, (), where)


def _check_chains(elements: Sequence[mx.Element], where: str) -> None:
    """Check how many nodes follow each other, through the inputs and outputs of graphs too."""
    sources = _sources(elements)
    lengths: dict[str, int] = {}
    for root in sources:
        # What is on the way: a place, what it still has to ask, and the longest chain behind it so far.
        way = [] if root in lengths else [(root, iter(sources[root]))]
        lengths.setdefault(root, 0)
        while way:
            place, waiting = way[-1]
            source = next(waiting, None)
            if source is None:
                way.pop()
                if way:
                    _lengthen(way[-1][0], lengths[place], lengths, where)
            elif source in lengths:
                # Of what goes round, where it closes counts as its end.
                _lengthen(place, lengths[source], lengths, where)
            else:
                lengths[source] = 0
                way.append((source, iter(sources.get(source, ()))))


def _lengthen(place: str, length: int, lengths: dict[str, int], where: str) -> None:
    # Places of graphs' inputs and outputs are no nodes.
    lengths[place] = max(lengths[place], length + (not place.endswith(">")))
    if lengths[place] > LONGEST_CHAIN:
        raise MrmError(
            f"{where}: {place}: more than {LONGEST_CHAIN} nodes, each the source of the one before"
        )


def _sources(elements: Sequence[mx.Element]) -> dict[str, list[str]]:
    """By the path of a node, or of a port of a graph (with `>` behind it), the places that it is connected to."""
    sources: dict[str, list[str]] = {}
    for port in elements:
        if not isinstance(port, mx.Input | mx.Output):
            continue
        owner = port.getParent()
        if isinstance(owner, mx.NodeDef):
            continue
        path = owner.getNamePath()
        place = path if isinstance(owner, mx.Node) else f"{path}/{port.getName()}>"
        around = owner if isinstance(port, mx.Output) else owner.getParent()
        # An input may stand in the document itself, where it means nothing.
        scope = around.getNamePath() if around is not None else ""
        found = sources.setdefault(place, [])
        beside = f"{scope}/" if scope else ""
        node, graph, output, interface = map(
            port.getAttribute, ("nodename", "nodegraph", "output", "interfacename")
        )
        if node:
            found.append(f"{beside}{node}")
        if graph or (output and not node):
            found.append(f"{beside}{graph}/{output}>" if graph else f"{beside}{output}>")
        if interface:
            found.append(f"{beside}{interface}>")
        if isinstance(owner, mx.NodeGraph) and isinstance(port, mx.Output):
            # Who names no output has any of them.
            sources.setdefault(f"{path}/>", []).append(place)
    return sources


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
