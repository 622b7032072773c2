"""Files that a kill left half written go, and nobody else's."""

import os
import shutil
import time

from mrm_nodes.files import ABANDONED, UNFINISHED, clear, prepare_folder, reason
from mrm_nodes.surfaces.convert import convert


def left_behind(folder, age):
    """A file and a folder that a kill left so long ago."""
    for name in (f"{UNFINISHED}file-{age}", f"{UNFINISHED}folder-{age}/inside"):
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_text("half")
    for path in folder.glob(f"{UNFINISHED}*-{age}"):
        os.utime(path, (time.time() - age,) * 2)


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_what_nobody_can_still_be_writing_is_removed(tmp_path):
    kept = {"mine", ".hidden"}
    for name in kept:
        (tmp_path / name).write_text("kept")
    left_behind(tmp_path, 10)
    fresh = names(tmp_path)
    left_behind(tmp_path, int(ABANDONED) + 10)
    prepare_folder(tmp_path)
    assert names(tmp_path) == fresh
    clear(tmp_path)
    assert names(tmp_path) == kept


def test_a_link_that_is_called_so_goes_alone(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "kept").write_text("kept")
    (tmp_path / f"{UNFINISHED}link").symlink_to(tmp_path / "mine")
    clear(tmp_path)
    assert names(tmp_path) == {"mine"} and names(tmp_path / "mine") == {"kept"}


def test_retrofit_clears_where_it_writes(tmp_path):
    left_behind(tmp_path, int(ABANDONED) + 10)
    (tmp_path / "vest.mtlx").write_text(
        '<materialx version="1.39"><standard_surface name="vest" type="surfaceshader"/></materialx>'
    )
    convert(tmp_path / "vest.mtlx", tmp_path / "retro.mtlx")
    assert names(tmp_path) == {"vest.mtlx", "retro.mtlx"}


def test_of_several_reasons_the_first_is_told():
    assert reason(OSError(28, "No space left on device")) == "No space left on device"
    assert reason(shutil.Error([("a", "b", "No space left"), ("c", "d", "another")])) == "No space left"
    assert reason(OSError("something")) == "something"
