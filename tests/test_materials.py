"""The finished materials: valid, generated for every target, and bright with the light at the camera."""

from __future__ import annotations

import functools
import json
import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import numpy as np
import pytest
from numpy.typing import NDArray

import mrm_nodes
from mrm_nodes.commands.photometry import spread
from mrm_nodes.documents import read_document
from mrm_nodes.library import materials_path
from mrm_nodes.photometry import SheetPoints, check, read_sheet
from mrm_nodes.render import CameraLight, PointLight, RenderedImage, render

MATERIALS = sorted(path.stem for path in materials_path().glob("*.mtlx"))
OUR_NODES = {"mrm_conductor_bsdf", "mrm_dielectric_bsdf", "mrm_generalized_schlick_bsdf"}
DEFINITIONS = mrm_nodes.library_path() / "mrm_defs.mtlx"
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

each_material = pytest.mark.parametrize("name", MATERIALS)


def file_of(name: str) -> Path:
    return materials_path() / f"{name}.mtlx"


@functools.cache
def own_document(name: str) -> mx.Document:
    """The file's own elements, without any library's."""
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(file_of(name)))
    return document


def our_node(document: mx.Document) -> mx.Node:
    (node,) = (node for node in document.getNodes() if node.getCategory() in OUR_NODES)
    return node


def mxvalidate(file: Path) -> str:
    """What MaterialX's own validator prints; its exit status is 0 whatever it found."""
    # Later releases load the standard libraries unasked.
    options = ["--stdlib"] if mx.getVersionIntegers() < (1, 39, 5) else []
    command = [sys.executable, "-m", "MaterialX._scripts.mxvalidate", str(file), *options]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout


def test_there_is_a_material_for_each_use_that_the_readme_names():
    assert {"hi_vis_tape", "traffic_cone", "road_paint", "chevron_sign", "number_plate"} <= set(MATERIALS)


@pytest.mark.parametrize("file", [DEFINITIONS, *map(file_of, MATERIALS)], ids=lambda file: file.stem)
def test_mxvalidate_calls_it_valid(file: Path):
    assert mxvalidate(file).startswith(f"{file} is a valid MaterialX document")


@pytest.mark.parametrize(
    ("file", "sound", "broken"),
    [
        (file_of("traffic_cone"), 'nodename="traffic_cone_body"', 'nodename="nobody"'),
        (file_of("road_paint"), 'output="roughness"', 'output="base_color"'),
        (DEFINITIONS, 'value="0.05, 0.05"', 'value="0.05"'),
    ],
    ids=["a node that does not exist", "an output of another type", "one number for two"],
)
def test_mxvalidate_rejects_a_broken_copy(tmp_path: Path, file: Path, sound: str, broken: str):
    text = file.read_text()
    assert sound in text
    copy = tmp_path / file.name
    copy.write_text(text.replace(sound, broken))
    assert f"{copy} is not a valid MaterialX document" in mxvalidate(copy)


@each_material
def test_it_is_valid_beside_the_loaded_library(name: str):
    assert read_document(file_of(name)).validate() == (True, "")


def test_all_of_them_are_valid_together_with_the_library():
    document = mrm_nodes.load_library()
    for name in MATERIALS:
        material = mx.createDocument()
        mx.readFromXmlFile(material, str(file_of(name)))
        document.importLibrary(material)  # skips a name that is taken
    assert len(document.getMaterialNodes()) == len(MATERIALS)
    assert sum(node.getCategory() in OUR_NODES for node in document.getNodes()) == len(MATERIALS)
    assert document.validate() == (True, "")


@each_material
def test_it_has_exactly_one_renderable_of_its_own_name(name: str):
    renderables = mx_gen_shader.findRenderableElements(read_document(file_of(name)))
    assert [renderable.getName() for renderable in renderables] == [name]


@each_material
@pytest.mark.parametrize("target", mrm_nodes.supported_targets())
def test_it_generates_for_every_target(name: str, target: str):
    assert mrm_nodes.generate_shader(file_of(name), target).pixel


