"""Images in and out: exact, complete or not at all, and clear about what is wrong."""

import os

import numpy as np
import OpenImageIO as oiio
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.render import read_image, write_exr, write_png


def picture(height=5, width=7, channels=3):
    return np.random.default_rng(0).normal(size=(height, width, channels)).astype(np.float32) * 100


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_exr_keeps_every_bit(tmp_path, channels):
    image = picture(channels=channels)
    write_exr(tmp_path / "a.exr", image)
    assert np.array_equal(read_image(tmp_path / "a.exr"), image)


def test_exr_keeps_what_is_no_number(tmp_path):
    image = np.array([[np.nan, np.inf, -np.inf]], np.float32)
    write_exr(tmp_path / "a.exr", image)
    assert np.array_equal(read_image(tmp_path / "a.exr")[..., 0], image, equal_nan=True)


def test_png_is_srgb(tmp_path):
    write_png(tmp_path / "a.png", np.array([[0.0, 0.0031308, 0.2158605, 1.0, 7.0, -1.0, np.nan]]))
    codes = read_image(tmp_path / "a.png")[0, :, 0] * 255
    np.testing.assert_allclose(codes, [0, 10, 128, 255, 255, 0, 0], atol=0.6)
    write_png(tmp_path / "b.png", np.array([[0.2158605 / 4]]), exposure=2.0)
    assert read_image(tmp_path / "b.png")[0, 0, 0] * 255 == pytest.approx(128, abs=0.6)


def test_row_0_is_the_top(tmp_path):
    image = np.zeros((4, 2, 3), np.float32)
    image[0] = 1.0
    for name, write in (("a.exr", write_exr), ("a.png", write_png)):
        write(tmp_path / name, image)
        assert read_image(tmp_path / name)[:, 0, 0].tolist() == [1, 0, 0, 0]


def test_colours_are_not_multiplied_with_alpha(tmp_path):
    write_png(tmp_path / "a.png", np.array([[[1.0, 0.0, 0.0, 0.0]]]))
    assert read_image(tmp_path / "a.png")[0, 0].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_what_is_read_belongs_to_the_reader(tmp_path):
    write_exr(tmp_path / "a.exr", picture())
    image = read_image(tmp_path / "a.exr")
    assert image.dtype == np.float32 and image.flags.writeable and image.flags.c_contiguous


@pytest.mark.parametrize("ending", ["exr", "png", "tif", "hdr", "jpg"])
@pytest.mark.parametrize("kept", [0, 4, 0.3, 0.9])
def test_a_truncated_image_is_named(tmp_path, ending, kept):
    file = tmp_path / f"a.{ending}"
    kind = oiio.FLOAT if ending in ("exr", "hdr") else oiio.UINT8
    whole = oiio.ImageBuf(np.random.default_rng(0).random((64, 64, 3)).astype(np.float32))
    assert whole.write(str(file), kind)
    assert read_image(file).shape == (64, 64, 3)
    content = file.read_bytes()
    file.write_bytes(content[: kept if kept >= 1 else int(kept * len(content))])
    with pytest.raises(MrmError, match=rf"a\.{ending}: (the image is damaged|not an image)") as error:
        read_image(file)
    assert "\n" not in str(error.value)


def test_an_unknown_or_missing_image_is_named(tmp_path):
    (tmp_path / "a.png").write_text("This is no image.\n")
    with pytest.raises(MrmError, match=r"a\.png: not an image"):
        read_image(tmp_path / "a.png")
    (tmp_path / "a.xyz").write_text("Nor is this.\n")
    with pytest.raises(MrmError, match=r"a\.xyz: not an image"):
        read_image(tmp_path / "a.xyz")
    with pytest.raises(MrmError, match=r"nowhere\.exr: no such image"):
        read_image(tmp_path / "nowhere.exr")


@pytest.mark.parametrize(("name", "write"), [("a.exr", write_exr), ("a.png", write_png)])
def test_a_folder_that_is_not_there_is_named(tmp_path, name, write):
    with pytest.raises(MrmError, match=rf"nowhere.{name}: cannot be written"):
        write(tmp_path / "nowhere" / name, picture())


@pytest.mark.parametrize(("name", "write"), [("a.exr", write_exr), ("a.png", write_png)])
def test_a_failed_write_leaves_the_former_file(tmp_path, monkeypatch, name, write):
    write(tmp_path / name, picture())
    before = (tmp_path / name).read_bytes()

    def fail(*arguments):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(MrmError, match=rf"{name}: cannot be written: No space left"):
        write(tmp_path / name, picture() + 1)
    assert (tmp_path / name).read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_a_new_file_can_be_read_by_others(tmp_path):
    write_exr(tmp_path / "a.exr", picture())
    mask = os.umask(0)
    os.umask(mask)
    assert (tmp_path / "a.exr").stat().st_mode & 0o777 == 0o666 & ~mask


@pytest.mark.parametrize("array", [np.zeros(3), np.zeros((0, 4, 3)), np.zeros((2, 2, 2, 3))])
def test_what_is_no_picture_is_refused(tmp_path, array):
    with pytest.raises(MrmError, match=r"a\.exr: an array of shape .* is not an image"):
        write_exr(tmp_path / "a.exr", array)
