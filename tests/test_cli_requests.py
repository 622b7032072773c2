"""What is nearly right is told what is right; help is never cut off; targets do not take each other's files."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path

import click
import pytest

from mrm_nodes import shadergen
from mrm_nodes.cli import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.report import terminal
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.regression.suites.suitetable import SuiteError
from mrm_nodes.regression.verdict.outcome import Outcome
from mrm_nodes.regression.verdict.tolerance import Tolerance
from mrm_nodes.render import CameraLight, DirectionalLight, SpotLight, parse_light
from mrm_nodes.shipped import materials

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


RENDER = ["render", "traffic_cone", "-o", "x.png"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["rendr"], "Did you mean 'render'"),
        (["render", "x", "--msh", "plane"], "--mesh"),
        ([*RENDER, "--backend", "osmessa"], "did you mean osmesa?"),
        (["doctor", "--backend", "osmessa"], "did you mean osmesa?"),
        (["regress", "--filter", "figure5", "--backend", "osmessa"], "did you mean osmesa?"),
        ([*RENDER, "--backend", "glx"], "known: auto, egl, osmesa"),
        ([*RENDER, "--tonemap", "neutrl"], "did you mean neutral?"),
        ([*RENDER, "--mesh", "spere"], "did you mean sphere?"),
        ([*RENDER, "--light", "camra"], "did you mean camera?"),
        ([*RENDER, "--light", "directionl:0,0,-1"], "did you mean directional?"),
        ([*RENDER, "--light", "camera:two"], "'two' is not a number"),
        ([*RENDER, "--light", "camera:1,2"], "is not three finite numbers"),
        ([*RENDER, "--light", "camera:"], "'' is not a number"),
        ([*RENDER, "--env", "skyy"], "did you mean sky?"),
        ([*RENDER, "--background", "transparant"], "did you mean transparent?"),
        ([*RENDER, "--exposure", "bright"], "write auto, or stops"),
        ([*RENDER, "--exposure", "nan"], "write auto, or stops"),
        ([*RENDER, "--tonemap", "ACES 9 - cinema"], "unknown tone mapping ACES 9 - cinema"),
        ([*RENDER, "--element", "trafic_cone"], "did you mean traffic_cone?"),
        ([*RENDER, "--size", "16384"], "16384x16384"),
        (["material", "--class", "RA3", "-o", "x.mtlx"], "did you mean RA2 or RA1?"),
        (["material", "--class", "RA2", "--colour", "yelow", "-o", "x.mtlx"], "did you mean yellow?"),
        (["material", "--class", "RA2", "--as", "open_pb", "-o", "x.mtlx"], "did you mean open_pbr?"),
        (["photometry", "traffic_cone", "--class", "RA22"], "did you mean RA2"),
        (["generate", "traffic_cone", "--target", "gls", "-o", "x"], "did you mean glsl"),
        (["generate", "traffic_cone", "--target", "al", "-o", "x"], "did you mean all?"),
        (["generate", "traffic_cone", "--environment", "fiss", "-o", "x"], "did you mean fis?"),
        (["install", ".", "--environment", "prefiltr"], "did you mean prefilter?"),
        (["scene", "con", "-o", "x.png"], "did you mean cone?"),
        (["scene", "road", "--class", "sgn=RA2", "-o", "x.png"], "did you mean sign?"),
        (["fit", "x.dat", "--model", "layerd", "-o", "x.mtlx"], "did you mean layered?"),
        (["regress", "--suite", "defalt"], "did you mean default?"),
        (["materials", "trafic_cone"], "did you mean traffic_cone?"),
        (["merge", "p1", "p1", "-o", "x"], "p1: named twice"),
        (["merge", "p1", "./p2/../p1", "-o", "x"], "named twice"),
        (["render", ".", "-o", "x.png"], ".: is a folder; name a document"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)  # fmt: skip
def test_what_is_nearly_right_is_told_what_is(run: Run, folder: Path, arguments: list[str], said: str):
    status, out, err = run(*arguments)
    assert (status, out) == (2, "")
    assert said in err
    assert err.count("\n") == 1
    assert not list(folder.rglob("*"))


@pytest.mark.parametrize("place", ["/proc/x.png", "/dev/null/x.png", "file/x.png"])
def test_where_nothing_can_be_written_is_one_line(run: Run, folder: Path, gl: None, place: str):
    (folder / "file").write_text("kept")
    status, out, err = run("render", "traffic_cone", "-o", place, "--size", "8")
    assert (status, out) == (2, "")
    assert "cannot be written" in err
    assert err.count("\n") == 1
    assert [each.name for each in folder.iterdir()] == ["file"]


def test_a_colour_of_a_light_may_be_one_number():
    assert parse_light("camera:2") == CameraLight((2.0, 2.0, 2.0))
    assert parse_light("camera:2") == parse_light("camera:2,2,2")
    assert parse_light("directional:0,0,-1:0.5") == DirectionalLight((0.0, 0.0, -1.0), (0.5, 0.5, 0.5))
    spot = parse_light("spot:0,0,3:0,0,-1:3")
    assert isinstance(spot, SpotLight)
    assert spot.color == (3.0, 3.0, 3.0)
    with pytest.raises(MrmError, match=r"\[1.0\] is not three finite numbers"):
        parse_light("directional:1")


def suite_of(folder: Path, text: str) -> Path:
    (folder / "cone.mtlx").write_text(
        materials()["traffic_cone"].read_text(encoding="utf-8"), encoding="utf-8"
    )
    (folder / "suite.toml").write_text(text, encoding="utf-8")
    return folder / "suite.toml"


def test_no_light_in_an_environment_is_no_light(folder: Path):
    case = '[defaults]\nlight = "camera"\n[[case]]\nmaterial = "cone.mtlx"\n'
    lit, around = load(
        suite_of(folder, f'{case}[[case]]\nname="around"\nmaterial="cone.mtlx"\nenvironment="sky"\nlight=[]')
    ).cases
    assert (lit.lights, around.lights) == ((CameraLight(),), ())
    for wrong in ("light = []", 'light = "none"\n[lights]\nnone = []'):
        with pytest.raises(SuiteError, match=r"suite\.toml:5: case 1\.light: no light and no environment"):
            load(suite_of(folder, f"{case}{wrong}"))


def test_a_tolerance_may_be_written_in_its_place(folder: Path):
    case = '[[case]]\nmaterial = "cone.mtlx"\n'
    (found,) = load(suite_of(folder, f"{case}tolerance = {{ max_rel = 0.1, flip = 0.2 }}")).cases
    assert found.tolerance == Tolerance(max_rel=0.1, flip=0.2)
    (adjusted,) = load(suite_of(folder, f'{case}[[adjust]]\ncases = "*"\ntolerance.rmse = 0.1')).cases
    assert adjusted.tolerance == Tolerance(rmse=0.1)
    for wrong, said in (
        ("{ max_rel = -1 }", "tolerance.max_rel: expected greater than or equal to 0"),
        ("{ max_rell = 1 }", "tolerance.max_rell: unknown key; did you mean max_rel?"),
        ('"close"', "unknown tolerance close"),
        ("3", "tolerance: expected a valid string"),
    ):
        with pytest.raises(SuiteError, match=re.escape(said)) as told:
            load(suite_of(folder, f"{case}tolerance = {wrong}"))
        assert "suite.toml:3: case 1.tolerance" in str(told.value)
        assert len(told.value.faults) == 1


def test_no_target_takes_the_files_of_another(run: Run, folder: Path):
    names = []
    for target in shadergen.supported_targets():
        status, out, _ = run("generate", "yellow_tape", "--target", target, "-o", "one")
        assert status == 0
        names += out.split()
    assert len(set(names)) == len(names) == len(list((folder / "one").iterdir()))
    status, out, _ = run("generate", "yellow_tape", "--target", "all", "-o", "all")
    assert status == 0
    assert [Path(each).name for each in out.split()] == [Path(each).name for each in names]
    for name in names:
        assert (folder / name).read_bytes() == (folder / "all" / Path(name).name).read_bytes()
    assert run("generate", "yellow_tape", "-o", "plain")[1].split() == [
        "plain/yellow_tape.vertex.glsl",
        "plain/yellow_tape.pixel.glsl",
    ]


def commands(
    command: click.Command = cli, names: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    yield names, command
    for name, each in command.commands.items() if isinstance(command, click.Group) else ():
        yield from commands(each, (*names, name))


def joined(text: str) -> str:
    return re.sub(r"\s+", "", text)


@pytest.mark.parametrize("columns", [40, 80, None])
def test_help_is_never_cut_off(run: Run, monkeypatch: pytest.MonkeyPatch, columns: int | None):
    for variable in ("COLUMNS", "LINES"):
        monkeypatch.delenv(variable, raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", str(columns))
    for names, command in commands():
        status, out, _ = run(*names, "--help")
        assert status == 0
        shown = joined(out)
        for paragraph in (command.help or "").replace("\b", "").split("\n"):
            assert joined(paragraph) in shown, names
        for option in command.params:
            if isinstance(option, click.Option) and not option.hidden:
                assert joined(option.help or "") in shown, (names, option.name)
                assert all(each in shown for each in option.opts)
        for each in command.commands.values() if isinstance(command, click.Group) else ():
            assert joined(each.get_short_help_str(1000)) in shown
            assert not each.get_short_help_str(1000).endswith("...")
        # What has no place to be broken, and examples, go on in the terminal's next line.
        prose = [line for line in out.splitlines() if "mrm-nodes" not in line and len(line.split()) > 2]
        assert max((len(line) for line in prose), default=0) <= (columns or 80), names


def test_every_command_has_a_section_and_an_example(run: Run):
    out = run("--help")[1]
    sections = [each for _, each in cli.sections.values()]
    assert [command for section in sections for command in section] == list(cli.commands.values())
    for title, (example, section) in cli.sections.items():
        assert f"{title}:\n" in out
        assert f"  {example}\n" in out
        assert example.split()[1] in [command.name for command in section]
    for names, command in commands():
        if not isinstance(command, click.Group):
            assert re.search(rf"^ *mrm-nodes {' '.join(names)}\b", command.help or "", re.MULTILINE), names


def test_version_has_that_of_materialx(run: Run):
    status, out, _ = run("--version")
    python = ".".join(map(str, sys.version_info[:3]))
    said = f"mrm-nodes {version('mrm-nodes')}, MaterialX {version('MaterialX')}, Python {python}\n"
    assert (status, out) == (0, said)


def test_help_where_there_is_no_terminal():
    done = subprocess.run(
        [sys.executable, "-m", "mrm_nodes", "render", "--help"], capture_output=True, text=True
    )
    assert done.returncode == 0
    assert "…" not in done.stdout
    assert "\x1b" not in done.stdout


def test_a_run_says_how_far_it_is_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    outcome = Outcome.__new__(Outcome)
    for name, value in {"verdict": "pass", "backend": "egl", "name": "case"}.items():
        object.__setattr__(outcome, name, value)
    now = [0.0]
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now[0])
    with terminal.progress() as shown:
        for done in range(1, 6):
            now[0] += 6.0
            shown.outcome(outcome, done, 5)
        now[0] += 20.0
        shown.compiled(1, 4)
    assert capsys.readouterr().err.splitlines() == [
        "regression: 2 of 5",
        "regression: 4 of 5",
        terminal.COMPILING,
        "evaluator: 1 of 4",
    ]
