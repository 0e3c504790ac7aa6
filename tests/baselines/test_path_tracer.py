"""The path tracer, where the answer is known."""

from __future__ import annotations

import time

import numpy as np
import pytest

from baselines.options import PathTracerOptions
from baselines.path_tracer import PathTracer
from baselines.protocol import CannotServe
from gpf.scene.views import View
from tests.baselines.classical import ABOVE, INSIDE, floor_radiance, lit_floor, pane, task_for
from tests.furnace import cornell_box, furnace

FRONT = View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), up=(0, 1, 0), fov=39.3)


def prepare(scene, spp=400, **task):
    return PathTracer(PathTracerOptions(system="path_tracer", spp=spp)).prepare(
        task_for(scene, **task)
    )


# With rr_depth 0, which the settings allow and Mitsuba refuses.
@pytest.mark.parametrize("rr_depth", [5, 0])
@pytest.mark.parametrize("light", ["point", "area"])
def test_in_the_furnace_the_radiance_is_one(light, rr_depth):
    image = prepare(furnace(light), spp=4000, rr_depth=rr_depth).render(INSIDE, seed=1)
    assert image.shape == (6, 8, 3)
    assert image.dtype == np.float32
    np.testing.assert_allclose(image, 1, atol=0.05)
    assert image.mean() == pytest.approx(1, abs=0.005)


def test_each_pixel_sees_its_part_of_the_floor():
    image = prepare(lit_floor(), spp=10_000).render(ABOVE, seed=2)
    np.testing.assert_allclose(image, floor_radiance(ABOVE), rtol=0.015)


def test_a_caustic_of_a_point_is_never_found():
    prepared = prepare(lit_floor(pane=pane()))
    assert prepared.render(ABOVE, seed=3).max() == 0


def test_equal_time_is_by_the_clock_or_has_a_reason():
    with pytest.raises(CannotServe, match="analytic: .*no equal time.*Set `seconds_per_view`"):
        prepare(cornell_box(), "equal_time")
    prepared = prepare(cornell_box(), "equal_time", seconds_per_view=0.5)
    start = time.perf_counter()
    image = prepared.render(FRONT, 1)
    assert time.perf_counter() - start > 0.2
    spp = prepared.facts["spp"]
    assert spp > 16
    dim = image.max(-1) < 2
    wanted = prepare(cornell_box(), 500).render(FRONT, 2)[dim].mean()
    assert image[dim].mean() == pytest.approx(wanted, rel=0.1)
    prepared.render(FRONT, 3)
    # What is told is the mean over views.
    assert prepared.facts["spp"] == pytest.approx(np.mean(prepared.samples.taken))
    assert len(prepared.samples.taken) == 2 and prepared.samples.taken[0] == spp


def test_nothing_is_kept_and_the_samples_are_told():
    prepared = prepare(lit_floor(), spp=7)
    assert prepared.storage_bytes == 0
    assert prepared.facts == {"spp": 7}
    first, again, other = (prepared.render(ABOVE, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
