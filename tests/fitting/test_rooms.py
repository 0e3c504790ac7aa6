"""Fits of rooms with what makes real ones hard, against Mitsuba's path tracer."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.images import propose_exposure, tone_map
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.sensors import make_sensor, views_of_sensors
from tests.rooms import ROOMS, load

SIZE = 128, 96
# Unlike `path`, it finds the sun through holes in cloth by samples of the emitters.
PATH = {"type": "volpath", "max_depth": -1, "rr_depth": 8}


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over blocks of 4 × 4 pixels, in which the path tracer has little noise."""
    height, width, _ = image.shape
    return image.reshape(height // 4, 4, width // 4, 4, 3).mean(axis=(1, 3))


def trimmed(image: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Which pixels are not among the brightest percent of either image."""
    kept = np.ones(image.shape[:2], bool)
    for each in (image, other):
        light = each.mean(axis=2)
        kept &= light <= np.quantile(light, 0.99)
    return kept


@pytest.mark.slow
@pytest.mark.parametrize("name", ROOMS)
def test_a_room_has_the_light_that_a_path_tracer_finds(name):
    scene = load(name)
    view = views_of_sensors(scene)[0]
    field = gpf.fit(scene, passes=12)
    renderer = FieldRenderer.make(scene, field, RenderSettings())
    image = blocks(renderer.render(view, SIZE, seed=1)["radiance"])
    sensor, integrator = make_sensor(view, *SIZE), mi.load_dict(PATH)
    first, second = (
        blocks(np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=256, seed=seed)))
        for seed in range(2)
    )
    kept = trimmed(image, (first + second) / 2)
    assert image[kept].sum() == pytest.approx((first + second)[kept].sum() / 2, rel=0.02)
    # Without the noise of the two halves, which is independent.
    exposure = propose_exposure(image)
    shown, a, b = (tone_map(each, exposure)[kept] for each in (image, first, second))
    assert -10 * np.log10(((shown - a) * (shown - b)).mean()) > 33
