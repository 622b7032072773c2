"""The command line: what it prints, what it writes, and how it ends."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mrm_nodes.library import materials_path, own_libraries
from mrm_nodes.regression.run.runner import required_backends
from mrm_nodes.render.context import probe_backends
from mrm_nodes.render.images import read_image

TAPE = sorted(materials_path().glob("*.mtlx"))[0]


@pytest.fixture(scope="module")
def backend():
    """The first backend that works."""
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working and required_backends():
        pytest.fail("no backend works")
    return working[0] if working else pytest.skip("no backend works")


def fault(run, *arguments):
    """A command that must end with status 2 and one line on stderr: the line."""
    status, _, err = run(*arguments)
    assert status == 2, err
    assert err.startswith("mrm-nodes: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def test_help_names_every_command(run):
    status, out, _ = run("--help")
    assert status == 0
    for command in ("doctor", "regress", "render", "generate", "install"):
        assert command in out


def test_help_is_quick_because_nothing_heavy_is_imported():
    heavy = "{'numba', 'MaterialX', 'moderngl', 'OpenImageIO', 'numpy'}"
    code = f"import sys, mrm_nodes.cli; sys.exit(bool({heavy} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_the_package_is_the_command():
    done = subprocess.run([sys.executable, "-m", "mrm_nodes", "--help"], capture_output=True, text=True)
    assert done.returncode == 0
    assert done.stdout.startswith("Usage: mrm-nodes")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["regres"], "No such command 'regres'"),
        (["regress", "--jobs", "none"], "Invalid value for '--jobs'"),
        (["regress", "--suite", "nightly"], "unknown suite nightly: it is `default`, `full`, a .toml file"),
        (["regress", "--filter", "no-such-case"], "no case matches no-such-case"),
        (["regress", "--filter", "figure5", "--backend", "glx"], "unknown backend glx; known: auto, all, egl"),
        (["doctor", "--backend", "glx"], "unknown backend glx; known: auto, egl, osmesa"),
        (["render", "missing.mtlx", "-o", "out.exr"], "missing.mtlx: no such file"),
        (["render", TAPE, "-o", "out.jpeg"], "out.jpeg: unknown image ending .jpeg; use .exr or .png"),
        (["render", TAPE, "-o", "out.exr", "--size", "big"], "size big: write width and height as 640x480"),
        (["render", TAPE, "-o", "out.exr", "--size", "0x5"], "size 0x5: each side is 1 to 16384 pixels"),
        (["render", TAPE, "-o", "out.exr", "--light", "laser"], "unknown light laser"),
        (["render", TAPE, "-o", "out.exr", "--mesh", "pot.ply"], "pot.ply: unknown mesh"),
        (["render", TAPE, "-o", "out.exr", "--camera", "0,0,nan"], "camera"),
        (["render", TAPE, "-o", "out.exr", "--element", "nothing"], "unknown element nothing"),
        (["generate", TAPE, "--target", "hlsl", "-o", "out"], "unknown target hlsl"),
        (["install", "missing"], "missing: no such folder"),
    ],
    ids=lambda value: "-".join(map(str, value[:2])) if isinstance(value, list) else "",
)  # fmt: skip
def test_bad_input_is_one_line_and_leaves_nothing(run, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    assert message in fault(run, *arguments)
    assert [path.name for path in tmp_path.iterdir()] in ([], ["report"])
    assert not list(tmp_path.glob("report/*"))


@pytest.mark.parametrize("text", ["", "<materialx", "not xml", '<materialx version="1.39"><a/></materialx>'])
def test_a_document_that_is_none_is_named(run, tmp_path, text):
    broken = tmp_path / "broken.mtlx"
    broken.write_text(text)
    assert "broken.mtlx" in fault(run, "render", broken, "-o", tmp_path / "out.exr")
    assert "broken.mtlx" in fault(run, "generate", broken, "--target", "glsl", "-o", tmp_path / "out")
    assert not (tmp_path / "out.exr").exists()


@pytest.mark.parametrize("command", ["render", "generate", "regress"])
def test_an_output_that_cannot_be_written_changes_nothing(run, tmp_path, command):
    there = tmp_path / "file"
    there.write_text("kept")
    arguments = {
        "render": ["render", TAPE, "-o", there / "out.exr"],
        "generate": ["generate", TAPE, "--target", "glsl", "-o", there],
        "regress": ["regress", "--filter", "figure5", "-o", there],
    }[command]
    assert "cannot be written" in fault(run, *arguments)
    assert there.read_text() == "kept"


def test_a_warning_is_one_line_and_the_work_goes_on(run, tmp_path):
    document = tmp_path / "tape.mtlx"
    document.write_text(
        '<materialx version="1.39"><mrm_conductor_bsdf name="b" type="BSDF">'
        '<input name="retroreflectivity" type="float" value="1.5"/></mrm_conductor_bsdf>'
        '<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b"/></surface>'
        '<surfacematerial name="m" type="material">'
        '<input name="surfaceshader" type="surfaceshader" nodename="s"/></surfacematerial></materialx>'
    )
    status, out, err = run("generate", document, "--target", "glsl", "-o", tmp_path / "out")
    assert status == 0
    assert err.startswith("warning: ")
    assert "1.5 is clamped" in err
    assert err.count("\n") == 1
    assert len(out.splitlines()) == 2


def test_an_unexpected_error_is_one_line_too(run, monkeypatch):
    def broken(folder, environment):
        raise RuntimeError("out of\npaper")

    monkeypatch.setattr("mrm_nodes.library.install", broken)
    assert "unexpected RuntimeError: out of paper (MRM_TRACEBACK=1 shows where)" in fault(run, "install", ".")


def test_output_that_finds_no_room_is_one_line():
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "mrm_nodes", "suite", "list", TAPE.parent],
            stdout=full,
            stderr=subprocess.PIPE,
        )
    assert done.returncode == 2
    assert done.stderr.startswith(b"mrm-nodes: a file or stdout: No space left on device")


@pytest.mark.parametrize(("target", "count"), [("glsl", 2), ("osl", 1), ("wgsl", 2)])
def test_generate_writes_and_names_its_files(run, tmp_path, target, count):
    status, out, _ = run("generate", TAPE, "--target", target, "-o", tmp_path / "shaders")
    assert status == 0
    files = [Path(line) for line in out.splitlines()]
    assert len(files) == count
    assert sorted(files) == sorted((tmp_path / "shaders").iterdir())
    assert all(file.read_text() for file in files)


def test_install_puts_the_library_into_a_libraries_folder(run, tmp_path):
    libraries = tmp_path / "libraries"
    shutil.copytree(own_libraries(), libraries)
    status, out, _ = run("install", libraries)
    assert status == 0
    assert out.strip().endswith(f"files in {libraries / 'mrm'}")
    assert list((libraries / "mrm").rglob("*.glsl"))


@pytest.mark.parametrize("ending", ["exr", "png"])
def test_render_writes_an_image(run, backend, tmp_path, ending):
    image = tmp_path / "new" / f"tape.{ending}"
    arguments = ["--size", "40x30", "--light", "camera", "--light", "point:0,3,3", "--backend", backend]
    status, _, err = run("render", TAPE, "-o", image, *arguments)
    assert status == 0, err
    pixels = read_image(image)
    assert pixels.shape == (30, 40, 4)
    assert pixels[..., :3].max() > 0.05


def test_doctor_says_what_works(run, backend):
    status, out, _ = run("doctor")
    assert status == 0
    for word in ("versions", "library", "glsl", "mdl", "egl", "osmesa", f"render    works on {backend}"):
        assert word in out


def test_regress_writes_a_report_and_says_where(run, backend, tmp_path):
    folder = tmp_path / "report"
    status, out, err = run(
        "regress", "-o", folder, "--backend", backend, "--filter", "conductor-figure5-0deg-*"
    )
    assert status == 0, out + err
    assert "2 passed of 2" in out
    assert str(folder / "index.html") in out
    report = json.loads((folder / "report.json").read_text())
    assert report["summary"]["passed"] == 2
    assert report["environment"]["backends"].keys() == {backend}
    assert os.access(folder / report["cases"][0]["files"]["render"], os.R_OK)
