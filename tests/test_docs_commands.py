"""Each command and each piece of Python in README.md and docs/**/*.md runs as it is written.

Who writes a page keeps to this:

- A line of a code block (indented, or fenced as sh, bash or console, or as nothing) that begins with `mrm-nodes` is
  run, and so is what goes on after a `\\` at its end. A `$ ` before it is passed over; ` # ` begins a comment. A line
  with `|`, `>`, `<`, `;`, `&&` or `$(` is run by a shell.
- A block fenced as python is run; those of a page have one namespace.
- A page runs from top to bottom in one folder: what a command writes, the next ones read. What has to be there before
  is made when a command or a piece of Python names it, as FILES says, and STATES for what is no single file.
  A file that is in neither, an unknown command and an unknown option fail.
- A block whose first line is a comment that is a file's name (`<!-- tape.mtlx -->`, `# suite.toml`) is that file.
  `python FILE` is run where a command or a block of the page has written FILE.
- After a line `<!-- fails: -->` a command has to end in another status than 0, and what it prints has to have the text
  of the block fenced as text that follows.
- Code in a line of text that begins with `mrm-nodes` may stand for many (`mrm-nodes photometry FILE …`): it is not
  run, but its command and its options must exist. `make TARGET` and `python FILE` must exist, too.
- Pictures are drawn small: SMALL says what is added to the command. Nothing else is changed.
- NOT_RUN lists what is parsed, but not run, with the reason. Under a line `<!-- not run: why -->` a block is only
  parsed.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from gltf_writer import SQUARE, gltf_of, write_glb

from mrm_nodes import cli, shipped
from mrm_nodes.library import own_libraries
from mrm_nodes.render import renderer, write_exr, write_png

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]

NOT_RUN = {
    "bench": "it measures for minutes",
    "targets": "it compiles with every compiler that is here, for minutes",
    "generate cone.mtlx --check": "the same",
    "figures": "it draws for half a minute, as tests/test_reference_outputs.py has it do",
    "scene road -o road.exr --class RA1": "it is the line above it, of another class",
    "regress --dask tcp:": "there is no such scheduler",
    "regress --suite suite.toml --dask tls:": "the same",
}
"""Commands, by what they begin with."""

SMALL = {
    "render": ["--size", "16"],
    "scene": ["--scale", "0.05", "--samples", "1"],
    "regress": ["--jobs", "1"],
}
"""What is added to a command."""

OTHERS = (
    "cd",
    "cp",
    "dask",
    "export",
    "eval",
    "git",
    "pip",
    "pipx",
    "uv",
    "pytest",
    "sudo",
    "apt",
    "apt-get",
    "source",
)
"""Other programs that blocks of commands may have; they are not run."""

OPEN_PBR = """<?xml version="1.0"?>
<materialx version="1.39">
  <open_pbr_surface name="cloth" type="surfaceshader">
    <input name="base_color" type="color3" value="0.6, 0.8, 0.02" />
    <input name="specular_roughness" type="float" value="0.4" />
  </open_pbr_surface>
  <surfacematerial name="vest" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="cloth" />
  </surfacematerial>
