"""`gpf view` without `--field` where a field is already: it is shown if it is this scene's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from gpf.cli import main
from gpf.core.files import write_tensors
from gpf.field.io import load_field, save_field
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
