"""Suites as files: what they multiply out to, how their cases are called, and what is said of their faults."""

from __future__ import annotations

import gc
import json
import os
import pickle
import re
import shutil
import weakref
from pathlib import Path

import pytest
from fuzzing import write_seeds

from mrm_nodes import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.library import materials_path
from mrm_nodes.regression.cases.baseline import fingerprint
from mrm_nodes.regression.cases.digests import Inputs, key
from mrm_nodes.regression.suites import selection as suites
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SuiteError
from mrm_nodes.regression.verdict.tolerance import Tolerance
from mrm_nodes.render import Camera, CameraLight, DirectionalLight

METAL = """<materialx version="1.39">
<mrm_conductor_bsdf name="b" type="BSDF" />
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="metal" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>
</materialx>"""
VELVET = METAL.replace("mrm_conductor_bsdf", "sheen_bsdf").replace("metal", "velvet")
TWO = METAL.replace(
    "</materialx>",
    '<surfacematerial name="again" type="material">'
    '<input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial></materialx>',
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of materials, with a mesh and a mask."""
    (tmp_path / "metal.mtlx").write_text(METAL)
    (tmp_path / "velvet.mtlx").write_text(VELVET)
    (tmp_path / "set" / "deep").mkdir(parents=True)
    (tmp_path / "set" / "deep" / "metal.mtlx").write_text(METAL)
    (tmp_path / "box.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "mask.png").write_bytes(b"")
    return tmp_path


def loaded(folder: Path, text: str) -> list[str]:
    return [case.name for case in cases_of(folder, text)]


def cases_of(folder: Path, text: str):
    path = folder / "suite.toml"
    path.write_text(text)
    return load(path).cases


def test_a_matrix_multiplies_out_and_its_values_are_in_the_names(folder: Path):
    text = """
    [lights]
    car = "camera"
    [[case]]
    material = "metal.mtlx"
    [case.matrix]
    mesh = ["sphere", "box.obj"]
    light = ["car", "directional:0,0,-1"]
    "input:b/retroreflectivity" = [0, 0.5]
    """
    cases = {case.name: case for case in cases_of(folder, text)}
    assert len(cases) == 8
    case = cases["metal-box-car-retroreflectivity0.5"]
    assert (case.mesh, case.lights, case.inputs) == (
        "box.obj",
        (CameraLight(),),
        {"b/retroreflectivity": 0.5},
    )
    other = cases["metal-sphere-directional_0_0_-1-retroreflectivity0"]
    assert other.lights == (DirectionalLight((0.0, 0.0, -1.0)),)


def test_what_a_case_says_goes_over_the_defaults_and_what_adjusts_it_over_both(folder: Path):
    text = """
    [defaults]
    size = 64
    camera = "0,0,4"
    time_limit = 30
    [tolerances]
    loose = { max_rel = 0.5, flip = 0.1 }
    [[case]]
    material = "*.mtlx"
    size = "32x16"
    [[adjust]]
    cases = "vel*"
    tolerance = "loose"
    size = [8, 8]
    """
    metal, velvet = cases_of(folder, text)
    assert (metal.size, metal.camera, metal.tolerance) == ((32, 16), Camera((0.0, 0.0, 4.0)), Tolerance())
    assert (velvet.size, velvet.tolerance) == ((8, 8), Tolerance(max_rel=0.5, flip=0.1))
    assert metal.time_limit == velvet.time_limit == 30.0


def test_a_suite_says_for_how_many_lights_its_shaders_have_room(folder: Path):
    text = """
    [defaults]
    max_lights = 5
    [lights]
    six = ["camera", "camera", "camera", "camera", "camera", "camera"]
    [[case]]
    material = "metal.mtlx"
    {more}
    """
    (case,) = cases_of(folder, text.format(more=""))
    assert case.room == case.describe()["max_lights"] == 5
    (case,) = cases_of(folder, text.replace("max_lights = 5", "").format(more='light = "six"'))
    assert case.room == 6 and "max_lights" not in case.describe()
    with pytest.raises(SuiteError, match=r"suite.toml:3: defaults.max_lights: 6 lights, but room for 5"):
        cases_of(folder, text.format(more='light = "six"'))
    with pytest.raises(SuiteError, match=r"max_lights: expected greater than or equal to 1"):
        cases_of(folder, text.replace("= 5", "= 0").format(more=""))


def test_each_case_says_which_truth_it_has_and_why(folder: Path):
    metal, velvet = cases_of(folder, '[[case]]\nmaterial = "*.mtlx"')
    assert (metal.truth, velvet.truth) == ("physics", "baseline")
    assert "sheen_bsdf" in velvet.reason
    (forced,) = cases_of(folder, '[[case]]\nmaterial = "metal.mtlx"\ntruth = "baseline"')
    assert (forced.truth, forced.reason) == ("baseline", "the suite says so")


def test_a_value_that_brings_in_an_unknown_lobe_changes_the_truth(folder: Path):
    mixed = METAL.replace(
        'nodename="b"',
        'nodename="x"',
    ).replace(
        "<surface ",
        '<sheen_bsdf name="v" type="BSDF" /><mix name="x" type="BSDF"><input name="fg" type="BSDF" nodename="v" />'
        '<input name="bg" type="BSDF" nodename="b" /><input name="mix" type="float" value="0" /></mix><surface ',
        1,
    )
    (folder / "mixed.mtlx").write_text(mixed)
    text = '[[case]]\nmaterial = "mixed.mtlx"\n[case.matrix]\n"input:x/mix" = [0, 0.25]'
    assert [case.truth for case in cases_of(folder, text)] == ["physics", "baseline"]


@pytest.mark.parametrize(
    ("node", "truth"),
    [
        ('<mrm_conductor_bsdf name="b" type="BSDF" />', "physics"),
        ('<oren_nayar_diffuse_bsdf name="b" type="BSDF" />', "physics"),
        (
            '<oren_nayar_diffuse_bsdf name="b" type="BSDF"><input name="roughness" type="float" value="0.3" />'
            "</oren_nayar_diffuse_bsdf>",
            "physics",
        ),
        (
            '<dielectric_bsdf name="b" type="BSDF"><input name="scatter_mode" type="string" value="RT" />'
            "</dielectric_bsdf>",
            "physics",
        ),
        ('<sheen_bsdf name="b" type="BSDF" />', "baseline"),
    ],
    ids=["a metal", "Lambert", "rough diffuse", "a transmission", "a sheen"],
)
def test_in_an_environment_the_same_is_known_as_by_lights(folder: Path, node: str, truth: str):
    (folder / "b.mtlx").write_text(METAL.replace('<mrm_conductor_bsdf name="b" type="BSDF" />', node))
    (around,) = cases_of(folder, '[[case]]\nmaterial = "b.mtlx"\nenvironment = "studio"')
    (lit,) = cases_of(folder, '[[case]]\nmaterial = "b.mtlx"')
    assert (around.truth, lit.truth) == (truth, truth)
    assert (around.lights, len(lit.lights)) == ((), 2)


def test_names_below_a_pattern_hold_the_folders_and_no_other_file_changes_them(folder: Path):
    text = '[[case]]\nmaterial = "set/**/*.mtlx"'
    assert loaded(folder, text) == ["deep.metal"]
    (folder / "set" / "metal.mtlx").write_text(METAL)
    assert loaded(folder, text) == ["deep.metal", "metal"]


def test_each_material_of_a_document_is_a_case(folder: Path):
    (folder / "two.mtlx").write_text(TWO)
    assert loaded(folder, '[[case]]\nmaterial = "two.mtlx"') == ["two-metal", "two-again"]
    assert loaded(folder, '[[case]]\nmaterial = "two.mtlx"\nelement = "again"') == ["two-again"]


def test_a_template_names_cases(folder: Path):
    text = """
    [[case]]
    material = "metal.mtlx"
    name = "the {material} {element} at {b/retroreflectivity}/{size}"
    [case.matrix]
    size = ["8x8"]
    "input:b/retroreflectivity" = [0.25]
    """
    assert loaded(folder, text) == ["the_metal_metal_at_0.25_8x8"]


def test_every_name_is_fit_for_a_folder(folder: Path):
    text = '[[case]]\nmaterial = "metal.mtlx"\nname = "../../{material}:<é>|*"'
    (name,) = loaded(folder, text)
    assert re.fullmatch(r"[A-Za-z0-9_.+-]+", name) and not name.startswith(".")


def test_a_folder_without_a_suite_is_one(folder: Path):
    assert [case.name for case in load(folder).cases] == ["metal", "set.deep.metal", "velvet"]
    (folder / "report" / "cases" / "metal").mkdir(parents=True)
    (folder / "report" / "report.json").write_text("{}")
    (folder / "report" / "cases" / "metal" / "material.mtlx").write_text(METAL)
    assert [task.name for task in suites.suite(str(folder))] == ["metal", "set.deep.metal", "velvet"]


def test_files_beside_the_suite_s_folder_move_with_it(folder: Path):
    text = '[[case]]\nmaterial = "../../metal.mtlx"\nmesh = "../../box.obj"\nmask = "../../mask.png"'
    (case,) = cases_of(folder / "set" / "deep", text)
    assert case.root == folder
    assert {path.relative_to(folder).as_posix() for path in case.files()} == {
        "metal.mtlx",
        "box.obj",
        "mask.png",
    }
    assert case.moved(Path("/elsewhere")).files()[0] == Path("/elsewhere/metal.mtlx")
    assert case.store.folder == folder / "set" / "deep" / "baselines"


ABSOLUTE = """
[meshes]
post = "{here}/box.obj"
[environments]
dusk = {{ map = "{here}/dusk.exr" }}
[[case]]
material = ["{here}/set/**/*.mtlx", "{here}/velvet.mtlx", "metal.mtlx"]
name = "{{material}}-{{mesh}}"
mask = "{here}/mask.png"
[case.matrix]
mesh = ["post", "{here}/box.obj", "{studio}/pole.obj"]
[[case]]
material = "{studio}/steel.mtlx"
environment = "dusk"
[[case]]
material = "textured.mtlx"
[case.input]
"i/file" = "{here}/mask.png"
"""
TEXTURED = METAL.replace(
    "<mrm_conductor_bsdf",
    '<image name="i" type="color3"><input name="file" type="filename" value="STUDIO/a.exr" /></image>'
    '<oren_nayar_diffuse_bsdf name="d" type="BSDF"><input name="color" type="color3" nodename="i" />'
    "</oren_nayar_diffuse_bsdf><mrm_conductor_bsdf",
)


@pytest.mark.parametrize("through_a_link", [False, True])
def test_a_suite_that_names_files_absolutely_is_the_same_wherever_its_checkout_lies(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, through_a_link: bool
):
    """Names, baselines and what the cache knows of its cases: scripts write such suites, anew in each checkout."""
    studio = tmp_path_factory.mktemp("studio")
    (studio / "steel.mtlx").write_text(METAL)
    (studio / "pole.obj").write_text((folder / "box.obj").read_text())
    (folder / "textured.mtlx").write_text(TEXTURED.replace("STUDIO", str(studio)))
    for image in (folder / "dusk.exr", studio / "a.exr", folder / "mask.png"):
        image.write_bytes(b"")
    other = tmp_path_factory.mktemp("elsewhere") / "deeper" / "checkout"
    shutil.copytree(folder, other)
    link = tmp_path_factory.mktemp("links") / "checkout"
    link.symlink_to(other, target_is_directory=True)
    told = []
    for here in (folder, other):
        read = link if through_a_link and here == other else here
        (here / "suite.toml").write_text(ABSOLUTE.format(here=here, studio=studio))
        told.append(
            [
                (case.name, case.describe(), fingerprint(case), key(case, "egl", Inputs(), ""))
                for case in load(read / "suite.toml", allow_external=True).cases
            ]
        )
    assert told[0] == told[1]
    names = [name for name, *_ in told[0]]
    assert names[:3] == ["deep.metal-post", "deep.metal-box", "deep.metal-pole"]
    described = {name: setup for name, setup, *_ in told[0]}
    assert described["deep.metal-box"]["material"] == "set/deep/metal.mtlx"
    assert described["deep.metal-box"]["mesh"] == "box.obj"
    assert described["deep.metal-pole"]["mesh"] == f"{studio}/pole.obj"
    assert described["steel"]["material"] == f"{studio}/steel.mtlx"
    assert described["textured"]["inputs"] == {"i/file": "mask.png"}
    # What is outside counts by its contents.
    (studio / "a.exr").write_bytes(b"another")
    (case,) = (case for case in load(folder / "suite.toml", True).cases if case.name == "textured")
    assert fingerprint(case) != told[0][-1][2]


def test_a_case_is_data(folder: Path):
    (case,) = cases_of(folder, '[[case]]\nmaterial = "metal.mtlx"\nenvironment = "studio"')
    assert pickle.loads(pickle.dumps(case)) == case
    assert json.loads(json.dumps(case.describe()))["environment"] is not None


FAULTS = {
    "no TOML": ("a = \n", ":1:", "not TOML"),
    "no case": ('title = "x"', ":1:", "case: is missing"),
    "unknown table": (
        '[camera]\nfront = "0,0,1"\n[[case]]\nmaterial = "metal.mtlx"',
        ":1: camera",
        "cameras",
    ),
    "unknown key": (
        '[[case]]\nmaterial = "metal.mtlx"\nmehs = "sphere"',
        ":3: case 1.mehs",
        "did you mean mesh?",
    ),
    "second case": (
        '[[case]]\nmaterial = "metal.mtlx"\n\n[[case]]\nname = "b"\nmaterial = "metal.mtlx"\nsizes = 3',
        ":7: case 2.sizes",
        "did you mean size?",
    ),
    "no material": ('[[case]]\nmesh = "sphere"', ":1: case 1.material", "is missing"),
    "no such material": (
        '[[case]]\nmaterial = "metall.mtlx"',
        ":2: case 1.material",
        "did you mean metal.mtlx",
    ),
    "a size": ('[[case]]\nmaterial = "metal.mtlx"\nsize = "big"', ":3: case 1.size", '"640x480"'),
    "a huge size": ('[[case]]\nmaterial = "metal.mtlx"\nsize = 1000000', ":3: case 1.size", "16384"),
    "a truth": ('[[case]]\nmaterial = "metal.mtlx"\ntruth = "yes"', ":3: case 1.truth", "'physics'"),
    "no physics": ('[[case]]\nmaterial = "velvet.mtlx"\ntruth = "physics"', ":3: case 1.truth", "sheen_bsdf"),
    "a mesh": (
        '[[case]]\nmaterial = "metal.mtlx"\nmesh = "spheer"',
        ":3: case 1.mesh",
        "did you mean sphere?",
    ),
    "a mesh file": ('[[case]]\nmaterial = "metal.mtlx"\nmesh = "a.obj"', ":3: case 1.mesh", "no mesh file"),
    "a mesh in a table": (
        '[meshes]\na = "a.obj"\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: meshes.a",
        "no mesh",
    ),
    "a name that no file can have": (
        f'[[case]]\nmaterial = "metal.mtlx"\nmesh = "{"x" * 500}.obj"',
        ":3: case 1.mesh",
        "no mesh file",
    ),
    "a camera": (
        '[[case]]\nmaterial = "metal.mtlx"\ncamera = "front"',
        ":3: case 1.camera",
        "A camera is X,Y,Z",
    ),
    "a camera in a table": (
        '[cameras]\nfront = "0,0"\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: cameras.front",
        "three finite numbers",
    ),
    "a light": ('[[case]]\nmaterial = "metal.mtlx"\nlight = "sun"', ":3: case 1.light", "A light is camera"),
    "a default": (
        '[defaults]\nlight = "sun"\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: defaults.light",
        "sun",
    ),
    "an environment": (
        '[environments]\na = { map = "x.hdr", turn = 3 }\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: environments.a.turn",
        "known: intensity, map, rotation, samples",
    ),
    "a tolerance": (
        '[[case]]\nmaterial = "metal.mtlx"\ntolerance = "x"',
        ":3: case 1.tolerance",
        "there is none",
    ),
    "a threshold": (
        '[tolerances.close]\nmax_rel = -1\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: tolerances.close.max_rel",
        "greater than or equal to 0",
    ),
    "a threshold that is no number": (
        '[tolerances.close]\nflip = nan\n[[case]]\nmaterial = "metal.mtlx"',
        ":2: tolerances.close.flip",
        "finite number",
    ),
    "an axis": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.matrix]\nroughness = [1]',
        ":4: case 1.matrix.roughness",
        "input:NODE/INPUT",
    ),
    "an axis of one value": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.matrix]\nmesh = "sphere"',
        ":4: case 1.matrix.mesh",
        "a valid list",
    ),
    "an axis of none": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.matrix]\nmesh = []',
        ":4: case 1.matrix.mesh",
        "empty",
    ),
    "an axis and a key": (
        '[[case]]\nmaterial = "metal.mtlx"\nmesh = "sphere"\n[case.matrix]\nmesh = ["plane"]',
        ":5: case 1.matrix.mesh",
        "also given",
    ),
    "an input": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.input]\n"b/rough" = 1',
        ":4: case 1.input.b/rough",
        "did you mean b/roughness",
    ),
    "a value of an axis": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.matrix]\n"input:b/weight" = [1, "no"]',
        ":4: case 1.matrix.input:b/weight",
        "'no' is no float",
    ),
    "a date for a value": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.input]\n"b/weight" = 2020-01-01',
        ":4: case 1.input.b/weight",
        "is no value",
    ),
    "infinity for a value": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.input]\n"b/weight" = inf',
        ":4: case 1.input.b/weight",
        "finite",
    ),
    "one name twice": (
        '[[case]]\nmaterial = "metal.mtlx"\n[[case]]\nmaterial = "metal.mtlx"',
        ":3: case 2",
        "is taken by case 1",
    ),
    "a template": ('[[case]]\nmaterial = "metal.mtlx"\nname = "{meterial}"', ":3: case 1.name", "{material}"),
    "an element": (
        '[[case]]\nmaterial = "metal.mtlx"\nelement = "metl"',
        ":3: case 1.element",
        "did you mean metal",
    ),
    "an adjustment of nothing": (
        '[[case]]\nmaterial = "metal.mtlx"\n[[adjust]]\ncases = "x*"',
        ":4: adjust 1.cases",
        "no case matches",
    ),
    "a matrix without end": (
        '[[case]]\nmaterial = "metal.mtlx"\n[case.matrix]\n'
        + "\n".join(f'"input:b/i{k}" = [{", ".join(map(str, range(100)))}]' for k in range(9)),
        ":3: case 1.matrix",
        "1000000000000000000 cases",
    ),
}


@pytest.mark.parametrize("text, place, words", FAULTS.values(), ids=FAULTS)
def test_a_fault_is_named_by_file_line_and_key_with_what_is_expected(
    folder: Path, text: str, place: str, words: str
):
    with pytest.raises(SuiteError) as fault:
        cases_of(folder, text)
    message = fault.value.faults[0]
    assert f"suite.toml{place}" in message
    assert words in message


def told(capsys: pytest.CaptureFixture[str], *arguments: object) -> list[str]:
    """What a command that ends with status 2 says."""
    with pytest.raises(SystemExit) as ended:
        cli.main([str(each) for each in arguments])
    assert ended.value.code == 2
    return capsys.readouterr().err.splitlines()


BROKEN = {
    "not XML": ("<materialx", "line 1: "),
    "empty": ("", "no element found"),
    "an unknown node": (METAL.replace("mrm_conductor", "mrm_conductr"), "did you mean mrm_conductor_bsdf"),
    "no material": ('<materialx version="1.39" />', "nothing to render"),
    "an include that is not there": (METAL.replace("<surface ", '<xi:include href="x.mtlx" /><surface ', 1), "x.mtlx"),
    "an image from outside": (
        METAL.replace("</materialx>", '<image name="i" type="color3"><input name="file" type="filename" '
        f'value="{__file__}" /></image></materialx>'),
        "--allow-external",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "words"), BROKEN.values(), ids=BROKEN)
def test_a_broken_document_of_a_folder_is_one_broken_case_and_check_names_it(
    folder: Path, text: str, words: str, capsys: pytest.CaptureFixture[str]
):
    (folder / "metal.mtlx").write_text(text)
    metal, *others = load(folder).cases
    assert (metal.name, metal.broken) == ("metal", True)
    assert words in metal.reason
    assert [(case.name, case.broken) for case in others] == [("set.deep.metal", False), ("velvet", False)]
    (line,) = told(capsys, "suite", "check", folder)
    assert line == f"mrm-nodes: {folder}: {metal.reason}"


def test_a_broken_document_of_a_suite_is_named_by_line_and_key_and_costs_its_own_cases_only(
    folder: Path, capsys: pytest.CaptureFixture[str]
):
    (folder / "metal.mtlx").write_text("<materialx")
    text = """
    [[case]]
    material = "metal.mtlx"
    element = ["one", "other"]
    [case.input]
    "b/weight" = 0.5
    [case.matrix]
    size = [8, 16]
    [[case]]
    material = "velvet.mtlx"
    [[adjust]]
    cases = "metal-third-*"
    size = 32
    """
    cases = {case.name: case.broken for case in cases_of(folder, text)}
    assert cases == {
        "metal-one-8": True,
        "metal-other-8": True,
        "metal-one-16": True,
        "metal-other-16": True,
        "velvet": False,
    }
    (line,) = told(capsys, "suite", "check", folder / "suite.toml")
    assert "suite.toml:3: case 1.material: " in line and "not a MaterialX document" in line


def test_a_fault_of_the_suite_itself_is_still_one(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "metal.mtlx").write_text("<materialx")
    (folder / "suite.toml").write_text(
        '[[case]]\nmaterial = "*.mtlx"\n[[case]]\nmaterial = "velvet.mtlx"\nmesh = "x"\nname = "x"'
    )
    first, second = told(capsys, "suite", "check", folder / "suite.toml")
    assert ":5: case 2.mesh" in first and ":2: case 1.material" in second
    (line,) = told(capsys, "regress", "--suite", folder / "suite.toml", "-o", folder / "report")
    assert ":5: case 2.mesh" in line
    assert not (folder / "report").exists()


def test_all_faults_are_told_at_once(folder: Path, capsys: pytest.CaptureFixture[str]):
    (folder / "suite.toml").write_text(
        '[[case]]\nmaterial = "metal.mtlx"\nmesh = "x"\n[[case]]\nmaterial = "velvet.mtlx"\nlight = "x"'
    )
    with pytest.raises(SystemExit) as ended:
        cli.main(["suite", "check", str(folder / "suite.toml")])
    lines = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2
    assert [re.search(r"toml:(\d+)", line)[1] for line in lines] == ["3", "6"]  # type: ignore[index]


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe\x00", b"x = " + b"[" * 5000, b"x = " + b"9" * 5000, b"", b"[[case]]\nmaterial = 3"],
    ids=["not text", "nested deeply", "a number without end", "empty", "a number for a name"],
)
def test_what_is_no_suite_is_one_clear_error(folder: Path, content: bytes):
    (folder / "suite.toml").write_bytes(content)
    with pytest.raises(MrmError, match=r"suite\.toml"):
        load(folder / "suite.toml")


@pytest.mark.parametrize("name", ["nothing", "nothing.toml", "default.tom"])
def test_an_unknown_suite_is_an_error(name: str):
    with pytest.raises(MrmError, match=name):
        suites.suite(name)


def test_an_empty_folder_is_no_suite(tmp_path: Path):
    with pytest.raises(MrmError, match=r"no \.mtlx file"):
        suites.suite(str(tmp_path))


def test_init_writes_a_suite_that_is_sound_and_takes_nothing_s_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    for status in (0, 2):
        with pytest.raises(SystemExit) as ended:
            cli.main(["suite", "init", str(tmp_path)])
        assert ended.value.code == status
    cases = load(tmp_path / "suite.toml").cases
    assert {case.truth for case in cases} == {"physics"}
    assert "exists" in capsys.readouterr().err


def test_list_shows_the_truth_of_each_case_and_why(folder: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as ended:
        cli.main(["suite", "list", str(folder), "--filter", "velvet"])
    printed = capsys.readouterr().out
    assert ended.value.code == 0
    assert (
        "baseline" in printed and "sheen_bsdf" in printed and "metal" not in printed.replace("metal.mtlx", "")
    )


def test_the_finished_materials_are_all_decided_by_physics():
    assert {case.truth for case in load(materials_path()).cases} == {"physics"}


def test_a_suite_that_is_a_pipe_a_device_or_endless_is_refused_at_once(tmp_path: Path):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "device.toml").symlink_to("/dev/zero")
    (tmp_path / "sparse.toml").touch()
    os.truncate(tmp_path / "sparse.toml", 8 << 30)
    for name, told in (
        ("pipe", "no ordinary file"),
        ("device", "no ordinary file"),
        ("sparse", "larger than"),
    ):
        with pytest.raises(MrmError, match=f"{name}.toml: .*{told}"):
            load(tmp_path / f"{name}.toml")


def test_what_a_suite_was_made_by_goes_with_it(tmp_path, monkeypatch):
    write_seeds(tmp_path)
    makers = []
    monkeypatch.setattr(suitefile._Maker, "_check_names", lambda self: makers.append(weakref.ref(self)))
    assert load(tmp_path / "suite.toml").cases
    gc.collect()
    assert len(makers) == 1 and makers[0]() is None
