"""Camera rays: when they start, and which cameras keep samples to their pixels."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from gpf.camera.rays import keeps_to_pixels, sample_pixel_rays
from gpf.core.structs import from_numpy
from tests.furnace import camera

COUNT = 4096


def times(**shutter: float) -> tuple[mi.Sensor, np.ndarray]:
    sensor = mi.load_dict(camera((0, 0, 3), (0, 0, 0), 45, (8, 8)) | shutter)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, COUNT)
    ray, _ = sample_pixel_rays(sensor, sampler, from_numpy(mi.Point2u, np.zeros((COUNT, 2))))
    return sensor, np.broadcast_to(np.array(ray.time), COUNT)


def test_rays_start_while_the_shutter_is_open():
    sensor, found = times(shutter_open=0.25, shutter_close=0.75)
    # Evenly: a tenth of the time has a tenth of the rays, give or take four standard errors.
    shares = np.histogram(found, bins=10, range=(0.25, 0.75))[0] / COUNT
    np.testing.assert_allclose(shares, 0.1, atol=4 * (0.09 / COUNT) ** 0.5)
    assert not keeps_to_pixels(sensor)


def test_a_shutter_without_a_length_opens_at_its_time():
    _, found = times(shutter_open=0.5, shutter_close=0.5)
    np.testing.assert_array_equal(found, 0.5)
