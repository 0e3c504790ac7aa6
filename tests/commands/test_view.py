"""`gpf view` without `--field` where a field is already: it is shown if it is this scene's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gpf.cli import main
from gpf.commands.cameras import file_beside
from gpf.commands.scenes import title_of
from gpf.core.files import write_tensors
from gpf.field.io import load_field, save_field
from gpf.scene.views import Keyframe, SceneViews
from gpf.viewing.downloads import add_view
from gpf.viewing.viewer import Viewer


@pytest.fixture
def shown(box, monkeypatch) -> list[Viewer]:
    """The viewers that ran until Ctrl-C, in the folder of the box."""
    viewers: list[Viewer] = []
    monkeypatch.setattr(Viewer, "run", lambda viewer: viewers.append(viewer))
    return viewers


def view(*words: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["view", "box.xml", "--no-open", *words])
    return int(ended.value.code or 0)


def test_the_field_of_this_scene_is_shown(shown, capsys):
    before = Path("field.safetensors").read_bytes()
    assert view() == 0
    said = capsys.readouterr().err
    assert "field.safetensors: a field of this scene; to fit a new one, choose another" in said
    assert shown[0].field is not None and shown[0].fit is None and shown[0].subject.exposure == 1.5
    assert Path("field.safetensors").read_bytes() == before
    assert not Path("field.fit").exists()


def test_a_saved_camera_stays_out_of_later_fits(shown):
    """It is listed the next time; what `gpf fit` and `render` take is as before."""
    assert view() == 0
    viewer = shown[0]
    camera = viewer.subject.cameras[0]
    file, known = viewer.subject.views_file, len(viewer.subject.cameras)
    add_view(
        file, Keyframe(origin=(0, 1, 3), target=camera.target, fov=40), "mine", (), SceneViews()
    )
    assert file == Path("box.views.yaml") and file.exists()
    assert file_beside(Path("box.xml"), None) is None
    assert view() == 0
    names = [camera.name for camera in shown[1].subject.cameras]
    assert len(names) == known + 1 and names[-1] == "mine"
    assert view("--views", "own.yaml") == 0
    assert shown[2].subject.views_file == Path("own.yaml")


@pytest.mark.parametrize(
    ("given", "title"),
    [
        ("box.xml", "box"),
        ("rooms/kitchen/scene.xml", "kitchen"),
        ("rooms/kitchen", "kitchen"),
        ("rooms/bath v1.2", "bath v1.2"),
        ("pool.blend", "pool"),
        ("veach_ajar", "veach_ajar"),
    ],
)
def test_a_scene_is_called_as_it_is_given(given, title, tmp_path, monkeypatch):
    (tmp_path / "rooms" / "bath v1.2").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert title_of(given) == title


def no_words(field: Path) -> None:
    """Nothing that says to which scene it was fitted."""
    loaded = load_field(field)
    loaded.record = {}
    save_field(loaded, field)


def other_scene(field: Path) -> None:
    text = Path("box.xml").read_text()
    assert text.count("</scene>") == 1
    Path("box.xml").write_text(text.replace("</scene>", '<shape type="sphere"/></scene>'))


def no_field(field: Path) -> None:
    write_tensors(field, "targets", {}, {})


def damaged(field: Path) -> None:
    field.write_bytes(field.read_bytes()[:-100])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            other_scene,
            r"was fitted to another scene, or before box\.xml was changed: different geometry and "
            r"materials\. Choose another name with --output .* --changed-scene\.",
        ),
        (no_words, r"does not say which scene it was fitted to\. Choose .* --changed-scene"),
        (no_field, r"holds targets, not field\. Choose another name with --output\.$"),
        (damaged, r"is truncated or damaged \(.*\)\. Choose another name with --output\.$"),
    ],
)
def test_what_is_not_the_field_of_this_scene_stays_and_is_refused(shown, capsys, change, words):
    change(Path("field.safetensors"))
    before = Path("field.safetensors").read_bytes()
    assert view() == 2
    said = " ".join(capsys.readouterr().err.split())
    assert re.search(rf"error: field\.safetensors: already exists, and {words}", said), said
    assert not shown and Path("field.safetensors").read_bytes() == before


def test_the_field_of_another_scene_is_shown_on_demand(shown):
    other_scene(Path("field.safetensors"))
    assert view("--changed-scene") == 0
    assert shown[0].field is not None


def test_groups_are_for_a_new_field(shown, capsys):
    assert view("--groups", "auto") == 2
    assert "field.safetensors: already exists. Choose another name" in capsys.readouterr().err
