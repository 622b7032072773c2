"""Names of a document's elements that generated code can have."""

from __future__ import annotations

import MaterialX as mx

from mrm_nodes.elements import descendant, graph_around


def named_for_code(document: mx.Document, element: mx.Element) -> tuple[mx.Document, mx.Element]:
    """A document whose nodes and graphs have names that compile, and the element in it: the one given, or a copy.

    MaterialX makes identifiers of names, but leaves a digit in front, which no language takes. It finds nothing
    again by a path that goes through a name with a slash.
    """
    own = [each for each in document.traverseTree() if _is_named_in_code(each)]
    names = {each.getName() for each in own}
    fitting = _fitting({name for name in names if _is_unfit(name)}, names)
    if not fitting:
        return document, element
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    if document.hasDataLibrary():
        copy.setDataLibrary(document.getDataLibrary())
    found = descendant(copy, element.getNamePath())
    for each in list(copy.traverseTree()):
        for reference in ("nodename", "nodegraph", "interfacename", "output"):
            name = each.getAttribute(reference)
            if name in fitting and _refers_to_own(each, reference):
                each.setAttribute(reference, fitting[name])
    for each in [each for each in copy.traverseTree() if _is_named_in_code(each)]:
        if each.getName() in fitting:
            each.setName(fitting[each.getName()])
    return copy, found


def _is_unfit(name: str) -> bool:
    return name[:1] in set("0123456789") or "/" in name


def _fitting(unfit: set[str], names: set[str]) -> dict[str, str]:
    """A name that no other element has, for each that is unfit."""
    taken = set(names)
    found: dict[str, str] = {}
    for name in sorted(unfit):
        fitting = f"n{name.replace('/', '_')}"
        while fitting in taken:
            fitting = f"n{fitting}"
        taken.add(fitting)
        found[name] = fitting
    return found


def _is_named_in_code(element: mx.Element) -> bool:
    """Whether an element is a node, a graph, or what a graph that defines no node takes and gives."""
    if element.isA(mx.Node) or element.isA(mx.NodeGraph):
        return True
    is_port = element.isA(mx.Input) or element.isA(mx.Output)
    parent = element.getParent()
    return is_port and (parent.isA(mx.Document) or _is_plain_graph(parent))


def _is_plain_graph(element: mx.Element | None) -> bool:
    return element is not None and element.isA(mx.NodeGraph) and not element.getAttribute("nodedef")


def _refers_to_own(element: mx.Element, reference: str) -> bool:
    """Whether a reference names an element of this document and no input or output of a definition."""
    if reference == "interfacename":
        return _is_plain_graph(graph_around(element))
    if reference == "output":
        graph = element.getDocument().getNodeGraph(element.getAttribute("nodegraph"))
        return element.hasAttribute("nodegraph") and (graph is None or _is_plain_graph(graph))
    return True
