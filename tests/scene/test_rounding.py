"""Scenes that are very small, or far from the origin."""

from __future__ import annotations

import warnings

import mitsuba as mi
import numpy as np
import pytest

from gpf.scene.inventory import check_scene
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import diffuse, point_light


def ball(scale: float, shift: float) -> mi.Scene:
    at = [shift, 0.5 * shift, 0]
    shape = {"type": "sphere", "center": at, "radius": scale, "bsdf": diffuse(0.5)}
    light = point_light((shift, 0.5 * shift, 3 * scale), 1)
    return mi.load_dict({"type": "scene", "ball": shape, "light": light})


@pytest.mark.parametrize(
    ("scale", "shift", "todo"),
    [
        (1e-3, 0, "Scale it to a size of 1 or more"),
        (1, 1e4, "Move it to the origin"),
        (1, 1e5, "Move it to the origin"),
        (0.1, 0, None),
        (1, 10, None),
        (1e3, 1e4, None),
        (1e5, 0, None),
    ],
)
def test_what_single_precision_cannot_hold_is_told(scale, shift, todo):
    scene = ball(scale, shift)
    if todo:
        with pytest.warns(
            UserWarning, match=rf"The scene extends from .* single precision .* {todo}"
        ):
            check_scene(scene)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_scene(scene)


@pytest.mark.parametrize("scale", [1e-4, 1, 1e6])
def test_views_show_scenes_of_any_size(scale):
    """Nothing is too near or too far."""
    scene = ball(scale, 0)
    view = View(name="near", origin=(0, 0, 1.1 * scale), target=(0, 0, 0), up=(0, 1, 0), fov=30)
    depth = mi.load_dict({"type": "aov", "aovs": "d:depth"})
    image = np.array(mi.render(scene, sensor=make_sensor(view, 4, 3), integrator=depth, spp=4))
    assert image.min() > 0 and image.max() < 0.2 * scale
