"""What a material may read: its own folder and the search path, and nothing else unless it is asked for."""

from __future__ import annotations

from pathlib import Path

import MaterialX as mx
import pytest

from mrm_nodes import cli, documents, external
from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.shadergen import generate_shader

GRAPH = '<constant name="c" type="color3" /><output name="out" type="color3" nodename="c" />'

SHOWN = '<output name="shown" type="color3" nodename="c" />'


def write(path: Path, body: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<?xml version="1.0"?>\n<materialx version="1.39">{body}</materialx>\n')
    return path


def include(name: str) -> str:
    return f'<xi:include href="{name}" />'


def image(name: str, attributes: str = "") -> str:
    return (
        f'<image name="i" type="color3"{attributes}><input name="file" type="filename" value="{name}" /></image>'
        '<output name="out" type="color3" nodename="i" />'
    )


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file beside the material's folder."""
    write(tmp_path / "secret.mtlx", GRAPH)
    for name in ("secret.png", "secret.1001.png"):
        (tmp_path / name).write_bytes(b"not for materials")
    (tmp_path / "material").mkdir()
    return tmp_path


def materials_that_look_out(folder: Path) -> dict[str, Path]:
    """Every way in which a material of `folder`/material can name the secret beside it."""
    inside = folder / "material"
    (inside / "link.mtlx").symlink_to(folder / "secret.mtlx")
    (inside / "link.png").symlink_to(folder / "secret.png")
    (inside / "tile.u1_v1.png").symlink_to(folder / "secret.1001.png")
    (inside / "door").symlink_to(folder)
    write(inside / "inner.mtlx", include("../secret.mtlx"))
    ways = {
        "include above": include("../secret.mtlx"),
        "include absolute": include(f"{folder}/secret.mtlx"),
        "include a link": include("link.mtlx"),
        "include through a linked folder": include("door/secret.mtlx"),
        "include what includes it": include("inner.mtlx"),
        "image above": image("../secret.png"),
        "image absolute": image(f"{folder}/secret.png"),
        "image through a link": image("link.png"),
        "image above, with a backslash": image("..\\secret.png"),
        "image above, from a folder below": image("door/material/..\\secret.png"),
        "tiles above": image("../secret.&lt;UDIM&gt;.png"),
        "tiles through a link": image("tile.&lt;UVTILE&gt;.png"),
        "image by a prefix with a backslash": image("secret.png", ' fileprefix="..\\"'),
        "image by a token": image("[up]/secret.png").replace(
            "<input", '<token name="up" type="string" value=".." /><input'
        ),
        "image by a prefix": image("secret.png", ' fileprefix="../"'),
        "image by the document's prefix": image("secret.png"),
    }
    files = {way: write(inside / f"{way.replace(' ', '_')}.mtlx", body) for way, body in ways.items()}
    prefixed = files["image by the document's prefix"]
    prefixed.write_text(prefixed.read_text().replace('version="1.39">', 'version="1.39" fileprefix="../">'))
    return files


def test_every_way_out_is_closed_and_the_error_names_the_file_and_the_flag(secret: Path):
    for way, file in materials_that_look_out(secret).items():
        with pytest.raises(MrmError) as fault:
            read_document(file)
        assert f"{secret / 'secret'}" in str(fault.value), way
        assert "--allow-external" in str(fault.value), way


def test_with_the_flag_the_same_materials_are_read(secret: Path):
    for file in materials_that_look_out(secret).values():
        read_document(file, allow_external=True)


def test_what_lies_in_the_folder_or_below_is_read_without_a_flag(tmp_path: Path):
    write(tmp_path / "parts" / "graph.mtlx", GRAPH)
    (tmp_path / "wood.png").write_bytes(b"")
    (tmp_path / "again.png").symlink_to(tmp_path / "wood.png")
    body = include("parts/graph.mtlx") + image("again.png").replace('"out"', '"seen"')
    document = read_document(write(tmp_path / "wood.mtlx", body))
    assert document.getNode("c") is not None
    assert {path.name for path in documents.files_of(tmp_path / "wood.mtlx", document)} == {
        "wood.mtlx",
        "graph.mtlx",
        "again.png",
    }


def test_of_a_checkout_only_the_node_libraries_are_read_and_nothing_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """There the folder that our GLSL is found from is the whole repository."""
    repository = tmp_path / "repository"
    for name in (
        "mtlx/graph.mtlx",
        "libraries/graph.mtlx",
        "glsl/graph.mtlx",
        "tests/graph.mtlx",
        "graph.mtlx",
    ):
        write(repository / name, GRAPH)
    monkeypatch.setattr(external.library, "search_path", lambda: mx.FileSearchPath(str(repository)))
    for name in ("mtlx/graph.mtlx", "libraries/graph.mtlx", "glsl/graph.mtlx"):
        read_document(write(tmp_path / "material" / "a.mtlx", include(name)))
    for name in ("tests/graph.mtlx", "graph.mtlx"):
        with pytest.raises(MrmError, match="--allow-external"):
            read_document(write(tmp_path / "material" / "a.mtlx", include(name)))


def test_materialx_s_search_path_is_no_way_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    shared = write(tmp_path / "shared" / "graph.mtlx", GRAPH)
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(shared.parent))
    read_document(write(tmp_path / "material" / "a.mtlx", include("graph.mtlx")))


