"""Whole materials move over: ten that use every lobe, and those that packages bring."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import MaterialX.PyMaterialXGenShader as mx_gen_shader
import numpy as np
import pytest
from surface_lobes import BLACK, EVERYTHING

import mrm_nodes
from mrm_nodes.errors import MrmError
from mrm_nodes.render import CameraLight, RenderedImage, probe_backends, render, write_png
from mrm_nodes.shadergen import check_document, read_document
from mrm_nodes.surfaces import Surface, known_surfaces
from mrm_nodes.surfaces.rewrite import retrofit_file

MATERIALS = sorted((Path(__file__).parent / "surfaces").glob("*.mtlx"))

#: Packages that bring example materials; their tests run where they are installed.
PACKAGES = {"materialxgltf": "data", "materialxMaterials": "data/PhysicallyBasedMaterialX"}

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
@pytest.mark.parametrize("material", MATERIALS if EVERYTHING else MATERIALS[::4], ids=lambda path: path.stem)
def test_a_material_renders_as_before_until_it_is_given_a_weight(material: Path, tmp_path: Path) -> None:
    paths = (material, retrofitted(material, tmp_path, 0.0), retrofitted(material, tmp_path, 1.0))
    before, zero, one = (drawn(path) for path in paths)
    # With a light at the camera, every point that is seen is lit; the silhouette is not compared.
    view = np.array(before.camera.position) - before.position
    cosine = np.sum(view * before.normal, -1) / np.maximum(np.linalg.norm(view, axis=-1), 1e-6)
    inside = before.mask & (cosine > 0.1)
    is_anisotropic = "anisotropy" in material.read_text()  # there, our masking is exact: see the README
    tolerance = 0.3 if is_anisotropic else 2e-5
    assert np.allclose(zero.image[inside], before.image[inside], rtol=tolerance, atol=1e-6)
    assert np.isfinite(one.image).all()
    rim = inside & (cosine < 0.8)
    assert one.image[rim].mean() > before.image[rim].mean()


def drawn(source: Path, mesh: str = "sphere", camera: str | None = None) -> RenderedImage:
    shader = mrm_nodes.generate_shader(source, max_lights=1, interface="reduced")
    return render(shader, mesh, camera, [CameraLight()], (48, 48), environment=BLACK)


DRIVEN = list(known_surfaces().values()) if EVERYTHING else [known_surfaces()["gltf_pbr"]]
by_driven = pytest.mark.parametrize("surface", DRIVEN, ids=lambda surface: surface.node)


@needs_gl
@by_driven
def test_an_image_on_the_weight_drives_it_at_each_pixel(surface: Surface, tmp_path: Path) -> None:
    mask = np.zeros((8, 8, 3), np.float32)
    mask[::2, 1::2] = mask[1::2, ::2] = 1.0
    write_png(tmp_path / "mask.png", mask)
    driver = """
      <image name="driver" type="float">
        <input name="file" type="filename" value="mask.png" />
        <input name="filtertype" type="string" value="closest" />
      </image>"""
    image, zero, one = driven(surface, driver, tmp_path)
    texel = (image.texcoord * 8.0).astype(int)
    on = (texel.sum(axis=-1) % 2 == 0) == (mask[7, 0, 0] == 1.0)
    assert np.allclose(image.image, np.where(on[..., None], one.image, zero.image), rtol=1e-5)


@needs_gl
@by_driven
def test_a_pattern_on_the_weight_drives_it_at_each_pixel(surface: Surface, tmp_path: Path) -> None:
    driver = """
      <texcoord name="uv" type="vector2" />
      <extract name="driver" type="float">
        <input name="in" type="vector2" nodename="uv" />
        <input name="index" type="integer" value="0" />
      </extract>"""
    image, zero, one = driven(surface, driver, tmp_path)
    u = image.texcoord[..., :1]
    assert np.allclose(image.image, (1.0 - u) * zero.image + u * one.image, rtol=1e-5, atol=1e-7)


def driven(surface: Surface, driver: str, folder: Path) -> list[RenderedImage]:
    """The plane with the weight driven by the node `driver`, at 0, and at 1."""
    images = []
    for value in ('nodename="driver"', 'value="0"', 'value="1"'):
        path = folder / "driven.mtlx"
        path.write_text(f"""<?xml version="1.0"?>
    <materialx version="1.39">{driver}
      <{surface.name} name="s" type="surfaceshader">
        <input name="{surface.input}" type="float" {value} />
      </{surface.name}>
      <surfacematerial name="m" type="material">
        <input name="surfaceshader" type="surfaceshader" nodename="s" />
      </surfacematerial>
    </materialx>""")
        images.append(drawn(path, "plane", "0.4,0.3,2.5"))
        assert images[-1].mask.mean() > 0.3
    return images


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
    for element in mx_gen_shader.findRenderableElements(document):
        assert mrm_nodes.generate_shader(document, "glsl", element.getNamePath()).pixel