</materialx>
"""


def of_material(name: str) -> Callable[[Path], None]:
    """What copies a finished material."""
    return lambda path: shutil.copy(shipped.materials()[name], path) and None


def gltf(path: Path) -> None:
    """A square with a material, as .gltf or .glb."""
    import json

    shapes = [[SQUARE]]
    extension = {"KHR_materials_retroreflection": {"retroreflectionFactor": 0.7}}
    changes: dict[str, Any] = {
        "materials": [
            {"name": "cone", "pbrMetallicRoughness": {"roughnessFactor": 0.4}, "extensions": extension}
        ],
        "extensionsUsed": list(extension),
    }
    if path.suffix == ".glb":
        write_glb(path, shapes, **changes)
    else:
        tree, data = gltf_of(shapes, **changes)
        tree["buffers"] = [{"byteLength": len(data), "uri": "data.bin"}]
        (path.parent / "data.bin").write_bytes(data)
        path.write_text(json.dumps(tree))


def environment(path: Path) -> None:
    """A small latitude-longitude map, which is brighter above."""
    import OpenImageIO as oiio

    texels = np.linspace(2.0, 0.1, 8, dtype=np.float32)[:, None, None] * np.ones((8, 16, 3), np.float32)
    image = oiio.ImageOutput.create(str(path))
    image.open(str(path), oiio.ImageSpec(16, 8, 3, "float"))
    image.write_image(texels)
    image.close()


def image(path: Path) -> None:
    """A small picture with values from 0 to 1."""
    write = write_exr if path.suffix == ".exr" else write_png
    write(path, np.linspace(0.0, 1.0, 8 * 8 * 3, dtype=np.float32).reshape(8, 8, 3))


def measurement(path: Path) -> None:
    """A few samples of a tape at three angles of the light, as ALTA writes them."""
    from mrm_nodes import reference as ref

    tape = ref.GeneralizedSchlick(0.19, alpha=0.053, retroreflectivity=1.0)
    lines = ["#DIM 3 1", "#VS 0", "#PARAM_IN ISOTROPIC_TV_TL_DPHI", "#PARAM_OUT INV_STERADIAN"]
    for light in np.radians((15.0, 30.0, 60.0)):
        for view in np.linspace(-1.2, 1.2, 13):
            seen, lit = (np.array([np.sin(each), 0.0, np.cos(each)]) for each in (view, light))
            value = 0.05 + float(tape.eval(seen, lit)[0])
            lines.append(f"{abs(view):.4f} {light:.4f} {0.0 if view >= 0 else np.pi:.6f} {value:.6f}")
    path.write_text("\n".join(lines) + "\n")


FILES: dict[str, Callable[[Path], None]] = {
    "cone.mtlx": of_material("traffic_cone"),
    "tape.mtlx": of_material("yellow_tape"),
    "foreign.mtlx": of_material("road_paint"),
    "sign.mtlx": of_material("chevron_sign"),
    "vest.mtlx": lambda path: path.write_text(OPEN_PBR) and None,
    "cone.gltf": gltf,
    "cone.glb": gltf,
    "shaderball.glb": gltf,
    "yours.glb": gltf,
    "sky.hdr": environment,
    "tape.png": image,
    "tape.dat": measurement,
    "retro-3M-jaune.dat": measurement,
    "path/to/libraries": lambda path: shutil.copytree(own_libraries(), path) and None,
    "asset.xomp": lambda path: said("material", "--class", "RA2", "--colour", "white", "-o", path),
}
"""What pages name without having made it, and how it is made."""


def said(*arguments: Any) -> str:
    """What a command prints; it has to end well."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.raises(SystemExit) as ended, redirect_stdout(out), redirect_stderr(err):
        cli.main([str(each) for each in arguments])
    assert not ended.value.code, f"status {ended.value.code}: {err.getvalue() or out.getvalue()}"
    return out.getvalue()


@dataclass(frozen=True)
class Piece:
    """A command, or a block of Python, and where it is written."""

    line: int
    kind: str
    text: str
    is_run: bool


