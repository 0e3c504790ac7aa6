"""The estimate of a field's PSNR, against images of a reference."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.images import tone_map
from gpf.fitting.quality import QualityEstimate
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.lamps import Lamps
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings
from stages.references.renderer import ReferenceRenderer
from tests.furnace import diffuse, floor
from tests.small_fit import make_small

VIEWS = [
    View(name="front", origin=(0, 0, 3.9), target=(0, -0.8, 0), fov=39.3),
    View(name="left", origin=(-0.5, 0.2, 2.5), target=(0.1, -0.8, 0), fov=45),
]
SIZE, PASSES, EXPOSURE = (24, 24), 200, 0.5


def under_a_sky():
    """A floor and a ball: most of a reference's noise is that of its samples of the sky."""
    return {
        "type": "scene",
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [1, 1.2, 1.6]}},
        "floor": floor(diffuse(0.6, 0.5, 0.4)),
        "ball": {"type": "sphere", "center": [0, -0.6, 0.4], "radius": 0.4, "b": diffuse(0.5)},
    }


@pytest.mark.slow
@pytest.mark.parametrize("make", [mi.cornell_box, under_a_sky])
def test_the_estimate_is_the_psnr_against_a_reference(make, monkeypatch):
    """For fields that are too dark, right, or too bright."""
    make_small(monkeypatch, passes=30, steps=60, paths=5_000)
    monkeypatch.setattr("gpf.fitting.quality.REFERENCE_PASSES", PASSES)
    scene = mi.load_dict(make(), optimize=False)
    settings = PassSettings(photons_per_pass=40_000, initial_radius=0.08)
    sensors = {view.name: make_sensor(view, *SIZE) for view in VIEWS}
    estimate = QualityEstimate(
        scene,
        [*sensors.values()],
        settings,
        Lamps(scene, ()),
        seed=7,
        pixels=4000,
        exposure=EXPOSURE,
    )
    for _ in range(100):
        estimate.add_pass()
    reference = ReferenceRenderer(scene, sensors, {}, settings, 51)
    sums = reference.run(PASSES)
    field = gpf.fit(scene, [*sensors.values()], passes=40, seed=3)
    gaussians = field.gaussians
    for level in (0.9, 1.0, 1.3):
        field.update(replace(gaussians, irradiance=gaussians.irradiance * level))
        renderer = FieldRenderer.make(scene, field, RenderSettings(spp=1024))
        errors = [
            tone_map(renderer.render(view, SIZE, seed=5)["radiance"], EXPOSURE)
            - tone_map(reference.image(view.name, sums), EXPOSURE)
            for view in VIEWS
        ]
        measured = np.mean([-10 * np.log10(np.mean(error**2)) for error in errors])
        assert estimate.psnr(field) == pytest.approx(measured, abs=1), level
