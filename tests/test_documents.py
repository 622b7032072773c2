"""Documents as other programs write them are read as MaterialX's own reader reads them, and safely."""

from __future__ import annotations

import random
import shutil
from pathlib import Path
from typing import Any

import MaterialX as mx
import pytest

from mrm_nodes import documents, xmltext
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.shadergen import generate_shader
from mrm_nodes.surfaces.rewrite import retrofit_file

SURFACE = (
    '<standard_surface name="s" type="surfaceshader"{attributes} /><surfacematerial name="m" type="material">'
    '<input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial>'
)


def document_with(attributes: str = "", more: str = "", head: str = '<?xml version="1.0"?>\n') -> str:
    body = SURFACE.format(attributes=attributes) + more
    return f'{head}<materialx version="1.39">{body}</materialx>\n'


def written(folder: Path, content: str | bytes, name: str = "a.mtlx") -> Path:
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    return file


# --- markup that is no XML, and that MaterialX takes


@pytest.mark.parametrize(
    "text", ["R&D", "a < b", "<b>bold</b>", "&", "&nbsp;", "&#60;", "&lt;&quot;", "a=1&b=2", "-->"]
)
def test_a_value_is_what_materialx_reads(tmp_path: Path, text: str):
    content = document_with(f' doc="{text}"')
    bare = mx.createDocument()
    mx.readFromXmlString(bare, content)
    read = read_document(written(tmp_path, content))
    assert read.getNode("s").getDocString() == bare.getNode("s").getDocString() != ""


def test_udim_as_it_stands_is_a_name(tmp_path: Path):
    image = (
        '<image name="i" type="color3"><input name="file" type="filename" value="ud.<UDIM>.png" /></image>'
    )
    document = read_document(written(tmp_path, document_with(more=image)))
    assert document.getNode("i").getInput("file").getValueString() == "ud.<UDIM>.png"


@pytest.mark.parametrize(
    "content",
    [
        '<materialx version="1.39"><a name="x"></b></materialx>',
        '<materialx version="1.39"><a name="x" /></materialx',
        '<materialx version="1.39"><a name=x /></materialx>',
        '<materialx version="1.39"><a name="x"b="y" /></materialx>',
        '<materialx version="1.39"><a name="x" /><!-- </materialx>',
        '<materialx version="1.39"><1 /></materialx>',
        '<materialx version="1.39">',
        '<mx:materialx xmlns:mx="x" version="1.39" />',
    ],
)
def test_what_materialx_does_not_read_is_one_line(tmp_path: Path, content: str):
    with pytest.raises(mx.ExceptionParseError):
        mx.readFromXmlString(mx.createDocument(), content)
    with pytest.raises(MrmError, match=r"a\.mtlx: not a MaterialX document: ") as fault:
        read_document(written(tmp_path, content))
    assert "\n" not in str(fault.value)


# --- encodings

CODECS = {
    "utf-8": "",
    "utf-8-sig": "",
    "utf-16": "UTF-16",
    "utf-32": "",
    "latin-1": "ISO-8859-1",
    "iso8859-1": "latin1",
    "cp1252": "",
    "windows-1252": "windows-1252",
    "cp1250": "windows-1250",
    "shift_jis": "Shift_JIS",
    "gbk": "GBK",
}


@pytest.mark.parametrize("codec", CODECS)
def test_an_encoding_is_read_and_kept_by_retrofit(tmp_path: Path, codec: str):
    name = "磁石" if codec in ("shift_jis", "gbk") else "Köln"
    declared = f' encoding="{CODECS[codec]}"' if CODECS[codec] else ""
    content = document_with(
        f' doc="{name}"', "<!-- ö -->" if name == "Köln" else "", f'<?xml version="1.0"{declared}?>\n'
    )
    file = written(tmp_path, content.encode(codec))
    assert read_document(file).getNode("s").getDocString() == name
    assert generate_shader(file).pixel
    retrofit_file(file, tmp_path / "b.mtlx")
    before, after = file.read_bytes(), (tmp_path / "b.mtlx").read_bytes()
    assert after.decode(codec) == content.replace("standard_surface", "mrm_standard_surface")
    assert after.startswith(before[:10])


@pytest.mark.parametrize("mark", ["utf-16-le", "utf-16-be"])
def test_utf_16_without_a_mark_is_read(tmp_path: Path, mark: str):
    file = written(tmp_path, document_with(' doc="Köln"').encode(mark))
    assert read_document(file).getNode("s").getDocString() == "Köln"


