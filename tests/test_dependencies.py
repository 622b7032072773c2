"""All that a case depends on is known: its key and its fingerprint change with every file of it, and with no other."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from mrm_nodes import cli, documents
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.baseline import fingerprint
from mrm_nodes.regression.cases.digests import Inputs, key
from mrm_nodes.regression.cases.material_case import MaterialCase
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.testing import picture
from mrm_nodes.shadergen import generate_shader

MATERIAL = """<materialx version="1.39">
<xi:include href="parts\\graph.mtlx" />
<image name="worn" type="float"><input name="file" type="filename" value="tex\\worn.png" /></image>
<image name="tiled" type="float"><input name="file" type="filename" value="t.<UDIM>.png" /></image>
<image name="old" type="float" fileprefix="tex/"><input name="file" type="filename" value="old_<UVTILE>.png" /></image>
<noise_of_ours name="noise" type="float" />
<add name="sum" type="float">
  <input name="in1" type="float" nodename="worn" /><input name="in2" type="float" nodename="noise" />
</add>
<mrm_conductor_bsdf name="b" type="BSDF">
  <input name="retroreflectivity" type="float" nodename="sum" />
</mrm_conductor_bsdf>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""
GRAPH = """<materialx version="1.39">
<nodedef name="ND_noise_of_ours" node="noise_of_ours">
  <input name="in" type="float" value="0.5" /><output name="out" type="float" />
</nodedef>
<implementation name="IM_noise" nodedef="ND_noise_of_ours" target="genglsl" file="glsl\\noise.glsl" function="noise" />
<implementation name="IM_osl" nodedef="ND_noise_of_ours" target="genosl" file="noise.osl" function="noise" />
</materialx>"""
NOISE = """// not code to a compiler: #include "in_comment.glsl"
#include "sub\\deep.glsl"
  /* see #include "after.glsl" */
#include <system.glsl>
#  include "spaced.glsl"
#include "libraries/stdlib/genglsl/lib/$fileTransformUv"
void noise(float i, out float o) { o = i; }
"""
FILES = {
    "m.mtlx": MATERIAL,
    "parts/graph.mtlx": GRAPH,
    "parts/glsl/noise.glsl": NOISE,
    "parts/glsl/in_comment.glsl": "// in a comment",
    "parts/glsl/after.glsl": '// after\n#include "noise.glsl"',
    "parts/glsl/sub/deep.glsl": '// deep\n#include "../up.glsl"\n#include "missing.glsl"\n',
    "parts/glsl/up.glsl": "// up",
    "parts/noise.osl": "void noise(float i, output float o) { o = i; }",
    "tex/worn.png": "",
    "t.1001.png": "",
    "t.1012.png": "",
    "tex/old_u1_v1.png": "",
    "tex/old_u12_v1.png": "",
    "ball.obj": "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "sky.hdr": "",
}
"""What the render depends on."""
JUDGING = {"mask.png": "", "baselines/m.json": "{}", "baselines/m.exr": ""}
"""What its verdict depends on besides."""
BESIDE = {
    "parts/tex/worn.png": "",
    "worn.png": "",
    "t.0999.png": "",
    "t.1001.jpg": "",
    "parts/glsl/system.glsl": "",
    "parts/glsl/spaced.glsl": "",
    "parts/sub/deep.glsl": "",
    "glsl/noise.glsl": "void noise(float i, out float o) { o = 2.0 * i; }",
    "other.mtlx": '<materialx version="1.39" />',
}
"""What it does not depend on, whatever it is called."""
SUITE = """
[[case]]
material = "m.mtlx"
mesh = "ball.obj"
environment = "sky.hdr"
mask = "mask.png"
truth = "baseline"
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "studio"
    for name, text in {**FILES, **JUDGING, **BESIDE, "suite.toml": SUITE}.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_text(text)
    # What is missing of the source is an error of its own.
    (place / "parts/glsl/sub/missing.glsl").write_text("// there after all")
    return place


def case_of(folder: Path, **options: bool) -> MaterialCase:
    (case,) = load(folder / "suite.toml", **options).cases
    return case


def state(folder: Path) -> tuple[str, str]:
    """A key, and a fingerprint, as another run would have them."""
    case = case_of(folder)
    return key(case, "egl", Inputs(), "around"), fingerprint(case)


def test_the_files_of_a_case_are_these_and_no_others(folder: Path):
    case = case_of(folder)
    missing = "parts/glsl/sub/missing.glsl"
    names = [path.relative_to(folder).as_posix() for path in case.files()]
    assert sorted(names) == sorted([*FILES, *JUDGING, missing])
    assert sorted(path.relative_to(folder).as_posix() for path in case.sources()) == sorted([*FILES, missing])


@pytest.mark.parametrize("name", [*FILES, *JUDGING, *BESIDE])
def test_the_key_and_the_fingerprint_change_with_each_file_and_with_no_other(name: str, folder: Path):
    before = state(folder)
    file = folder / name
    contents = file.read_bytes()
    ends = {".mtlx": b"\n<!-- later -->", ".json": b" "}.get(file.suffix, b"\n// later\n")
    file.write_bytes(contents + ends)
    changed = tuple(one != other for one, other in zip(before, state(folder), strict=True))
    assert changed == (name not in BESIDE, name in FILES)
    file.write_bytes(contents)
    assert state(folder) == before


def test_a_tile_that_is_added_changes_them(folder: Path):
    before = state(folder)
    (folder / "t.1002.png").write_bytes(b"")
    assert all(one != other for one, other in zip(before, state(folder), strict=True))


def test_a_file_that_comes_before_in_the_order_of_looking_changes_them(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "shared/tex").mkdir(parents=True)
    (folder / "tex/worn.png").rename(tmp_path / "shared/tex/worn.png")
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(tmp_path / "shared"))
    case = case_of(folder)
    assert tmp_path / "shared/tex/worn.png" in case.files()
    before = state(folder)
    (folder / "tex/worn.png").write_bytes(b"")
    assert all(one != other for one, other in zip(before, state(folder), strict=True))


def test_what_is_not_in_the_list_is_not_read_and_what_is_in_it_is(folder: Path, tmp_path: Path):
    """MaterialX itself is the witness: the source that it generates needs each file of the list and no other."""
    listed = documents.files_of(folder / "m.mtlx", documents.read_document(folder / "m.mtlx"))
    alone = tmp_path / "alone"
    for file in listed:
        (alone / file.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(file, alone / file.relative_to(folder))
    whole = generate_shader(folder / "m.mtlx").pixel
    assert generate_shader(alone / "m.mtlx").pixel == whole
    for file in listed:
        if file.suffix == ".glsl":
            there = alone / file.relative_to(folder)
            there.rename(alone / "away")
            with pytest.raises(MrmError, match=rf"{file.name}|{there.name}"):
                generate_shader(alone / "m.mtlx")
            (alone / "away").rename(there)


def test_a_value_that_a_suite_or_a_test_sets_names_files_too(folder: Path):
    (folder / "tex/other.png").write_bytes(b"")
    more = '[[case]]\nmaterial = "m.mtlx"\nname = "set"\ninput = { "old/file" = "other.png" }\ntruth = "baseline"\n'
    (folder / "suite.toml").write_text(SUITE + more)
    case = load(folder / "suite.toml").cases[1]
    assert folder / "tex/other.png" in case.files()
    shown = picture(folder, "m.mtlx", inputs={"worn/file": "tex\\other.png"})
    assert folder / "tex/other.png" in shown.case.files()
    assert folder / "tex/worn.png" not in shown.case.files()


def test_a_suite_s_own_names_may_have_backslashes_and_mean_the_same_files(folder: Path):
    before = state(folder)
    for name in ("m.mtlx", "ball.obj", "sky.hdr", "mask.png"):
        (folder / "set").mkdir(exist_ok=True)
        (folder / "set" / name).write_bytes((folder / name).read_bytes())
    text = SUITE
    for name in ("ball.obj", "sky.hdr", "mask.png"):
        text = text.replace(f'"{name}"', f"'set\\{name}'")
    keys = set()
    for written in (text, text.replace("\\", "/")):
        (folder / "suite.toml").write_text(written)
        files = {path.relative_to(folder).as_posix() for path in case_of(folder).files()}
        assert {"set/ball.obj", "set/sky.hdr", "set/mask.png"} <= files
        keys.add(state(folder))
    assert len(keys) == 1
    assert before not in keys


def test_a_document_that_is_a_link_reads_what_lies_beside_the_link(tmp_path: Path):
    """As MaterialX does, which knows the name only."""
    for place, contents in (("store", "stored"), ("job", "own")):
        (tmp_path / place).mkdir()
        (tmp_path / place / "own.glsl").write_text(
            f"// {contents}\nvoid noise(float i, out float o) {{ o = i; }}\n"
        )
        (tmp_path / place / "part.mtlx").write_text(GRAPH.replace("glsl\\noise.glsl", "own.glsl"))
    top = '<materialx version="1.39"><xi:include href="part.mtlx" />'
    body = '<noise_of_ours name="n" type="float" /><output name="o" type="float" nodename="n" /></materialx>'
    (tmp_path / "store" / "m.mtlx").write_text(top + body)
    (tmp_path / "job" / "m.mtlx").symlink_to(tmp_path / "store" / "m.mtlx")
    document = tmp_path / "job" / "m.mtlx"
    assert "// own" in generate_shader(document).pixel
    files = documents.files_of(document, documents.read_document(document))
    assert files == [tmp_path / "job" / name for name in ("m.mtlx", "part.mtlx", "own.glsl")]


def test_what_lies_above_a_linked_folder_is_the_file_that_is_read(folder: Path):
    """`door/..` is not the folder of the link, to the system as to MaterialX."""
    (folder / "deep/sub").mkdir(parents=True)
    (folder / "door").symlink_to(folder / "deep/sub")
    (folder / "deep/more.mtlx").write_text('<materialx version="1.39" />')
    (folder / "deep/worn.png").write_bytes(b"")
    include = '<xi:include href="door/../more.mtlx" /><image'
    text = MATERIAL.replace("tex\\worn.png", "door\\..\\worn.png").replace("<image", include, 1)
    (folder / "m.mtlx").write_text(text)
    files = {path.relative_to(folder).as_posix() for path in case_of(folder).files()}
    assert {"deep/more.mtlx", "deep/worn.png"} <= files
    assert not {"more.mtlx", "worn.png"} & files
    before = state(folder)
    (folder / "deep/worn.png").write_bytes(b"later")
    assert all(one != other for one, other in zip(before, state(folder), strict=True))


SECRET = "not for a document above this folder"
WAYS = {
    "above": "../secret.txt",
    "above, with a backslash": "..\\secret.txt",
    "by a folder below": "sub/../../secret.txt",
    "absolute": "SECRET",
    "through a link": "link.glsl",
    "through a linked folder": "door/secret.txt",
}


@pytest.fixture
def leaking(tmp_path: Path) -> Path:
    """A folder whose material has a node of its own, and a secret beside the folder."""
    place = tmp_path / "material"
    (place / "sub").mkdir(parents=True)
    (tmp_path / "secret.txt").write_text(SECRET)
    (place / "link.glsl").symlink_to(tmp_path / "secret.txt")
    (place / "door").symlink_to(tmp_path)
    (place / "m.mtlx").write_text(
        GRAPH.replace("</materialx>", "").replace("glsl\\noise.glsl", "FILE")
        + MATERIAL.partition("tex/")[2].partition("</image>")[2].replace('nodename="worn"', 'value="0.1"')
    )
    return place


def write_source(place: Path, name: str, by: str) -> Path:
    """Have the material's node lead to a file: itself, by its source, or by what that includes in a comment."""
    name = name.replace("SECRET", str(place.parent / "secret.txt"))
    document = place / "m.mtlx"
    text = document.read_text()
    if by == "itself":
        document.write_text(text.replace("FILE", name))
    else:
        document.write_text(text.replace("FILE", "own.glsl"))
        own = f'#include "{name}"\n' if by == "its source" else '#include "inner.glsl"\n'
        (place / "own.glsl").write_text(own + "void noise(float i, out float o) { o = i; }\n")
        (place / "inner.glsl").write_text(f'// #include "{name}"\n')
    return document


