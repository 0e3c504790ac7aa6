"""Fits of scenes with media."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.lights import set_lights
from gpf.rendering.settings import RenderSettings
from gpf.scene.light_groups import LightGroups
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.foggy import fog_box, medium
from tests.furnace import point_light, render, sppm
from tests.small_fit import assert_same_gaussians, make_small

VIEWS = [
    View(name="front", origin=(0, -5, 0.6), target=(0, 0, 0), fov=34),
    View(name="side", origin=(4, -3, 0.6), target=(0, 0, 0), fov=34),
]
PLAIN = RenderSettings(spp=64, adaptive=False)


def scene_of(**objects) -> mi.Scene:
    return mi.load_dict(fog_box(medium(1.0, g=0.3), **objects), optimize=False)


def fit(scene: mi.Scene, passes: int, **options) -> GaussianPhotonField:
    sensors = [make_sensor(view, 48, 48) for view in VIEWS]
    return gpf.fit(scene, sensors, passes=passes, **options)


def image(scene: mi.Scene, field: GaussianPhotonField, *aovs: str) -> dict[str, np.ndarray]:
    return FieldRenderer.make(scene, field, PLAIN, aovs).render(VIEWS[0], (24, 24), seed=0)


@pytest.mark.slow
def test_a_fit_in_fog(monkeypatch, tmp_path):
    """As bright as SPPM, and about as good as the fit says; the same from its file; the expected
    error is there."""
    make_small(monkeypatch, passes=24, steps=48, paths=40_000)
    scene = scene_of()
    field = fit(scene, 24)
    assert field.volume is not None
    found = image(scene, field, "error")
    truth = render(fog_box(medium(1.0, g=0.3)), sppm(50_000, radius=0.1, direct="emitters"), 60, 4)
    ratio = found["radiance"].mean((0, 1)) / truth.mean((0, 1, 2))
    np.testing.assert_allclose(ratio, 1, atol=0.015)
    apart = np.abs(found["radiance"] - truth.mean(0)) / truth.mean()
    assert np.median(apart) < 0.03
    assert 0 < np.median(found["error"]) < 0.2
    assert field.record["estimated_psnr"] > 28
    save_field(field, tmp_path / "field.safetensors")
    again = image(scene, load_field(tmp_path / "field.safetensors"))["radiance"]
    np.testing.assert_allclose(again, found["radiance"], rtol=1e-3, atol=1e-3 * truth.mean())


@pytest.mark.slow
def test_a_fit_goes_on_where_it_ended(monkeypatch, tmp_path):
    make_small(monkeypatch, passes=4, steps=8, paths=5_000)
    whole = fit(scene_of(), 8)
    fit(scene_of(), 4, state=tmp_path)
    resumed = fit(scene_of(), 8, state=tmp_path, resume="always")
    assert_same_gaussians(resumed.volume.fluence, whole.volume.fluence)
    np.testing.assert_array_equal(resumed.volume.moments, whole.volume.moments)


@pytest.mark.slow
def test_lamps_in_fog_are_dimmed(monkeypatch):
    make_small(monkeypatch, passes=12, steps=24, paths=20_000)
    bulb = point_light((0.6, -0.6, 0.6), 2)
    scene = scene_of(bulb=bulb)
    field = fit(scene, 12, groups=LightGroups.parse("auto", scene))
    names = field.lights.groups.names
    name = next(each for each in names if "bulb" in each)
    set_lights(scene, field, f"{name}=0")
    without = image(scene, field)["radiance"]
    expected = render(fog_box(medium(1.0, g=0.3)), sppm(50_000, radius=0.1), 40, 2).mean(0)
    assert without.mean() == pytest.approx(expected.mean(), rel=0.04)
    set_lights(scene, field, f"{name}=1")
    assert image(scene, field)["radiance"].mean() > 1.1 * without.mean()


@pytest.mark.slow
def test_recorded_frames_are_the_same(monkeypatch):
    """The viewer's frames, and walks that are recorded, in a medium."""
    make_small(monkeypatch, passes=4, steps=8, paths=5_000)
    scene = scene_of()
    field = fit(scene, 4)
    sensor = make_sensor(VIEWS[0], 16, 16)
    # What is recorded shares no answers.
    monkeypatch.setattr("gpf.rendering.gpf.GroupedWalks", lambda walks, *_: walks)
    plain, recorded = (mi.load_dict({"type": "gpf", "record": on}) for on in (False, True))
    plain.field = recorded.field = field
    for seed in range(4):
        a, b = (
            to_numpy(mi.render(scene, integrator=each, sensor=sensor, spp=4, seed=seed))
            for each in (plain, recorded)
        )
        np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_fog_without_walls(monkeypatch):
    """Photons and what cameras see reach far beyond all surfaces. After 24 passes, .980 of the
    light is there, after 48 .986."""
    make_small(monkeypatch, passes=48, steps=96, paths=40_000)
    fog = {"type": "ref", "id": "fog"}
    scene = {"type": "scene", "fog": medium(0.5, g=0.3) | {"id": "fog"}} | fog_box(medium(1))
    del scene["box"]
    scene["sensor"] |= {"medium": fog}
    scene["lamp"] |= {"exterior": fog}
    scene["floor"] |= {"exterior": fog}
    loaded = mi.load_dict(scene, optimize=False)
    field = fit(loaded, 48)
    found = image(loaded, field)["radiance"]
    truth = render(scene, {"type": "volpathmis", "max_depth": 100, "rr_depth": 20}, 512, 4)
    ratio = found.mean((0, 1)) / truth.mean((0, 1, 2))
    np.testing.assert_allclose(ratio, 1, atol=0.02)
