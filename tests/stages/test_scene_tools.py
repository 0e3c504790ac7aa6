"""`gpf scene list` and `gpf scene preview` on the command line."""

from __future__ import annotations

import re

import numpy as np
from PIL import Image


def test_list_tells_views_and_membership(fresh):
    text = fresh.gpf("scene", "list").text
    row = next(line for line in text.splitlines() if "cornell_box" in line)
    assert re.search(r"cornell_box +3 +4 +24 +yes", row)
    views = fresh.folder / "scenes/cornell_box/views.yaml"
    views.write_text("exposure: -1\n", encoding="utf-8")
    text = fresh.gpf("scene", "list").text
    assert "cornell_box" in text and "exposure" in text


def test_preview_shows_all_views_and_names_the_bad_one(fresh):
    views = fresh.folder / "scenes/cornell_box/views.yaml"
    text = views.read_text(encoding="utf-8")
    bad = "    - {name: away, origin: [0, 0, 5], target: [0, 0, 9], fov: 40}\n"
    views.write_text(text.replace("  novel:\n", "  novel:\n" + bad), encoding="utf-8")
    outcome = fresh.gpf("scene", "preview", "cornell_box", "--height", "16", "--passes", "1")
    assert outcome.code == 0, outcome.text
    for name in ("front", "left", "right", "above", "floor", "inside", "ceiling", "frame_008"):
        assert name in outcome.text
    assert "only 0% of its" in outcome.text
    picture = np.array(Image.open(fresh.folder / "results/cornell_box/preview.png"))
    assert picture.std() > 10
    assert not (fresh.folder / "results/cornell_box/scene").exists()


def test_preview_of_no_scene(fresh):
    outcome = fresh.gpf("scene", "preview", "cornel_box")
    assert outcome.code == 2
    assert "does not exist. Did you mean" in outcome.text