@pytest.mark.parametrize("by", ["itself", "its source", "what it includes"])
@pytest.mark.parametrize("way", WAYS)
def test_source_outside_of_the_folder_is_refused_before_it_is_read_and_never_quoted(
    way: str, by: str, leaking: Path, capsys: pytest.CaptureFixture[str]
):
    document = write_source(leaking, WAYS[way], by)
    with pytest.raises(MrmError) as fault:
        documents.read_document(document)
    assert "--allow-external" in str(fault.value)
    assert str(leaking.parent / "secret.txt") in str(fault.value)
    assert SECRET not in str(fault.value)
    with pytest.raises(SystemExit) as ended:
        cli.main(["generate", str(document), "--target", "glsl", "-o", str(leaking / "out")])
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert SECRET not in told.out + told.err
    assert told.err.count("\n") == 1
    assert not (leaking / "out").exists()
    allowed = documents.read_document(document, allow_external=True)
    assert leaking.parent / "secret.txt" in [path.resolve() for path in documents.files_of(document, allowed)]


def test_a_case_whose_source_lies_outside_is_an_error_and_its_report_does_not_quote_it(
    leaking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    write_source(leaking, "../secret.txt", "itself")
    (leaking / "door").unlink()
    with pytest.raises(SystemExit):
        cli.main(["regress", "--suite", str(leaking), "-o", str(tmp_path / "report"), "--no-cache"])
    told = capsys.readouterr()
    assert SECRET not in told.out + told.err
    for file in (tmp_path / "report").rglob("*"):
        assert not file.is_file() or SECRET.encode() not in file.read_bytes(), file
    (case,) = json.loads((tmp_path / "report" / "report.json").read_text())["cases"]
    assert case["verdict"] == "error"
    assert "--allow-external" in case["message"]


@pytest.mark.parametrize(
    ("source", "told"),
    [
        (b'#include "../$envRadiance"', "`$`"),
        (b'#include "\xe9.glsl"', "not UTF-8"),
        (b'#include "missing.glsl"', "missing.glsl"),
        (b"//" + b" " * (9 << 20), "MiB"),
        (b'#include "/dev/zero"', "/dev/zero is a device"),
        (b'#include "sub"', "is a folder"),
        (b'#include "low/../x.glsl"', "MaterialX reads"),
    ],
)
def test_source_that_cannot_be_looked_through_is_one_line(source: bytes, told: str, leaking: Path):
    document = write_source(leaking, "own.glsl", "itself")
    (leaking / "sub/deep").mkdir()
    (leaking / "low").symlink_to(leaking / "sub/deep")
    (leaking / "sub/x.glsl").write_text("// above the folder that the link leads to")
    (leaking / "own.glsl").write_bytes(source + b"\nvoid noise(float i, out float o) { o = i; }\n")
    with pytest.raises(MrmError) as fault:
        generate_shader(document)
    assert told in str(fault.value)
    assert "\n" not in str(fault.value)


def test_source_that_includes_itself_is_read_once(leaking: Path):
    document = write_source(leaking, "own.glsl", "itself")
    (leaking / "own.glsl").write_text('#include "a.glsl"\nvoid noise(float i, out float o) { o = i; }\n')
    (leaking / "a.glsl").write_text('#include "b.glsl"\n#include "own.glsl"\n')
    (leaking / "b.glsl").write_text('#include "a.glsl"\n')
    files = documents.files_of(document, documents.read_document(document))
    assert sorted(file.name for file in files) == ["a.glsl", "b.glsl", "m.mtlx", "own.glsl"]


def test_source_that_is_not_there_is_named_with_what_asks_for_it(leaking: Path):
    document = write_source(leaking, "own.glsl", "itself")
    with pytest.raises(MrmError, match=r"m\.mtlx: \w+ asks for own\.glsl, which is not there"):
        generate_shader(document)
    (leaking / "own.glsl").write_text('#include "a.glsl"\nvoid noise(float i, out float o) { o = i; }\n')
    (leaking / "a.glsl").write_text('#include "gone.glsl"\n')
    with pytest.raises(MrmError, match=r"a\.glsl asks for gone\.glsl, which is not there"):
        generate_shader(document)
