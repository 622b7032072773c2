"""The XML that MaterialX's own reader (pugixml) takes: what encoding a file has, and where its tags are.

pugixml knows no entities but `&lt; &gt; &amp; &quot; &apos;` and numbers, and takes `&` and `<` in a value as they
stand. This follows its grammar, so that what is limited here, and what is edited here, is what it reads.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from typing import NamedTuple

from mrm_nodes.errors import MrmError

DEEPEST = 100
"""Elements within elements: MaterialX's own reader has no limit but the stack."""

_BYTE_ORDER_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
    # Without a mark: the first `<` tells.
    (b"<\0\0\0", "utf-32-le"),
    (b"\0\0\0<", "utf-32-be"),
    (b"<\0", "utf-16-le"),
    (b"\0<", "utf-16-be"),
)
_DECLARATION = re.compile(rb"""\s*<\?xml\s[^>]{0,200}?\bencoding\s*=\s*["']([\w.:-]{1,40})["']""")
#: Whose decoders take the square of the text in time, and which no document has.
_NO_DOCUMENT_HAS = {"idna", "punycode"}

_NAME = r"[A-Za-z_:\x80-\U0010ffff][\w:.\-\x80-\U0010ffff]*+"
_TOKEN = re.compile(
    rf"""
      <!--.*?-->
    | <!\[CDATA\[(?P<data>.*?)\]\]>
    | <\?.*?\?>
    | </(?P<end>{_NAME})\s*+>
    | <(?P<start>{_NAME})(?P<attributes>(?>\s++{_NAME}\s*+=\s*+(?>"[^"]*+"|'[^']*+'))*+)\s*+(?P<empty>/?)>
    | (?P<doctype><!DOCTYPE)
    | (?P<bad><)
    """,
    re.VERBOSE | re.DOTALL | re.ASCII,
)
_ATTRIBUTE = re.compile(rf"""\s++({_NAME})\s*+=\s*+("[^"]*+"|'[^']*+')""", re.ASCII)
_REFERENCE = re.compile(r"&(?:#(\d{1,9})|#x([0-9A-Fa-f]{1,8})|(lt|gt|amp|quot|apos));")
_LETTERS = {"lt": "<", "gt": ">", "amp": "&", "quot": '"', "apos": "'"}


def decode(content: bytes, where: str) -> tuple[str, str]:
    """The text of a file, and its codec: text.encode(codec) is the file again, a byte-order mark included.

    UTF-8 before all, as MaterialX reads whatever it is told; Latin-1 where it is declared; what is neither, by
    what it declares, or is Windows-1252.

    Raises:
        MrmError: it is in no encoding that is known, or not text.
    """
    codec = next((codec for mark, codec in _BYTE_ORDER_MARKS if content.startswith(mark)), None)
    declared = _declared(content) if codec is None else None
    tried = [codec] if codec is not None else ["utf-8", *_fitting(declared)]
    if declared == "iso8859-1":
        tried = [declared]
    for each in tried:
        try:
            text = content.decode(each)
        except UnicodeError:
            continue
        if "\0" in text:
            break
        return text, each
    else:
        raise MrmError(
            f"{where}: not a MaterialX document: is not text in {declared or codec}; save it as UTF-8"
        )
    raise MrmError(f"{where}: not a MaterialX document: holds a zero byte, which no text does")


def _declared(content: bytes) -> str | None:
    """The codec of the encoding that a file declares, or the encoding's own name where there is none."""
    found = _DECLARATION.match(content)
    if found is None:
        return None
    name = found[1].decode("ascii")
    try:
        return codecs.lookup(name).name
    except LookupError:
        return name


def _fitting(declared: str | None) -> list[str]:
    """The codecs of a file that is not UTF-8, by what it declares."""
    if declared is None or declared in ("utf-8", "ascii") or declared.startswith(("utf-16", "utf-32")):
        # The last takes each byte, also the five that Windows-1252 leaves open.
        return ["cp1252", "iso8859-1"]
    try:
        is_text = declared not in _NO_DOCUMENT_HAS and bool("".encode(declared) == b"")
    except LookupError:
        return []
    return [declared] if is_text else []


class Token(NamedTuple):
    """A start tag, an end tag, or text between tags (its name is empty), from position start to end."""

    name: str
    start: int
    end: int
    opens: bool = False
    closes: bool = False
    attributes: str = ""


def tokens(text: str, where: str) -> Iterator[Token]:
    """The tags of a text and what stands between them, in order; comments and instructions are left out.

    Raises:
        MrmError: no XML, a document type, or too many elements within each other.
    """
    open_: list[str] = []
    position = 0
    for found in _TOKEN.finditer(text):
        start, end = found.span()
        if (open_ and text[position:start].strip()) or found["data"] is not None:
            yield Token("", position, end)
        position = end
        if (name := found["start"]) is not None:
            is_empty = found["empty"] == "/"
            if not is_empty:
                open_.append(name)
                if len(open_) > DEEPEST:
                    raise MrmError(f"{where}: more than {DEEPEST} elements within each other")
            yield Token(name, start, end, True, is_empty, found["attributes"])
        elif (name := found["end"]) is not None:
            if not open_ or open_.pop() != name:
                raise _fault(text, start, f"</{name}> closes nothing", where)
            yield Token(name, start, end, closes=True)
        elif found["doctype"] is not None:
            # Its entities would name files that only one of two readers sees.
            raise MrmError(f"{where}: has a document type (<!DOCTYPE …>), which no MaterialX document needs")
        elif found["bad"] is not None:
            raise _fault(text, start, f"{_excerpt(text, start)} is no tag", where)
    if open_:
        raise _fault(text, len(text), f"ends before </{open_[-1]}>", where)


def _fault(text: str, position: int, what: str, where: str) -> MrmError:
    line = text.count("\n", 0, position) + 1
    return MrmError(f"{where}: not a MaterialX document: line {line}: {what}")


def _excerpt(text: str, position: int) -> str:
    shown = " ".join(text[position : position + 30].split())
    return shown if position + 30 >= len(text) else f"{shown}…"


def attributes_of(tag: str) -> dict[str, str]:
    """The attributes of a start tag, by name; of two with one name the last, as in MaterialX, but for the name's."""
    found: dict[str, str] = {}
    for name, quoted in _ATTRIBUTE.findall(tag):
        if name != "name" or name not in found:
            found[name] = unescaped(quoted[1:-1])
    return found


def name_in(tag: str) -> str:
    """The name that a start tag gives, as `attributes_of` has it; empty for none."""
    for name, quoted in _ATTRIBUTE.findall(tag) if "name" in tag else ():
        if name == "name":
            return unescaped(quoted[1:-1])
    return ""


def attribute_spans(tag: str) -> Iterator[tuple[str, int, int]]:
    """The attributes of a start tag in order: name, and where the value with its quotes is."""
    for found in _ATTRIBUTE.finditer(tag):
        yield found[1], found.start(2), found.end(2)


def unescaped(value: str) -> str:
    """A value as pugixml reads it: what is no reference stays as it stands, and white space is spaces."""
    value = re.sub(r"\r\n|[\t\r\n]", " ", value)
    return _REFERENCE.sub(_letter, value) if "&" in value else value


def _letter(found: re.Match[str]) -> str:
    if found[3]:
        return _LETTERS[found[3]]
    code = int(found[1]) if found[1] else int(found[2], 16)
    return chr(code) if 0 < code < 0x110000 else found[0]
