"""XML text with the positions of its elements, so that an edit leaves every other character as it was."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from mrm_nodes import xmltext
from mrm_nodes.errors import MrmError


@dataclass
class Tag:
    """An element and where its text is: `<name …>` from start to start_end, `</name>` from end to end_end.

    An empty element, `<name …/>`, has no end tag: end and end_end are start_end.
    """

    name: str
    attributes: dict[str, str]
    start: int
    start_end: int
    is_empty: bool
    parent: Tag | None
    children: list[Tag] = field(default_factory=list)
    end: int = 0
    end_end: int = 0

    def walk(self) -> Iterator[Tag]:
        """Yield this element and all below it, in document order."""
        yield self
        for child in self.children:
            yield from child.walk()

    def child(self, category: str, name: str) -> Tag | None:
        """Return the child element of this category whose attribute `name` is `name`."""
        return next(
            (c for c in self.children if c.name == category and c.attributes.get("name") == name), None
        )


def parse(text: str, where: str) -> Tag:
    """Return the root element of an XML text: the first `materialx` as in MaterialX, else the first of all.

    Raises:
        MrmError: not XML as MaterialX reads it.
    """
    roots: list[Tag] = []
    current: Tag | None = None
    for token in xmltext.tokens(text, where):
        if token.opens:
            attributes = xmltext.attributes_of(token.attributes)
            tag = Tag(token.name, attributes, token.start, token.end, token.closes, current)
            (roots if current is None else current.children).append(tag)
            tag.end = tag.end_end = token.end
            if not tag.is_empty:
                current = tag
        elif token.closes and current is not None:
            current.end, current.end_end = token.start, token.end
            current = current.parent
    if not roots:
        raise MrmError(f"{where}: not XML: there is no element in it")
    return next((root for root in roots if root.name == "materialx"), roots[0])


class Edits:
    """Replacements of ranges of one text, applied together."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._edits: list[tuple[int, int, str]] = []

    def replace(self, start: int, end: int, new: str) -> None:
        """Replace the characters from start to end."""
        self._edits.append((start, end, new))

    def rename(self, tag: Tag, name: str) -> None:
        """Rename an element in its start and end tag."""
        length = len(tag.name)
        self.replace(tag.start + 1, tag.start + 1 + length, name)
        if not tag.is_empty:
            self.replace(tag.end + 2, tag.end + 2 + length, name)

    def set_attribute(self, tag: Tag, name: str, value: str) -> None:
        """Change the value of an attribute that the element has, or add it after the others."""
        begin = position = tag.start + 1 + len(tag.name)
        for present, start, end in xmltext.attribute_spans(self._text[begin : tag.start_end]):
            position = begin + end
            if present == name:
                self.replace(begin + start, position, quoteattr(value))
                return
        self.replace(position, position, f" {name}={quoteattr(value)}")

    def add_child(self, tag: Tag, child: str) -> None:
        """Add an element after the last child of `tag`, indented like it."""
        newline = "\r\n" if "\r\n" in self._text else "\n"
        own = self.indentation(tag)
        inner = own + self._step(tag)
        if tag.is_empty:
            slash = self._text.rindex("/", tag.start, tag.start_end)
            body = len(self._text[:slash].rstrip())
            self.replace(
                body, tag.start_end, f">{newline}{inner}{child}{newline}{own}</{self._name_of(tag)}>"
            )
        elif tag.children:
            last = tag.children[-1]
            self.replace(last.end_end, last.end_end, f"{newline}{self.indentation(last)}{child}")
        else:
            self.replace(tag.start_end, tag.start_end, f"{newline}{inner}{child}{newline}{own}")

    def add_before(self, tag: Tag, sibling: str) -> None:
        """Add an element before `tag`, indented like it."""
        newline = "\r\n" if "\r\n" in self._text else "\n"
        self.replace(tag.start, tag.start, f"{sibling}{newline}{self.indentation(tag)}")

    def indentation(self, tag: Tag) -> str:
        """Return the white space before the element on its line."""
        line = self._text[self._text.rfind("\n", 0, tag.start) + 1 : tag.start]
        return line if not line.strip() else ""

    def _step(self, tag: Tag) -> str:
        """Return what an element is indented by against its parent."""
        if tag.parent is not None:
            step = self.indentation(tag).removeprefix(self.indentation(tag.parent))
            if step:
                return step
        return "  "

    def _name_of(self, tag: Tag) -> str:
        """Return the element's name as it will be once it is renamed."""
        position = tag.start + 1
        renamed = next((new for start, _, new in self._edits if start == position), None)
        return tag.name if renamed is None else renamed

    def apply(self) -> str:
        """Return the text with every edit made; edits at one place keep the order in which they came."""
        parts, position = [], 0
        for start, end, new in sorted(self._edits, key=lambda edit: (edit[0], edit[1])):
            parts += [self._text[position:start], new]
            position = end
        return "".join([*parts, self._text[position:]])
