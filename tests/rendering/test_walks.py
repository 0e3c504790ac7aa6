"""Samples that share answers of the field, and further walks only where they are needed."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.recorded_steps import RecordedSteps
from gpf.core.structs import from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.rendering.walks import GroupedWalks, Walks
from gpf.scene.bounds import scene_bounds
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import floor
from tests.plain_field import random_gaussians, to_device

AOVS = ("albedo", "irradiance", "visible_normal")


def test_shared_walks_make_the_same_picture(monkeypatch):
    """Glass with faint and strong reflections, of a lamp too; metal; lacquer; a chequered floor."""
    t = mi.ScalarTransform4f
    chequers = {"type": "checkerboard", "to_uv": t().scale([40, 40, 1])}
    scene = mi.load_dict(
        {
            "type": "scene",
            "floor": floor({"type": "diffuse", "reflectance": chequers}),
            "glass": floor({"type": "thindielectric", "int_ior": 1.8}, z=0.1),
            "ball": {
                "type": "sphere",
                "center": [0.4, -0.3, 0.2],
                "radius": 0.2,
                "bsdf": {"type": "roughconductor", "alpha": 0.3},
            },
            "lacquer": {
                "type": "sphere",
                "center": [-0.4, -0.3, 0.2],
                "radius": 0.2,
                "bsdf": {"type": "plastic"},
            },
            "lamp": {
                "type": "sphere",
                "center": [0, 1.5, 0.9],
                "radius": 0.7,
                "emitter": {"type": "area", "radiance": 3.0},
            },
        }
    )
    view = View(name="it", origin=(0, -1.5, 0.9), target=(0, 0.1, 0.1), fov=60)
    sensor = make_sensor(view, 32, 24)
    g = random_gaussians(np.random.default_rng(5), 500)
    g.means[:, 2], g.normals[:] = 0, (0, 0, 1)
    field = GaussianPhotonField(to_device(g), FieldSettings(search_radius=0.2), scene_bounds(scene))
    images = {}
    for kind, made in {"shared": GroupedWalks, "apart": lambda walks, *more: walks}.items():
        monkeypatch.setattr("gpf.rendering.gpf.GroupedWalks", made)
        integrator = mi.load_dict({"type": "gpf", "adaptive": True, "aovs": ",".join(AOVS)})
        integrator.field = field
        images[kind] = np.array(
            [
                mi.render(scene, sensor=sensor, integrator=integrator, seed=s, spp=64).numpy()
                for s in range(24)
            ]
        )
    mean = {kind: each.mean(axis=0) for kind, each in images.items()}
    square = sum(each.var(axis=0, ddof=1) / len(each) for each in images.values())
    difference = mean["shared"] - mean["apart"]
    noisy = square > 1e-7
    # With 24 images each, the squares of these scores have a mean of nearly 1.
    assert noisy.mean() > 0.2
    assert np.mean(difference[noisy] ** 2 / square[noisy]) < 1.25
    whole = difference.mean(axis=(0, 1)) / mean["apart"].mean(axis=(0, 1))
    np.testing.assert_allclose(whole[:3], 0, atol=2e-3)


@pytest.mark.parametrize("rays", [1, 4, 64])
def test_single_walks_and_answers_that_are_the_same_for_all(rays):
    """One pixel that looks at glass over a floor of one irradiance. It reflects so much that each
    sample takes both ways."""
    glass = {"type": "thindielectric", "int_ior": 3.0}
    parts = {"floor": floor({"type": "diffuse"}), "glass": floor(glass, z=0.2)}
    scene = mi.load_dict({"type": "scene", "sky": {"type": "constant"}} | parts)

    class Constant:
        settings, volume = FieldSettings(search_radius=1.0), None

        def unfold(self, x):
            return x

        def query(self, x, n, active):
            return mi.Color3f(2), mi.Float(0)

        def reflect(self, points, value):
            return points.radiance(value)

    walks = Walks(scene, Constant(), ("coverage", "albedo"), -1, 5, True)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, rays)
    o, d = np.tile([0.1, 0.2, 2.0], (rays, 1)), np.tile([0, 0, -1.0], (rays, 1))
    ray = mi.Ray3f(from_numpy(mi.Point3f, o), from_numpy(mi.Vector3f, d))
    found = GroupedWalks(walks, RecordedSteps()).look(sampler, ray, mi.Bool(True))
    # Glass with index 3 reflects r = 2 f / (1 + f) with f = 1/4; the floor reflects a half.
    r = 0.5 / 1.25
    expected = r + (1 - r) * 0.5 * 2 / np.pi
    radiance = np.broadcast_to(to_numpy(found["radiance"]), (rays, 3))
    np.testing.assert_allclose(radiance, expected, rtol=2e-3)
    assert (np.broadcast_to(found["valid"].numpy(), rays)).all()
