"""The scenes show what the paper describes, and are drawn by one command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mrm_nodes.cli import cli
from mrm_nodes.errors import MrmError
from mrm_nodes.render import probe_backends, read_image, sphere
from mrm_nodes.scenes import TITLES, draw, scene_gallery
from mrm_nodes.scenes.compose import sampled
from mrm_nodes.scenes.figures import figure3, figure5

needs_gl = pytest.mark.skipif(
    not any(report.works for report in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)
SIZE = 40


def on_the_ball(picture: np.ndarray) -> np.ndarray:
    """The middle of the ball: a background is 0.004 or more everywhere, the rim is left out."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] - (SIZE - 1) / 2
    return picture.mean(axis=-1)[np.hypot(x, y) < 0.36 * SIZE]


def highlight(picture: np.ndarray) -> tuple[float, int]:
    brightness = on_the_ball(picture)
    return float(brightness.max()), int(brightness.argmax())


@needs_gl
@pytest.mark.parametrize("figure", [figure3, figure5])
def test_mrm_is_bright_all_over_and_then_dark_where_ggx_only_moves(figure) -> None:
    pictures = [sampled(scene, (SIZE, SIZE), 1) for row in figure(sphere()) for scene, _ in row]
    count = len(pictures) // 2
    ggx, mrm = pictures[:count], pictures[count:]
    lit = on_the_ball(mrm[0])
    assert lit.min() > 0.5 * lit.max()
    for away in mrm[1:]:
        assert on_the_ball(away).max() < 0.15 * lit.min()
    bright, place = highlight(ggx[0])
    assert on_the_ball(ggx[0]).min() < 0.2 * bright
    for away in ggx[1:]:
        still_bright, other_place = highlight(away)
        assert still_bright > 0.4 * bright
        assert other_place != place


@needs_gl
def test_the_command_draws_a_figure_on_a_mesh_of_the_users(tmp_path: Path) -> None:
    output = tmp_path / "folder" / "figure.png"
    arguments = [
        "scene",
        "figure3",
        "-o",
        str(output),
        "--mesh",
        "baluster",
        "--scale",
        "0.1",
        "--samples",
        "1",
    ]
    result = CliRunner().invoke(cli, arguments)
    assert result.exit_code == 0, result.output
    # Four pictures beside each other, six white pixels between them.
    assert read_image(output).shape == (21, 4 * 21 + 3 * 6, 3)


@needs_gl
def test_the_gallery_says_where_each_picture_is(tmp_path: Path) -> None:
    (shown,) = scene_gallery(tmp_path, ["figure3"], scale=0.1)
    assert (shown["title"], shown["caption"]) == ("figure3", TITLES["figure3"])
    assert read_image(tmp_path / shown["image"]).max() > 0.5


@pytest.mark.parametrize(
    ("name", "mesh", "message"),
    [
        ("cones", None, "unknown scene cones; did you mean cone\\?"),
        ("cone", "sphere", "cone: has its own geometry; a mesh can be shown in figure3 and figure5"),
        ("figure3", "no_such.glb", r"no_such\.glb"),
    ],
)
def test_what_cannot_be_drawn_is_said(name: str, mesh: str | None, message: str) -> None:
    with pytest.raises(MrmError, match=message):
        draw(name, mesh)


@pytest.mark.parametrize(
    ("name", "output", "options"),
    [
        ("figure3", "a.gif", []),
        ("figure3", "a.png", ["--mesh", "no_such.glb"]),
        ("cone", "a.png", ["--mesh", "sphere"]),
    ],
)
def test_what_is_refused_leaves_no_folder(tmp_path: Path, name: str, output: str, options: list[str]) -> None:
    result = CliRunner().invoke(cli, ["scene", name, "-o", str(tmp_path / "folder" / output), *options])
    assert isinstance(result.exception, MrmError)
    assert not (tmp_path / "folder").exists()


def test_a_scene_does_not_take_a_folder_for_its_file(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    result = CliRunner().invoke(cli, ["scene", "figure3", "-o", str(tmp_path / "a.png")])
    assert isinstance(result.exception, MrmError) and "a.png: is a folder" in str(result.exception)


@needs_gl
def test_samples_of_a_scene_are_tone_mapped_before_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    """A mean of radiance leaves the edge of what is hundreds of times white as jagged as one sample."""
    black = (0.0, 0.0, 0.0)
    monkeypatch.setattr("mrm_nodes.scenes.figures.grey", lambda exposure: (black, black))
    bright = draw("figure3", "sphere", 0.1, 4, exposure=10.0, tonemap="none")
    shown = bright[:, 54:75].max(axis=-1)
    edges = shown[(shown > 0.1) & (shown < 0.9)]
    assert shown.max() == 1.0
    assert len(edges) > 4, "pixels that are partly covered are partly bright"


def test_scene_options_are_checked_before_anything_is_drawn(tmp_path: Path) -> None:
    for options, message in (
        (["--tonemap", "neutrl"], "did you mean neutral"),
        (["--exposure", "auto"], "have their own"),
        (["--exposure", "x"], "exposure x: write auto, or stops"),
        (["--exposure", ""], "exposure : write auto, or stops"),
    ):
        given = ["scene", "figure3", "-o", str(tmp_path / "folder" / "a.png"), *options]
        result = CliRunner().invoke(cli, given)
        assert isinstance(result.exception, MrmError) and message in str(result.exception)
        assert not (tmp_path / "folder").exists()
