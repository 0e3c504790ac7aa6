"""Recorded camera walks: the same bits as those that are traced each time."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.recorded_steps import RecordedSteps, traced_step
from gpf.core.structs import from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gathering import _follow as _gather
from gpf.field.settings import FieldSettings
from gpf.rendering.walks import _followed
from gpf.scene.bounds import scene_bounds
from gpf.scene.lamps import Lamps
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import diffuse, floor, lamp, point_light, room
from tests.plain_field import random_gaussians, to_device

DEPTHS = -1, 5


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    """Glass, plastic, metal and Disney's material in a room with three lamps."""
    t = mi.ScalarTransform4f()
    principled = {"type": "separable_principled", "specular": 0.5, "roughness": 0.3}
    balls = {
        "glass": {"type": "dielectric"},
        "plastic": {"type": "roughplastic", "alpha": 0.2},
        "metal": {"type": "roughconductor", "alpha": 0.1},
        "coat": principled,
    }
    parts = {
        name: {"type": "sphere", "center": [0.5 * k - 0.75, 0, 0.3], "radius": 0.24, "bsdf": bsdf}
        for k, (name, bsdf) in enumerate(balls.items())
    }
    chequers = {"type": "checkerboard", "to_uv": t.scale([9, 9, 1])}
    parts |= {
        "room": room(diffuse(0.5), half=(3, 3, 3)),
        "floor": floor({"type": "diffuse", "reflectance": chequers}),
        "bulb": point_light((0, 1, 2), 2),
        "other bulb": point_light((1, -1, 2), 3),
        "lamp": lamp((0, 0, 2.5), (0, 0, 0), 0.5, 5),
    }
    return mi.load_dict({"type": "scene"} | parts)


def arguments(scene, kind, seed, count, samples, back):
    """Of a walk from above, towards the middle of the scene."""
    sampler = mi.load_dict({"type": kind, "sample_count": samples})
    sampler.set_samples_per_wavefront(sampler.sample_count())  # some round it
    sampler.seed(seed, count)
    rng = np.random.default_rng(seed)
    target = rng.uniform((-1, -0.5, 0), (1, 0.5, 0.5), (count, 3))
    away = target - [0, -2, 1.5]
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    o = from_numpy(mi.Point3f, np.tile([0, -2, 1.5], (count, 1)))
    ray = mi.Ray3f(o, from_numpy(mi.Vector3f, away))
    side = None if back is None else mi.Bool(back)
    return scene, sampler, ray, *DEPTHS, mi.Bool(True), Lamps(scene, (0, 1)), side


def values(found) -> list[np.ndarray]:
    points, way, _ = found
    names = "p", "n", "throughput", "emission", "reflectance"
    return [
        *(to_numpy(getattr(points, n)) for n in names),
        points.valid.numpy(),
        way.weight.numpy(),
        way.chance.numpy(),
    ]


def run(steps: RecordedSteps | None, case: tuple) -> tuple:
    """What a step finds, and the next numbers of its sampler."""
    scene, sampler, ray, *depths, active, lamps, back = arguments(*case)
    step = traced_step if steps is None else steps.run
    found = step(_followed, scene, sampler, [lamps], ray, active, back, tuple(depths))
    return values(found), sampler.next_1d().numpy()


def check(steps: RecordedSteps, case: tuple) -> None:
    """A walk, and the next numbers of its sampler, are those of a walk that is traced."""
    (found, after), (expected, also_after) = run(steps, case), run(None, case)
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(after, also_after)


@pytest.mark.parametrize(
    "kind", ["independent", "stratified", "multijitter", "orthogonal", "ldsampler"]
)
def test_the_bits_are_those_of_a_walk_that_is_traced(scene, kind):
    """With other seeds, numbers of rays, samples of a pixel, and both ways from the surface."""
    recorded = RecordedSteps()
    for seed, (count, samples, back) in enumerate(
        [(400, 4, False), (400, 4, True), (800, 4, False), (800, 16, False), (400, 4, None)] * 2
    ):
        check(recorded, (scene, kind, seed, count, samples, back))
    assert recorded._frozen[_followed].n_recordings < 8


