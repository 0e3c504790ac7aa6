"""Dimmed and coloured lights: as in a scene whose emitters are really changed."""

from __future__ import annotations

import sys

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, save_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.rendering.lights import LightMixer
from gpf.scene.bounds import scene_bounds
from gpf.scene.light_groups import LightGroups, emitter_names
from tests.furnace import bitmap, diffuse, floor, lamp, point_light, rgb
from tests.plain_field import flat_gaussians, to_device

SKY = np.random.default_rng(1).uniform(0.1, 1, (4, 8, 3))


def scene_with(window=(1, 1, 1), spot=(1, 1, 1), sky=(1, 1, 1), map_=(1, 1, 1)):
    """Four kinds of emitters; their factors."""
    light = lamp((0, 0, 2), (0, 0, 0), 0.5, *(3 * np.array(window)))
    pixels = {"type": "envmap", "bitmap": mi.Bitmap((SKY * map_).astype(np.float32))}
    return mi.load_dict(
        {
            "type": "scene",
            "camera": {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f().look_at([0, -4, 3], [0, 0, 0], [0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 24, "height": 16, "rfilter": {"type": "box"}},
            },
            "floor": floor(diffuse(0.5)),
            "window": light,
            "spot": point_light((1, 0, 2), *(2 * np.array(spot))),
            "map": pixels,
        }
    )


def field_for(scene, stored):
    """A field whose groups have these irradiances everywhere."""
    rng = np.random.default_rng(3)
    p = np.hstack([rng.uniform(-3, 3, (600, 2)), np.zeros((600, 1))])
    g = flat_gaussians(p, np.full((600, 3), sum(stored)), size=0.3)
    names = emitter_names(scene)
    groups = LightGroups(tuple(names), tuple((k,) for k in range(len(names))))
    parts = np.stack([np.full((600, 3), value, np.float32) for value in stored])
    settings = FieldSettings(search_radius=0.6)
    return GaussianPhotonField(
        to_device(g), settings, scene_bounds(scene), lights=FieldLights(groups, parts)
    )


def render(scene, integrator):
    return np.array(mi.render(scene, integrator=integrator, spp=256, seed=4))[..., :3]


PATH = {"type": "path", "max_depth": 3}
BOX_FILM = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}


@pytest.mark.parametrize(
    "levels",
    [{"window": (0.2, 0.2, 0.2)}, {"spot": (0, 0, 0), "window": (2, 1, 0.5)}, {"map": (0.1, 1, 3)}],
)
def test_emitters_of_the_scene_follow(levels):
    scene = scene_with()
    mixer = LightMixer(scene, field_for(scene, (1, 2, 3)))
    before = render(scene, mi.load_dict(PATH))
    mixer.set(levels)
    changed = {"map_" if name == "map" else name: level for name, level in levels.items()}
    expected = render(scene_with(**changed), mi.load_dict(PATH))
    found = render(scene, mi.load_dict(PATH))
    assert np.abs(found - before).mean() > 0.02 * before.mean()
    np.testing.assert_allclose(found.mean((0, 1)), expected.mean((0, 1)), rtol=0.02)
    assert np.abs(found - expected).mean() < 0.05 * expected.mean()
    mixer.set({})
    np.testing.assert_allclose(render(scene, mi.load_dict(PATH)), before, rtol=1e-4, atol=1e-6)


def test_dimmed_pictures_are_not_corrected():
    """How much of each group's light is caustics is not known."""
    scene = scene_with()
    field = field_for(scene, (1, 2, 3))
    field.set_caustics(np.zeros((dr.width(field.gaussians.means), 3), np.float32))
    integrator = mi.load_dict({"type": "gpf", "denoise": True})
    integrator.field = field
    sensor = mi.load_dict({"type": "perspective", "film": BOX_FILM})
    mixer = LightMixer(scene, field)
    assert integrator.corrects(sensor)
    mixer.set({"window": (0.2, 0.2, 0.2)})
    assert not integrator.corrects(sensor)
    mixer.set({})
    assert integrator.corrects(sensor)
    assert not integrator.corrects(mi.load_dict({"type": "perspective"}))  # its film blurs
    integrator.lights = "window=.5"
    assert not integrator.corrects(sensor)


