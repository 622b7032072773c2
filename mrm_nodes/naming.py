"""Names of a document's elements that generated code can have."""

from __future__ import annotations

import MaterialX as mx

from mrm_nodes.elements import descendant, graph_around, used_by


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
    copy = _copy_of(document)
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


def named_apart(
    document: mx.Document, element: mx.Element, target: str
) -> tuple[mx.Document, mx.Element, dict[str, str]]:
    """A document in which no two nodes that an element uses share a uniform: the one given, or a copy.

    MaterialX names a uniform by its node and input alone and declares each name once: of two nodes of one name in
    two graphs the second would read the first one's values and image. Before 1.39.5 it may drop the second too.

    Args:
        element: what is rendered.
        target: MaterialX's own name for it, such as `genglsl`.

    Returns:
        the document, the element in it, and the new path of each node that was renamed, by its path.
    """
    nodes = [each for each in used_by([element], target) if each.isA(mx.Node)]
    # A document's own nodes keep their names, a graph's are no one's to ask for.
    nodes.sort(key=lambda node: node.getNamePath().count("/"))
    fitting: dict[str, str] = {}
    names: set[str] = set()
    uniforms: set[str] = set()
    for node in nodes:
        name, scope = node.getName(), node.getParent()
        count = 0
        while (
            mx.createValidName(name) in names
            or uniforms & _uniforms_of(node, name)
            or (count and scope.getChild(name) is not None)
        ):
            count += 1
            name = f"{scope.getName()}_{node.getName()}{count if count > 1 else ''}"
        names.add(mx.createValidName(name))
        uniforms |= _uniforms_of(node, name)
        if name != node.getName():
            fitting[node.getNamePath()] = name
    if not fitting:
        return document, element, {}
    copy = _copy_of(document)
    renamed = {path: copy.getDescendant(path) for path in fitting}
    found = copy.getDescendant(element.getNamePath())
    for path, node in renamed.items():
        scope = node.getParent()
        for port in scope.traverseTree():
            if port.getAttribute("nodename") == node.getName() and _scope_of(port) == scope:
                port.setAttribute("nodename", fitting[path])
        node.setName(fitting[path])
    return copy, found, {path: node.getNamePath() for path, node in renamed.items()}


def _uniforms_of(node: mx.Node, name: str) -> set[str]:
    """The uniforms that a node has under a name."""
    definition = node.getNodeDef()
    ports = definition.getActiveInputs() if definition is not None else node.getInputs()
    return {f"{mx.createValidName(name)}_{port.getName()}" for port in ports}


def _scope_of(port: mx.Element) -> mx.Element:
    """The graph or document in which a port's `nodename` is looked for."""
    return graph_around(port) or port.getDocument()


def _copy_of(document: mx.Document) -> mx.Document:
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    if document.hasDataLibrary():
        copy.setDataLibrary(document.getDataLibrary())
    return copy


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