def test_utf_8_is_utf_8_whatever_else_is_declared_but_latin_1(tmp_path: Path):
    """As MaterialX's own reader has it."""
    for declared, expected in (
        ("UTF-16", "Köln"),
        ("windows-1252", "Köln"),
        ("nonsense", "Köln"),
        ("latin1", "KÃ¶ln"),
    ):
        content = document_with(' doc="Köln"', head=f'<?xml version="1.0" encoding="{declared}"?>')
        file = written(tmp_path, content)
        bare = mx.createDocument()
        mx.readFromXmlFile(bare, str(file))
        assert read_document(file).getNode("s").getDocString() == bare.getNode("s").getDocString() == expected


@pytest.mark.parametrize("declared", ["nonsense", "zlib", "rot13", "idna", "us-ascii; drop"])
def test_an_encoding_that_is_none_is_named(tmp_path: Path, declared: str):
    content = document_with(' doc="Köln"', head=f'<?xml version="1.0" encoding="{declared}"?>')
    file = written(tmp_path, content.encode("latin-1"))
    if ";" in declared:
        assert read_document(file).getNode("s").getDocString() == "Köln"
        return
    with pytest.raises(MrmError, match=f"{declared[:3]}.*save it as UTF-8"):
        read_document(file)


def test_a_zero_byte_is_no_text(tmp_path: Path):
    with pytest.raises(MrmError, match="zero byte"):
        read_document(written(tmp_path, document_with() + "\0"))


# --- includes: one reader

NOT_INCLUDES = {
    "comment": '<!-- <xi:include href="secret.mtlx" /> -->',
    "comment that looks closed": '<!-- -- > <xi:include href="secret.mtlx" /> -->',
    "data": '<![CDATA[<xi:include href="secret.mtlx" />]]>',
    "instruction": '<?x <xi:include href="secret.mtlx" /> ?>',
    "value": "<backdrop name='b' doc='<xi:include href=\"secret.mtlx\" />' />",
    "another prefix": '<inc:include xmlns:inc="http://www.w3.org/2001/XInclude" href="secret.mtlx" />',
    "no prefix": '<include xmlns="http://www.w3.org/2001/XInclude" href="secret.mtlx" />',
    "capitals": '<XI:INCLUDE href="secret.mtlx" />',
    "deeper": '<nodegraph name="g"><xi:include href="secret.mtlx" /></nodegraph>',
    "after the document": '</materialx><materialx version="1.39"><xi:include href="secret.mtlx" />',
}
INCLUDES = {
    "plain": '<xi:include href="secret.mtlx" />',
    "single quotes": "<xi:include href='secret.mtlx' />",
    "lines": '<xi:include\n\thref\n=\r\n"secret.mtlx"\n></xi:include >',
    "numbers for letters": '<xi:include href="s&#101;cret&#x2e;mtlx" />',
    "with a namespace": '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="secret.mtlx" />',
    "under another namespace": '<xi:include xmlns:xi="urn:other" href="secret.mtlx" />',
    "beside a raw &": '<xi:include title="a & b < c" href="secret.mtlx" />',
    "after a comment with a quote": '<!-- it\'s "here --><xi:include href="secret.mtlx" />',
    "after data that ends oddly": '<![CDATA[ ]] > ]]]><xi:include href="secret.mtlx" />',
    "after an instruction with a tag": '<?x > <q ?><xi:include href="secret.mtlx" />',
    "after a root-like value": '<backdrop name="b" doc="</materialx>" /><xi:include href="secret.mtlx" />',
}