def test_a_mixer_keeps_its_scene():
    """Emitters without their shapes make Dr.Jit crash as soon as another scene has a lamp."""
    scene = scene_with()
    field = field_for(scene, (1, 2, 3))
    count = sys.getrefcount(scene)
    mixer = LightMixer(scene, field)
    assert sys.getrefcount(scene) > count
    del mixer
    assert sys.getrefcount(scene) == count


def test_the_field_follows(tmp_path):
    scene = scene_with()
    field = field_for(scene, (1, 2, 3))
    save_field(field, tmp_path / "field.safetensors")
    save_field(field, tmp_path / "compact.safetensors", "compact")
    for file in ("field.safetensors", "compact.safetensors"):
        field = load_field(tmp_path / file)
        names = list(field.lights.groups.names)
        index = [names.index(name) for name in ("window", "spot", "map")]
        window, spot, map_ = (1.0 + k for k in index)
        mixer = LightMixer(scene, field)
        mixer.set({"window": (0.5, 1, 2), "spot": (0, 0, 0)})
        found = np.array(field.gaussians.irradiance).T
        np.testing.assert_allclose(
            found, [[window * f + map_ for f in (0.5, 1, 2)]] * 600, rtol=2e-3
        )
        mixer.set({})
        whole = window + spot + map_
        np.testing.assert_allclose(np.array(field.gaussians.irradiance), whole, rtol=2e-3)


def test_the_plugin_has_a_parameter_and_leaves_the_scene_as_it_was():
    scene = scene_with()
    plain, dimmed = (mi.load_dict({"type": "gpf", "lights": t}) for t in ("", "map=0,spot=0.5"))
    plain.field = dimmed.field = field = field_for(scene, (1, 2, 3))
    names = list(field.lights.groups.names)
    before = render(scene, plain)
    left = sum(f * (1 + names.index(n)) for n, f in (("window", 1), ("spot", 0.5)))
    ratio = render(scene, dimmed)[12:].mean() / before[12:].mean()
    assert ratio == pytest.approx(left / 6, rel=0.01)
    np.testing.assert_allclose(render(scene, plain), before, rtol=1e-4, atol=1e-6)


def test_what_cannot_be_is_explained():
    scene = scene_with()
    field = field_for(scene, (1, 2, 3))
    field.lights = None
    with pytest.raises(UserError, match="gpf fit --groups auto"):
        LightMixer(scene, field)
    grey = mi.load_dict(
        {
            "type": "scene",
            "floor": floor(diffuse(0.5)),
            "sky": {"type": "constant", "radiance": {"type": "uniform", "value": 0.5}},
            "sun": point_light((1, 0, 2), 1, 1, 1),
        }
    )
    names = emitter_names(grey)
    field.lights = FieldLights(
        LightGroups(tuple(names), ((0,), (1,))), np.ones((2, 600, 3), np.float32)
    )
    mixer = LightMixer(grey, field)
    mixer.set({"sky": (0.5, 0.5, 0.5)})
    with pytest.raises(UserError, match="sky: has a grey radiance"):
        mixer.set({"sky": (0.5, 0.4, 0.3)})
    with pytest.raises(UserError, match="lights: in the field belong to another scene"):
        LightMixer(scene, field)


def test_a_bitmap_lamp_is_dimmed():
    texture = bitmap(np.random.default_rng(2).uniform(0.5, 2, (3, 3, 3)))
    shape = lamp((0, 0, 2), (0, 0, 0), 0.5, 1, 1, 1)
    shape["emitter"] = {"type": "area", "radiance": texture}
    more = {"type": "scene", "floor": floor(diffuse(0.5)), "lamp": shape}
    more["camera"] = {
        "type": "perspective",
        "to_world": mi.ScalarTransform4f().look_at([0, -4, 3], [0, 0, 0], [0, 0, 1]),
    }
    scene = mi.load_dict(more)
    field = field_for(scene, (1,))
    before = np.array(mi.render(scene, integrator=mi.load_dict(PATH), spp=16, seed=1))[..., :3]
    LightMixer(scene, field).set({"lamp": (0.5, 1, 2)})
    after = np.array(mi.render(scene, integrator=mi.load_dict(PATH), spp=16, seed=1))[..., :3]
    np.testing.assert_allclose(after.mean((0, 1)) / before.mean((0, 1)), (0.5, 1, 2), rtol=0.02)
    assert rgb(1)["type"] == "rgb"
