"""Grids of media, before Mitsuba reads them."""

import struct

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.scene.grids import check_grid
from gpf.scene.load import load_scene_file

SCENE = """<scene version="3.0.0">
  <shape type="cube">
    <bsdf type="null"/>
    <medium type="heterogeneous" name="interior">
      <volume type="gridvolume" name="sigma_t"><string name="filename" value="smoke.vol"/></volume>
    </medium>
  </shape>
  <shape type="rectangle"/>
  <emitter type="constant"/>
  <sensor type="perspective"/>
</scene>"""


def test_a_grid_of_gigabytes(tmp_path):
    """In words, before anything is read: the file holds nothing but its header."""
    (tmp_path / "scene.xml").write_text(SCENE)
    header = struct.pack("<3sB5i6f", b"VOL", 3, 1, 9000, 9000, 9000, 1, *(0,) * 3, *(1,) * 3)
    (tmp_path / "smoke.vol").write_bytes(header)
    with pytest.raises(UserError, match=r"(?s)smoke.vol, a grid of 9000 x 9000 x 9000.*GiB"):
        load_scene_file(tmp_path / "scene.xml")


@pytest.mark.parametrize("content", [b"", b"VOL", b"something else, long enough for a header"])
def test_other_errors_are_left_to_mitsuba(tmp_path, content):
    file = tmp_path / "smoke.vol"
    file.write_bytes(content)
    check_grid(file, "here")
    (tmp_path / "scene.xml").write_text(SCENE)
    with pytest.raises(UserError):
        load_scene_file(tmp_path / "scene.xml")


def test_a_small_grid_loads(tmp_path):
    (tmp_path / "scene.xml").write_text(SCENE)
    mi.VolumeGrid(np.ones((4, 4, 4, 1), np.float32)).write(str(tmp_path / "smoke.vol"))
    assert load_scene_file(tmp_path / "scene.xml").shapes()[0].interior_medium() is not None
