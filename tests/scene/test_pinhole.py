"""Pinhole cameras against Mitsuba's."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.scene.pinhole import make_pinhole
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View


@pytest.mark.parametrize("axis", ["x", "y", "diagonal", "smaller", "larger"])
@pytest.mark.parametrize("size", [(8, 6), (5, 9)])
def test_pixels_are_those_of_the_sensor(axis: str, size: tuple[int, int]) -> None:
    view = View(
        name="a", origin=(1, 2, 3), target=(-1, 0.5, 1), up=(0.2, 1, 0.1), fov=50, fov_axis=axis
    )
    places = np.array([[0, 0], [1, 0], [0, 1], [0.5, 0.5], [0.9, 0.2]])
    rays, _ = make_sensor(view, *size).sample_ray(
        0, 0, from_numpy(mi.Point2f, places), mi.Point2f(0.5)
    )
    dr.eval(rays)
    points = np.array(rays.o).T + 2.5 * np.array(rays.d).T
    camera = make_pinhole(view, size)
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(pixels, places * size, atol=1e-3)
    assert (depth > 0).all() and (camera.project(2 * camera.origin - points)[1] < 0).all()
    np.testing.assert_allclose(camera.pose @ [0, 0, 0, 1], [1, 2, 3, 1])
