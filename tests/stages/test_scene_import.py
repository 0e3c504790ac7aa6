"""`gpf scene import` on the command line, and the scene's line in params.yaml."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from gpf.scene.views import SceneViews, ViewSets
from stages.commands import scene_import
from stages.commands.scene_import import add_scene
from stages.config.params import read_params

PROJECT = Path(__file__).parent.parent.parent


def place_two(scene, own, aspect) -> SceneViews:
    """The scene's own camera, and one a step aside: placing views has tests of its own."""
    x, y, z = own[0].origin
    aside = own[0].model_copy(update={"name": "aside", "origin": (x - 0.2, y, z)})
    return SceneViews(views=ViewSets(train=tuple(own), novel=(aside,)), aspect=aspect)


@pytest.fixture(autouse=True)
def quick_views(monkeypatch):
    monkeypatch.setattr(scene_import, "place_views", place_two)


@pytest.fixture
def foreign(tmp_path) -> Path:
    """A scene file that is no part of the project."""
    (tmp_path / "foreign").mkdir()
    source = PROJECT / "scenes/cornell_box/scene.xml"
    return Path(shutil.copy(source, tmp_path / "foreign/box.xml"))


def test_an_imported_scene_goes_through_the_pipeline(fresh, foreign):
    before = (fresh.folder / "params.yaml").read_text(encoding="utf-8")
    outcome = fresh.gpf("scene", "import", str(foreign), "--name", "other")
    assert outcome.code == 0, outcome.text
    assert "scenes/other: imported from box.xml" in outcome.text
    assert re.search(r"emitters +1 area", outcome.text)
    assert "params.yaml: other added to scenes" in outcome.text
    assert "Next: `gpf scene preview other`" in outcome.text
    after = (fresh.folder / "params.yaml").read_text(encoding="utf-8")
    added = set(after.splitlines()) - set(before.splitlines())
    assert {line.strip() for line in added} == {"- other"}
    listed = fresh.gpf("scene", "list").text
    assert re.search(r"cornell_box .* yes", listed) and re.search(r"other .* yes", listed)
    assert fresh.stage("scene", "other").code == 0
    assert (fresh.folder / "results/other/scene/scene.xml").exists()


def test_what_is_refused_leaves_scenes_and_params_alone(fresh, foreign):
    (fresh.folder / "scenes/cornell_box/README.md").unlink()
    before = {p: p.read_bytes() for p in fresh.folder.rglob("*") if p.is_file()}
    outcome = fresh.gpf("scene", "import", str(foreign), "--name", "cornell_box")
    assert outcome.code == 2
    assert "error: name 'cornell_box': is taken" in outcome.text
    assert "Traceback" not in outcome.text
    outcome = fresh.gpf("scene", "import", str(foreign.with_name("lost.xml")), "--name", "other")
    assert outcome.code == 2
    assert "lost.xml: does not exist. Check the path." in outcome.text
    assert {p: p.read_bytes() for p in fresh.folder.rglob("*") if p.is_file()} == before


def test_bad_params_are_told_before_anything_is_made(fresh, foreign):
    fresh.edit("params.yaml", train__stepps=10)
    outcome = fresh.gpf("scene", "import", str(foreign), "--name", "other")
    assert outcome.code == 2
    assert "train.stepps: is an unknown key" in outcome.text
    assert not (fresh.folder / "scenes/other").exists()


LISTS = {
    "block": (
        "scenes:  # all\n  - a  # first\n  - b  # second\n\n# what\nfilm: {height: 8}\n",
        "scenes:  # all\n  - a  # first\n  - b  # second\n  - c\n\n# what\nfilm: {height: 8}\n",
    ),
    "not indented": ("scenes:\n- a\nfilm: {height: 8}\n", "scenes:\n- a\n- c\nfilm: {height: 8}\n"),
    "at the end": ("scenes:\n  -   a", "scenes:\n  -   a\n  -   c\n"),
    "in one line": ("scenes: [a, b] # both\n", "scenes: [a, b, c] # both\n"),
}


@pytest.mark.parametrize("kind", LISTS)
def test_the_name_joins_the_list_and_comments_stay(tmp_path, kind):
    before, after = LISTS[kind]
    file = tmp_path / "params.yaml"
    file.write_text(before)
    assert add_scene("c", file)
    assert file.read_text() == after
    assert read_params(file).scenes[-1] == "c"
    assert not add_scene("c", file)
    assert file.read_text() == after


def test_the_projects_own_params_get_one_line_more(tmp_path):
    file = Path(shutil.copy(PROJECT / "params.yaml", tmp_path))
    lines = file.read_text(encoding="utf-8").splitlines()
    add_scene("guest", file)
    again = file.read_text(encoding="utf-8").splitlines()
    assert len(again) == len(lines) + 1
    assert [line for line in again if line != "  - guest"] == lines
    assert YAML(typ="safe").load(file.read_text(encoding="utf-8"))["scenes"][-1] == "guest"