@pytest.mark.parametrize("way", [*NOT_INCLUDES, *INCLUDES])
def test_what_materialx_includes_is_asked_for_and_nothing_else(tmp_path: Path, way: str):
    """Outside of the folder it needs the flag; MaterialX itself is the judge of what an include is."""
    body = (NOT_INCLUDES | INCLUDES)[way]
    written(tmp_path, '<materialx version="1.39"><backdrop name="read" /></materialx>', "secret.mtlx")
    inner = document_with(more=body)
    bare = mx.createDocument()
    mx.readFromXmlFile(bare, str(written(tmp_path, inner)), mx.FileSearchPath(str(tmp_path)))
    assert (bare.getBackdrop("read") is not None) == (way in INCLUDES)

    assert (read_document(tmp_path / "a.mtlx").getBackdrop("read") is not None) == (way in INCLUDES)
    assert len(documents.included_documents(tmp_path / "a.mtlx")) == (2 if way in INCLUDES else 1)

    outside = written(
        tmp_path, inner.replace("secret.mtlx", "../secret.mtlx").replace("s&#", "../s&#"), "in/a.mtlx"
    )
    if way in INCLUDES:
        with pytest.raises(MrmError, match="--allow-external"):
            read_document(outside)
        assert read_document(outside, allow_external=True).getBackdrop("read") is not None
    else:
        assert read_document(outside).getBackdrop("read") is None


def test_an_include_in_another_encoding_is_read(tmp_path: Path):
    part = (
        '<?xml version="1.0"?><materialx version="1.38"><backdrop name="b" doc="Köln & Bonn" /></materialx>'
    )
    written(tmp_path, part.encode("utf-16"), "part.mtlx")
    document = read_document(written(tmp_path, document_with(more='<xi:include href="part.mtlx" />')))
    assert document.getBackdrop("b").getDocString() == "Köln & Bonn"
    assert document.getBackdrop("b").getActiveSourceUri() == str(tmp_path / "part.mtlx")


def test_of_two_things_with_one_name_the_included_one_counts_as_in_materialx(tmp_path: Path):
    written(
        tmp_path,
        '<materialx version="1.39" colorspace="acescg"><backdrop name="b" doc="included" /></materialx>',
        "part.mtlx",
    )
    content = document_with(more='<backdrop name="b" doc="own" /><xi:include href="part.mtlx" />')
    file = written(tmp_path, content)
    bare = mx.createDocument()
    mx.readFromXmlFile(bare, str(file), mx.FileSearchPath(str(tmp_path)))
    read = read_document(file)
    assert read.getBackdrop("b").getDocString() == bare.getBackdrop("b").getDocString() == "included"
    assert read.getBackdrop("b").getAttribute("colorspace") == bare.getBackdrop("b").getAttribute(
        "colorspace"
    )


def test_an_include_is_found_beside_the_file_that_names_it_then_beside_those_above(tmp_path: Path):
    written(tmp_path, document_with(more='<xi:include href="sub/one.mtlx" />'))
    written(
        tmp_path,
        '<materialx version="1.39"><xi:include href="two.mtlx" /><xi:include href="three.mtlx" /></materialx>',
        "sub/one.mtlx",
    )
    for name in ("sub/two.mtlx", "two.mtlx", "three.mtlx"):
        written(
            tmp_path,
            f'<materialx version="1.39"><backdrop name="b_{Path(name).stem}" doc="{name}" /></materialx>',
            name,
        )
    document = read_document(tmp_path / "a.mtlx")
    assert document.getBackdrop("b_two").getDocString() == "sub/two.mtlx"
    assert document.getBackdrop("b_three").getDocString() == "three.mtlx"


