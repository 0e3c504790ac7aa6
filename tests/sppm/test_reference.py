"""Camera samples and fixed points of views, and the passes that gather light at them."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.random import pass_seed
from gpf.core.structs import VisiblePoints, concatenate, to_numpy
from gpf.sppm.passes import PassSettings, PhotonPasses
from stages.references.view_samples import fixed_points, sample_view
from tests.furnace import camera, cornell_box

SETTINGS = PassSettings(photons_per_pass=5000, initial_radius=0.1, direct="photons")
CAMERAS = {
    "front": camera((0, -0.2, 3.6), (0, 0, 0), 45, (8, 6)),
    "side": camera((-0.7, 0.3, 3), (0.3, -0.4, 0), 50, (5, 7)),
}


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    box = cornell_box(glass=True)
    del box["sensor"]
    return mi.load_dict(box)


def points_of(scene: mi.Scene, name: str) -> VisiblePoints:
    return fixed_points(scene, mi.load_dict(CAMERAS[name]), name, SETTINGS, 3)


def test_a_share_of_the_fixed_points(scene):
    sensor = mi.load_dict(
        CAMERAS["front"] | {"film": {"type": "hdrfilm", "width": 64, "height": 48}}
    )
    whole = fixed_points(scene, sensor, "front", SETTINGS, 3)
    part = fixed_points(scene, sensor, "front", SETTINGS, 3, share=0.25)
    kept, valid = np.array(part.valid), np.array(whole.valid)
    assert (kept <= valid).all()
    assert kept.sum() == pytest.approx(0.25 * valid.sum(), rel=0.15)
    np.testing.assert_array_equal(np.array(part.p), np.array(whole.p))
    other = fixed_points(scene, sensor, "other", SETTINGS, 3, share=0.25)
    assert (np.array(other.valid) != kept).any()


def test_seed_and_name_give_other_samples(scene):
    sensor = mi.load_dict(CAMERAS["front"])

    def positions(name: str, seed: int, t: int) -> np.ndarray:
        return to_numpy(sample_view(scene, sensor, name, SETTINGS, seed, t).points.p)

    base = positions("front", 3, 1)
    np.testing.assert_array_equal(base, positions("front", 3, 1))
    for other in (("side", 3, 1), ("front", 4, 1), ("front", 3, 2)):
        assert (positions(*other) != base).any(1).mean() > 0.9


def test_pass_seeds_do_not_collide():
    seeds = {pass_seed(s, t, k) for s in range(8) for t in range(64) for k in (0, 1, 2, 3, 12345)}
    assert len(seeds) == 8 * 64 * 5
    assert all(0 <= s < 2**32 for s in seeds)


def test_the_kernel_shrinks_from_pass_to_pass(scene):
    """Fewer points find photons: the radius of a pass is that of its index."""
    points = points_of(scene, "front")
    few = PassSettings(photons_per_pass=2000, initial_radius=0.05, direct="photons")
    found = [
        np.mean(
            [
                (to_numpy(PhotonPasses(scene, few, s).trace(t).irradiance(points)) > 0).mean()
                for s in range(8)
            ]
        )
        for t in (1, 4000)
    ]
    # r_4000² / r_1² = 0.09
    assert found[1] < 0.5 * found[0]


def test_concatenation_keeps_every_lane_in_place(scene):
    a, b = (points_of(scene, name) for name in CAMERAS)
    joined = concatenate([a, b])
    for field in ("p", "n", "reflectance", "throughput", "emission", "depth", "valid"):
        parts = []
        for points, width in ((a, 48), (b, 35)):
            values = to_numpy(getattr(points, field))
            parts.append(np.broadcast_to(values, (width, *values.shape[1:])))
        np.testing.assert_array_equal(to_numpy(getattr(joined, field)), np.concatenate(parts))