@each_material
def test_one_textured_node_does_it_and_no_image_file(name: str):
    document = own_document(name)
    weight = our_node(document).getInput("retroreflectivity")
    assert weight.hasNodeGraphString()
    for element in document.traverseTree():
        assert element.getCategory() != "mix" or element.getType() != "BSDF"
        assert not (isinstance(element, mx.Input) and element.getType() == "filename")


@each_material
def test_every_public_input_says_what_it_is(name: str):
    (graph,) = own_document(name).getNodeGraphs()
    assert graph.getInputs()
    for each in graph.getInputs():
        assert each.getAttribute("doc") and each.getAttribute("uiname"), each.getNamePath()


@each_material
def test_the_lobe_is_as_narrow_as_a_retroreflector_s(name: str):
    """Measured tape has alpha 0.053, and real sheeting goes down to 0.007."""
    roughness = our_node(own_document(name)).getInput("roughness")
    if not roughness.hasNodeGraphString():
        alphas = roughness.getValue()
        assert 0.005 <= min(alphas[0], alphas[1]) <= 0.1


@functools.cache
def rendered(name: str, degrees: float) -> RenderedImage:
    """The material on the sphere, with the light so far beside the camera."""
    size = (128, 128)
    if degrees == 0.0:
        return render(file_of(name), lights=CameraLight(), size=size)
    distance, angle = rendered(name, 0.0).camera.position[2], math.radians(degrees)
    position = (distance * math.sin(angle), 0.0, distance * math.cos(angle))
    return render(file_of(name), lights=PointLight(position, decay_rate=0.0), size=size)


@functools.cache
def weight_image(name: str) -> NDArray[Any]:
    """What the material's pattern gives the node, on the same pixels."""
    source = our_node(own_document(name)).getInput("retroreflectivity")
    element = f"{source.getNodeGraphString()}/{source.getOutputString()}"
    shader = mrm_nodes.generate_shader(file_of(name), element=element)
    return render(shader, size=(128, 128)).image[..., 0]


def view_cosine(seen: RenderedImage) -> NDArray[Any]:
    view = np.subtract(seen.camera.position, seen.position)
    return np.sum(view * seen.normal, axis=-1) / np.linalg.norm(view, axis=-1)


def mean_luminance(seen: RenderedImage, region: NDArray[np.bool_]) -> float:
    return float((seen.image[region] @ LUMINANCE).mean())


@pytest.mark.usefixtures("gl")
@each_material
@pytest.mark.parametrize(("low", "high"), [(0.8, 1.0), (0.4, 0.8)], ids=["facing the camera", "turned away"])
def test_the_retroreflective_part_blazes_over_all_of_the_visible_surface(name: str, low: float, high: float):
    at_camera, aside = rendered(name, 0.0), rendered(name, 30.0)
    cosine, weight = view_cosine(at_camera), weight_image(name)
    region = at_camera.mask & (weight > 0.5) & (cosine > low) & (cosine <= high)
    assert region.sum() > 100
    assert mean_luminance(at_camera, region) > 5.0 * mean_luminance(aside, region)


@pytest.mark.usefixtures("gl")
@each_material
def test_the_rest_of_the_surface_keeps_its_diffuse_colour(name: str):
    at_camera, aside = rendered(name, 0.0), rendered(name, 30.0)
    rest = at_camera.mask & (weight_image(name) < 0.001) & (view_cosine(at_camera) > 0.4)
    if rest.sum() > 100:
        assert 0.5 < mean_luminance(at_camera, rest) / mean_luminance(aside, rest) < 3.0


def wave(x: NDArray[Any]) -> NDArray[Any]:
    """MaterialX's `trianglewave`."""
    return np.abs(np.mod(x + 0.5, 1.0) - 0.5)


