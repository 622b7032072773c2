"""Frames in which the mesh turns or the light moves: what moves, at one exposure, and the files of it."""

from __future__ import annotations

import gc
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from mrm_nodes.render import (
    DirectionalLight,
    Mesh,
    PointLight,
    Renderer,
    SpotLight,
    baluster,
    parse_camera,
    probe_backends,
    read_image,
)
from mrm_nodes.render.environment import Environment, EnvironmentTextures, sky
from mrm_nodes.render.picture import Picture
from mrm_nodes.render.sweep import light_sweep, turntable
from mrm_nodes.shadergen import generate_shader

BACKENDS = [probe.backend for probe in probe_backends() if probe.works]
BSDF = """<?xml version="1.0"?><materialx version="1.39">
  <mrm_conductor_bsdf name="b" type="BSDF">
    <input name="roughness" type="vector2" value="0.1, 0.1" />
    <input name="retroreflectivity" type="float" value="0.8" />
  </mrm_conductor_bsdf>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial></materialx>"""


@pytest.fixture
def tape(tmp_path: Path) -> Path:
    path = tmp_path / "tape.mtlx"
    path.write_text(BSDF)
    return path


def test_the_light_starts_at_the_camera_and_keeps_its_distance():
    camera, center = parse_camera("2,1.5,3:0.1,0,0:up=0.2,1,0"), (0.1, 0.0, 0.0)
    view = np.subtract(camera.position, center)
    angles = []
    for frame in light_sweep(5, camera, center, None):
        (light,) = frame.lights
        toward = np.subtract(light.position, center)
        assert np.linalg.norm(toward) == pytest.approx(np.linalg.norm(view))
        cosine = toward @ view / np.linalg.norm(view) ** 2
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        assert frame.label == f"{angles[-1]:.3g}°" or angles[-1] < 1e-5
    assert np.allclose(angles, 60 * np.array([0, 1 / 16, 1 / 4, 9 / 16, 1]), atol=1e-5)


def turned_mesh(mesh: Mesh, degrees: float) -> Mesh:
    angle = np.radians(degrees)
    c, s = np.cos(angle), np.sin(angle)
    matrix = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    center = np.array(mesh.center)
    return replace(
        mesh,
        positions=((mesh.positions - center) @ matrix.T + center).astype(np.float32),
        normals=(mesh.normals @ matrix.T).astype(np.float32),
        tangents=(mesh.tangents @ matrix.T).astype(np.float32),
    )


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_a_turntable_is_the_mesh_turned_under_the_same_lights(backend, tape):
    if backend not in BACKENDS:
        pytest.skip(f"no {backend} here")
    shader, renderer = generate_shader(tape), Renderer(backend)
    mesh = replace(baluster(), positions=baluster().positions + np.float32([0.3, 0, 0.2]))
    camera = parse_camera("0.8,0.5,3.2:0.3,0,0.2")
    lights = [
        DirectionalLight((-1, -1, -0.3)),
        PointLight((2, 1, 3), (1.0, 0.5, 0.2)),
        SpotLight((-3, 1, 2), (1, -0.2, -0.6)),
    ]
    environment = replace(sky(), samples=4, rotation=20.0)
    still = renderer.render(shader, mesh, camera, lights, (24, 24), environment=environment)
    for frame, degrees in zip(
        turntable(3, camera, lights, mesh.center, environment), (0, 120, 240), strict=True
    ):
        seen = renderer.render(
            shader, mesh, frame.camera, frame.lights, (24, 24), environment=frame.environment
        )
        truth = renderer.render(
            shader, turned_mesh(mesh, degrees), camera, lights, (24, 24), environment=environment
        )
        both = seen.mask & truth.mask
        assert both.sum() > 60 and (seen.mask ^ truth.mask).sum() < 6
        difference = np.abs(seen.image - truth.image)[both] / (1e-2 + truth.image[both])
        assert np.quantile(difference, 0.9) < 2e-2
    assert np.quantile(np.abs(still.image - seen.image)[both] / (1e-2 + seen.image[both]), 0.9) > 0.1


@pytest.mark.skipif(not BACKENDS, reason="no backend works")
def test_frames_of_a_light_sweep_have_one_exposure_and_are_written_together(run, tape, tmp_path):
    folder = tmp_path / "out"
    outputs = [each for name in ("a.png", "a.exr", "a.webp", "a.apng") for each in ("-o", folder / name)]
    status, out, err = run(
        *("render", tape, *outputs, "--light-sweep", "4", "--size", "32", "--samples", "2"),
        "--background",
        "black",
    )
    assert status == 0, err
    frames = [f"a.{number:02}.{ending}" for number in (1, 2, 3, 4) for ending in ("png", "exr")]
    names = sorted([*frames, "a.png", "a.webp", "a.apng"])
    assert sorted(path.name for path in folder.iterdir()) == names
    assert sorted(out.split()) == sorted(str(folder / name) for name in names)
    assert err.startswith("4 frames: exposure ") and err.count("\n") == 1
    pictures = [read_image(folder / f"a.{number:02}.png") for number in (1, 2, 3, 4)]
    assert all(before.mean() > after.mean() for before, after in pairwise(pictures))
    said = {
        oiio.ImageInput.open(str(folder / name)).spec().getattribute("mrm:exposure")
        for name in ("a.01.png", "a.02.png", "a.04.png", "a.png")
    }
    assert len(said) == 1
    assert read_image(folder / "a.png").shape[0] > 64
    for name in ("a.webp", "a.apng"):
        with Image.open(folder / name) as film:
            assert film.n_frames == 6 and film.size == (32, 32)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--turntable", "1"], "turntable: 1 frames; it takes 2 to 360"),
        (["--light-sweep", "361"], "light sweep: 361 frames"),
        (["--turntable", "2", "--light-sweep", "2"], "one of them at a time"),
        (["--light-sweep", "2", "--light", "camera"], "leave out --light"),
        (["-o", "b.webp"], "b.webp: unknown image ending .webp; use .exr or .png, or name frames with"),
        (["-o", "a.png"], "a.png: named twice"),
        (["--turntable", "two"], "Invalid value for '--turntable'"),
        (["-o", "c.png", "-o", "c.01.png", "--turntable", "2"], "c.01.png: would be written twice, as a frame"),
        (["-o", "sub/../a.png", "--turntable", "2"], "/a.png: would be written twice, as -o a.png and"),
        (["-o", "a.webp", "--turntable", "2", "--size", "16384x1"], "a.webp: size 16384x1: a .webp has 16383 pixels"),
        (["--turntable", "1000000000"], "turntable: 1000000000 frames"),
    ],
)  # fmt: skip
def test_a_bad_request_is_one_line_and_writes_nothing(run, tape, tmp_path, monkeypatch, arguments, message):
    folder = tmp_path / "empty"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.setattr("mrm_nodes.render.renderer.render", None)
    status, out, err = run("render", tape, "-o", "a.png", *arguments)
    assert status == 2 and message in err and err.count("\n") == 1 and out == ""
    assert not list(folder.iterdir())