def pieces(text: str) -> Iterator[Piece]:
    """What a page has, in its order."""
    fence, language, begun, block = "", "", 0, list[str]()
    goes_on, is_run = "", True
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        marked = re.match(r"(```+|~~~+)\s*([\w+-]*)", bare)
        if fence and bare == fence:
            named = re.fullmatch(r"(?:<!-- |# )([\w./-]+\.\w+)(?: -->)?", block[0]) if block else None
            if named:
                yield Piece(begun, "file", f"{named[1]}\n{_dedented(block)}", True)
            elif language in ("python", "py"):
                yield Piece(begun, "python", _dedented(block), is_run)
            elif language == "text":
                yield Piece(begun, "said", _dedented(block), True)
            fence, is_run = "", True
        elif marked and not fence:
            fence, language, begun, block = marked[1], marked[2], number + 1, []
        elif fence and language not in ("", "sh", "bash", "shell", "console"):
            block.append(line)
        elif not fence and bare.startswith("<!-- not run:"):
            is_run = False
        elif not fence and bare == "<!-- fails: -->":
            yield Piece(number, "fails", "", True)
        elif fence or line.startswith("    ") or goes_on:
            command = f"{goes_on}{bare.removeprefix('$ ')}"
            goes_on = f"{command[:-1]} " if command.endswith("\\") else ""
            first = command.split(maxsplit=1)[0] if command else ""
            if (
                goes_on
                or not command
                or command.startswith("#")
                or (language == "console" and bare[:2] != "$ ")
            ):
                continue
            if first.endswith("mrm-nodes"):
                yield Piece(number, "command", command, is_run)
            elif first in ("make", "python") or (fence and language):
                yield Piece(number, "other", command, is_run)
        else:
            is_run = is_run or bool(bare)
            for found in re.findall(r"`(mrm-nodes [^`]+)`", line):
                yield Piece(number, "mention", found, False)


def _dedented(block: list[str]) -> str:
    import textwrap

    return textwrap.dedent("\n".join(block))


def _words(command: str) -> list[str]:
    return shlex.split(command, comments=True)


def make_files(text: str) -> None:
    """Make the files that a command or a piece of Python names and that are not there."""
    for name, make in FILES.items():
        if re.search(rf"(?<![\w./-]){re.escape(name)}(?![\w.-])", text) and not Path(name).exists():
            Path(name).parent.mkdir(parents=True, exist_ok=True)
            make(Path(name))


def parse(words: list[str]) -> None:
    """Parse a command as click does, and no more: what it names has to be there."""
    command: click.Command = cli.cli
    context = click.Context(command, info_name="mrm-nodes")
    rest = list(words)
    while isinstance(command, click.Group):
        name = rest.pop(0)
        found = command.get_command(context, name)
        assert found is not None, f"unknown command {name}"
        command = found
    command.make_context(command.name, rest, parent=context)


def check_mention(words: list[str]) -> None:
    """Check that a command and its options exist, whatever stands for files and values."""
    command: click.Command = cli.cli
    context = click.Context(command)
    for word in words:
        if isinstance(command, click.Group) and not word.startswith("-"):
            found = command.get_command(context, word)
            assert found is not None, f"unknown command {word}"
            command = found
        elif re.match(r"--?[a-zA-Z]", word):
            options = {
                name
                for each in command.get_params(click.Context(command))
                for name in (*each.opts, *each.secondary_opts)
            }
            assert word.split("=")[0] in options | {"--version"}, f"unknown option {word}"


def run_command(command: str) -> None:
    make_files(command)
    if re.search(r"[|<>;]|&&|\$\(", re.sub(r"\s#.*|'[^']*'|\"[^\"]*\"", "", command)):
        environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        done = subprocess.run(["sh", "-ec", command], capture_output=True, text=True, env=environment)
        assert done.returncode == 0, done.stderr
        return
    words = _words(command)[1:]
    plain = " ".join(words)
    if any(plain.startswith(each) for each in NOT_RUN):
        parse(words)
        return
    for beginning, prepare in STATES.items():
        if plain.startswith(beginning):
            prepare(words)
    more = SMALL.get(words[0], [])
    if words[0] == "regress" and "--suite" not in words:
        more = [*more, "--filter", CASE, "--configurations", "0"]
    said(*words, *more)


CASE = "figure5"
"""The cases of the default suite that are run."""


def make_parts(words: list[str]) -> None:
    """What `merge` reads: the reports of a run's parts."""
    parts = [each for each in words if re.fullmatch(r"part\d+", each)]
    for number, part in enumerate(parts, 1):
        said(
            "regress", "--shard", f"{number}/{len(parts)}", "-o", part, "--filter", CASE, "--configurations", "0"
        )  # fmt: skip


