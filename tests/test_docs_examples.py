"""Each script of docs/examples, and the notebook's cells, run from an empty folder and make what they say.

Pictures are drawn small: a script names no size, so that `mrm_nodes.render`'s own is taken.
"""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mrm_nodes.render import read_image, renderer

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which small pictures are drawn."""
    defaults = renderer.render.__defaults__
    assert defaults is not None
    small = tuple((32, 32) if each == (512, 512) else each for each in defaults)
    monkeypatch.setattr(renderer.render, "__defaults__", small)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_there_are_ten():
    assert len(SCRIPTS) == 10


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_an_example_runs_and_makes_what_it_says(script: Path, gl: None, folder: Path):
    text = script.read_text(encoding="utf-8")
    about = ast.get_docstring(ast.parse(text)) or ""
    assert about.splitlines()[0].endswith((".", "?"))
    try:
        runpy.run_path(str(script), run_name="__main__")
    except SystemExit as ended:
        assert not ended.code
    made = {each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file()}
    named = {word.strip(".,:;()") for word in about.split()}
    named = {word for word in named if Path(word).suffix in KINDS}
    assert named <= made, "the docstring names files that are not made"
    for name in named:
        if name.endswith((".png", ".webp")):
            check_picture(folder / name)


KINDS = (".png", ".webp", ".exr", ".mtlx", ".toml", ".json", ".csv", ".xml", ".html", ".frag")


def check_picture(path: Path) -> None:
    """Fails where a picture has nothing on it."""
    if path.suffix == ".webp":
        from PIL import Image

        with Image.open(path) as moving:
            assert getattr(moving, "n_frames", 1) > 4
            pixels: Any = np.asarray(moving.convert("RGB"), float) / 255.0
    else:
        pixels = read_image(path)[..., :3]
    assert np.ptp(pixels) > 0.2, f"{path.name}: nothing is to be seen"


def test_the_notebook_s_cells_run_and_show_what_they_have(gl: None, folder: Path):
    cells = json.loads((EXAMPLES / "tour.ipynb").read_text(encoding="utf-8"))["cells"]
    namespace: dict[str, Any] = {}
    shown = []
    for cell in cells:
        if cell["cell_type"] == "code":
            assert not cell["outputs"], "it is kept without what it shows"
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop()
            assert isinstance(last, ast.Expr)
            exec(compile(tree, "tour.ipynb", "exec"), namespace)
            shown.append(eval(compile(ast.Expression(last.value), "tour.ipynb", "eval"), namespace))
    lit, aside, lobe, values = shown
    assert lit.image.max() > 10.0 * aside.image.mean() > 0.0
    assert lit._repr_png_() and aside._repr_png_()
    assert hasattr(lobe, "_repr_png_")
    assert (values > 0.0).all()
