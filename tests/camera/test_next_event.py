"""Direct light on glossy surfaces: right for every emitter, and without sparkles."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.camera.next_event import share_of_bsdf
from gpf.camera.visible_points import find_visible_points
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.scene.lamps import Lamps
from tests.furnace import Scene, camera, floor, lamp, point_light, rectangle, rgb

METAL = {"type": "roughconductor", "material": "Al", "alpha": 0.2}
TWO_SIDED = {"type": "twosided", "m": METAL}
EMITTERS = {
    "small lamp": lamp((0.4, 0.6, 1.2), (0, 0, 0), 0.05, 300, 200, 100, bsdf=METAL),
    "point": point_light((0.4, 0.6, 1.2), 3, 2, 1),
    "sky": {"type": "constant", "radiance": rgb(1, 2, 4)},
}
GLOSSY = {
    "metal": TWO_SIDED,
    "rough glass": {"type": "roughdielectric", "alpha": 0.2},
    "masked metal": {"type": "mask", "opacity": 0.6, "m": TWO_SIDED},
    "two metals": {"type": "blendbsdf", "weight": 0.4, "a": METAL, "b": METAL | {"alpha": 0.05}},
}


def walk(loaded: mi.Scene, spp: int, **options: Any) -> VisiblePoints:
    """Camera walks from all over the film, (8 * 6 * spp,)."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 8 * 6 * spp)
    ray, _ = loaded.sensors()[0].sample_ray(
        0.0, sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    )
    points, _ = find_visible_points(loaded, sampler, mi.Ray3f(ray), **options)
    dr.eval(points)
    return points


def emission(scene: Scene, spp: int, max_depth: int = -1) -> np.ndarray:
    """Radiance that the camera walk gathers, one row per sample, (N, 3)."""
    points = walk(mi.load_dict(scene), spp, max_depth=max_depth, rr_depth=1000)
    assert not np.any(points.valid.numpy())
    return to_numpy(points.emission).astype(np.float64)


def gallery(glossy: Scene, *emitters: str) -> Scene:
    """A floor and a wall that reflect one another, and a screen in the light's way."""
    return {
        "type": "scene",
        "sensor": camera((0, -2, 1), (0, 0, 0.3), 70, (8, 6)),
        "floor": floor(glossy, size=2),
        "wall": rectangle((0, 1, 0.5), (0, 0, 0.5), 2, 1, TWO_SIDED),
        "screen": rectangle((0.2, 0.3, 0.6), (0.4, 0.6, 1.2), 0.3, 0.3, TWO_SIDED),
    } | {name: EMITTERS[name] for name in emitters}


@pytest.mark.parametrize("max_depth", [2, 3, 6])
@pytest.mark.parametrize("kind", GLOSSY)
def test_it_is_what_a_path_tracer_finds(kind, max_depth):
    """Nothing here is diffuse: all light is found by the camera walk."""
    scene = gallery(GLOSSY[kind], *EMITTERS)
    path = {"type": "path", "max_depth": max_depth, "rr_depth": 1000}
    loaded = mi.load_dict(scene)
    images = [
        np.array(mi.render(loaded, integrator=mi.load_dict(path), spp=2048, seed=s)).mean((0, 1))
        for s in range(8)
    ]
    found = emission(scene, 8192, max_depth)
    error = np.hypot(np.std(images, axis=0) / 8**0.5, found.std(0) / len(found) ** 0.5)
    expected = np.mean(images, axis=0)
    assert (error < 0.01 * expected).all()
    assert (np.abs(found.mean(0) - expected) < 4 * error + 1e-3 * expected).all()


@pytest.mark.parametrize("weight", [0, 0.5])
def test_the_weights_of_both_ways_to_a_lamp_add_up_to_one(weight):
    """The density of a direction that was sampled at a lamp is the one found on meeting it."""
    panel = lamp((-0.7, 0.2, 0.6), (-0.4, 0, 0), 0.8, 6, 9, 12)
    panel["emitter"]["sampling_weight"] = weight
    lights = {"panel": panel, "sky": EMITTERS["sky"]}
    scene = mi.load_dict({"type": "scene", "floor": floor(TWO_SIDED, size=2)} | lights)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 2000)
    place = 2 * sampler.next_2d() - 1
    ray = mi.Ray3f(mi.Point3f(place.x, place.y, 0.01), mi.Vector3f(0, 0, -1))
    lit = scene.ray_intersect(ray)
    light, _ = Lamps(scene).sample(lit, sampler.next_2d(), mi.Bool(True))
    hit = scene.ray_intersect(lit.spawn_ray(light.d))
    met = ((hit.emitter(scene) == light.emitter) & (light.pdf > 0)).numpy()
    met &= light.d.z.numpy() > 0
    kinds = hit.is_valid().numpy()[met]
    assert kinds.sum() > 500 and (~kinds).sum() > 200
    share = share_of_bsdf(scene, hit, lit.p, mi.Float(0.7), mi.Bool(True))
    taken = light.pdf / (light.pdf + 0.7)
    # The ray starts a little above the floor.
    np.testing.assert_allclose((share + taken).numpy()[met], 1, atol=1e-3)


def test_the_glint_of_a_small_lamp_is_no_matter_of_luck():
    """Samples of the lobe alone would have a hundred times the variance of a single bounce."""
    scene = gallery(TWO_SIDED, "small lamp")
    found = emission(scene, 4096, max_depth=2)
    # One in so many directions of a hemisphere meets the lamp.
    chance = 0.05**2 / (2 * np.pi * 1.5**2)
    by_luck = np.mean(found) * 200 / np.sqrt(chance)
    assert found.var() < 1e-2 * by_luck**2


def test_walls_without_gloss_draw_no_light():
    """A perfect mirror can't be asked for a lamp: it meets it by itself, and only once."""
    mirror = {"type": "conductor", "material": "none"}
    scene = gallery(mirror, "small lamp") | {"wall": floor(mirror, z=-1)}
    scene.pop("screen")
    found = emission(scene, 4096)
    assert np.isin(np.round(found[:, 0] / 300, 3), [0, 1]).all()
    assert 0 < (found > 0).mean() < 0.1


def test_lamps_light_the_diffuse_part_of_a_layered_surface_once():
    """And not where the walk goes on from the coat, which shows a point light to nobody."""
    plastic = {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2), "nonlinear": True}
    view = {"type": "scene", "sensor": camera((0, -2, 1), (0, 0, 0.3), 70, (8, 6))}
    loaded = mi.load_dict(view | {"floor": floor(plastic), "point": EMITTERS["point"]})
    path = mi.load_dict({"type": "path", "max_depth": 2})
    expected = np.array(mi.render(loaded, integrator=path, spp=4096)).mean((0, 1))
    points = walk(loaded, 4096, lamps=Lamps(loaded))
    found = to_numpy(points.emission).astype(np.float64)
    valid = points.valid.numpy()
    assert 0.1 < valid.mean() < 0.9 and not found[~valid].any()
    error = found.std(0) / len(found) ** 0.5
    assert (error < 0.005 * expected).all()
    assert (np.abs(found.mean(0) - expected) < 5 * error).all()
