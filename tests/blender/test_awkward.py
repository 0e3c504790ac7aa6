"""Scenes with what people's files have, converted, against Cycles; and what is said of them."""

from __future__ import annotations

import re

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.blender.conversion import convert
from gpf.scene.views import read_views
from tests.blender.test_against_cycles import PYTHON, cycles, mitsuba, run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(600),
    pytest.mark.skipif(PYTHON is None, reason="no Blender: gpf blender-install"),
]
BLOCKS = (4, 6)


def converted(tmp_path, name, suffix="blend"):
    run("awkward.py", name, tmp_path / f"{name}.{suffix}")
    return convert(tmp_path / f"{name}.{suffix}", tmp_path / "out", lambda what: None)


def blocks(image: np.ndarray) -> np.ndarray:
    """The means of parts of a picture, (4, 6, 3)."""
    rows, columns = (size // count for size, count in zip(image.shape, BLOCKS, strict=False))
    return image.reshape(BLOCKS[0], rows, BLOCKS[1], columns, 3).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("name", "within", "notes"),
    [
        ("layers", 0.05, {"other: view layer left out"}),
        ("slots", 0.05, set()),
        ("skies", 0.02, {"the world: as surfaces see it, also for the camera"}),
        ("filters", None, {"Spot: its nodes as their mean over all directions"}),
        ("sizes", 0.05, set()),
        ("points", None, set()),
        ("leaf", 0.05, set()),
        ("sums", 0.06, set()),
        ("hidden", 0.05, set()),
    ],
)
def test_light_is_as_in_cycles(tmp_path, two_threads, name, within, notes):
    """The energy of each channel, and of each part of the picture but for a few percent."""
    made = converted(tmp_path, name)
    ours = mitsuba(made, 64, 1)
    theirs = cycles(tmp_path / f"{name}.blend", 64, 1)
    energy, expected = (image.mean(axis=(0, 1)) for image in (ours, theirs))
    apart = np.abs(blocks(ours) - blocks(theirs)).max() / expected.max()
    print(name, energy / expected, apart)
    np.testing.assert_allclose(energy, expected, rtol=0.02)
    assert within is None or apart < within
    assert {*made.notes} == notes
    assert {*made.how.values()} <= {"exact", "baked"}


def test_what_is_left_out_is_said(tmp_path):
    made = converted(tmp_path, "misty")
    assert {*made.notes} == {
        "the world: its volume left out",
        "camera Camera: depth of field left out",
    }
    assert read_views(made.folder / "views.yaml").exposure == 2
    mi.load_file(str(made.xml))  # an object is called "id"


def test_pictures_that_are_baked_keep_their_detail(tmp_path):
    """All of 128 stripes; what is black does not shine, so it has no other side."""
    made = converted(tmp_path, "leaf")
    (name,) = re.findall(
        r'<texture type="bitmap" name="opacity">.*?value="(.*?)"', made.xml.read_text(), re.S
    )
    stripes = np.asarray(Image.open(made.folder / name)) / 255
    edges = [(np.diff(stripes > 0.5, axis=axis) != 0).sum(axis=axis).max() for axis in (0, 1)]
    assert max(edges) == 127
    assert len([*made.folder.glob("meshes/*")]) == 2


@pytest.mark.parametrize("suffix", ["glb", "fbx"])
def test_suns_of_other_formats_are_points(tmp_path, suffix):
    made = converted(tmp_path, "glowing", suffix)
    assert re.search('<emitter type="directional"', made.xml.read_text())
