"""The particle tracer, where the answer is known, and where it has none."""

from __future__ import annotations

import numpy as np
import pytest

from baselines.options import ParticleTracerOptions
from baselines.particle_tracer import ParticleTracer
from gpf.scene.views import View
from tests.baselines.classical import ABOVE, INSIDE, floor_radiance, lit_floor, pane, task_for
from tests.furnace import cornell_box, furnace

FRONT = View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), up=(0, 1, 0), fov=39.3)


def prepare(scene, spp, **task):
    options = ParticleTracerOptions(system="particle_tracer", spp=spp)
    return ParticleTracer(options).prepare(task_for(scene, **task))


# Half of what the area furnace shows is its own light, seen directly.
@pytest.mark.parametrize("light", ["point", "area"])
def test_in_the_furnace_the_radiance_is_one(light):
    image = prepare(furnace(light), 20_000).render(INSIDE, seed=1)
    assert image.shape == (6, 8, 3)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, 1, atol=0.15)
    assert image.mean() == pytest.approx(1, abs=0.01)


def test_each_pixel_sees_its_part_of_the_floor():
    image = prepare(lit_floor(), 100_000).render(ABOVE, seed=2)
    np.testing.assert_allclose(image, floor_radiance(ABOVE), rtol=0.06)
    assert image.mean() == pytest.approx(floor_radiance(ABOVE).mean(), rel=0.01)


def test_what_is_behind_glass_remains_black():
    assert prepare(lit_floor(pane=pane()), 1000).render(ABOVE, seed=3).max() == 0


def test_equal_time_is_by_the_clock():
    box = cornell_box()
    prepared = prepare(box, "equal_time", seconds_per_view=2)
    image = prepared.render(FRONT, 1)
    spp = prepared.facts["spp"]
    assert spp > 16 and prepared.facts["paths"] == spp * 48
    np.testing.assert_allclose(image.mean(), prepare(box, 2000).render(FRONT, 2).mean(), rtol=0.1)


def test_nothing_is_kept_and_the_paths_are_told():
    prepared = prepare(lit_floor(), 16)
    assert prepared.storage_bytes == 0
    assert prepared.facts == {"spp": 16, "paths": 16 * 48}
    first, other = (prepared.render(ABOVE, seed) for seed in (4, 5))
    assert (first != other).any()
