"""Scattered lobes, against integrals over the sphere."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.scene.phase_functions import scatter_lobes

PHASES = {
    "isotropic": {"type": "isotropic"},
    "hg": {"type": "hg", "g": 0.6},
    "backward": {"type": "hg", "g": -0.4},
    "rayleigh": {"type": "rayleigh"},
    "blend": {
        "type": "blendphase",
        "weight": 0.3,
        "first": {"type": "hg", "g": 0.6},
        "second": {"type": "isotropic"},
    },
}


def lobe(r: float, cosine: np.ndarray) -> np.ndarray:
    return (1 - r**2) / (4 * np.pi * (1 + r**2 - 2 * r * cosine) ** 1.5)


def values(phase: dict, cosine: np.ndarray) -> np.ndarray:
    """The phase function where light turns by an angle; (N,)."""
    loaded = mi.load_dict(phase)
    place = dr.zeros(mi.MediumInteraction3f, len(cosine))
    place.wi = mi.Vector3f(0, 0, -1)
    place.sh_frame = mi.Frame3f(place.wi)
    out = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=1)
    context = mi.PhaseFunctionContext()
    share = loaded.eval_pdf(context, place, from_numpy(mi.Vector3f, out))[1].numpy()
    return np.broadcast_to(share, cosine.shape)


def found(phase: dict, r: float, cosine: np.ndarray) -> np.ndarray:
    medium = mi.load_dict({"type": "homogeneous", "phase": phase})
    pointers = dr.select(dr.full(mi.Bool, True, len(cosine)), mi.MediumPtr(medium), None)
    mean = dr.full(mi.Float, r, len(cosine))
    return scatter_lobes(pointers, [mean], [from_numpy(mi.Float, cosine)])[0].numpy()


@pytest.mark.parametrize("name", PHASES)
def test_a_beam_is_scattered_by_the_phase_function_itself(name):
    cosine = np.linspace(-0.99, 0.99, 41)
    expected = values(PHASES[name], cosine)
    np.testing.assert_allclose(found(PHASES[name], 1.0, cosine), expected, rtol=1e-4)


@pytest.mark.parametrize(("name", "r"), [("hg", 0.5), ("backward", 0.7), ("isotropic", 0.5)])
def test_a_lobe_is_scattered_into_a_lobe(name, r):
    """∫ f(ω, ω') L(ω') dω', over a million directions ω'."""
    z, angle = (v.ravel() for v in np.meshgrid(np.arange(2000) / 1000 - 0.9995, np.arange(500)))
    angle = angle * 2 * np.pi / 500
    x = np.sqrt(1 - z**2) * np.cos(angle)
    for cosine in (-0.8, 0.1, 0.9):
        sine = np.sqrt(1 - cosine**2)
        integrand = values(PHASES[name], z) * lobe(r, np.clip(sine * x + cosine * z, -1, 1))
        expected = 4 * np.pi * integrand.mean()
        here = found(PHASES[name], r, np.array([cosine]))
        assert here == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("name", PHASES)
def test_nothing_is_lost(name):
    cosine = np.linspace(-1, 1, 20001)
    middle = (cosine[1:] + cosine[:-1]) / 2
    total = 4 * np.pi * found(PHASES[name], 0.6, middle).mean()
    assert total == pytest.approx(1, rel=1e-3)