def make_run(words: list[str]) -> None:
    """What `baseline` reads: a suite whose cases have stored images, and its run."""
    suite = Path("suite.toml")
    if "--suite" in words:
        return
    if not suite.exists() or '\ntruth = "baseline"' not in suite.read_text():
        shutil.copy(shipped.materials()["traffic_cone"], "stop.mtlx")
        suite.write_text('[[case]]\nmaterial = "stop.mtlx"\nname = "stop"\nsize = 16\ntruth = "baseline"\n')
        shutil.rmtree("report", ignore_errors=True)
    if not Path("report").exists():
        with pytest.raises(SystemExit):
            cli.main(["regress", "--suite", "suite.toml", "--jobs", "1"])
        said("baseline", "accept", "stop", "--reason", "it is the first")


STATES: dict[str, Callable[[list[str]], None]] = {
    "merge": make_parts,
    "baseline": make_run,
}
"""What a command needs besides files, by what it begins with."""


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `mrm_nodes.render` draw small pictures unless it is told otherwise."""
    defaults = renderer.render.__defaults__
    assert defaults is not None
    monkeypatch.setattr(
        renderer.render, "__defaults__", tuple((16, 16) if each == (512, 512) else each for each in defaults)
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_what_a_page_tells_to_run_runs(
    page: Path, gl: None, small: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "page"}
    faults, fails, failed = [], False, ""
    for piece in pieces(page.read_text(encoding="utf-8")):
        try:
            if piece.kind == "fails":
                fails = True
            elif piece.kind == "said":
                assert not failed or " ".join(piece.text.split()) in " ".join(failed.split()), (
                    f"it says {failed}"
                )
                failed = ""
            elif fails:
                fails, failed = False, what_fails(piece.text)
            else:
                run_piece(piece, f"{page.name}:{piece.line}", namespace)
        except Exception as error:
            faults.append(f"{page.name}:{piece.line}: {piece.text}\n    {type(error).__name__}: {error}")
    assert not faults, "\n".join(faults)


def what_fails(command: str) -> str:
    """What a command prints that is meant to fail."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    done = subprocess.run(["sh", "-ec", command], capture_output=True, text=True, env=environment)
    assert done.returncode != 0, f"it does not fail: {done.stdout}"
    return done.stdout + done.stderr


def test_the_examples_in_the_help_are_commands(gl: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    examples = [example for example, _ in cli.cli.sections.values()]
    waiting: list[click.Command] = [cli.cli]
    while waiting:
        command = waiting.pop()
        examples += re.findall(r"^ *(mrm-nodes .*)$", command.help or "", re.MULTILINE)
        waiting += command.commands.values() if isinstance(command, click.Group) else ()
    assert len(examples) > 30
    for example in examples:
        make_files(example)
        parse(_words(example)[1:])


def run_piece(piece: Piece, where: str, namespace: dict[str, Any]) -> None:
    if piece.kind == "python":
        code = compile(piece.text, where, "exec")
        if piece.is_run:
            make_files(piece.text)
            exec(code, namespace)
    elif piece.kind == "file":
        name, text = piece.text.split("\n", 1)
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(text, "utf-8")
    elif piece.kind == "mention":
        check_mention(_words(piece.text)[1:])
    elif piece.kind == "command" and piece.is_run:
        run_command(piece.text)
    elif piece.kind == "command":
        make_files(piece.text)
        parse(_words(piece.text)[1:])
    else:
        check_other(_words(piece.text))


def check_other(words: list[str]) -> None:
    """Check another program's line: a target of the Makefile, a script of ours, or a program that is known."""
    program = words[0].removeprefix(".venv/bin/")
    if program == "make":
        targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
        assert words[1] in targets, f"no target {words[1]} in the Makefile"
    elif program == "python" and Path(words[1]).is_file():
        done = subprocess.run([sys.executable, *words[1:]], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    elif program == "python" and words[1] != "-m":
        assert (ROOT / words[1]).is_file(), f"no file {words[1]}"
    else:
        assert program in (*OTHERS, "python"), f"unknown program {program}: name it in OTHERS"
