"""Mutated files, and the command line run on them in a process that may crash, hang or eat memory.

Mutations come from a seed and a number alone, so that a fault is found again by its number.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import multiprocessing
import random
import re
import resource
import struct
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from mrm_nodes.errors import MrmError

MEMORY = 2 << 30
"""Bytes by which the command may grow over what it has when it starts to work."""
SECONDS = 60.0
"""After which a command counts as hung; none takes a tenth of it on a quiet machine."""
LARGEST = 64
"""Pixels a side of a case that is rendered: a mutated size is sound, and may take minutes."""

METAL = """<?xml version="1.0"?>
<materialx version="1.39">
  <nodegraph name="G">
    <input name="scale" type="float" value="4.0" />
    <texcoord name="uv" type="vector2" />
    <multiply name="scaled" type="vector2">
      <input name="in1" type="vector2" nodename="uv" /><input name="in2" type="float" interfacename="scale" />
    </multiply>
    <noise2d name="noise" type="float"><input name="texcoord" type="vector2" nodename="scaled" /></noise2d>
    <clamp name="weight" type="float"><input name="in" type="float" nodename="noise" /></clamp>
    <output name="out" type="float" nodename="weight" />
  </nodegraph>
  <mrm_conductor_bsdf name="b" type="BSDF">
    <input name="ior" type="color3" value="0.2, 0.9, 1.1" />
    <input name="roughness" type="vector2" value="0.2, 0.3" />
    <input name="retroreflectivity" type="float" nodegraph="G" output="out" />
    <input name="distribution" type="string" value="ggx" />
  </mrm_conductor_bsdf>
  <oren_nayar_diffuse_bsdf name="d" type="BSDF">
    <input name="color" type="color3" value="0.2, 0.4, 0.1" />
  </oren_nayar_diffuse_bsdf>
  <mix name="m" type="BSDF">
    <input name="fg" type="BSDF" nodename="b" /><input name="bg" type="BSDF" nodename="d" />
    <input name="mix" type="float" value="0.5" />
  </mix>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="m" /></surface>
  <surfacematerial name="metal" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" />
  </surfacematerial>
</materialx>
"""
PATTERN = """<?xml version="1.0"?>
<materialx version="1.39" colorspace="lin_rec709">
  <nodedef name="ND_twice_color3" node="twice">
    <input name="in" type="color3" value="0.1, 0.2, 0.3" />
    <output name="out" type="color3" />
  </nodedef>
  <nodegraph name="NG_twice_color3" nodedef="ND_twice_color3">
    <add name="sum" type="color3">
      <input name="in1" type="color3" interfacename="in" /><input name="in2" type="color3" interfacename="in" />
    </add>
    <output name="out" type="color3" nodename="sum" />
  </nodegraph>
  <image name="picture" type="color3">
    <input name="file" type="filename" value="picture.png" colorspace="srgb_texture" />
    <input name="default" type="color3" value="0.5, 0.5, 0.5" />
    <input name="uaddressmode" type="string" value="mirror" />
  </image>
  <ramplr name="ramp" type="color3"><input name="valuel" type="color3" value="0, 0, 1" /></ramplr>
  <multiply name="both" type="color3">
    <input name="in1" type="color3" nodename="picture" /><input name="in2" type="color3" nodename="ramp" />
  </multiply>
  <twice name="more" type="color3"><input name="in" type="color3" nodename="both" /></twice>
  <output name="shown" type="color3" nodename="more" />
