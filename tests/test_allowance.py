"""A document that would take the machine's memory, or time without end, costs a line and status 2, or its own case."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import BOX, FLAT, METAL

from mrm_nodes import allowance
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites import suitefile
from mrm_nodes.render.context import BACKENDS, probe_backends

PROGRAM = "from mrm_nodes.cli import main; main()"
# Mesa's software driver ends a loop after 65535 turns: that is for ever where there are pixels enough.
TURNS = "for (int mrm_i = 0; mrm_i != -1; mrm_i += 2) mrm_x = sin(mrm_x + {by});"
ENDLESS = """<?xml version="1.0"?>
<materialx version="1.39">
  <nodedef name="ND_own" node="own">
    <input name="in" type="vector2" value="0, 0" /><output name="out" type="color3" />
  </nodedef>
  <implementation name="IM_own" nodedef="ND_own" file="own.glsl" function="own" target="genglsl" />
  <texcoord name="uv" type="vector2" />
  <own name="turn" type="color3"><input name="in" type="vector2" nodename="uv" /></own>
  <output name="shown" type="color3" nodename="turn" />
</materialx>
"""
OWN = "void own(vec2 uv, out vec3 color)\n{\n    float mrm_x = uv.x;\n    %s\n    color = vec3(mrm_x);\n}\n"
SPOILT_VERTICES = """
import mrm_nodes.render.renderer as renderer

LOOP = "float mrm_x = 0.0; TURNS if (mrm_x > 0.999) gl_Position.x += 1.0;"
sound = renderer.mesh_stages

def spoilt(vertex, pixel):
    place = vertex.rindex("}")
    return sound(vertex[:place] + LOOP + vertex[place:], pixel)

renderer.mesh_stages = spoilt
""".replace("TURNS", TURNS.format(by="gl_Position.x"))
SUITE = """[defaults]
size = %d
mesh = "%s"
truth = "baseline"
[[case]]
material = ["endless.mtlx", "metal.mtlx"]
"""


@pytest.fixture
def folder(tmp_path):
    """Materials, and meshes of four vertices and of very many."""
    (tmp_path / "endless.mtlx").write_text(ENDLESS)
    (tmp_path / "own.glsl").write_text(OWN % TURNS.format(by="gl_FragCoord.x"))
    (tmp_path / "flat.mtlx").write_text(FLAT)
    (tmp_path / "metal.mtlx").write_text(METAL)
    (tmp_path / "box.obj").write_text(BOX)
    (tmp_path / "many.glb").write_bytes(many_triangles())
    return tmp_path


def many_triangles() -> bytes:
    """600,000 vertices, as the vertices of one take no time."""
    corners = np.random.default_rng(1).uniform(-1, 1, (600_000, 3)).astype("<f4").tobytes()
    tree = {
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": len(corners)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(corners)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 600_000, "type": "VEC3"}],
    }
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    chunks = (
        struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(corners), b"BIN\0") + corners
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def started(folder: Path, *arguments: str, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(folder), *filter(None, sys.path)]),
            **environment,
        },
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def ended(folder: Path, *arguments: str, **environment: str) -> tuple[int, list[str]]:
    """Status, and what was said on stderr but warnings."""
    process = started(folder, *arguments, **environment)
    _, said = process.communicate(timeout=300)
    lines = [line for line in said.splitlines() if not line.startswith("warning: ")]
    return process.returncode, lines


def failed(folder: Path, *limit: str) -> dict[str, Any]:
    """The cases, by name, of the folder's suite, run within a limit; the run says that some did not pass."""
    given = ("regress", "--suite", "suite.toml", "-o", "report", "--no-cache", "--jobs", "1")
    status, _ = ended(folder, *given, *limit)
    assert status == 1
    report = json.loads((folder / "report/report.json").read_text())
    return {each["name"]: each for each in report["cases"]}


def spoil_vertices(folder: Path) -> None:
    (folder / "sitecustomize.py").write_text(SPOILT_VERTICES)


@pytest.fixture(params=BACKENDS)
def backend(request):
    (probe,) = probe_backends(request.param)
    if not probe.works:
        is_required = request.param in os.environ.get("MRM_REQUIRE_BACKENDS", "").split(",")
        (pytest.fail if is_required else pytest.skip)(f"{request.param}: {probe.reason}")
    return request.param


def test_a_shader_that_never_ends_costs_render_one_line(folder, backend):
    given = (
        "render",
        "endless.mtlx",
        "-o",
        "x.png",
        "--mesh",
        "plane",
        "--size",
        "2048x2048",
        "--time-limit",
        "5",
    )
    status, said = ended(folder, *given, "--backend", backend)
    assert status == 2 and len(said) == 1
    assert said[0].startswith("mrm-nodes: no result within the time limit of 5 s")
    assert "a loop in its shader endless; --time-limit SECONDS" in said[0]
    assert not list(folder.glob("*.png"))