@pytest.mark.parametrize(
    "address", ["http://example.org/wood.png", "file:///etc/hostname", "data:image/png;,"]
)
@pytest.mark.parametrize("allowed", [False, True])
def test_no_address_is_looked_up(tmp_path: Path, address: str, allowed: bool):
    with pytest.raises(MrmError, match="is no file"):
        read_document(write(tmp_path / "a.mtlx", image(address)), allow_external=allowed)


def test_a_document_type_is_refused_because_its_entities_name_files(tmp_path: Path):
    file = tmp_path / "a.mtlx"
    file.write_text(
        '<!DOCTYPE materialx [<!ENTITY x SYSTEM "/etc/hostname">]><materialx version="1.39">&x;</materialx>'
    )
    with pytest.raises(MrmError, match="document type"):
        read_document(file)


@pytest.mark.parametrize("name", ["itself.mtlx", "other.mtlx"])
def test_documents_that_include_each_other_are_an_error(tmp_path: Path, name: str):
    write(tmp_path / "other.mtlx", include("itself.mtlx"))
    with pytest.raises(MrmError, match="includes itself"):
        read_document(write(tmp_path / "itself.mtlx", include(name)))


def test_a_document_nested_without_end_is_an_error_before_materialx_reads_it(tmp_path: Path):
    deep = '<nodegraph name="g">' * 100_000 + "</nodegraph>" * 100_000
    with pytest.raises(MrmError, match="within each other"):
        read_document(write(tmp_path / "deep.mtlx", deep))


@pytest.mark.parametrize("command", ["generate", "render", "suite"])
def test_each_command_asks_for_the_flag(command: str, secret: Path, capsys: pytest.CaptureFixture[str]):
    file = write(secret / "material" / "a.mtlx", include("../secret.mtlx"))
    arguments = {
        "generate": ["generate", str(file), "--target", "glsl", "-o", str(secret / "out")],
        "render": ["render", str(file), "-o", str(secret / "out.png")],
        "suite": ["suite", "check", str(file.parent)],
    }[command]
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert "--allow-external" in error
    assert error.count("\n") == 1


def test_generate_with_the_flag_goes_on(secret: Path, capsys: pytest.CaptureFixture[str]):
    file = write(secret / "material" / "a.mtlx", include("../secret.mtlx") + SHOWN)
    with pytest.raises(SystemExit) as ended:
        cli.main(["generate", str(file), "--target", "glsl", "-o", str(secret / "out"), "--allow-external"])
    assert ended.value.code == 0


def test_a_document_s_images_are_found_from_its_own_folder(tmp_path: Path):
    """A document that was read from a file knows its folder, whoever generates it."""
    file = write(tmp_path / "a.mtlx", image("wood.png"))
    shader = generate_shader(read_document(file))
    assert shader.search_path[0] == tmp_path
