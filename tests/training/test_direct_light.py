"""Samples of direct light at supervised points: how many, and in independent halves."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.direct_light import DirectLight
from gpf.training.sampled_light import AT_ONCE, balance

COUNT = 1000


@pytest.fixture(scope="module")
def direct() -> DirectLight:
    """A floor under a lamp of some size, half of which a board hides."""
    T = mi.ScalarTransform4f
    down = T().translate([0, 3, 0]).rotate([1, 0, 0], 90)
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "to_world": T().scale(9).rotate([1, 0, 0], -90)},
            "lamp": {"type": "rectangle", "to_world": down, "emitter": {"type": "area"}},
            "board": {
                "type": "rectangle",
                "to_world": T().translate([1, 2.9, 0]).rotate([1, 0, 0], 90),
            },
        }
    )
    rng = np.random.default_rng(0)
    x, z = np.sort(rng.uniform(-2, 2, COUNT)), rng.uniform(-2, 2, COUNT)
    points = dr.zeros(VisiblePoints, COUNT)
    points.p, points.n = mi.Point3f(x, 0, z), mi.Normal3f([0] * COUNT, [1] * COUNT, [0] * COUNT)
    return DirectLight(FixedPoints(scene, points), Lamps(scene), 1, seed=3)


def test_the_halves_are_independent_and_agree_with_many_samples(direct):
    direct.sample(1)
    assert direct.samples == DirectLight.LEAST
    exact = direct.points.mean_direct(Lamps(direct.points.scene), 512, seed=9)
    errors = [direct.mean(half) - exact for half in range(2)]
    spread = exact.mean() * 0.02
    assert all(abs(error.mean()) < spread for error in errors)
    together = np.corrcoef(errors[0][:, 0], errors[1][:, 0])[0, 1]
    assert abs(together) < 4 / np.sqrt(COUNT)


def test_a_saved_one_continues_with_the_same_bits(direct):
    other = DirectLight(direct.points, direct.lamps, 1, seed=3)
    direct.per_pass = 1.0
    direct.sample(6)
    other.restore(direct.tensors())
    assert (other.samples, other.per_pass) == (6, 1.0)
    direct.sample(8)
    other.sample(8)
    np.testing.assert_array_equal(direct.mean(1), other.mean(1))


def test_many_samples_come_in_parts_between_which_a_fit_can_be_interrupted(direct, monkeypatch):
    """All of them, and with the sums of all at once."""
    count = 2 * AT_ONCE + 3
    together, apart = (DirectLight(direct.points, direct.lamps, 1, seed=3) for _ in range(2))
    together.add(count)
    parts, add = [], apart.add
    monkeypatch.setattr(apart, "add", lambda more: (parts.append(more), add(more)))
    apart.per_pass = count
    apart.sample(1)
    assert parts == [AT_ONCE, AT_ONCE, 3]
    np.testing.assert_allclose(apart.mean(0), together.mean(0), rtol=1e-4)


@pytest.mark.parametrize(("noise", "expected"), [(0.0, 0.0), (0.02, 0.5), (9.0, 24.0)])
def test_the_noisier_light_gets_more_of_the_time(direct, noise, expected):
    """n/N = sqrt(8 v/V): with as much noise in 4 samples as in 25 passes, sqrt(8 · 4/25) = 1.13."""
    direct.samples = DirectLight.LEAST
    balance(25, halves(0.045), [direct], [halves(noise)])
    assert direct.per_pass == pytest.approx(expected, rel=0.15)


def test_kinds_of_light_share_the_time_that_is_too_much_for_one(direct):
    """Twice the noise, twice the samples, also where one has reached its most."""
    other = DirectLight(direct.points, direct.lamps, 1, seed=4)
    direct.samples = other.samples = DirectLight.LEAST
    balance(25, halves(0.001), [direct, other], [halves(0.5), halves(1.0)])
    assert other.per_pass == DirectLight.MOST_PER_PASS
    assert direct.per_pass == pytest.approx(other.per_pass / 2, rel=0.1)


def halves(sigma: float) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(round(1e6 * sigma))
    first, second = (1 + sigma * rng.normal(size=(COUNT, 3)) for _ in range(2))
    return first, second
