"""Volume shaders of Blender as media: their coefficients, by Cycles' formulas."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.blender.materials import translate
from gpf.blender.media import make_medium
from gpf.blender.textures import Textures

PLAIN = Textures(work=None, folder=None, images={})  # type: ignore[arg-type]
SCATTER = {
    "closure": "volume_scatter",
    "color": [0.5, 0.25, 1.0],
    "density": 2.0,
    "anisotropy": 0.3,
}
ABSORB = {"closure": "volume_absorption", "color": [0.5, 1.0, 0.0], "density": 4.0}
FOG = SCATTER | {
    "closure": "volume_principled",
    "absorption_color": [0.25, 0.0, 1.0],
    "emission_strength": 0.0,
    "blackbody_intensity": 0.0,
}


def coefficients(closure):
    """Scattering and extinction, (3,) each, as Mitsuba has them."""
    made, _ = make_medium(closure)
    medium = mi.load_dict(made)
    found = medium.get_scattering_coefficients(mi.MediumInteraction3f(), True)
    return [np.array(value).ravel() for value in (found[0], found[2])]


@pytest.mark.parametrize(
    ("closure", "scattering", "absorption"),
    [
        (SCATTER, [1, 0.5, 2], [0, 0, 0]),
        (ABSORB, [0, 0, 0], [2, 0, 4]),
        (FOG, [1, 0.5, 2], [2 * 0.5 * 0.5, 2 * 0.75, 0]),
        ({"closure": "add", "first": SCATTER, "second": ABSORB}, [1, 0.5, 2], [2, 0, 4]),
        (
            {"closure": "mix", "factor": 0.25, "first": SCATTER, "second": ABSORB},
            [0.75, 0.375, 1.5],
            [0.5, 0, 1],
        ),
    ],
    ids=["scatter", "absorption", "principled", "add", "mix"],
)
def test_coefficients(closure, scattering, absorption):
    found, extinction = coefficients(closure)
    np.testing.assert_allclose(found, scattering, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(extinction, np.add(scattering, absorption), rtol=1e-5, atol=1e-6)


def test_two_phase_functions_have_their_mean_cosine():
    other = SCATTER | {"anisotropy": -0.3, "density": 4.0}
    made, notes = make_medium({"closure": "add", "first": SCATTER, "second": other})
    assert made["phase"]["g"] == pytest.approx((0.3 - 2 * 0.3) / 3)
    assert notes == ["two phase functions as one, with their mean cosine"]


def test_what_cannot_be_expressed_is_said():
    _, notes = make_medium(FOG | {"varying": ["density"], "emission_strength": 1.0})
    assert notes == [
        "density of the volume the same everywhere",
        "emission of the volume left out",
    ]


def test_nothing_at_the_surface_and_nothing_inside():
    made = translate({"closure": "none", "volume": SCATTER}, PLAIN)
    assert made.whole() == {"type": "null"} and made.medium["type"] == "homogeneous"
    assert make_medium(SCATTER | {"density": 0.0}) == (None, [])
    assert make_medium({"closure": "none"}) == (None, [])
