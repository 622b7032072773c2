"""A file's name means what it means to MaterialX, which is asked itself."""

from __future__ import annotations

from pathlib import Path

import MaterialX as mx
import pytest

from mrm_nodes import filenames
from mrm_nodes.filenames import find
from mrm_nodes.render.uniforms import uniforms_of
from mrm_nodes.shadergen import generate_shader

BELOW = (
    "a.png",
    "tex/a.png",
    "tex/b c.png",
    "tex/b%20c.png",
    "tex/50%.png",
    "~/a.png",
    "$TEX/a.png",
    "%TEX%/a.png",
    "été.png",
    "写真.png",
    " a.png",
    "a.png ",
    "a.PNG",
    "a[1].png",
    "a*.png",
    "a#b.png",
    "C/a.png",
    "file:/a.png",
    "only/here.png/inside",
    ".hidden/.a.png",
)
"""Files below the first folder."""
LATER = ("a.png", "later.png", "only/here.png")
"""Files below the second: `only/here.png` is a folder in the first."""

NAMES = (
    *BELOW,
    *LATER,
    "tex\\a.png",
    "tex//a.png",
    "./tex/./a.png",
    "tex/../a.png",
    "missing/../a.png",
    "tex\\..\\a.png",
    "..\\first\\a.png",
    "\\a.png",
    "\\\\a.png",
    "tex",
    "tex/",
    "A.png",
    "TEX/a.png",
    "C:\\a.png",
    "C:/a.png",
    "c:a.png",
    "missing.png",
    "e\u0301te\u0301.png",
    "a.png\n",
)


@pytest.fixture
def folders(tmp_path: Path) -> list[Path]:
    for folder, names in (("first", BELOW), ("second", LATER)):
        for name in names:
            file = tmp_path / folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(b"")
    return [tmp_path / "first", tmp_path / "second"]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_means_the_file_that_materialx_finds(name: str, folders: list[Path]):
    path = mx.FileSearchPath(":".join(map(str, folders)))
    theirs = Path(path.find(mx.FilePath(name)).asString())
    found = find(name, folders)
    assert found.file == (theirs if theirs.is_file() else None)
    assert found.all() == ([] if found.file is None else [theirs])


def test_a_name_that_no_system_opens_is_looked_for_nowhere(tmp_path):
    name = "a/" * 20_000 + "b.png"
    assert not find(name, [tmp_path]).all()
    assert (
        filenames.absence(name, [tmp_path])
        == "its 40005 letters are more than the 4096 that a file's name can have"
    )


def test_an_absolute_name_is_looked_for_nowhere_else(folders: list[Path]):
    assert find(f"{folders[0]}/a.png", []).file == folders[0] / "a.png"
    assert find(str(folders[0]).replace("/", "\\"), []).file is None
    assert find("/a.png", folders).file is None