def exposure_of(path: Path) -> float:
    return float(oiio.ImageInput.open(str(path)).spec().getattribute("mrm:exposure"))


@pytest.mark.skipif(not BACKENDS, reason="no backend works")
def test_a_frame_in_which_nothing_is_lit_leaves_the_exposure_to_the_others(run, tape, tmp_path):
    """A plane is seen edge-on twice as it turns."""
    given = ["--mesh", "plane", "--size", "16", "--samples", "1"]
    dim = ["--light", "camera:1e-3,1e-3,1e-3"]
    assert run("render", tape, "-o", tmp_path / "one.png", *given, *dim)[0] == 0
    status, _, err = run("render", tape, "-o", tmp_path / "a.png", *given, *dim, "--turntable", "4")
    assert status == 0, err
    assert exposure_of(tmp_path / "one.png") > 2
    assert exposure_of(tmp_path / "a.02.png") == exposure_of(tmp_path / "a.png") > 2
    dark = ["--light", "camera:0,0,0"]
    status, _, err = run("render", tape, "-o", tmp_path / "a.png", *given, *dark, "--turntable", "2")
    assert status == 0 and exposure_of(tmp_path / "a.png") == 0
    assert err.startswith("2 frames: exposure +0.00 stops") and err.endswith("none of lit pixels clipped\n")


@pytest.mark.skipif(not BACKENDS, reason="no backend works")
def test_frames_are_kept_as_eight_bits_and_the_most_clipped_is_said(run, tape, tmp_path, monkeypatch):
    alive = []

    def count(*_, **__) -> np.ndarray:
        gc.collect()
        alive.append(sum(type(each) is Picture for each in gc.get_objects()))
        return np.zeros((4, 4, 3), np.uint8)

    gc.collect()
    before = sum(type(each) is Picture for each in gc.get_objects())
    monkeypatch.setattr("mrm_nodes.render.sheet.contact_sheet", count)
    outputs = ["-o", tmp_path / "a.png"]
    given = ["--size", "16", "--samples", "1", "--exposure", "12", "--light-sweep", "5"]
    status, _, err = run("render", tape, *outputs, *given)
    assert status == 0 and alive[0] - before <= 1
    assert err.endswith("100 % of lit pixels clipped at most\n")


@pytest.mark.skipif(not BACKENDS, reason="no backend works")
def test_frames_that_are_all_exr_are_drawn_once_each(run, tape, tmp_path, monkeypatch):
    drawn = []
    draw = Renderer.render
    monkeypatch.setattr(Renderer, "render", lambda *a, **k: drawn.append(1) or draw(*a, **k))
    monkeypatch.delattr("mrm_nodes.render.picture.Developer.add")
    status, out, err = run(
        "render", tape, "-o", tmp_path / "a.exr", "--turntable", "2", "--size", "8", "--samples", "3"
    )
    assert status == 0, err
    assert len(drawn) == 6 and err == "" and len(out.split()) == 2


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_a_turntable_s_map_is_on_the_gpu_once(backend, tape, monkeypatch):
    if backend not in BACKENDS:
        pytest.skip(f"no {backend} here")
    uploads = []
    upload = EnvironmentTextures.upload
    monkeypatch.setattr(
        EnvironmentTextures, "upload", lambda *given: uploads.append(1) or upload(*given), raising=True
    )
    radiance = np.random.default_rng(3).random((8, 16, 3)).astype(np.float32)
    around = Environment(radiance, samples=4)
    shader, mesh = generate_shader(tape), baluster()
    frames = turntable(3, parse_camera("0,0,3"), [], mesh.center, around)
    assert all(each.environment.radiance is around.radiance for each in frames)
    with Renderer(backend) as renderer:
        turned = [
            renderer.render(shader, mesh, environment=each.environment, size=(8, 8)).image for each in frames
        ]
        assert len(uploads) == 1
        copies = [replace(around, rotation=each.environment.rotation) for each in frames]
        again = [renderer.render(shader, mesh, environment=each, size=(8, 8)).image for each in copies]
    assert len(uploads) == 4 and np.array_equal(turned, again)
    assert not np.array_equal(turned[0], turned[1])
