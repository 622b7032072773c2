"""Documents of every kind that MaterialX's own have are generated, drawn, moved over and compared."""

from __future__ import annotations

from pathlib import Path

import document_kinds
import numpy as np
import pytest
import sweep

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.run.runner import required_backends
from mrm_nodes.render.context import probe_backends
from mrm_nodes.render.images import read_image
from mrm_nodes.render.renderer import shared_renderer

DRAWN = [name for name in document_kinds.KINDS if name not in document_kinds.NOTHING_TO_DRAW]
ON_BOTH = ("examples/textured", "examples/clamped")
"""Of a reduced shader and of a complete one; the last backend draws all of them as cases of a suite."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Like MaterialX's `resources`; its parent is on MaterialX's search path."""
    folder = tmp_path_factory.mktemp("kinds") / "resources"
    document_kinds.write(folder)
    return folder


@pytest.fixture(autouse=True)
def _found(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MATERIALX_SEARCH_PATH", str(root.parent))


def file_of(root: Path, name: str) -> Path:
    return root / "Materials" / f"{name}.mtlx"


@pytest.mark.parametrize("name", DRAWN)
def test_what_materialx_generates_we_generate_in_every_target(root: Path, name: str) -> None:
    rows = list(sweep.generated([file_of(root, name)], root, most=2))
    assert rows
    for row in rows:
        assert row.refused == {}
        assert "glsl" not in row.upstream


def drawing() -> list[str]:
    """The backends that work here; one that has to and does not fails the test."""
    for probe in probe_backends():
        assert probe.works or probe.backend not in required_backends(), f"{probe.backend}: {probe.reason}"
    return [probe.backend for probe in probe_backends() if probe.works] or pytest.skip("no backend works")


@pytest.mark.parametrize(
    ("name", "number"),
    [(name, number) for name in DRAWN for number in (0, 1) if not number or name in ON_BOTH],
)
def test_it_is_drawn_and_not_black(root: Path, name: str, number: int) -> None:
    backends = drawing()
    if number >= len(backends):
        pytest.skip("a second backend does not work")
    backend = backends[number]
    mesh = sweep.load_mesh("sphere")
    theirs = sweep.Theirs()
    file = file_of(root, name)
    for element in theirs.renderables(theirs.document(file, root))[:1]:
        row = sweep.Row(str(file.relative_to(root)), element)
        drawn = sweep.drawn(row, sweep.interface_of(file, root), root, mesh, backend)
        assert drawn is not None, row.message
        assert np.isfinite(drawn.image).all()
        assert drawn.image[drawn.mask].max() > 0.05
        again = sweep.drawn(row, sweep.interface_of(file, root), root, mesh, backend)
        assert again is not None
        assert again.image.tobytes() == drawn.image.tobytes()
        assert any("displacement" in each for each in row.warnings) == (name == "suite/displaced")


def test_what_a_picture_shows_is_drawn(root: Path) -> None:
    """Another picture makes another image: no texture is a plain colour."""
    for name in ("examples/textured", "examples/look", "suite/tokens", "suite/tiled", "suite/set"):
        row = sweep.Row(str(file_of(root, name).relative_to(root)), "kind")
        drawn = sweep.drawn(row, "reduced", root, sweep.load_mesh("sphere"), "auto")
        assert drawn is not None, row.message
        hues = drawn.image[drawn.mask] / drawn.image[drawn.mask].sum(axis=-1, keepdims=True)
        assert np.ptp(hues, axis=0).max() > 0.2, name


@pytest.mark.parametrize("name", ["examples/clamped", "suite/struct"])
def test_a_complete_and_a_reduced_shader_draw_the_same(root: Path, name: str) -> None:
    """With the address modes of the document, and the members of its structures."""
    shaders = [
        shadergen.generate_shader(file_of(root, name), interface=each, allow_external=True)
        for each in ("complete", "reduced")
    ]
    mesh = sweep.load_mesh("sphere")
    images = [
        shared_renderer().render(each, mesh, sweep.CAMERA, [sweep.LAMP], sweep.SIZE) for each in shaders
    ]
    np.testing.assert_allclose(images[0].image, images[1].image, rtol=1e-4, atol=1e-5)


def test_nothing_to_draw_is_one_line(root: Path) -> None:
    with pytest.raises(MrmError, match="nothing to render: no material, shader or output"):
        shadergen.generate_shader(file_of(root, "suite/lights"))


def test_all_are_moved_over(root: Path) -> None:
    files = [file_of(root, name) for name in document_kinds.KINDS]
    results = {name: (changed, complaint) for name, changed, complaint in sweep.retrofitted(files, root)}
    assert {name: complaint for name, (_, complaint) in results.items() if complaint} == {}
    for kind in ("standard", "open_pbr", "gltf", "textured"):
        assert results[f"Materials/examples/{kind}.mtlx"][0]


def test_all_are_cases_of_a_suite(root: Path, tmp_path: Path) -> None:
    files = [file_of(root, name) for name in DRAWN if name != "suite/outputs"]
    records = sweep.regressed(files, root, tmp_path, drawing()[-1])
    outcomes = {each["name"]: sweep.outcome(each) for each in records}
    assert len(outcomes) == len(files)
    assert set(outcomes.values()) == {"evaluator", "baseline"}, outcomes
    for each in records:
        image = read_image(tmp_path / each["files"]["render_data"])
        assert np.isfinite(image).all() and image[..., :3].max() > 0.05, each["name"]
