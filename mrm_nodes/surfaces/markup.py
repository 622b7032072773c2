"""XML text with the byte positions of its elements, so that an edit leaves every other byte as it was."""

from __future__ import annotations

import re
import xml.parsers.expat
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.sax.saxutils import quoteattr

from mrm_nodes.errors import MrmError

#: One attribute of a start tag; nothing else can match between the name and the end of a tag that was parsed.
_ATTRIBUTE = re.compile(rb"""\s+([^\s=]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class Tag:
    """An element and where its bytes are: `<name …>` from start to start_end, `</name>` from end to end_end.

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


def parse(text: bytes, where: str) -> Tag:
    """Return the root element of an XML text in UTF-8.

    Raises:
        MrmError: not XML, or in an encoding whose markup is not ASCII.
    """
    parser = xml.parsers.expat.ParserCreate()
    if text[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise MrmError(f"{where}: is encoded as UTF-16; save it as UTF-8")
    root: Tag | None = None
    current: Tag | None = None

    def on_start(name: str, attributes: dict[str, str]) -> None:
        nonlocal root, current
        start = parser.CurrentByteIndex
        start_end = _end_of_tag(text, start)
        is_empty = text[start_end - 2 : start_end] == b"/>"
        tag = Tag(name, attributes, start, start_end, is_empty, current)
        if current is None:
            root = tag
        else:
            current.children.append(tag)
        current = tag

    def on_end(name: str) -> None:
        nonlocal current
        assert current is not None
        current.end = current.start_end if current.is_empty else parser.CurrentByteIndex
        current.end_end = current.end if current.is_empty else text.index(b">", current.end) + 1
        current = current.parent

    parser.StartElementHandler = on_start
    parser.EndElementHandler = on_end
    try:
        parser.Parse(text, True)
    except xml.parsers.expat.ExpatError as error:
        message = xml.parsers.expat.ErrorString(error.code)
        raise MrmError(f"{where}: line {error.lineno}: not XML: {message}") from None
    assert root is not None
    return root


def _end_of_tag(text: bytes, start: int) -> int:
    """Return the position after the `>` that closes the tag at `start`; one in quotes does not."""
    quote = None
    for position in range(start, len(text)):
        byte = text[position : position + 1]
        if quote is not None:
            quote = None if byte == quote else quote
        elif byte in (b'"', b"'"):
            quote = byte
        elif byte == b">":
            return position + 1
    raise AssertionError("the parser saw the end of this tag")


class Edits:
    """Replacements of byte ranges of one text, applied together."""

    def __init__(self, text: bytes) -> None:
        self._text = text
        self._edits: list[tuple[int, int, bytes]] = []

    def replace(self, start: int, end: int, new: str) -> None:
        """Replace the bytes from start to end."""
        self._edits.append((start, end, new.encode("utf-8")))

    def rename(self, tag: Tag, name: str) -> None:
        """Rename an element in its start and end tag."""
        length = len(tag.name.encode("utf-8"))
        self.replace(tag.start + 1, tag.start + 1 + length, name)
        if not tag.is_empty:
            self.replace(tag.end + 2, tag.end + 2 + length, name)

    def set_attribute(self, tag: Tag, name: str, value: str) -> None:
        """Change the value of an attribute that the element has, or add it after the others."""
        length = len(tag.name.encode("utf-8"))
        position = tag.start + 1 + length
        while found := _ATTRIBUTE.match(self._text, position, tag.start_end):
            position = found.end()
            if found[1].decode("utf-8") == name:
                self.replace(found.start(2), found.end(2), quoteattr(value))
                return
        self.replace(position, position, f" {name}={quoteattr(value)}")

    def add_child(self, tag: Tag, child: str) -> None:
        """Add an element after the last child of `tag`, indented like it."""
        newline = "\r\n" if b"\r\n" in self._text else "\n"
        own = self.indentation(tag)
        inner = own + self._step(tag)
        if tag.is_empty:
            slash = self._text.rindex(b"/", tag.start, tag.start_end)
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
        newline = "\r\n" if b"\r\n" in self._text else "\n"
        self.replace(tag.start, tag.start, f"{sibling}{newline}{self.indentation(tag)}")

    def indentation(self, tag: Tag) -> str:
        """Return the white space before the element on its line."""
        line = self._text[self._text.rfind(b"\n", 0, tag.start) + 1 : tag.start].decode("utf-8")
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
        return tag.name if renamed is None else renamed.decode("utf-8")

    def apply(self) -> bytes:
        """Return the text with every edit made; edits at one place keep the order in which they came."""
        parts, position = [], 0
        for start, end, new in sorted(self._edits, key=lambda edit: (edit[0], edit[1])):
            parts += [self._text[position:start], new]
            position = end
        return b"".join([*parts, self._text[position:]])