def test_a_file_is_read_once_however_often_it_is_included(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    last = 16
    for number in range(last):
        twice = f'<xi:include href="i{number + 1}.mtlx" /><xi:include href="./i{number + 1}.mtlx" />'
        written(tmp_path, f'<materialx version="1.39">{twice}</materialx>', f"i{number}.mtlx")
    written(tmp_path, document_with(), f"i{last}.mtlx")
    read: list[str] = []
    content = documents._Reading._content
    monkeypatch.setattr(
        documents._Reading, "_content", lambda self, file: read.append(file.name) or content(self, file)
    )
    assert read_document(tmp_path / "i0.mtlx").getNode("s") is not None
    assert len(read) == len(set(read)) == last + 1


# --- limits


def test_what_is_included_counts_toward_the_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(documents, "LARGEST", 5000)
    for name in ("b.mtlx", "c.mtlx"):
        written(tmp_path, f'<materialx version="1.39"><!-- {"x" * 2000} --></materialx>', name)
    read_document(
        written(tmp_path, document_with(more='<xi:include href="b.mtlx" /><xi:include href="c.mtlx" />'))
    )
    written(tmp_path, f'<materialx version="1.39"><!-- {"x" * 4000} --></materialx>', "c.mtlx")
    with pytest.raises(MrmError, match=r"c\.mtlx: larger than"):
        read_document(tmp_path / "a.mtlx")


def test_what_is_copied_again_and_again_counts_each_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(documents, "MOST_ELEMENTS", 2000)
    many = "".join(f'<backdrop name="b{n}" />' for n in range(500))
    written(tmp_path, f'<materialx version="1.39">{many}</materialx>', "b.mtlx")
    read_document(written(tmp_path, document_with(more='<xi:include href="b.mtlx" />')))
    with pytest.raises(MrmError, match="more than 2000 elements"):
        read_document(written(tmp_path, document_with(more='<xi:include href="b.mtlx" />' * 5)))


def test_elements_without_a_name_are_few(tmp_path: Path):
    for body in (
        "<backdrop />",
        '<backdrop name="" />',
        "<backdrop doc=\" name='b' \" />",
        "a<!-- -->",
        "<![CDATA[a]]>",
    ):
        with pytest.raises(MrmError, match="without a name"):
            read_document(written(tmp_path, document_with(more=body * (documents.MOST_NAMELESS + 1))))


def test_reading_has_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(documents, "LONGEST", -1.0)
    with pytest.raises(MrmError, match="takes longer"):
        read_document(written(tmp_path, document_with()))


# --- what is limited and edited here is what MaterialX reads


def tree_of(element: mx.Element) -> tuple[object, ...]:
    attributes = {name: element.getAttribute(name) for name in element.getAttributeNames()}
    return (
        element.getCategory(),
        element.getName(),
        attributes,
        [tree_of(child) for child in element.getChildren()],
    )


def tree_here(text: str) -> Any:
    """The same from our own tags; None where MaterialX makes up names."""
    root: list[Any] = []
    open_ = [root]
    for token in xmltext.tokens(text, ""):
        if token.opens:
            attributes = xmltext.attributes_of(token.attributes)
            name = attributes.pop("name", "")
            if not name and token.name != "materialx":
                return None
            children: list[Any] = []
            taken = open_[-1] is not root and any(each[1] == name for each in open_[-1])
            if not taken:
                open_[-1].append((token.name, name, attributes, children))
            if not token.closes:
                open_.append(children)
        elif token.closes:
            open_.pop()
        else:
            return None
    return next((each for each in root if each[0] == "materialx"), None)


PIECES = [*"<>/&\"'= \néa", "-->", "<!--", "<![CDATA[", "]]>", "?>", "<?x ", "&lt;", "&#65;"]


def test_on_documents_that_were_changed_at_random_both_readers_see_the_same():
    rng = random.Random(1)
    base = document_with(
        ' doc="a > b" uiname=\'q"q\'', '<!-- c --><nodegraph name="g"><backdrop name="é" /></nodegraph >'
    )
    agreed = 0
    for _ in range(20_000):
        text = base
        for _ in range(rng.choice((1, 1, 2, 3))):
            at = rng.randrange(len(text))
            text = text[:at] + rng.choice(PIECES) + text[at + rng.choice((0, 0, 1, 5)) :]
        options = mx.XmlReadOptions()
        options.upgradeVersion = False
        options.readXIncludeFunction = None
        theirs = mx.createDocument()
        try:
            mx.readFromXmlString(theirs, "\ufeff" + text, mx.FileSearchPath(), options)
        except mx.ExceptionParseError:
            continue
        ours = tree_here(text)
        if ours is None:
            continue
        agreed += 1
        _, _, attributes, children = tree_of(theirs)
        # MaterialX gives a document its own version where it has none.
        assert (attributes, children) == ({"version": "1.39"} | ours[2], ours[3]), text
    assert agreed > 3000


CASES = Path(__file__).parents[2] / "shared" / "cases" / "doc"


@pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not here")
@pytest.mark.parametrize("name", ["raw_amp", "raw_lt_other", "cp1252_undeclared", "latin1", "udim_escaped"])
def test_the_shared_cases_are_read_and_moved_over(tmp_path: Path, name: str):
    for file in CASES.iterdir():
        shutil.copy(file, tmp_path)
    file = tmp_path / f"{name}.mtlx"
    assert generate_shader(file).pixel
    if "standard_surface" in file.read_text(encoding="latin-1"):
        retrofit_file(file, tmp_path / "b.mtlx")
        assert (tmp_path / "b.mtlx").read_bytes() == file.read_bytes().replace(
            b"standard_s", b"mrm_standard_s"
        )
