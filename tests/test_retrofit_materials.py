"""Whole materials move over: ten that use every lobe, and those that packages bring."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import numpy as np
import pytest
from surface_lobes import (
    BLACK,
    EVERYTHING,
    base_specular,
    only_base_specular,
    random_values,
    with_our_departures,
)

import mrm_nodes
from mrm_nodes.documents import read_document
from mrm_nodes.elements import check_document
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.truth.reference_image import shade, shading_frame
from mrm_nodes.regression.verdict.compare import relative_error
from mrm_nodes.render import CameraLight, RenderedImage, probe_backends, render, write_exr
from mrm_nodes.shadergen import Shader
from mrm_nodes.surfaces import Surface, known_surfaces
from mrm_nodes.surfaces.rewrite import retrofit_file

MATERIALS = sorted((Path(__file__).parent / "surfaces").glob("*.mtlx"))

#: Packages that bring example materials; their tests run where they are installed.
PACKAGES = {"materialxgltf": "data", "materialxMaterials": "data/PhysicallyBasedMaterialX"}

#: How much brighter the rim is than the middle, at least: without a weight no material reaches it.
RIM = 1.5

needs_gl = pytest.mark.skipif(
    not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)
by_material = pytest.mark.parametrize("material", MATERIALS, ids=lambda path: path.stem)


def retrofitted(material: Path, folder: Path, weight: float) -> Path:
    text = material.read_text()
    surface = next(surface for surface in known_surfaces().values() if f"<{surface.node} " in text)
    target = folder / f"{material.stem}-{weight:g}.mtlx"
    retrofit_file(material, target, {surface.input: weight})
    return target


@by_material
def test_a_material_stays_valid_and_generates_for_every_target(material: Path, tmp_path: Path) -> None:
    path = retrofitted(material, tmp_path, 0.7)
    assert read_document(path).validate()[0]
    for target in mrm_nodes.supported_targets():
        assert mrm_nodes.generate_shader(path, target).pixel, target


@needs_gl
@by_material
def test_a_material_renders_and_shines_at_its_rim_with_the_light_at_the_camera(
    material: Path, tmp_path: Path
) -> None:
    rendered = drawn(reduced(retrofitted(material, tmp_path, 1.0)))
    assert np.isfinite(rendered.image).all()
    cosine = view_cosine(rendered)
    # A forward lobe dies away towards the rim; the retro lobe only with the masking.
    rim = (cosine > 0.4) & (cosine < 0.7)
    assert rendered.image[rim].mean() > RIM * rendered.image[cosine > 0.97].mean()


@needs_gl
@pytest.mark.parametrize("material", MATERIALS if EVERYTHING else MATERIALS[::4], ids=lambda path: path.stem)
def test_a_material_renders_as_before_until_it_is_given_a_weight(material: Path, tmp_path: Path) -> None:
    is_anisotropic = re.search("specular_(roughness_)?anisotropy", material.read_text()) is not None
    before, zero = (
        drawn(with_our_departures(reduced(path), is_anisotropic))
        for path in (material, retrofitted(material, tmp_path, 0.0))
    )
    # With a light at the camera, every point that is seen is lit; the silhouette is not compared.
    inside = view_cosine(before) > 0.1
    assert np.allclose(zero.image[inside], before.image[inside], rtol=2e-6, atol=1e-7)


def view_cosine(rendered: RenderedImage) -> np.ndarray:
    view = np.array(rendered.camera.position) - rendered.position
    cosine = np.sum(view * rendered.normal, -1) / np.maximum(np.linalg.norm(view, axis=-1), 1e-6)
    return np.where(rendered.mask, cosine, -1.0)


def reduced(material: Path) -> Shader:
    """Its GLSL with the values folded in: it compiles in a third of the time."""
    shader = mrm_nodes.generate_shader(material, max_lights=1, interface="reduced")
    if mx.getVersionIntegers() >= (1, 39, 4):
        return shader
    # The sheen of earlier releases computes with it where there is transmission, without giving it a value.
    return replace(shader, pixel=shader.pixel.replace("float dirAlbedo;", "float dirAlbedo = 0.0;"))


def drawn(shader: Shader) -> RenderedImage:
    return render(shader, "sphere", None, [CameraLight()], (48, 48), environment=BLACK)


by_surface = pytest.mark.parametrize("surface", list(known_surfaces().values()), ids=lambda s: s.node)


@needs_gl
@by_surface
def test_an_image_on_the_weight_drives_it_at_each_pixel(surface: Surface, tmp_path: Path) -> None:
    texels = np.random.default_rng(2).random((8, 8)).astype(np.float32)
    write_exr(tmp_path / "mask.exr", np.repeat(texels[..., None], 3, axis=-1))
    driver = """
      <image name="driver" type="float">
        <input name="file" type="filename" value="mask.exr" />
        <input name="filtertype" type="string" value="closest" />
      </image>"""

    def weight(uv: np.ndarray) -> np.ndarray:
        column, row = np.floor(uv * 8.0).astype(int).T
        return texels[7 - row, column]

    check_driven(surface, driver, weight, tmp_path)


@needs_gl
@by_surface
def test_a_pattern_on_the_weight_drives_it_at_each_pixel(surface: Surface, tmp_path: Path) -> None:
    driver = """
      <texcoord name="uv" type="vector2" />
      <extract name="driver" type="float">
        <input name="in" type="vector2" nodename="uv" />
        <input name="index" type="integer" value="0" />
      </extract>"""
    check_driven(surface, driver, lambda uv: uv[:, 0], tmp_path)


def check_driven(
    surface: Surface, driver: str, weight: Callable[[np.ndarray], np.ndarray], folder: Path
) -> None:
    """The plane with only the base specular, its weight driven by the node `driver`, is what the evaluator says."""
    values = only_base_specular(surface, random_values(surface.node, np.random.default_rng(1)), True, False)
    values |= {"specular_roughness": 0.6, "roughness": 0.6}
    known = mrm_nodes.load_library().getMatchingNodeDefs(surface.name)[0]
    types = {one.getName(): one.getType() for one in known.getActiveInputs()}
    inputs = "".join(
        f'<input name="{name}" type="{types[name]}" value="{", ".join(f"{x:.9g}" for x in np.atleast_1d(value))}" />'
        for name, value in values.items()
        if name in types
    )
    path = folder / "driven.mtlx"
    path.write_text(f"""<?xml version="1.0"?>
    <materialx version="1.39">{driver}
      <{surface.name} name="s" type="surfaceshader">{inputs}
        <input name="{surface.input}" type="float" nodename="driver" />
      </{surface.name}>
      <surfacematerial name="m" type="material">
        <input name="surfaceshader" type="surfaceshader" nodename="s" />
      </surfacematerial>
    </materialx>""")
    shader = mrm_nodes.generate_shader(path, max_lights=1, interface="reduced")
    drawing = render(shader, "plane", "0.4,0.3,2.5", [CameraLight()], (48, 48), environment=BLACK)
    # At the very edge of a texel, float32 may choose the other one.
    edge = np.abs((drawing.texcoord * 8.0 + 0.5) % 1.0 - 0.5).min(axis=-1)
    seen = drawing.mask & (edge > 1e-3)
    assert seen.mean() > 0.3
    position = drawing.position[seen]
    view, frame = shading_frame(
        position, drawing.normal[seen], drawing.tangent[seen], drawing.camera.position
    )
    specular = base_specular(surface, values, weight(drawing.texcoord[seen]))
    expected = shade(specular.bsdf, 1.0, view, frame, position, [CameraLight().data(drawing.camera)])
    assert (relative_error(drawing.image[seen], expected) <= 2e-5).all()
    assert np.ptp(expected) > 0.1 * expected.max()


def examples() -> list[Path]:
    found = []
    for package, folder in PACKAGES.items():
        spec = importlib.util.find_spec(package)
        for place in (spec.submodule_search_locations or []) if spec else []:
            found += [
                path
                for path in sorted((Path(place) / folder).glob("*.mtlx"))
                if re.search(
                    "<(open_pbr_surface|gltf_pbr|standard_surface) ", path.read_text(encoding="utf-8")
                )
            ]
    return found


@pytest.mark.filterwarnings("ignore::mrm_nodes.errors.MrmWarning")
@pytest.mark.parametrize("example", examples() or [None], ids=lambda path: path.stem if path else "none")
def test_examples_of_other_packages_move_over(example: Path | None, tmp_path: Path) -> None:
    if example is None:
        pytest.skip(f"none of {', '.join(PACKAGES)} is installed")
    target = tmp_path / example.name
    for image in example.parent.glob("*.png"):
        (tmp_path / image.name).symlink_to(image)
    copied = tmp_path / f"copy-of-{example.name}"
    copied.write_bytes(example.read_bytes())
    try:
        check_document(read_document(copied), copied.name)
    except MrmError as error:
        pytest.skip(f"is not whole without its package's definitions: {error}")
    assert retrofit_file(copied, target)
    document = read_document(target)
    assert document.validate()[0] == read_document(copied).validate()[0]
    elements = mx_gen_shader.findRenderableElements(document)
    for element in elements:
        assert mrm_nodes.generate_shader(document, "glsl", element.getNamePath()).pixel
    first = elements[0].getNamePath()
    for kind in mrm_nodes.supported_targets():
        assert mrm_nodes.generate_shader(document, kind, first).pixel, kind
    if any(report.works for report in probe_backends()):
        shader = mrm_nodes.generate_shader(target, element=first, max_lights=1, interface="reduced")
        assert np.isfinite(drawn(shader).image).all()
