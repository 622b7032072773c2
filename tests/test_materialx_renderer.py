"""MaterialX's own renderer draws the nodes, and its image is ours."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import document_kinds
import MaterialX as mx
import numpy as np
import pytest
import sweep
from sweep import inner, start, write_obj

from mrm_nodes.regression.truth.material import document
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import shared_renderer
from mrm_nodes.render.scene import Camera, DirectionalLight
from mrm_nodes.shadergen import generate_shader

INSTALL = "no display for MaterialX's renderer: apt-get install xvfb xauth libgl1-mesa-dri libgl1 libxt6"
SIZE = (160, 120)

if shutil.which("xvfb-run") is None:
    assert "clients" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), INSTALL
    pytest.skip(INSTALL, allow_module_level=True)


@pytest.mark.client("MaterialX's own `GlslRenderer`: the same image")
@pytest.mark.parametrize(
    ("node", "values"),
    [
        ("mrm_conductor_bsdf", {"roughness": mx.Vector2(0.2, 0.2), "retroreflectivity": 0.5}),
        ("mrm_dielectric_bsdf", {"roughness": mx.Vector2(0.3, 0.3), "retroreflectivity": 1.0}),
        ("mrm_generalized_schlick_bsdf", {"roughness": mx.Vector2(0.1, 0.1), "retroreflectivity": 0.25}),
    ],
)
def test_materialx_own_renderer_draws_the_same_image(
    node: str, values: dict[str, object], tmp_path: Path
) -> None:
    doc = document(node)
    for name, value in values.items():
        doc.getNode("bsdf").setInputValue(name, value)
    material, mesh_file = tmp_path / "material.mtlx", tmp_path / "sphere.obj"
    mx.writeToXmlFile(doc, str(material))
    write_obj(load_mesh("sphere"), mesh_file)
    mesh = load_mesh(mesh_file)

    camera = Camera((0.5, 0.7, 4.0), (0.0, 0.0, 0.0))
    lamp = DirectionalLight(direction=(-0.3, -0.5, -1.0), color=(1.0, 0.9, 0.8))
    near, far = camera.clip_distances(mesh.center, mesh.radius)
    scene = {
        "size": SIZE,
        # MaterialX's matrices multiply row vectors.
        "view": camera.view_matrix().T.ravel().tolist(),
        "projection": camera.projection_matrix(SIZE[0] / SIZE[1], near, far).T.ravel().tolist(),
        "direction": lamp.direction,
        "color": lamp.color,
        "around": (0.0, 0.0, 0.0),
        "samples": 1,
        "mesh": str(mesh_file),
        "jobs": [{"material": str(material), "output": str(tmp_path / "image.npy")}],
    }
    process = start(scene, tmp_path)
    _, complaints = process.communicate(timeout=300)
    assert process.returncode == 0, complaints
    assert (tmp_path / "image.npy").exists(), (tmp_path / "image.txt").read_text()
    theirs = np.load(tmp_path / "image.npy")[..., :3]
    ours = shared_renderer().render(generate_shader(material), mesh, camera, [lamp], SIZE)

    # At an outline the two rasterizers, at different distances to the near plane, may differ.
    inside = inner(ours.mask)
    assert inside.sum() > 2000
    assert ours.image[inside].max() > 0.05
    error = np.abs(theirs - ours.image)[inside] / np.maximum(np.abs(ours.image[inside]), 1e-3)
    assert error.max() < 5e-5


@pytest.mark.client("MaterialX's own `GlslRenderer`: the same image")
def test_every_kind_of_document_is_drawn_as_materialx_draws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(tmp_path))
    root = tmp_path / "resources"
    theirs = sweep.Theirs()
    rows = [
        sweep.Row(str(file.relative_to(root)), element)
        for file in document_kinds.write(root)
        for element in theirs.renderables(theirs.document(file, root))
    ]
    sweep.draw(rows, root, tmp_path / "work")
    assert len(rows) >= len(document_kinds.KINDS) - 1
    differ = [row for row in rows if row.picture != "same"]
    # Where no file is named, its renderer reads whatever texture is bound; we take the node's default.
    assert [row.document for row in differ] == ["Materials/suite/unnamed.mtlx"], differ