def test_a_name_that_is_nowhere_is_relative_to_where_the_program_runs(
    folders: list[Path], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(folders[1])
    assert find("later.png", folders[:1]).file == Path("later.png")


@pytest.mark.parametrize("name", ["", "a\0.png", "a" * 300 + ".png", "a/" * 3000])
def test_a_name_that_no_file_can_have_means_none(name: str, folders: list[Path]):
    assert find(name, folders).all() == []


def document(body: str, attributes: str = "") -> mx.Document:
    doc = mx.createDocument()
    text = (
        f'<materialx version="1.39"{attributes}>{body}'
        '<output name="out" type="color3" nodename="i" /></materialx>'
    )
    mx.readFromXmlString(doc, text)
    return doc


def image(value: str, attributes: str = "", inside: str = "", name: str = "i") -> str:
    file = f'<input name="file" type="filename" value="{value}" />'
    return f'<image name="{name}" type="color3"{attributes}>{inside}{file}</image>'


DEFINED = """
<nodedef name="ND_mine" node="mine" fileprefix="of_definition/">
  <input name="file" type="filename" value="default.png" uniform="true" /><output name="out" type="color3" />
</nodedef>
<nodegraph name="NG_mine" nodedef="ND_mine" fileprefix="of_graph/">
  <image name="k" type="color3"><input name="file" type="filename" interfacename="file" /></image>
  <output name="out" type="color3" nodename="k" />
</nodegraph>
"""
GRAPH = """
<nodegraph name="g" fileprefix="of_graph/">
  <input name="shown" type="filename" value="a.png" />
  <image name="k" type="color3" fileprefix="of_node/">
    <input name="file" type="filename" interfacename="shown" />
  </image>
  <output name="out" type="color3" nodename="k" />
</nodegraph>
<dot name="i" type="color3"><input name="in" type="color3" nodegraph="g" /></dot>
"""
TOKEN = '<token name="Set" type="string" value="body" />'

DOCUMENTS = {
    "as it is": (image("a.png"), "", "a.png"),
    "backslash": (image("tex\\a.png"), "", "tex\\a.png"),
    "prefix": (image("a.png"), ' fileprefix="tex/"', "tex/a.png"),
    "prefix without a slash": (image("a.png"), ' fileprefix="tex"', "texa.png"),
    "prefix with a backslash": (image("a.png"), ' fileprefix="tex\\"', "tex\\a.png"),
    "prefix of the node": (image("a.png", ' fileprefix="own/"'), ' fileprefix="tex/"', "own/a.png"),
    "empty prefix of the node": (image("a.png", ' fileprefix=""'), ' fileprefix="tex/"', "a.png"),
    "absolute under a prefix": (image("/a.png"), ' fileprefix="tex/"', "/a.png"),
    "a drive under a prefix": (image("C:\\a.png"), ' fileprefix="tex/"', "C:\\a.png"),
    "no file under a prefix": (image(""), ' fileprefix="tex/"', ""),
    "token": (image("a_[Set].png", inside=TOKEN), "", "a_body.png"),
    "tiles": (image("a.&lt;UDIM&gt;.png"), ' fileprefix="tex/"', "tex/a.<UDIM>.png"),
    "default of a definition": (f'{DEFINED}<mine name="i" type="color3" />', "", "of_definition/default.png"),
    "given to a definition's node": (
        f'{DEFINED}<mine name="i" type="color3" fileprefix="of_node/">'
        '<input name="file" type="filename" value="a.png" /></mine>',
        "",
        "of_node/a.png",
    ),
    "through a graph's interface": (GRAPH, "", "of_graph/a.png"),
}


@pytest.mark.parametrize("kind", DOCUMENTS)
def test_a_shader_s_name_is_the_one_that_the_document_s_input_gives(kind: str):
    """The check of a document and its drawing must mean one file."""
    body, attributes, expected = DOCUMENTS[kind]
    doc = document(body, attributes)
    shader = generate_shader(doc, element="out")
    drawn = [each.value for each in uniforms_of(shader).values() if each.type == "filename" and each.path]
    assert drawn == [expected]
    ports = [
        each
        for each in doc.traverseTree()
        if isinstance(each, mx.ValueElement) and each.getType() == "filename"
    ]
    assert expected in {filenames.resolved(port) for port in ports}


def test_a_value_that_is_set_takes_the_document_s_prefix(tmp_path: Path):
    shader = generate_shader(document(image("a.png"), ' fileprefix="tex/"'))
    for value, expected in (("b.png", "tex/b.png"), ("/b.png", "/b.png"), ("", "")):
        named = uniforms_of(shader, {"i/file": value})
        assert [each.value for each in named.values() if each.path == "i/file"] == [expected]


TILED = {
    "a.<UDIM>.png": {(0, 0): "a.1001.png", (1, 0): "a.1002.png", (0, 1): "a.1011.png", (9, 0): "a.1010.png"},
    "tex\\<UDIM>/a.<UDIM>.png": {(0, 0): "tex/1001/a.1001.png"},
    "b_<UVTILE>.png": {(0, 0): "b_u1_v1.png", (11, 2): "b_u12_v3.png"},
    "c[1].<UDIM>.png": {(0, 0): "c[1].1001.png"},
    "d.<UDIM>.<UVTILE>.png": {(1, 0): "d.1002.u2_v1.png"},
    "e.<UDIM>.png": {},
    "f.<UDIM>.png": {(0, 0): "f.1001.png", (1, 0): "f.1002.png"},
    "g.<udim>.png": {},
}
OTHERS = (
    "a.1000.png",
    "a.0999.png",
    "a.10011.png",
    "a.1001.PNG",
    "a.1003.png.bak",
    "a.new.png",
    "tex/1001/a.1002.png",
    "b_u0_v1.png",
    "b_u1_v01.png",
    "d.1001.u2_v1.png",
    "e.<UDIM>.png",
    "g.1001.png",
)


@pytest.mark.parametrize("name", TILED)
def test_a_name_with_a_token_stands_for_a_file_for_each_tile(name: str, tmp_path: Path):
    first, second = tmp_path / "first", tmp_path / "second"
    files = {file for each in TILED.values() for file in each.values()}
    for file in {*files, *OTHERS} - {"f.1002.png"}:
        (first / file).parent.mkdir(parents=True, exist_ok=True)
        (first / file).write_bytes(b"")
    second.mkdir()
    for file in ("f.1001.png", "f.1002.png"):
        (second / file).write_bytes(b"")
    found = find(name, [first, second])
    assert found.file is None
    expected = {tile: first / file for tile, file in TILED[name].items()}
    if name.startswith("f"):
        expected[(1, 0)] = second / "f.1002.png"
    assert found.tiles == expected
    assert set(found.all()) == set(expected.values())
    for tile, file in found.tiles.items():
        # MaterialX puts the same numbers in.
        resolver = mx.createDocument().createStringResolver()
        resolver.setUdimString(str(filenames.udim(tile)))
        resolver.setUvTileString(f"u{tile[0] + 1}_v{tile[1] + 1}")
        theirs = resolver.resolve(name, "filename")
        assert mx.FileSearchPath(f"{first}:{second}").find(mx.FilePath(theirs)).asString() == str(file)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("tex/A.png", "there is tex/a.png"),
        ("TEX\\A.png", "there is tex/a.png"),
        ("tex/%61.png", "there is tex/a.png"),
        ("tex/a.png ", "there is tex/a.png"),
        ("e\u0301te\u0301.png", "there is été.png"),
        ("C:\\tex\\a.png", "Windows path"),
        ("C:\\tex\\unlike.png", "unlike.png lies beside the document"),
        ("\\\\server\\tex\\b.png", "Windows path"),
        ("/elsewhere/unlike.png", "unlike.png lies beside the document"),
        ("/elsewhere/b.png", "name it relative to the document"),
        ("~/b.png", "plain text"),
        ("$TEX/b.png", "plain text"),
        ("${TEX}/b.png", "plain text"),
        ("%TEX%/b.png", "plain text"),
        ("tex", "is a folder"),
        ("tex/", "is a folder"),
        ("a\0.png", "NUL"),
        ("http://example.org/a.png", "is no file"),
        ("b.<UDIM>.png", "no file of any tile"),
        ("tex/a.<udim>.png", "<UDIM> or <UVTILE>"),
        ("tex/a.%04d.png", "<UDIM> or <UVTILE>"),
        ("tex/a.$F4.png", "<UDIM> or <UVTILE>"),
        ("tex/aa.png", "did you mean tex/a.png"),
        ("unlikely.png", "did you mean unlike.png"),
        ("none/b.png", "looked from"),
        ("../b.png", "outside of"),
        ("..\\b.png", "--allow-external"),
        ("tex/../../b.png", "outside of"),
    ],
)
def test_a_name_that_means_nothing_is_told_why(name: str, told: str, tmp_path: Path):
    for file in ("tex/a.png", "unlike.png", "été.png"):
        (tmp_path / file).parent.mkdir(exist_ok=True)
        (tmp_path / file).write_bytes(b"")
    assert find(name, [tmp_path]).all() == []
    why = filenames.absence(name, [tmp_path])
    assert told in why
    assert "\n" not in why


def test_a_set_of_no_tile_is_not_called_a_foreign_one(tmp_path: Path):
    assert "does not know" not in filenames.absence("a.<UDIM>.png", [tmp_path])
    assert "does not know <udim>" in filenames.absence("a.<udim>.png", [tmp_path])
