"""A user's material against the evaluator: what its graphs drive is rendered, and what it is made of is known."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mrm_nodes.documents import read_document
from mrm_nodes.errors import MrmError
from mrm_nodes.library import materials_path
from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase, with_values
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites.suitefile import DEFAULT_LIGHTS, load
from mrm_nodes.regression.truth import image_sum, physics
from mrm_nodes.regression.truth.closure import UnknownClosure, closure_of
from mrm_nodes.regression.verdict.outcome import Outcome
from mrm_nodes.regression.verdict.tolerance import Tolerance
from mrm_nodes.render import Framing, probe_backends, write_png
from mrm_nodes.render.environment import Environment
from mrm_nodes.shadergen import Shader

MATERIALS = sorted(path.stem for path in materials_path().glob("*.mtlx"))

SURFACE = """
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""


@pytest.fixture(scope="module")
def backend() -> str:
    working = [probe.backend for probe in probe_backends() if probe.works]
    return working[0] if working else pytest.skip("no backend works")


@pytest.fixture(scope="module")
def worker(backend: str) -> Worker:
    return Worker(backend)


def write(folder: Path, body: str, name: str = "a.mtlx") -> Path:
    path = folder / name
    path.write_text(f'<materialx version="1.39">{body}</materialx>')
    return path


def case_of(path: Path, **others: object) -> MaterialCase:
    """The one case of a material, small."""
    (case,) = (case for case in load(path.parent).cases if case.material == path.name)
    return replace(case, size=(64, 64), **others)  # type: ignore[arg-type]


def judged(worker: Worker, case: MaterialCase, folder: Path) -> Outcome:
    outcome = worker.run(case, folder)
    assert outcome.message == ""
    return outcome


@pytest.mark.parametrize("name", MATERIALS)
def test_each_finished_material_is_what_physics_says(name: str, worker: Worker, tmp_path: Path):
    outcome = judged(worker, case_of(materials_path() / f"{name}.mtlx"), tmp_path)
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")
    assert outcome.figures is not None and outcome.figures.lit > 2000


def test_the_side_of_a_mesh_that_no_light_reaches_is_dark_but_for_what_materialx_leaks(
    worker: Worker, tmp_path: Path
):
    case = case_of(materials_path() / "road_paint.mtlx", mesh="baluster")
    outcome = judged(worker, case, tmp_path)
    assert outcome.verdict == "pass"
    assert outcome.figures is not None and outcome.figures.lit < outcome.figures.pixels


def graph_on(name: str, kind: str) -> str:
    """A blended lobe whose input `name` follows a pattern."""
    scale = {"float": "0.5", "color3": "0.9, 0.5, 0.2", "vector2": "0.4, 0.2"}[kind]
    inputs = {
        "roughness": '<input name="roughness" type="vector2" value="0.3, 0.15" />',
        "retroreflectivity": '<input name="retroreflectivity" type="float" value="0.5" />',
        name: f'<input name="{name}" type="{kind}" nodename="driven" />',
    }
    return f"""
    <texcoord name="uv" type="vector2" />
    <noise2d name="pattern" type="float">
      <input name="texcoord" type="vector2" nodename="uv" /><input name="amplitude" type="float" value="0.3" />
      <input name="pivot" type="float" value="0.6" />
    </noise2d>
    <multiply name="driven" type="{kind}">
      <input name="in1" type="{kind}" value="{scale}" /><input name="in2" type="float" nodename="pattern" />
    </multiply>
    <mrm_generalized_schlick_bsdf name="b" type="BSDF">{"".join(inputs.values())}</mrm_generalized_schlick_bsdf>"""


