"""Few passes of photon mapping, where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.options import SppmOptions
from baselines.protocol import CannotServe
from baselines.sppm import Sppm
from tests.baselines.classical import ABOVE, INSIDE, floor_radiance, lit_floor, pane, task_for
from tests.furnace import camera, diffuse, furnace, point_light, room


def prepare(scene, passes=3, photons=20_000):
    options = SppmOptions(system="sppm", passes=passes, photons_per_pass=photons)
    return Sppm(options).prepare(task_for(scene))


@pytest.mark.parametrize("light", ["point", "area"])
def test_in_the_furnace_the_radiance_is_one(light):
    image = prepare(furnace(light), passes=10).render(INSIDE, seed=1)
    assert image.shape == (6, 8, 3)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, 1, atol=0.3)
    assert image.mean() == pytest.approx(1, abs=0.02)


def test_each_pixel_sees_its_part_of_the_floor():
    scene = lit_floor(sensor=camera(ABOVE.origin, ABOVE.target, 35))
    image = prepare(scene, passes=60).render(ABOVE, seed=2)
    np.testing.assert_allclose(image, floor_radiance(ABOVE), rtol=0.1)


def test_it_finds_the_caustic_that_paths_never_do():
    scene = lit_floor(sensor=camera(ABOVE.origin, ABOVE.target, 35), pane=pane())
    image = prepare(scene, passes=10).render(ABOVE, seed=3)
    # Glass takes some light on the way down, on the way up, and shifts what it lets through.
    share = image.mean() / floor_radiance(ABOVE).mean()
    assert 0.7 < share < 1


def test_more_passes_have_less_noise():
    scene = furnace("point")
    variance = []
    for passes in (1, 4):
        prepared = prepare(scene, passes, photons=3000)
        variance.append(np.var([prepared.render(INSIDE, k) for k in range(12)], axis=0).mean())
    # A fourth, and somewhat more: radii shrink.
    assert 0.2 < variance[1] / variance[0] < 0.45


def test_the_storage_is_the_photon_map_of_a_pass():
    dark = {"type": "scene", "room": room(diffuse(0)), "light": point_light((0, 0, 0), 1)}
    prepared = prepare(dark | {"sensor": camera((0.3, 0.2, 0.1), (1, 0.5, 0.4))}, photons=1500)
    # Every path ends where it lands: position, normal and power of three, depth of one number.
    assert prepared.storage_bytes == 1500 * (3 + 3 + 3 + 1) * 4


def test_one_seed_is_one_image():
    prepared = prepare(furnace("point"), passes=1)
    assert prepared.facts["passes"] == 1
    assert prepared.facts["photons_per_pass"] == 20_000
    assert 0 < prepared.facts["initial_radius"] < 0.2
    first, again, other = (prepared.render(INSIDE, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_a_material_that_photons_cannot_use_is_refused_in_words():
    with pytest.raises(CannotServe, match="analytic: no photon mapping: .*principled"):
        prepare(lit_floor(room=room({"type": "principled"})))
