"""What a fit continues from, and what it refuses."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.fitting import state as state_module
from gpf.fitting.state import PHOTONS, FitState
from tests.commands.box import box_field

SCENE = {"geometry": [1.0] * 10, "materials": {"m": 1.0}, "lights": ["l"]}
IDENTITY = {
    "scene": SCENE,
    "cameras": "c",
    "seed": 1,
    "settings": [{"radius": 0.5}],
}
TENSORS = {"photons/keys": np.arange(3)}


@pytest.fixture
def folder(tmp_path):
    FitState(tmp_path / "box.fit", IDENTITY).save(TENSORS, {"passes": 7}, None)
    return tmp_path / "box.fit"


def test_what_was_saved_is_there(folder):
    tensors, facts, best = FitState(folder, IDENTITY).load("always")
    np.testing.assert_array_equal(tensors["photons/keys"], [0, 1, 2])
    assert facts == {"passes": 7} and best is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": SCENE | {"materials": {"x": 1.0}, "lights": []}}, "different materials, lights"),
        ({"cameras": "x"}, "different cameras"),
        ({"seed": 2}, "different seed"),
        ({"settings": []}, "different settings"),
        ({"groups": [[0], [1]]}, "different groups"),
    ],
)
def test_photons_of_another_fit_are_refused_or_not_used(folder, change, words, caplog):
    state = FitState(folder, IDENTITY | change)
    with pytest.raises(UserError, match=f"has the photons of another fit: {words}. Give the same"):
        state.load("always")
    assert not caplog.records
    assert state.load() == ({}, {}, None)
    assert words in caplog.text and "Starting a new fit" in caplog.text
    assert FitState(folder, IDENTITY).load()[1] == {"passes": 7}


def test_photons_of_another_version_are_told_as_such(folder, monkeypatch):
    monkeypatch.setattr(state_module, "FORMAT", state_module.FORMAT + 1)
    with pytest.raises(UserError, match="different version of this software"):
        FitState(folder, IDENTITY).load("always")


def test_a_fit_that_never_resumes_leaves_the_files_until_it_saves(folder):
    assert FitState(folder, IDENTITY).load("never") == ({}, {}, None)
    assert FitState(folder, IDENTITY).load()[1] == {"passes": 7}


def test_the_field_belongs_to_the_photons(folder):
    """Of another fit in the same folder, and of a kill between the two files, nothing is left."""
    field = box_field(mi.load_dict(mi.cornell_box(), optimize=False), count=50)
    field.record = {"passes": 72}
    own = FitState(folder, IDENTITY)
    own.save(TENSORS, {"passes": 72}, field)
    assert own.load("always")[2].record == {"passes": 72}
    (folder / ".gpf-partial-photons-x.safetensors").write_bytes(b"half")
    (folder / "field-of-mine.safetensors").write_bytes(b"not of the fit")
    (folder / "field-216.safetensors").write_bytes(b"whole, but its photons were not written")
    assert own.load("always")[2].record == {"passes": 72}
    other = FitState(folder, IDENTITY | {"seed": 2})
    other.save(TENSORS, {"passes": 5}, None)
    assert other.load("always")[1:] == ({"passes": 5}, None)
    assert sorted(f.name for f in folder.iterdir()) == ["field-of-mine.safetensors", PHOTONS]


def test_without_photons_there_is_nothing_to_go_on_with(tmp_path, caplog):
    state = FitState(tmp_path / "none.fit", IDENTITY)
    with pytest.raises(UserError, match="has no photons from a fit"):
        state.load("always")
    assert state.load() == ({}, {}, None) and not caplog.records


def test_damaged_photons_are_refused_or_not_used(folder, caplog):
    (folder / PHOTONS).write_bytes((folder / PHOTONS).read_bytes()[:-5])
    with pytest.raises(UserError, match="is truncated or damaged"):
        FitState(folder, IDENTITY).load("always")
    assert FitState(folder, IDENTITY).load() == ({}, {}, None)
    assert "truncated or damaged" in caplog.text
