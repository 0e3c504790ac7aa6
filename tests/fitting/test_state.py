"""What a fit continues from, and what it refuses."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
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
    FitState(tmp_path / "box.fit", IDENTITY).save(TENSORS, {"passes": 7}, {})
    return tmp_path / "box.fit"


def test_what_was_saved_is_there(folder):
    tensors, facts, fields = FitState(folder, IDENTITY).load("always")
    np.testing.assert_array_equal(tensors["photons/keys"], [0, 1, 2])
    assert facts == {"passes": 7} and fields == {}


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
    assert state.load() == ({}, {}, {})
    assert words in caplog.text and "Starting a new fit" in caplog.text
    assert FitState(folder, IDENTITY).load()[1] == {"passes": 7}


def test_photons_of_another_version_are_told_as_such(folder, monkeypatch):
    monkeypatch.setattr(state_module, "FORMAT", state_module.FORMAT + 1)
    with pytest.raises(UserError, match="different version of this software"):
        FitState(folder, IDENTITY).load("always")


def test_a_fit_that_never_resumes_leaves_the_files_until_it_saves(folder):
    assert FitState(folder, IDENTITY).load("never") == ({}, {}, {})
    assert FitState(folder, IDENTITY).load()[1] == {"passes": 7}


def a_field(light: float) -> GaussianPhotonField:
    field = box_field(mi.load_dict(mi.cornell_box(), optimize=False), count=50)
    field.record = {"passes": 72, "light": light}
    return field


def test_the_fields_belong_to_the_photons(folder):
    """Nothing is left of another fit in the same folder, or of what was half written."""
    field, other, own = a_field(1), a_field(2), FitState(folder, IDENTITY)
    own.save(TENSORS, {"passes": 72}, {"best": field, "gathering": other})
    found = own.load("always")[2]
    assert (found["best"].record, found["gathering"].record) == (field.record, other.record)
    own.save(TENSORS, {"passes": 72}, {"best": field, "gathering": field})
    found = own.load("always")[2]
    assert found["best"] is found["gathering"] and found["best"].record == field.record
    assert len(list(folder.glob("field-*"))) == 1
    (folder / ".gpf-partial-photons-x.safetensors").write_bytes(b"half")
    (folder / "field-of-mine.safetensors").write_bytes(b"not of the fit")
    (folder / "field-216.safetensors").write_bytes(b"whole, but its photons were not written")
    assert own.load("always")[2]["best"].record == field.record
    FitState(folder, IDENTITY | {"seed": 2}).save(TENSORS, {"passes": 5}, {})
    assert sorted(f.name for f in folder.iterdir()) == ["field-of-mine.safetensors", PHOTONS]


def test_a_kill_between_the_fields_and_the_photons_leaves_the_old_state(folder, monkeypatch):
    """Also where the new field has the passes of the old one."""
    own = FitState(folder, IDENTITY)
    own.save(TENSORS, {"passes": 72}, {"best": a_field(1)})

    def kill(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as once, pytest.raises(KeyboardInterrupt):
        once.setattr(state_module, "write_tensors", kill)
        own.save(TENSORS, {"passes": 72}, {"best": a_field(2)})
    assert own.load("always")[2]["best"].record["light"] == 1


def test_without_photons_there_is_nothing_to_go_on_with(tmp_path, caplog):
    state = FitState(tmp_path / "none.fit", IDENTITY)
    with pytest.raises(UserError, match="has no photons from a fit"):
        state.load("always")
    assert state.load() == ({}, {}, {}) and not caplog.records


def test_damaged_photons_are_refused_or_not_used(folder, caplog):
    (folder / PHOTONS).write_bytes((folder / PHOTONS).read_bytes()[:-5])
    with pytest.raises(UserError, match="is truncated or damaged"):
        FitState(folder, IDENTITY).load("always")
    assert FitState(folder, IDENTITY).load() == ({}, {}, {})
    assert "truncated or damaged" in caplog.text