def test_so_does_one_whose_vertices_never_end(folder):
    given = (
        "render",
        "flat.mtlx",
        "-o",
        "x.png",
        "--mesh",
        "many.glb",
        "--size",
        "8x8",
        "--samples",
        "1",
        "--time-limit",
        "12",
    )
    assert ended(folder, *given)[0] == 0
    spoil_vertices(folder)
    (folder / "x.png").unlink()
    status, said = ended(folder, *given)
    assert status == 2 and len(said) == 1 and "time limit of 12 s" in said[0]
    assert not list(folder.glob("*.png"))


@pytest.mark.parametrize(("size", "mesh", "stage"), [(2048, "plane", "pixels"), (8, "many.glb", "vertices")])
def test_a_case_whose_shader_never_ends_costs_itself(size, mesh, stage, folder):
    if stage == "vertices":
        # Only the one case is to be spoilt: its mesh is, and metal has another.
        spoil_vertices(folder)
        (folder / "endless.mtlx").write_text(FLAT)
    text = SUITE % (size, mesh) + '[[adjust]]\ncases = "metal*"\nsize = 8\nmesh = "box.obj"\n'
    (folder / "suite.toml").write_text(text)
    cases = failed(folder, "--time-limit", "7")
    endless = cases.pop("endless")
    assert endless["verdict"] == "error" and endless["fault"] == "time"
    assert endless["message"] == "no result within the time limit of 7 s, twice"
    # The other one was drawn: all that it lacks is a baseline.
    (other,) = cases.values()
    assert "no baseline" in other["message"] and other["files"]["render_data"]


def test_render_takes_no_more_memory_than_it_may(folder):
    given = ("render", "flat.mtlx", "-o", "x.exr", "--mesh", "plane", "--size", "6000x6000")
    status, said = ended(folder, *given, "--memory-limit", "900")
    assert status == 2 and len(said) == 1, said
    assert "memory" in said[0] and "unexpected" not in said[0]
    assert not list(folder.glob("*.exr"))


def test_nor_does_a_case(folder):
    (folder / "suite.toml").write_text(SUITE % (6000, "plane") + '[[adjust]]\ncases = "metal*"\nsize = 8\n')
    (folder / "endless.mtlx").write_text(FLAT)
    cases = failed(folder, "--memory-limit", "900")
    large = cases.pop("endless")
    assert large["verdict"] == "error" and large["fault"] in ("memory", "worker")
    (other,) = cases.values()
    assert "no baseline" in other["message"]


def test_a_crash_is_one_line_too(folder):
    (folder / "sitecustomize.py").write_text(
        "import os, mrm_nodes.shadergen as s\ns.generate_shader = lambda *a, **k: os.abort()\n"
    )
    status, said = ended(folder, "generate", "flat.mtlx", "--target", "glsl", "-o", "out")
    assert status == 2
    assert "ended by signal 6 (SIGABRT): a crash in MaterialX or the driver" in said[-1]


@pytest.mark.parametrize(("number", "status"), [(signal.SIGTERM, -signal.SIGTERM), (signal.SIGINT, 130)])
def test_a_signal_ends_both_processes(number, status, folder):
    (folder / "sitecustomize.py").write_text(
        "import os, pathlib, time, mrm_nodes.shadergen as s\n"
        "def wait(*a, **k):\n    pathlib.Path('pid').write_text(str(os.getpid()))\n    time.sleep(120)\n"
        "s.generate_shader = wait\n"
    )
    process = started(folder, "generate", "flat.mtlx", "--target", "glsl", "-o", "out")
    until = time.monotonic() + 60
    while not (folder / "pid").exists() or not (folder / "pid").read_text():
        assert time.monotonic() < until and process.poll() is None
        time.sleep(0.05)
    worker = int((folder / "pid").read_text())
    assert worker != process.pid
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == status
    assert not Path(f"/proc/{worker}").exists()


def test_what_processes_share_is_three_quarters_of_the_memory(monkeypatch):
    assert allowance.usual_memory(2) <= allowance.usual_memory(1)
    assert allowance.usual_memory(1000) == 2048
    monkeypatch.setattr(allowance, "_CONTROL_GROUPS", ())
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert allowance.usual_memory(1) == max(2048, total * 3 // 4 >> 20)


def test_a_container_has_less(tmp_path, monkeypatch):
    limit = tmp_path / "memory.max"
    monkeypatch.setattr(allowance, "_CONTROL_GROUPS", (str(limit),))
    limit.write_text("max\n")
    whole = allowance.usual_memory(1)
    limit.write_text(f"{4 << 30}\n")
    assert allowance.usual_memory(1) == min(whole, 3072)


def test_a_value_that_the_evaluator_does_not_know_is_named_with_its_node(tmp_path, backend):
    (tmp_path / "metal.mtlx").write_text(METAL.replace('value="0.2, 0.9, 1.1"', 'value="0.2, 0.9, 1e20"'))
    (tmp_path / "suite.toml").write_text('[defaults]\nsize = 8\n[[case]]\nmaterial = "metal.mtlx"\n')
    (case,) = suitefile.load(tmp_path / "suite.toml").cases
    outcome = Worker(backend).run(case, tmp_path / "out")
    assert outcome.verdict == "error"
    assert outcome.message.startswith("b: the evaluator: ior must be finite, above 0 and at most 1e+06")
