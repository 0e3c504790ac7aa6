"""The unit of time: a small image by `path`, whose time grows with what it has to do."""

from __future__ import annotations

import mitsuba as mi
import pytest

from gpf.scene.views import View
from stages.common import timing_baseline

VIEW = View(name="v", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3)


@pytest.fixture(scope="module")
def scene():
    box = mi.cornell_box()
    del box["sensor"]
    return mi.load_dict(box)


def test_the_median_of_some_after_one(scene, monkeypatch):
    ticks = iter([0, 50, 100, 101, 200, 203, 300, 302, 400, 409, 500, 504])
    monkeypatch.setattr(timing_baseline.time, "perf_counter", lambda: next(ticks))
    seen = []
    render = mi.render

    def watch(scene, **options):
        seen.append(options)
        return render(scene, **options)

    monkeypatch.setattr(timing_baseline.mi, "render", watch)
    # 50 s is the one that compiles; of 1, 3, 2, 9 and 4 s the median is 3.
    assert timing_baseline.time_path(scene, VIEW, (8, 6)) == 3
    assert len(seen) == 6 and all(options["spp"] == 1 for options in seen)
    assert tuple(seen[0]["sensor"].film().crop_size()) == (8, 6)
    assert "max_depth = 2" in str(seen[0]["integrator"])


def test_a_larger_image_takes_longer(scene):
    small, large = (timing_baseline.time_path(scene, VIEW, size) for size in ((8, 6), (800, 600)))
    assert 0 < small < large