def sheeting(name: str, part: str) -> SheetPoints:
    """Points all over the part of a material that is a retroreflector, as flat as a plane."""
    sheet = read_sheet(file_of(name))
    uv = spread(((0.0, 0.0), (1.0, 1.0)), 4096)
    (graph,) = own_document(name).getNodeGraphs()

    def value(of: str) -> Any:
        return graph.getInput(of).getValue()

    if name == "hi_vis_tape":
        across = wave(uv[:, 1] * value("tapes") - 0.5) / (0.5 * value("tape_share"))
        inside = across < value("silver_share") - 0.01
    elif name == "chevron_sign":
        u, v = uv[:, 0] * value("chevrons")[0], uv[:, 1] * value("chevrons")[1]
        inside = wave(u - wave(v)) > 0.25
    elif name == "traffic_cone":
        height = (2.0 * uv[:, 1] - 1.0 - value("band_offset")) / value("band_spacing")
        inside = wave(height) < 0.5 * value("band_share") - 0.005
    elif name == "road_paint":
        inside = np.abs(2.0 * uv[:, 0] - 1.0) < 0.45 * value("line_width")
    else:
        # The plate from -1.75 to 1.75 and -0.5 to 0.5, its frame, and boxes about its five characters.
        x, y = np.moveaxis((np.mod(uv * value("plates"), 1.0) - 0.5) * (3.5, 1.0), -1, 0)
        character = np.abs(x[:, None] - (-0.97, -0.47, 0.03, 0.68, 1.16)).min(axis=-1) < 0.2
        unprinted = (np.abs(x) < 1.58) & (np.abs(y) < 0.41) & ~(character & (np.abs(y) < 0.29))
        inside = unprinted & (x < -1.35 if part == "blue" else x > -1.33)
    assert inside.sum() > 100
    return sheet.at(uv[inside])


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(
    ("name", "retro_class", "colour"),
    [
        ("hi_vis_tape", "ISO 20471", "white"),
        ("chevron_sign", "RA2", "yellow"),
        ("number_plate", "number plate", "white"),
        ("number_plate", "number plate", "blue"),
        ("traffic_cone", "RA1", "white"),
        ("road_paint", "EN 1436 dry", "white"),
    ],
)
def test_it_is_as_bright_as_its_class_asks_for(name: str, retro_class: str, colour: str):
    """The mean of its sheeting is, at each geometry; at one of them by little more."""
    rows = check(sheeting(name, colour), retro_class, colour)
    assert all(row.passes for row in rows), [(row.requirement.geometry, row.margin) for row in rows]
    assert min(row.margin for row in rows) < 0.5


@pytest.mark.usefixtures("gl")
def test_the_paint_is_bright_by_day_too():
    uv = spread(((0.35, 0.0), (0.65, 1.0)), 64)
    (row,) = check(read_sheet(file_of("road_paint")).at(uv), "EN 1436 Q3")
    assert row.passes


def documented() -> list[list[str]]:
    """The rows of the finished materials in docs/photometry.md: material, class, area, value, margin."""
    text = (Path(__file__).parents[1] / "docs" / "photometry.md").read_text()
    lines = text.split("## The finished materials")[1].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return rows[2:]


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("row", documented(), ids=lambda row: row[0])
def test_the_page_says_what_the_command_prints(row: list[str], run: Any):
    """The value within 1 %, and the margin as it is rounded."""
    material, retro_class, area, value, margin = row
    name, colour = retro_class.split(", ") if margin else ("", "")
    asked = ("--class", name, "--colour", colour) if margin else ("--geometry", "0.2,5")
    file = file_of(material.split("`")[1])
    status, out, err = run("photometry", file, *asked, "--uv", area.strip("`"), "--json")
    assert status == 0, err
    tree = json.loads(out)
    first = tree["rows"][0] if margin else tree["geometries"][0]
    assert value.startswith(first["quantity"])
    assert float(value.split()[1]) == pytest.approx(first["value"], rel=0.01)
    if margin:
        assert 100.0 * min(each["margin"] for each in tree["rows"]) == pytest.approx(
            float(margin.removesuffix(" %")), abs=0.6
        )


def test_each_material_is_on_the_page():
    assert {row[0].split("`")[1] for row in documented()} == set(MATERIALS)