def test_lamps_may_change_their_light(scene):
    recorded, parameters = RecordedSteps(), mi.traverse(scene)
    key = "lamp.emitter.radiance.value"
    for light in (5.0, 5.0, 1.0):
        parameters[key] = mi.Color3f(light)
        parameters.update()
        check(recorded, (scene, "multijitter", 1, 400, 4, False))


@pytest.mark.parametrize("kind", ["adaptive", "record"])
@pytest.mark.parametrize("group", [False, True])
def test_meshes_may_move(kind, group):
    """Recorded kernels would go on reading the old vertices."""
    box = {"type": "cube", "to_world": mi.ScalarTransform4f().scale(0.3)}
    post = {"type": "cube", "to_world": mi.ScalarTransform4f().scale([0.01, 0.01, 2])}
    parts = {"floor": floor(diffuse(0.5)), "sky": {"type": "constant"}, "box": box, "post": post}
    if group:
        parts["box"] = {"type": "shapegroup", "inner": box}
        parts["one"] = {"type": "instance", "group": {"type": "ref", "id": "box"}}
    scene = mi.load_dict({"type": "scene"} | parts, optimize=False)
    sensor = make_sensor(View(name="it", origin=(0, -2, 1), target=(0, 0, 0), fov=40), 16, 12)
    g = random_gaussians(np.random.default_rng(5), 500)
    g.normals[:] = 0, 0, 1
    field = GaussianPhotonField(to_device(g), FieldSettings(search_radius=0.2), scene_bounds(scene))
    parameters = mi.traverse(scene)
    every = [key for key, _ in parameters.items() if key.endswith("vertex_positions")]
    (key,) = (key for key in every if "box" in key or "inner" in key)
    points = np.array(parameters[key]).reshape(-1, 3)
    kept = mi.load_dict({"type": "gpf", kind: True, "aovs": "position,irradiance"})
    kept.field = field
    for shift in np.linspace(0, 0.5, 4):
        moved = np.add(points, [0, 0, shift]).astype(np.float32).ravel()
        parameters[key] = from_numpy(mi.Float, moved)
        parameters.update()
        new = mi.load_dict({"type": "gpf", kind: True, "aovs": "position,irradiance"})
        new.field = field
        images = [
            np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=16, seed=3))
            for integrator in (kept, new)
        ]
        np.testing.assert_array_equal(*images)


def test_what_cannot_be_recorded_is_traced(scene, monkeypatch):
    """From the first time on with the numbers of a sampler that nobody has used."""

    def fails(scene, sampler, *arguments):
        sampler.next_2d()
        raise RuntimeError("record(): not fully traversable")

    monkeypatch.setattr("gpf.camera.recorded_steps._freeze", lambda step: fails)
    recorded = RecordedSteps()
    check(recorded, (scene, "multijitter", 1, 400, 4, False))
    assert recorded._frozen[_followed] is None
    check(recorded, (scene, "multijitter", 2, 400, 4, False))


@pytest.mark.parametrize("indices", [(), (0,), (0, 1), None])
def test_rays_that_gather_light_can_be_recorded(scene, indices):
    """Whatever number of lamps the field leaves out."""

    def found(run):
        sampler, ray = arguments(scene, "independent", 3, 400, 1, None)[1:3]
        lamps = [Lamps(scene, indices), Lamps(scene)]
        rest = mi.Bool(True), mi.Float(0), dr.opaque(mi.Float, 0.01), False
        ends = run(_gather, scene, sampler, lamps, ray, *rest)
        return to_numpy(ends.emission), ends.valid.numpy()

    recorded = RecordedSteps()
    for _ in range(2):
        for a, b in zip(found(recorded.run), found(traced_step), strict=True):
            np.testing.assert_array_equal(a, b)
    assert recorded._frozen[_gather] is not None