</materialx>
"""
SUITE = """title = "fuzz"
[defaults]
size = "16x16"
camera = "front"
[cameras]
front = "0,0,3:fov=42"
[lights]
around = ["directional:-0.08,-0.05,-1", "camera:1,1,1"]
[meshes]
box = "box.obj"
[environments]
dusk = { map = "sky", rotation = 90.0, samples = 4 }
[tolerances]
close = { max_rel = 1e-3, flip = 0.1 }
[[case]]
material = "metal.mtlx"
light = "around"
tolerance = "close"
[case.matrix]
mesh = ["sphere", "box"]
"input:b/roughness" = [[0.1, 0.1], [0.3, 0.2]]
[[case]]
material = "pattern.mtlx"
name = "{material}-{size}-pattern"
truth = "baseline"
[case.matrix]
size = [16, "8x8"]
[[adjust]]
cases = "*pattern*"
time_limit = 10
"""
BOX = """# a quad and a triangle
o box
v -1 -1 0
v 1 -1 0
v 1 1 0.1
v -1 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vn 0 0 1
g front
usemtl none
f 1/1/1 2/2/1 3/3/1 4/4/1
f 1/1/1 3/3/1 -1/-1/-1
"""


def glb() -> bytes:
    """One triangle with normals and texture coordinates."""
    positions = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], "<f4").tobytes()
    normals = np.array([[0, 0, 1]] * 3, "<f4").tobytes()
    texcoords = np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    indices = np.array([0, 1, 2, 0], "<u2").tobytes()
    parts = [positions, normals, texcoords, indices]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
        for start, part in zip(starts, parts, strict=False)
    ]
    kinds = [("VEC3", 5126, 3), ("VEC3", 5126, 3), ("VEC2", 5126, 3), ("SCALAR", 5123, 3)]
    accessors: list[dict[str, Any]] = [
        {"bufferView": view, "componentType": component, "count": count, "type": kind}
        for view, (kind, component, count) in enumerate(kinds)
    ]
    accessors[0] |= {"min": [-1, -1, 0], "max": [1, 1, 0]}
    tree = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [0, 0, 0.1]}],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}, "indices": 3}]}
        ],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    binary = b"".join(parts)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def write_seeds(folder: Path) -> None:
    """The sound files that are mutated, and those that they refer to."""
    import OpenImageIO as oiio

    from mrm_nodes.render.images import write_exr, write_png

    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metal.mtlx").write_text(METAL)
    (folder / "pattern.mtlx").write_text(PATTERN)
    (folder / "suite.toml").write_text(SUITE)
    (folder / "box.obj").write_text(BOX)
    (folder / "triangle.glb").write_bytes(glb())
    colors = np.random.default_rng(0).uniform(0, 2, (8, 16, 3))
    write_exr(folder / "map.exr", colors)
    write_png(folder / "picture.png", colors / 2)
    pixels = np.ascontiguousarray(colors, np.float32)
    for name, format_ in {"map.hdr": oiio.FLOAT, "tiled.exr": oiio.HALF, "piz.exr": oiio.HALF}.items():
        specification = oiio.ImageSpec(16, 8, 3, format_)
        if name == "tiled.exr":
            specification.tile_width = specification.tile_height = 8
        elif name == "piz.exr":
            specification.attribute("compression", "piz")
        image = oiio.ImageOutput.create(str(folder / name))
        assert image.open(str(folder / name), specification), image.geterror()
        if name == "tiled.exr":
            assert image.write_tiles(0, 16, 0, 8, 0, 1, pixels), image.geterror()
        else:
            assert image.write_image(pixels), image.geterror()
        image.close()


NUMBERS = [
    "0",
    "-1",
    "1e38",
    "1e39",
    "-1e-45",
    "nan",
    "inf",
    "-inf",
    "99999999999999999999",
    "0x10",
    "1,2",
    "",
    "1e",
]
WORDS = [
    "",
    "x",
    "é",
    "a" * 3000,
    "../../x",
    "/etc/passwd",
    "%s%n",
    "<",
    "&amp;",
    "[",
    "b",
    "s",
    "metal",
    "G",
    "out",
]


def mutated(content: bytes, kind: str, number: int) -> bytes:
    """The `number`-th mutation of a file."""
    rng = random.Random(f"{kind} {number}")
    is_text = kind in ("mtlx", "toml", "obj")
    ways = (TEXT if is_text else ()) + BYTES
    weights = [3] * (len(ways) - len(BYTES)) + [1 if is_text else 3] * len(BYTES)
    for _ in range(rng.choice((1, 1, 1, 1, 2, 4))):
        content = rng.choices(ways, weights)[0](content, rng)
    return content


def _at(content: bytes, rng: random.Random) -> int:
    """A place, more often in the header."""
    return rng.randrange(
        max(1, min(len(content), rng.choice((64, 512, len(content) or 1, len(content) or 1))))
    )


def _flip(content: bytes, rng: random.Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(rng.choice((1, 2, 8))):
        changed[_at(content, rng) % len(changed)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _truncate(content: bytes, rng: random.Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def _number(content: bytes, rng: random.Random) -> bytes:
    place = _at(content, rng)
    value = rng.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFF, 65536, 1 << 30))
    return content[:place] + struct.pack(rng.choice(("<I", ">I")), value) + content[place + 4 :]


def _drop(content: bytes, rng: random.Random) -> bytes:
    place = _at(content, rng)
    return content[:place] + content[place + rng.randrange(1, 64) :]


def _double(content: bytes, rng: random.Random) -> bytes:
    place = _at(content, rng)
    piece = content[place : place + rng.randrange(1, 256)]
    return content[:place] + piece * rng.choice((1, 2, 50)) + content[place:]


def _noise(content: bytes, rng: random.Random) -> bytes:
    place = _at(content, rng)
    return content[:place] + rng.randbytes(rng.randrange(1, 32)) + content[place:]


BYTES = (_flip, _truncate, _number, _drop, _double, _noise)


def _text(content: bytes) -> str:
    return content.decode("utf-8", errors="replace")


def _other_value(content: bytes, rng: random.Random) -> bytes:
    """Another of the file's own quoted texts in one's place: names that cross, cycles, types that differ."""
    text = _text(content)
    quoted = re.findall(r'"[^"]*"', text)
    if not quoted:
        return content
    spots = list(re.finditer(r'"[^"]*"', text))
    spot = rng.choice(spots)
    new = rng.choice((rng.choice(quoted), f'"{rng.choice(WORDS)}"', f'"{rng.choice(NUMBERS)}"'))
    return (text[: spot.start()] + new + text[spot.end() :]).encode()


def _other_number(content: bytes, rng: random.Random) -> bytes:
    text = _text(content)
    spots = list(re.finditer(r"-?\d+(\.\d+)?(e-?\d+)?", text))
    if not spots:
        return content
    spot = rng.choice(spots)
    return (text[: spot.start()] + rng.choice(NUMBERS) + text[spot.end() :]).encode()


def _other_lines(content: bytes, rng: random.Random) -> bytes:
    lines = _text(content).splitlines(keepends=True) or [""]
    first, second = rng.randrange(len(lines)), rng.randrange(len(lines))
    match rng.randrange(4):
        case 0:
            lines[first], lines[second] = lines[second], lines[first]
        case 1:
            del lines[first]
        case 2:
            lines.insert(first, lines[second])
        case 3:
            lines[first] = lines[first] * rng.choice((2, 300))
    return "".join(lines).encode()


def _deeper(content: bytes, rng: random.Random) -> bytes:
    """Something within itself, many times."""
    text, count = _text(content), rng.choice((20, 300, 20000))
    place = _at(content, rng)
    opening, closing = rng.choice(
        (("[", "]"), ("{a=", "}"), ('<nodegraph name="g">', "</nodegraph>"), ("<", ">"), ('"', '"'))
    )
    return (text[:place] + opening * count + closing * count + text[place:]).encode()


TEXT = (_other_value, _other_value, _other_number, _other_number, _other_lines, _deeper)


Result = tuple[int | str, str]


def is_fault(result: Result) -> bool:
    """Whether a command ended in another way than with status 0, 1 or 2 and a word on why."""
    status, said = result
    return status not in (0, 1, 2) or "Traceback" in said or "mrm-nodes: unexpected" in said


@dataclass(frozen=True)
class Kind:
    """One kind of file: its seeds, and the commands that read it."""

    seeds: tuple[str, ...]
    commands: tuple[Callable[[str, str], list[str]], ...]


def _rendering(*others: str) -> Callable[[str, str], list[str]]:
    def command(file: str, out: str) -> list[str]:
        given = [other.replace("FILE", file) for other in others]
        return ["render", *given, "-o", f"{out}/x.png", "--size", "16x16", "--samples", "2"]

    return command


def _generating(target: str) -> Callable[[str, str], list[str]]:
    return lambda file, out: ["generate", file, "--target", target, "-o", f"{out}/shader"]


def _regressing(suite: str) -> Callable[[str, str], list[str]]:
    def command(file: str, out: str) -> list[str]:
        path = suite.replace("FILE", file)
        return [
            "regress",
            "--suite",
            path,
            "-o",
            f"{out}/report",
            "--no-cache",
            "--junit",
            f"{out}/junit.xml",
        ]

    return command


KINDS = {
    "mtlx": Kind(
        ("metal.mtlx", "pattern.mtlx", "pattern.mtlx"),
        (
            _rendering("FILE"),
            _rendering("FILE"),
            _generating("glsl"),
            _generating("osl"),
            _generating("mdl"),
            lambda file, out: ["suite", "check", str(Path(file).parent)],
            _regressing("one.toml"),
            _regressing("one.toml"),
            lambda file, out: ["retrofit", file, "-o", f"{out}/x.mtlx"],
        ),
    ),
    "toml": Kind(
        ("suite.toml",),
        (
            lambda file, out: ["suite", "check", file],
            lambda file, out: ["suite", "list", file],
            _regressing("FILE"),
            _regressing("FILE"),
        ),
    ),
    "exr": Kind(
        ("map.exr", "tiled.exr", "piz.exr"),
        (
            _rendering("flat.mtlx", "--env", "FILE", "--env-samples", "1"),
            _rendering("picture_exr.mtlx"),
        ),
    ),
    "hdr": Kind(("map.hdr",), (_rendering("flat.mtlx", "--env", "FILE", "--env-samples", "1"),)),
    "obj": Kind(("box.obj",), (_rendering("flat.mtlx", "--mesh", "FILE"),)),
    "glb": Kind(("triangle.glb",), (_rendering("flat.mtlx", "--mesh", "FILE"),)),
}

ONE = '[defaults]\nsize = 16\n[[case]]\nmaterial = "work/file.mtlx"\n'
FLAT = """<?xml version="1.0"?>
<materialx version="1.39">
  <constant name="c" type="color3"><input name="value" type="color3" value="0.5, 0.5, 0.5" /></constant>
  <output name="shown" type="color3" nodename="c" />
