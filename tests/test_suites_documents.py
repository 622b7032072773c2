"""One document costs its own cases: what it calls its materials, what it leaves unknown, and where it lies."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from mrm_nodes import documents, elements, external
from mrm_nodes.errors import MrmError
from mrm_nodes.library import materials_path
from mrm_nodes.regression.cases import digests as inputs
from mrm_nodes.regression.cases.material_case import MaterialCase
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.regression.suites.patterns import files_matching
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SuiteError, read_table

LIT = """
<mrm_conductor_bsdf name="foil" type="BSDF" />
<surface name="lit" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="foil" /></surface>"""


def material(name: str, shader: str = "lit") -> str:
    connected = f'<input name="surfaceshader" type="surfaceshader" nodename="{shader}" />'
    return f'<surfacematerial name="{name}" type="material">{connected}</surfacematerial>'


def written(folder: Path, file: str, *body: str) -> None:
    path = folder / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f'<materialx version="1.39">{LIT}{"".join(body)}</materialx>')


def cases_of(folder: Path) -> dict[str, MaterialCase]:
    written(folder, "ok.mtlx", material("tape"))
    cases = {case.name: case for case in load(folder).cases}
    assert not cases["ok"].broken
    return cases


NASTY = {
    "a slash": "a/b",
    "as it would be a path out": "../../etc/passwd",
    "a line": "a&#10;b",
    "400 letters": "n" * 400,
    "a device": "con",
    "nothing that a file can be called": "磁石",
    "dots": "...",
    "a leading dash": "--help",
}


@pytest.mark.parametrize("name", NASTY.values(), ids=NASTY)
def test_a_material_may_be_called_what_it_likes(tmp_path: Path, name: str):
    written(tmp_path, "a.mtlx", material(name), material(name.swapcase() + "2"))
    cases = cases_of(tmp_path)
    assert len(cases) == 3
    for case in cases:
        file = tmp_path / "out" / case / f"{case}.exr"
        assert file.resolve() == file and len(case) <= suitefile.LONGEST_NAME
        file.parent.mkdir(parents=True)
        file.touch()
    assert not any(case.broken for case in cases.values())


def test_the_case_of_a_material_with_a_slash_is_drawn_and_judged(tmp_path: Path):
    from mrm_nodes.shadergen import generate_shader

    written(tmp_path, "a.mtlx", material("a/b"))
    case = cases_of(tmp_path)["a"]
    assert (case.element, case.truth) == ("a/b", "physics")
    shader = generate_shader(tmp_path / "a.mtlx", element="a/b")
    assert "mrm_conductor_bsdf" in shader.pixel


def test_names_that_would_be_one_file_are_told_apart_wherever_files_are_kept(tmp_path: Path):
    written(tmp_path, "a.mtlx", *map(material, ["a/b", "a b", "a_b", "A_B", "ä", "ö"]))
    written(tmp_path, "x/y.mtlx", material("tape"))
    written(tmp_path, "x.y.mtlx", material("tape"))
    cases = cases_of(tmp_path)
    assert len(cases) == 9
    assert len({name.casefold() for name in cases}) == 9
    assert len({(case.material, case.element) for case in cases.values()}) == 9
    assert {name: case.element for name, case in cases.items()} == {
        name: case.element for name, case in cases_of(tmp_path).items()
    }


def test_two_cases_that_the_author_called_by_one_name_are_an_error(tmp_path: Path):
    written(tmp_path, "a.mtlx", material("one"), material("two"))
    suite = tmp_path / "suite.toml"
    for text in (
        '[[case]]\nmaterial = "a.mtlx"\nname = "same"',
        '[[case]]\nmaterial = "a.mtlx"\n[[case]]\nmaterial = "a.mtlx"',
        '[[case]]\nmaterial = ["a.mtlx", "a.mtlx"]',
    ):
        suite.write_text(text)
        with pytest.raises(SuiteError, match="is taken by case 1"):
            load(suite)


def test_of_a_document_the_sound_materials_are_cases_beside_the_broken_ones(tmp_path: Path):
    bad = (
        '<houdini_private name="p" type="BSDF" />'
        '<surface name="dark" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="p" /></surface>'
    )
    written(tmp_path, "a.mtlx", bad, material("good"), material("bad", "dark"))
    cases = cases_of(tmp_path)
    assert (cases["a-good"].broken, cases["a-good"].truth) == (False, "physics")
    assert cases["a-bad"].broken
    assert "node p: unknown node houdini_private; did you mean" in cases["a-bad"].reason


def test_a_value_for_a_node_that_is_unknown_costs_its_own_case(tmp_path: Path):
    written(tmp_path, "a.mtlx", '<houdini_private name="p" type="float" />', material("m"))
    suite = tmp_path / "suite.toml"
    suite.write_text('[[case]]\nmaterial = "a.mtlx"\n[case.input]\n"p/x" = 1')
    with pytest.raises(SuiteError, match="no input p/x"):
        load(suite)


def test_a_folder_that_is_a_link_is_looked_into_once(tmp_path: Path):
    """With two circles every further level doubles the ways."""
    written(tmp_path, "set/deep/a.mtlx", material("m"))
    (tmp_path / "set" / "one").symlink_to(tmp_path)
    (tmp_path / "set" / "two").symlink_to(tmp_path / "set", target_is_directory=True)
    (tmp_path / "again").symlink_to(tmp_path / "set" / "deep")
    elsewhere = tmp_path.parent / f"{tmp_path.name}-elsewhere"
    written(elsewhere, "b.mtlx", material("m"))
    (tmp_path / "linked").symlink_to(elsewhere)
    assert set(cases_of(tmp_path)) == {"ok", "set.deep.a", "linked.b"}
    assert files_matching("**/*.mtlx", tmp_path) == ["linked/b.mtlx", "ok.mtlx", "set/deep/a.mtlx"]
    assert files_matching("s*/**/a.mtlx", tmp_path) == ["set/deep/a.mtlx"]
    assert files_matching("again/*.mtlx", tmp_path) == ["again/a.mtlx"]
    assert files_matching("**/deep/**/*.mtlx", tmp_path) == ["set/deep/a.mtlx"]
    assert files_matching(f"{tmp_path}/**/ok.mtlx", Path(os.sep)) == [f"{tmp_path}/ok.mtlx"]


HEADERS = {
    "spaces": "[" + " " * 200_000 + "x" + " " * 200_000,
    "words": "[[" + " a" * 200_000,
    "names": "a . " * 90 + " " * 200_000,
    "quotes": "[" + "'\" " * 100_000,
    "dashes": "a-" * 200_000,
}


@pytest.mark.parametrize("line", HEADERS.values(), ids=HEADERS)
def test_a_line_that_looks_like_a_header_is_read_once(tmp_path: Path, line: str):
    """Read as often as it has letters, each of these would take hours."""
    suite = tmp_path / "suite.toml"
    suite.write_text(
        f"title = '''\n{line}\n'''\n[[case]]\nmaterial = 'a.mtlx'\nsize = 0\n".replace("'\"", '"')
    )
    with pytest.raises(SuiteError, match=r"suite\.toml:6: case 1\.size"):
        read_table(suite)


@pytest.mark.parametrize("text", ["{} = 1", "[{}]", "x = {{ {} = 1 }}", "[[{}]]"])
@pytest.mark.parametrize("name", ["a", '"a"'])
def test_a_key_of_a_great_many_names_is_refused(tmp_path: Path, text: str, name: str):
    suite = tmp_path / "suite.toml"
    suite.write_text(text.format(" . ".join([name] * 100_000)))
    with pytest.raises(SuiteError, match="a key of more than 100 names"):
        read_table(suite)


def test_each_document_of_a_suite_is_read_and_looked_through_once_for_all_of_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """What a suite of thousands takes hangs on it: counted, since no clock is to be trusted."""
    counts: Counter[str] = Counter()

    def counted(owner: object, name: str, what: Callable[..., object]) -> None:
        function = getattr(owner, name)

        def call(*arguments: Any, **options: Any) -> Any:
            counts[f"{name} {what(*arguments)}"] += 1
            return function(*arguments, **options)

        monkeypatch.setattr(owner, name, call)

    for name in ("a", "b"):
        (tmp_path / f"{name}.mtlx").write_text(INCLUDING, "utf-8")
    (tmp_path / "part.inc").write_text(INCLUDED, "utf-8")
    (tmp_path / "map.png").write_bytes(b"")
    (tmp_path / "suite.toml").write_text(MANY_CASES, "utf-8")
    counted(documents._Reading, "_parse", lambda reading, document, file, content: Path(file).name)
    counted(external, "check_files", lambda document, path, *others: path.name)
    counted(external._Check, "source", lambda check, name, implementation: implementation.getName())
    counted(elements, "check_document", lambda document, where, *others: where)
    counted(suitefile, "closure_of", lambda document, element: element)
    counted(inputs, "_file_digest", lambda path: path.name)
    cases = load(tmp_path / "suite.toml").cases
    assert len(cases) == 2 * 6
    assert {path.name for path in cases[0].files()} == {"a.mtlx", "part.inc", "map.png"}
    contents = inputs.Inputs()
    assert len({inputs.key(case, "egl", contents, "") for case in cases}) == len(cases)
    assert counts == {
        # Once for each document that includes it.
        "_parse part.inc": 2,
        **{f"{what} {name}.mtlx": 1 for what in ("_parse", "check_files", "check_document") for name in "ab"},
        "closure_of m": 2,
        **{f"_file_digest {name}": 1 for name in ("a.mtlx", "b.mtlx", "part.inc", "map.png")},
    }


INCLUDING = """<materialx version="1.39" xmlns:xi="http://www.w3.org/2001/XInclude">
<xi:include href="part.inc" />
<mrm_standard_surface name="s" type="surfaceshader"><input name="base_color" type="color3" nodename="i" />
</mrm_standard_surface>
<surfacematerial name="m" type="material"><input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial></materialx>"""

INCLUDED = """<materialx version="1.39"><image name="i" type="color3">
<input name="file" type="filename" value="map.png" /></image></materialx>"""

MANY_CASES = """
[[case]]
material = "*.mtlx"
[case.matrix]
mesh = ["sphere", "plane"]
size = [8, 16, 32]
"""


def test_a_material_whose_name_is_no_text_costs_its_own_case(tmp_path: Path):
    """Names of files are bytes, and MaterialX's are UTF-8."""
    for name in (b"sound.mtlx", b"caf\xe9.mtlx"):
        shutil.copyfile(materials_path() / "hi_vis_tape.mtlx", os.fsencode(tmp_path) + b"/" + name)
    cases = {case.name: case for case in load(tmp_path).cases}
    assert sorted(cases) == ["caf", "sound"]
    assert not cases["sound"].broken and cases["caf"].broken
    assert cases["caf"].reason.endswith(
        r"caf\xe9.mtlx: the name of a file or folder on the way is not UTF-8: rename it"
    )
    with pytest.raises(MrmError, match="is not UTF-8: rename it"):
        documents.read_document(tmp_path / os.fsdecode(b"caf\xe9.mtlx"))
