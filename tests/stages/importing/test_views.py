"""The exposure of an imported scene; cameras have tests of their own."""

import mitsuba as mi
import pytest

from gpf.scene.views import View
from stages.importing.views import measure_exposure

OWN = View(name="own", origin=(0, 0, 3.9), target=(0, 0, 2.9), fov=39.3)


def test_exposure_brings_a_picture_into_range():
    exposure = measure_exposure(mi.load_dict(mi.cornell_box(), optimize=False), OWN, 1)
    brighter = mi.cornell_box()
    brighter["light"]["emitter"]["radiance"]["value"] = [184, 155, 80]
    ten_times = measure_exposure(mi.load_dict(brighter, optimize=False), OWN, 1)
    assert 0.5 < exposure < 5
    assert exposure / ten_times == pytest.approx(10, rel=0.15)
