"""Samples of the lit surfaces: where they lie, and that dim regions get their share."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.bounds import scene_bounds
from gpf.errors import UserError
from gpf.photon_tracing import record_photons
from gpf.surface_samples import sample_surface_points


def lit_floor(looks_down: bool = True) -> mi.Scene:
    """A floor of 4 by 2 with a small lamp close above its right end."""
    t = mi.ScalarTransform4f
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {
                "type": "rectangle",
                "to_world": t().scale([2, 1, 1]),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.25}},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": t()
                .translate([1.2, 0, 0.5])
                .scale(0.1)
                .rotate([1, 0, 0], 180 if looks_down else 0),
                "bsdf": {"type": "conductor"},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [5, 4, 3]}},
            },
        }
    )


def sample(count: int, paths: int, radius: float, looks_down: bool = True):
    scene = lit_floor(looks_down)
    photons = record_photons(scene, paths=paths, seed=3)
    return sample_surface_points(photons, count, radius, scene_bounds(scene), seed=3)


def test_surface_points_lie_on_the_lit_surface_and_are_spread():
    points = sample(3000, paths=20_000, radius=0.05)
    x, y, z = np.array(points.p)
    assert dr.width(points.p) == 3000 and np.array(points.valid).all()
    assert np.abs(z).max() < 1e-4
    np.testing.assert_allclose(np.array(points.n), np.tile([[0], [0], [1]], 3000), atol=1e-5)
    # Photons alone would put some 70% of the points into the disc below the lamp; evenly spread
    # ones 10%. Half of each:
    below = np.mean(np.hypot(x - 1.2, y) < 0.5)
    assert 0.25 < below < 0.6
    left = np.mean(x < 0)
    assert left > 0.1  # half of the floor gets next to no light, but its points


def test_no_more_surface_points_than_photons():
    points = sample(100_000, paths=100, radius=0.1)
    assert 50 < dr.width(points.p) <= 100
    points = sample(7, paths=100, radius=0.1)
    assert dr.width(points.p) == 7


def test_a_lamp_that_shines_elsewhere_is_said_in_words():
    with pytest.raises(UserError, match="no photon reached a diffuse surface. Check where the emi"):
        sample(10, paths=100, radius=0.1, looks_down=False)