@pytest.mark.parametrize(
    ("name", "kind"), [("color0", "color3"), ("roughness", "vector2"), ("retroreflectivity", "float")]
)
def test_an_input_that_a_graph_drives_is_taken_from_that_graph(
    name: str, kind: str, worker: Worker, tmp_path: Path
):
    outcome = judged(worker, case_of(write(tmp_path, graph_on(name, kind) + SURFACE)), tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")


TEXTURED = """
<tiledimage name="colour" type="color3">
  <input name="file" type="filename" value="colour.png" colorspace="srgb_texture" />
</tiledimage>
<tiledimage name="bumps" type="vector3">
  <input name="file" type="filename" value="bumps.png" />
  <input name="uvtiling" type="vector2" value="4, 2" />
</tiledimage>
<normalmap name="n" type="vector3"><input name="in" type="vector3" nodename="bumps" /></normalmap>
<mrm_generalized_schlick_bsdf name="b" type="BSDF">
  <input name="color0" type="color3" nodename="colour" />
  <input name="roughness" type="vector2" value="0.3, 0.2" />
  <input name="retroreflectivity" type="float" value="0.4" />
  <input name="normal" type="vector3" nodename="n" />
</mrm_generalized_schlick_bsdf>"""


@pytest.fixture(scope="module")
def textured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A material with a texture in sRGB and a normal map."""
    folder = tmp_path_factory.mktemp("textured")
    rng = np.random.default_rng(1)
    write_png(folder / "colour.png", rng.uniform(0.1, 0.9, (16, 16, 3)))
    slopes = np.stack([*rng.uniform(-0.2, 0.2, (2, 16, 16)), np.ones((16, 16))], axis=-1)
    write_png(folder / "bumps.png", (0.5 + 0.5 * slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)))
    return write(folder, TEXTURED + SURFACE)


def test_textures_and_normal_maps_need_no_second_implementation(
    textured: Path, worker: Worker, tmp_path: Path
):
    outcome = judged(worker, case_of(textured), tmp_path)
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")


def test_a_case_names_its_textures_so_that_a_change_is_noticed(textured: Path):
    assert {path.name for path in case_of(textured).files()} == {"a.mtlx", "bumps.png", "colour.png"}


COATED = """
<mrm_dielectric_bsdf name="coat" type="BSDF">
  <input name="retroreflectivity" type="float" value="0.5" />
</mrm_dielectric_bsdf>
<oren_nayar_diffuse_bsdf name="base" type="BSDF">
  <input name="roughness" type="float" value="0.5" />
</oren_nayar_diffuse_bsdf>
<layer name="b" type="BSDF">
  <input name="top" type="BSDF" nodename="coat" /><input name="base" type="BSDF" nodename="base" />
</layer>"""


@pytest.mark.parametrize(
    ("fault", "by"),
    [
        (r"(top\.response \+) base\.response", r"\1 0.999 * base.response"),
        (r"(void mx_oren_nayar_diffuse_bsdf\(.*\n\{)", r"\1 roughness = roughness * 1.01;"),
    ],
    ids=["a layer loses a thousandth", "a diffuse roughness is off"],
)
def test_a_fault_in_the_shader_fails(fault: str, by: str, worker: Worker, backend: str, tmp_path: Path):
    places: list[str] = []

    def plant(shader: Shader) -> Shader:
        places.extend(re.findall(fault, shader.pixel))
        return replace(shader, pixel=re.sub(fault, by, shader.pixel))

    case = case_of(write(tmp_path, COATED + SURFACE))
    assert judged(worker, case, tmp_path / "report").verdict == "pass"
    assert judged(Worker(backend, plant), case, tmp_path / "report").verdict == "fail"
    assert places, "the fault has no place in the shader"


def test_a_wrong_normal_map_fails(
    textured: Path, worker: Worker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The evaluator gets each lobe's own frame: with the mesh's normal, the reference is another."""

    original = physics.shading_frame
    kept: list[np.ndarray] = []

    def frame(position: object, normal: np.ndarray, *others: object) -> object:
        kept.append(normal)
        return original(position, np.full_like(normal, (0.0, 0.0, 1.0)), *others)

    monkeypatch.setattr(physics, "shading_frame", frame)
    outcome = worker.run(case_of(textured), tmp_path)
    assert kept and outcome.verdict == "fail"


CLOSURES = """
<conductor_bsdf name="metal" type="BSDF">
  <input name="roughness" type="vector2" value="0.1, 0.1" />
  <input name="retroreflective" type="boolean" value="true" />
</conductor_bsdf>
<generalized_schlick_bsdf name="film" type="BSDF">
  <input name="roughness" type="vector2" value="0.2, 0.2" />
  <input name="thinfilm_thickness" type="float" value="300" />
</generalized_schlick_bsdf>
<mix name="mixed" type="BSDF">
  <input name="fg" type="BSDF" nodename="metal" /><input name="bg" type="BSDF" nodename="film" />
  <input name="mix" type="float" value="0.3" />
</mix>
<multiply name="tinted" type="BSDF">
  <input name="in1" type="BSDF" nodename="mixed" /><input name="in2" type="color3" value="0.5, 2, 0.1" />
</multiply>
<oren_nayar_diffuse_bsdf name="chalk" type="BSDF">
  <input name="color" type="color3" value="1.3, 0.5, 0.2" colorspace="srgb_texture" />
  <input name="roughness" type="float" value="0.6" />
</oren_nayar_diffuse_bsdf>
<add name="both" type="BSDF">
  <input name="in1" type="BSDF" nodename="tinted" /><input name="in2" type="BSDF" nodename="chalk" />
</add>
<dielectric_bsdf name="coat" type="BSDF"><input name="weight" type="float" value="0.4" /></dielectric_bsdf>
<layer name="b" type="BSDF">
  <input name="top" type="BSDF" nodename="coat" /><input name="base" type="BSDF" nodename="both" />
</layer>"""


def test_materialx_s_own_nodes_mixed_added_multiplied_and_layered_are_known(worker: Worker, tmp_path: Path):
    outcome = judged(worker, case_of(write(tmp_path, CLOSURES + SURFACE)), tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")


def test_a_user_s_tolerance_takes_the_place_of_the_physical_bounds(worker: Worker, tmp_path: Path):
    path = write(tmp_path, CLOSURES + SURFACE)
    case = case_of(path, tolerance=Tolerance(max_rel=1e-2, flip=0.01))
    outcome = judged(worker, case, tmp_path / "report")
    assert outcome.verdict == "pass"
    assert outcome.tolerance == {"max_rel": 1e-2, "flip": 0.01}
    strict = replace(case, tolerance=Tolerance(max_rel=1e-12))
    assert judged(worker, strict, tmp_path / "report").verdict == "fail"


def test_a_value_of_a_matrix_is_a_uniform_and_gives_what_the_document_would(backend: str, tmp_path: Path):
    generated: list[str] = []

    def count(shader: Shader) -> Shader:
        generated.append(shader.name)
        return shader

    worker = Worker(backend, count)
    path = write(tmp_path, COATED + SURFACE)
    figures = [
        judged(worker, case_of(path, inputs={"coat/retroreflectivity": weight}), tmp_path / "report").figures
        for weight in (0.2, 0.9)
    ]
    assert generated == ["m"]
    assert figures[0] != figures[1]
    written = write(tmp_path, COATED.replace("0.5", "0.9", 1) + SURFACE)
    assert judged(worker, case_of(written), tmp_path / "report").figures == figures[1]


def test_a_mask_says_which_pixels_count(worker: Worker, tmp_path: Path):
    path = write(tmp_path, CLOSURES + SURFACE)
    half = np.zeros((64, 64))
    half[:, :32] = 1.0
    write_png(tmp_path / "mask.png", half)
    whole = judged(worker, case_of(path), tmp_path / "report")
    part = judged(worker, case_of(path, mask="mask.png"), tmp_path / "report")
    assert whole.figures is not None and part.figures is not None
    assert 2 * part.figures.pixels == whole.figures.pixels
    wrong = worker.run(replace(case_of(path, mask="mask.png"), size=(32, 32)), tmp_path / "report")
    assert wrong.verdict == "error" and "64 × 64" in wrong.message


ANISOTROPIC = """
<constant name="r" type="vector2"><input name="value" type="vector2" value="0.1, 0.4" /></constant>
<conductor_bsdf name="b" type="BSDF"><input name="roughness" type="vector2" nodename="r" /></conductor_bsdf>"""
CUTOUT = """
<texcoord name="uv" type="vector2" />
<extract name="u" type="float"><input name="in" type="vector2" nodename="uv" /></extract>
<mrm_conductor_bsdf name="b" type="BSDF" />"""


@pytest.mark.parametrize(
    ("body", "complaint"),
    [
        (ANISOTROPIC + SURFACE, "b/roughness is anisotropic"),
        (
            CUTOUT
            + SURFACE.replace("</surface>", '<input name="opacity" type="float" nodename="u" /></surface>'),
            "opacity is not 1",
        ),
    ],
    ids=["anisotropic", "cut out"],
)
def test_what_only_the_pixels_show_to_be_unknown_is_an_error_that_names_the_way_out(
    body: str, complaint: str, worker: Worker, tmp_path: Path
):
    outcome = worker.run(case_of(write(tmp_path, body)), tmp_path / "report")
    assert outcome.verdict == "error"
    assert complaint in outcome.message and 'truth = "baseline"' in outcome.message


def test_a_case_is_the_same_below_another_folder(textured: Path, worker: Worker, tmp_path: Path):
    here = case_of(textured)
    for path in here.files():
        target = tmp_path / "elsewhere" / path.relative_to(here.root)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(path.read_bytes())
    there = here.moved(tmp_path / "elsewhere")
    assert there.describe() == here.describe()
    first, second = (judged(worker, case, tmp_path / "report") for case in (here, there))
    assert first.figures == second.figures


def test_a_value_that_an_input_cannot_have_is_named(textured: Path):
    document = read_document(textured)
    for path, value, complaint in (
        ("b/roughness", 0.3, "is no vector2"),
        ("b/retroreflectivity", (0.1, 0.2), "is no float"),
        ("b/retroreflectivity", True, "is no float"),
        ("b/nothing", 1.0, "no input b/nothing"),
        ("b/rougness", 1.0, "did you mean b/roughness"),
    ):
        with pytest.raises(MrmError, match=re.escape(complaint)):
            with_values(document, {path: value}, "a.mtlx")


def test_the_lights_of_a_case_are_the_suite_s_and_none_where_it_says_so(textured: Path):
    assert case_of(textured).lights == DEFAULT_LIGHTS
    assert isinstance(case_of(textured).camera, Framing)


METAL = """
<mrm_conductor_bsdf name="b" type="BSDF">
  <input name="roughness" type="vector2" value="0.4, 0.3" />
  <input name="retroreflectivity" type="float" value="0.5" />
</mrm_conductor_bsdf>"""
STUDIO = EnvironmentMap("studio", (("samples", 64),))


AROUND = {
    "a metal": METAL + SURFACE,
    "a rough diffuse lobe": SURFACE.replace(
        "<surface ",
        """<oren_nayar_diffuse_bsdf name="b" type="BSDF">
      <input name="color" type="color3" value="0.8, 0.3, 0.1" /><input name="roughness" type="float" value="0.7" />
    </oren_nayar_diffuse_bsdf><surface """,
        1,
    ),
    "a compensated one": SURFACE.replace(
        "<surface ",
        """<oren_nayar_diffuse_bsdf name="b" type="BSDF">
      <input name="color" type="color3" value="0.8, 0.3, 0.1" /><input name="roughness" type="float" value="0.7" />
      <input name="energy_compensation" type="boolean" value="true" /></oren_nayar_diffuse_bsdf><surface """,
        1,
    ),
    "materialx's own, retroreflective": SURFACE.replace(
        "<surface ",
        """<dielectric_bsdf name="b" type="BSDF">
      <input name="roughness" type="vector2" value="0.3, 0.3" />
      <input name="retroreflective" type="boolean" value="true" /></dielectric_bsdf><surface """,
        1,
    ),
}


@pytest.mark.parametrize("body", AROUND.values(), ids=AROUND)
def test_an_environment_is_summed_as_the_shader_sums_it(worker: Worker, tmp_path: Path, body: str):
    case = replace(case_of(write(tmp_path, body), environment=STUDIO), size=(32, 32))
    outcome = judged(worker, case, tmp_path / "report")
    assert (outcome.truth, outcome.verdict) == ("physics", "pass")
    assert outcome.figures is not None and outcome.figures.notices is not None
    assert outcome.figures.notices < 1e-4
    beside = outcome.details["image_light"]
    assert beside["samples"] == 64
    assert 0 <= beside["rms_error"] < 0.02
    # Few samples blur a dark room with a few bright lamps.
    assert abs(beside["mean"]) < 0.4


def test_an_environment_that_is_turned_a_little_fails(
    worker: Worker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    original = image_sum.Surroundings.turned

    def turned(around: image_sum.Surroundings, vectors: NDArray[np.float64]) -> NDArray[np.float64]:
        return original(around, vectors) @ Environment(np.ones((1, 2, 3)), rotation=0.05).matrix[:3, :3]

    monkeypatch.setattr(image_sum.Surroundings, "turned", turned)
    case = replace(case_of(write(tmp_path, METAL + SURFACE), environment=STUDIO), size=(16, 16))
    assert judged(worker, case, tmp_path / "report").verdict == "fail"


@pytest.mark.parametrize("sheen", [False, True])
def test_the_evaluator_knows_gltf_without_sheen(tmp_path: Path, sheen: bool) -> None:
    colour = '<input name="sheen_color" type="color3" value="0, 0.5, 0" />' if sheen else ""
    file = tmp_path / "gltf.mtlx"
    file.write_text(
        f"""<materialx version="1.39">
  <mrm_gltf_pbr name="shaded" type="surfaceshader">{colour}</mrm_gltf_pbr>
  <surfacematerial name="tape" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="shaded" />
  </surfacematerial>
</materialx>
"""
    )
    document = read_document(file)
    if sheen:
        with pytest.raises(UnknownClosure, match="sheen_bsdf, which the evaluator does not know"):
            closure_of(document, "tape")
    else:
        assert "sheen" not in str(closure_of(document, "tape").tree)


def test_a_value_for_the_normal_is_passed_over_as_generators_do(worker: Worker, tmp_path: Path) -> None:
    body = """<mrm_standard_surface name="s" type="surfaceshader">
  <input name="normal" type="vector3" value="1, 0.5, 1" />
</mrm_standard_surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""
    write(tmp_path, body)
    (case,) = load(tmp_path).cases
    outcome = worker.run(replace(case, size=(32, 32)), tmp_path / "report")
    assert outcome.truth == "physics"
    assert outcome.verdict == "pass", outcome.figures