</materialx>
"""


@dataclass(frozen=True)
class Fault:
    """A command that ended in another way than it may."""

    kind: str
    number: int
    what: str

    def __str__(self) -> str:
        return f"{self.kind} {self.number}: {self.what}"


def run(folder: Path, numbers: dict[str, range]) -> tuple[list[Fault], dict[int, int]]:
    """Run the command line on mutated files of each kind; the faults, and how often each exit status came.

    The folder holds the last file of each kind that ended badly.
    """
    seeds = folder / "seeds"
    write_seeds(seeds)
    faults, statuses = [], {0: 0, 1: 0, 2: 0}
    victim = Victim()
    try:
        for kind, number in [(kind, number) for kind, each in numbers.items() for number in each]:
            arguments, path = prepare(folder, kind, number)
            result = victim.run(arguments)
            if is_fault(result):
                kept = folder / f"fault-{kind}-{number}.{kind}"
                kept.write_bytes(path.read_bytes())
                faults.append(Fault(kind, number, f"{result[0]} {' '.join(arguments)}: {result[1][-400:]}"))
            else:
                statuses[int(result[0])] += 1
    finally:
        victim.end()
    return faults, statuses


def prepare(folder: Path, kind: str, number: int) -> tuple[list[str], Path]:
    """Write one mutated file, and say which command reads it."""
    seeds, work = folder / "seeds", folder / "work"
    rng = random.Random(f"command {kind} {number}")
    chosen = KINDS[kind]
    seed = rng.choice(chosen.seeds)
    work.mkdir(exist_ok=True)
    for old in work.glob("*"):
        if old.is_file():
            old.unlink()
    for each in ("picture.png", "box.obj", "metal.mtlx", "pattern.mtlx"):
        if kind == "toml" or each == "picture.png":
            (work / each).write_bytes((seeds / each).read_bytes())
    path = work / f"file.{kind}"
    path.write_bytes(mutated((seeds / seed).read_bytes(), kind, number))
    (folder / "flat.mtlx").write_text(FLAT)
    (folder / "one.toml").write_text(ONE)
    (folder / "work" / "picture_exr.mtlx" if kind == "exr" else folder / "flat.mtlx").write_text(
        PATTERN.replace("picture.png", "file.exr") if kind == "exr" else FLAT
    )
    places = {name: str(folder / name) for name in ("flat.mtlx", "one.toml")}
    places["picture_exr.mtlx"] = str(work / "picture_exr.mtlx")
    arguments = rng.choice(chosen.commands)(str(path), str(folder / "out"))
    return [places.get(each, each) for each in arguments], path


class Victim:
    """A process that runs commands one after the other, and is replaced when one ends it.

    seconds: after which a command counts as hung.
    """

    def __init__(self, seconds: float = SECONDS) -> None:
        self._seconds = seconds
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other,), daemon=True)
        self._process.start()
        other.close()
        self._pipe.recv()

    def run(self, arguments: list[str], command: Callable[[list[str]], Any] | None = None) -> Result:
        """Exit status and what was said; `killed by N`, `hung` or `raised` where there is no status.

        command: what is called with the arguments, by default the command line.
        """
        self._pipe.send((command or _command_line, arguments))
        if not self._pipe.poll(self._seconds):
            self.end()
            self._start()
            return "hung", ""
        try:
            status, said = self._pipe.recv()
            return status, said
        except EOFError:
            self._process.join()
            ended = self._process.exitcode
            self._start()
            return f"killed by {ended}", ""

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def _serve(pipe: Connection) -> None:
    from mrm_nodes.regression.cases.workshop import Workshop
    from mrm_nodes.regression.run import runner as run
    from mrm_nodes.render import shared_renderer
    from mrm_nodes.render.context import BackendReport

    backend = shared_renderer().backend
    run.run_locally = functools.partial(_judge_one, Workshop(backend))  # type: ignore[attr-defined]
    run.probe_backends = lambda *asked: [BackendReport(backend, True)]  # type: ignore[attr-defined]
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    pipe.send("ready")
    while True:
        try:
            command, arguments = pipe.recv()
        except EOFError:
            return
        pipe.send(_call(command, arguments))


def _judge_one(
    workshop: Any, tasks: Sequence[Any], backend: str, scratch: Path, *others: object
) -> Iterator[Any]:
    """In place of worker processes, which would make a verdict of every fault: judge one small case, and here."""
    from mrm_nodes.regression.run.pool import Judged
    from mrm_nodes.regression.run.worker import JUDGES
    from mrm_nodes.regression.verdict.outcome import outcome_of

    small = [task for task in tasks if max(task.size) <= LARGEST and task.environment is None][:1]
    for number, task in enumerate(tasks):
        folder = scratch / str(number)
        folder.mkdir()
        outcome = outcome_of(task, backend, "error" if task in small else "skipped", message="one is enough")
        if task in small:
            try:
                JUDGES[task.kind](task, workshop, outcome, folder)
            except MrmError as error:
                outcome.message = str(error)
        yield Judged(task, outcome, folder)


def _command_line(arguments: list[str]) -> None:
    from mrm_nodes import cli

    cli.main(arguments)


def _call(command: Callable[[list[str]], Any], arguments: list[str]) -> Result:
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            command(arguments)
        except SystemExit as ended:
            return ended.code, said.getvalue()  # type: ignore[return-value]
        except BaseException:
            return "raised", traceback.format_exc()
    return "returned", said.getvalue()


def numbers_of(count: int) -> dict[str, range]:
    """So many mutations in all, most of them of materials."""
    shares = {"mtlx": 0.35, "toml": 0.2, "exr": 0.15, "hdr": 0.1, "obj": 0.1, "glb": 0.1}
    return {kind: range(round(count * share)) for kind, share in shares.items()}
