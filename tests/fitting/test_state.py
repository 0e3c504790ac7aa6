"""What a fit continues from, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.fitting.state import PHOTONS, FitState

IDENTITY = {
    "scene": {"geometry": "g", "materials": "m", "lights": "l"},
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
    tensors, facts, best = FitState(folder, IDENTITY).load(must_exist=True)
    np.testing.assert_array_equal(tensors["photons/keys"], [0, 1, 2])
    assert facts == {"passes": 7} and best is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scene": {"geometry": "g", "materials": "x", "lights": "y"}}, "other materials, lights"),
        ({"cameras": "x"}, "other cameras"),
        ({"seed": 2}, "other seed"),
        ({"settings": []}, "other settings"),
        ({"groups": [[0], [1]]}, "other groups"),
    ],
)
def test_photons_of_another_fit_are_refused_or_not_used(folder, change, words, caplog):
    state = FitState(folder, IDENTITY | change)
    with pytest.raises(UserError, match=f"has the photons of another fit: {words}. Give the same"):
        state.load(must_exist=True)
    assert not caplog.records
    assert state.load() == ({}, {}, None)
    assert words in caplog.text and "Starting anew" in caplog.text
    assert FitState(folder, IDENTITY).load()[1] == {"passes": 7}


def test_without_photons_there_is_nothing_to_go_on_with(tmp_path, caplog):
    state = FitState(tmp_path / "none.fit", IDENTITY)
    with pytest.raises(UserError, match="has no photons of a fit"):
        state.load(must_exist=True)
    assert state.load() == ({}, {}, None) and not caplog.records


def test_damaged_photons_are_refused_or_not_used(folder, caplog):
    (folder / PHOTONS).write_bytes((folder / PHOTONS).read_bytes()[:-5])
    with pytest.raises(UserError, match="is truncated or damaged"):
        FitState(folder, IDENTITY).load(must_exist=True)
    assert FitState(folder, IDENTITY).load() == ({}, {}, None)
    assert "truncated or damaged" in caplog.text
