"""Gathered pictures in a furnace: all light, and each light once."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gathering import _sample_diffuse
from gpf.field.settings import FieldSettings
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import diffuse, rgb, two_sided
from tests.plain_field import random_gaussians, to_device

ALBEDO, EMITTED = 0.4, 1.5
LIGHT = EMITTED / (1 - ALBEDO)
"""Radiance everywhere in the furnace."""


def furnace(opacity: float | None = None) -> mi.Scene:
    """A closed cube that shines on all sides, and in it a panel that does not, so small that it
    takes hardly any light from the cube."""
    panel = two_sided(ALBEDO)
    if opacity is not None:
        panel = {"type": "mask", "opacity": opacity, "material": panel}
    turned = mi.ScalarTransform4f().translate([0.6, 0, 0]).rotate([0, 1, 0], -90)
    return mi.load_dict(
        {
            "type": "scene",
            "walls": {
                "type": "cube",
                "flip_normals": True,
                "bsdf": diffuse(ALBEDO),
                "emitter": {"type": "area", "radiance": rgb(EMITTED)},
            },
            "panel": {"type": "rectangle", "to_world": turned.scale(0.03), "bsdf": panel},
        }
    )


def field_of(scene: mi.Scene, radius: float, caustics: float | None) -> GaussianPhotonField:
    """The same irradiance everywhere on the cube and the panel."""
    rng = np.random.default_rng(1)
    g = random_gaussians(rng, 6000, sizes=(0.3, 0.5))
    axis, side = rng.integers(0, 3, 6000), rng.choice([-1.0, 1.0], 6000)
    rows = np.arange(6000)
    g.means[:] = rng.uniform(-1, 1, (6000, 3))
    g.means[rows, axis] = side
    g.normals[:] = 0
    g.normals[rows, axis] = -side
    g.irradiance[:] = np.pi * LIGHT
    share = None if caustics is None else np.full((6000, 3), caustics, np.float32)
    settings = FieldSettings(search_radius=radius)
    return GaussianPhotonField(to_device(g), settings, scene_bounds(scene), caustics=share)


def picture(scene: mi.Scene, field: GaussianPhotonField, **options) -> np.ndarray:
    """The panel, and the wall behind it."""
    view = View(name="it", origin=(-0.8, 0.1, 0.2), target=(0.6, 0, 0), fov=3.6)
    integrator = mi.load_dict({"type": "gpf", "gather": "always", **options})
    integrator.field = field
    return np.array(
        mi.render(scene, sensor=make_sensor(view, 16, 12), integrator=integrator, spp=4096)
    )


@pytest.mark.parametrize("adaptive", [False, True])
@pytest.mark.parametrize(
    ("caustics", "opacity"), [(0, None), (0.25, None), (0, 0.6)], ids=["", "caustics", "cloth"]
)
def test_a_furnace(adaptive, caustics, opacity):
    scene = furnace(opacity)
    image = picture(scene, field_of(scene, 0.3, caustics), adaptive=adaptive)
    more = ALBEDO * caustics * LIGHT
    wall, panel = LIGHT + more, ALBEDO * LIGHT + more
    if opacity is not None:
        panel = opacity * panel + (1 - opacity) * wall
    np.testing.assert_allclose(image[:, 0].mean(), wall, rtol=6e-3)
    np.testing.assert_allclose(image[3:9, 5:11].mean(), panel, rtol=6e-3)


@pytest.mark.parametrize("side", [1, -1])
def test_cloth_with_holes_reflects_as_much_as_there_is_of_it(side):
    cloth = {"type": "mask", "opacity": 0.3, "material": two_sided(ALBEDO)}
    bsdf, count = mi.load_dict(cloth), 4096
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi, si.n = mi.Vector3f(0, 0, side), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    way, weight, density = _sample_diffuse(bsdf, si, sampler, mi.Bool(True))
    np.testing.assert_allclose(to_numpy(weight), 0.3 * ALBEDO, rtol=1e-4)
    assert (side * way.z.numpy() >= 0).all()
    np.testing.assert_allclose(density.numpy(), np.abs(way.z.numpy()) / np.pi, rtol=1e-4)


@pytest.mark.parametrize("seconds", [None, 1.0])
def test_what_gathered_light_shows_corrects_a_picture(seconds):
    """The field has a quarter too much light everywhere. What is gathered is mostly the walls' own
    light, which is right."""
    pytest.importorskip("pyoidn")
    scene = furnace()
    field = field_of(scene, 0.3, 0)
    field.recolour(1.25 * to_numpy(field.gaussians.irradiance))
    view = View(name="it", origin=(0.2, 0.1, 0.1), target=(0.6, 0, 0), fov=3)
    images = {}
    for gather in ("never", "auto"):
        settings = RenderSettings(spp=64, denoise=True, gather=gather)
        renderer = FieldRenderer.make(scene, field, settings)
        images[gather] = renderer.render(view, (48, 40), 0, seconds)["radiance"].mean()
    assert images["never"] == pytest.approx(1.25 * ALBEDO * LIGHT, rel=0.01)
    # What the walls reflect is the field's, too.
    expected = ALBEDO * (EMITTED + 1.25 * ALBEDO * LIGHT)
    assert images["auto"] == pytest.approx(expected, rel=0.02)


def test_a_field_that_does_not_know_its_caustics():
    scene = furnace()
    with pytest.raises(UserError, match="does not know which part of its light is caustics"):
        FieldRenderer.make(scene, field_of(scene, 0.3, None), RenderSettings(gather="always"))


def test_another_word():
    with pytest.raises(RuntimeError, match="use one of auto, never, always"):
        mi.load_dict({"type": "gpf", "gather": "often"})
