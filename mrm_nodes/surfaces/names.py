"""Names in the text of a document that shading languages do not take, changed with all that refers to them."""

from __future__ import annotations

from collections.abc import Iterator

from mrm_nodes import library, xmltext
from mrm_nodes.surfaces.markup import Edits, Tag, parse

#: Elements with a type that are no nodes.
_DEFINITIONS = {"nodedef", "implementation", "typedef", "geompropdef", "geomprop", "token", "variant"}


def named_for_code(content: bytes, where: str) -> tuple[bytes, dict[str, str]]:
    """Return the text of a document whose nodes and graphs have names that compile, and the new names by path.

    MaterialX makes identifiers of names but leaves a digit in front, which no language takes, and finds its own
    element where a node has the name of one, such as `float`.

    Raises:
        MrmError: not XML.
    """
    text, codec = xmltext.decode(content, where)
    root = parse(text, where)
    names = {id(tag): new for tag, new in _new_names(root)}
    if not names:
        return content, {}
    edits = Edits(text)
    for tag in root.walk():
        if id(tag) in names:
            edits.set_attribute(tag, "name", names[id(tag)])
        for attribute, target in _references(tag, root):
            if target is not None and id(target) in names:
                edits.set_attribute(tag, attribute, names[id(target)])
    renamed = {path_of(tag): names[id(tag)] for tag in root.walk() if id(tag) in names}
    return edits.apply().encode(codec, "xmlcharrefreplace"), renamed


def path_of(tag: Tag) -> str:
    """An element's name with those of the elements around it, as MaterialX writes a path."""
    name = tag.attributes.get("name", tag.name)
    has_place = tag.parent is not None and tag.parent.parent is not None
    return f"{path_of(tag.parent)}/{name}" if has_place and tag.parent is not None else name


def fitting(name: str, taken: set[str]) -> str:
    """A name like this one that compiles and is not taken."""
    stem = f"n{name}" if name[:1].isdigit() else name
    fits, count = stem, 1
    while fits in taken or library.shared_library().getChild(fits) is not None:
        count += 1
        fits = f"{stem}{count}"
    return fits


def _new_names(root: Tag) -> Iterator[tuple[Tag, str]]:
    for scope in (root, *(child for child in root.children if child.name == "nodegraph")):
        taken = {child.attributes.get("name", "") for child in scope.children}
        for child in scope.children:
            name = child.attributes.get("name", "")
            if not _is_named_in_code(child, scope):
                continue
            is_library_s = scope is root and library.shared_library().getChild(name) is not None
            if name[:1] in set("0123456789") - {""} or (is_library_s and _is_node(child)):
                new = fitting(name, taken)
                taken.add(new)
                yield child, new


def _is_node(tag: Tag) -> bool:
    is_port = tag.name in ("input", "output")
    return tag.name == "nodegraph" or ("type" in tag.attributes and not is_port)


def _is_named_in_code(tag: Tag, scope: Tag) -> bool:
    if not tag.attributes.get("name") or tag.name in _DEFINITIONS:
        return False
    # What a graph that implements a definition takes and gives is the definition's.
    return _is_node(tag) or (tag.name in ("input", "output") and "nodedef" not in scope.attributes)


def _references(tag: Tag, root: Tag) -> Iterator[tuple[str, Tag | None]]:
    """Yield the attributes of an element that name others, each with the one it names."""
    graph = _named(root, tag.attributes.get("nodegraph", ""), "nodegraph")
    if "nodegraph" in tag.attributes:
        yield "nodegraph", graph
    if "output" in tag.attributes and graph is not None:
        yield "output", _named(graph, tag.attributes["output"], "output")
    if "material" in tag.attributes:
        yield "material", _named(root, tag.attributes["material"])
    scope = tag.parent if tag.name == "output" or tag.parent is None else tag.parent.parent
    if "nodename" in tag.attributes and scope is not None:
        yield "nodename", _named(scope, tag.attributes["nodename"])
    if "interfacename" in tag.attributes and scope is not None:
        yield "interfacename", _named(scope, tag.attributes["interfacename"], "input")


def _named(scope: Tag, name: str, category: str = "") -> Tag | None:
    return next(
        (
            child
            for child in scope.children
            if child.attributes.get("name") == name and (not category or child.name == category)
        ),
        None,
    )
