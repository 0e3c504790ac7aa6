"""Solids of glass or water that overlap are found; those that may be as they are, are not."""

from __future__ import annotations

import mitsuba as mi
import pytest

from gpf.fitting import fit
from gpf.scene.solids import overlapping_solids

T = mi.ScalarTransform4f
GLASS, WATER = {"type": "dielectric"}, {"type": "dielectric", "int_ior": 1.33}
ROUGH = {"type": "principled", "spec_trans": 1.0, "roughness": 0.2}


def ball(x: float, radius: float, bsdf: dict, **more: object) -> dict:
    return {"type": "sphere", "center": [x, 0, 0], "radius": radius, "bsdf": bsdf, **more}


def load(first: dict, second: dict) -> mi.Scene:
    ground = {"type": "rectangle", "to_world": T().translate([0, 0, -2]).scale(5)}
    parts = {"ground": ground, "sky": {"type": "constant"}, "water": second, "glass": first}
    return mi.load_dict({"type": "scene", **parts})


@pytest.mark.parametrize(
    ("second", "overlap"),
    [
        (ball(0.8, 1, WATER), True),
        (ball(1.05, 0.1, WATER), True),  # a small part of a small one
        (ball(0.8, 1, ROUGH), True),
        (ball(0.8, 1, {"type": "thindielectric"}), False),  # a sheet
        (ball(0.8, 1, {"type": "diffuse"}), False),
        (ball(0.2, 0.5, WATER), False),
        (ball(0.2, 0.5, GLASS, flip_normals=True), False),  # a bubble
        (ball(2.5, 1, WATER), False),
        # The surface of water in a glass, which is open.
        ({"type": "disk", "to_world": T().scale(0.99), "bsdf": WATER}, False),
    ],
)
def test_solids_that_overlap(second, overlap):
    assert overlapping_solids(load(ball(0, 1, GLASS), second)) == [("glass", "water")] * overlap


def test_sheets_of_glass_that_mitsuba_merges():
    """Their mesh has no box in Mitsuba."""
    glass = mi.load_dict(GLASS)
    parts = {
        f"pane {k}": {"type": "rectangle", "to_world": T().translate([0, 0, k]), "bsdf": glass}
        for k in range(2)
    }
    assert (
        overlapping_solids(mi.load_dict({"type": "scene", "b": ball(0, 3, WATER), **parts})) == []
    )


def test_a_fit_says_so(monkeypatch, caplog):
    monkeypatch.setattr(fit, "place_sensors", lambda scene: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        fit.fit(load(ball(0, 1, GLASS), ball(0.8, 1, WATER)))
    assert "glass and water overlap: light in both is refracted as if" in caplog.text
