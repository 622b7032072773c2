"""MaterialX's own examples move over: the same picture at weight 0, and another one at weight 1.

They are read where they lie beside the checkout, in ../shared; what they name and has no file there is made.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest
from numpy.typing import NDArray

from mrm_nodes import filenames
from mrm_nodes.documents import read_document
from mrm_nodes.regression.verdict.compare import relative_error
from mrm_nodes.render import DirectionalLight, probe_backends, render, write_png
from mrm_nodes.shadergen import generate_shader
from mrm_nodes.surfaces import known_surfaces
from mrm_nodes.surfaces.rewrite import retrofit_file

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "materialx" / "Materials" / "Examples"
NODES = "|".join(known_surfaces())


def _examples() -> list[Path]:
    """The first two of each kind of surface; all with MRM_EXAMPLES, as `make sweep` asks."""
    kinds: dict[str, list[Path]] = {}
    for path in sorted(DATA.rglob("*.mtlx")):
        found = re.search(rf"<({NODES})\b", path.read_text("utf-8"))
        if found:
            kinds.setdefault(found[1], []).append(path)
    most = None if os.environ.get("MRM_EXAMPLES") else 2
    return [path for paths in kinds.values() for path in paths[:most]]


EXAMPLES = _examples()
#: Our masking is exact there, MaterialX's takes the mean of both alphas.
ANISOTROPIC = re.compile(r'anisotropy"[^>]* value="0?\.0*[1-9]|brushed')
#: Without a base specular (the car paint's coat has the index of its base); of roughness 0, which no light but one in
#: its mirror's direction shows; and a white metal of alpha 1, whose lobe is the same mirrored.
ALIKE = re.compile(r'velvet|carpaint|gltf_pbr_default|"(specular_)?roughness"[^>]* value="0(\.0*)?"')
#: Materials of one document that are drawn.
MOST = 1

pytestmark = [
    pytest.mark.skipif(not EXAMPLES, reason="MaterialX's examples are not beside the checkout"),
    pytest.mark.skipif(
        not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
    ),
]


@pytest.fixture
def example(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of an example with every image that it names."""
    path: Path = tmp_path / request.param.parent.name / request.param.name
    shutil.copytree(request.param.parent, path.parent)
    document = read_document(path, allow_external=True)
    folders = [path.parent, *filenames.search_folders()]
    for count, port in enumerate(document.traverseTree()):
        if not isinstance(port, mx.Input) or port.getType() != "filename" or not port.getValueString():
            continue
        name = filenames.resolved(port)
        if not filenames.find(name, folders).all():
            file = path.parent / name.replace(filenames.UDIM, "1001").replace(filenames.UVTILE, "u1_v1")
            file.parent.mkdir(parents=True, exist_ok=True)
            # Each a different grey; of normals the one that bends none, 0.5 encoded.
            grey = 0.2 + count % 7 / 10
            color = (0.2140, 0.2140, 1.0) if "normal" in name.lower() else (grey, grey, grey)
            write_png(file.with_suffix(".png"), np.full((4, 4, 3), color, np.float32))
            file.with_suffix(".png").rename(file)
    return path


def drawn(path: Path, element: str) -> NDArray[np.float32]:
    shader = generate_shader(path, element=element, interface="reduced", allow_external=True)
    light = DirectionalLight((-0.3, -0.1, -0.95), (2.0, 2.0, 2.0))
    rendered = render(shader, lights=[light], size=(32, 32))
    # Grazing pixels round most, and MaterialX's leak light from below the horizon.
    toward = np.asarray(rendered.normal)[..., 2]
    seen = rendered.mask & (toward > 0.3)
    return np.asarray(rendered.image)[seen]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem, indirect=True)
def test_an_example_is_the_same_at_weight_0_and_another_at_weight_1(example: Path) -> None:
    inputs = {
        surface.input
        for surface in known_surfaces().values()
        if f"<{surface.node} " in example.read_text("utf-8")
    }
    paths = {weight: example.parent / f"weight{weight}.mtlx" for weight in (0, 1)}
    for weight, path in paths.items():
        assert retrofit_file(example, path, dict.fromkeys(inputs, float(weight)), allow_external=True)
    text = example.stem + example.read_text("utf-8")
    names = [node.getName() for node in read_document(example, allow_external=True).getMaterialNodes()]
    assert names
    for name in names[:MOST]:
        own, zero, one = (drawn(path, name) for path in (example, *paths.values()))
        assert own.max() > 0
        if not ANISOTROPIC.search(text):
            error = relative_error(zero, own)
            assert error.max() < 2e-3, name
            assert np.quantile(error, 0.999) < 2e-5, name
        if not ALIKE.search(text):
            assert relative_error(one, zero).max() > 0.01, name
