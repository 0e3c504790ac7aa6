"""What a fit makes of the light on both sides of a thin wall."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import gpf
from gpf.core.structs import from_numpy, to_numpy
from tests.furnace import camera, diffuse, lamp, room

UP = np.array([0, 0, 1], np.float32)
HALF = 0.005
"""Half of the wall's thickness."""


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    """A closed box, z from -0.8 to 0.8, with a wall of a centimetre across it, at y = 0. On the
    left, a lamp shines on the ceiling, so that all light of the floor is indirect."""
    at = mi.ScalarTransform4f().scale([1.5, HALF, 0.8])
    wall = {"type": "cube", "to_world": at, "bsdf": diffuse(0.5)}
    light = lamp((0, -0.5, 0.2), (0, -0.5, 1), 0.4, 10)
    shapes = {"room": room(diffuse(0.5)), "wall": wall, "lamp": light}
    return mi.load_dict({"type": "scene"} | shapes, optimize=False)


def path_irradiance(scene: mi.Scene, places: np.ndarray, samples: int) -> np.ndarray:
    """By `path`, at places on the floor, (N,)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(places) * samples)
    si.p = from_numpy(mi.Point3f, np.repeat(places, samples, 0))
    si.n = from_numpy(mi.Normal3f, np.tile(UP, (len(places) * samples, 1)))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, len(places) * samples)
    ray = si.spawn_ray(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    light, _, _ = mi.load_dict({"type": "path"}).sample(scene, sampler, mi.RayDifferential3f(ray))
    return np.pi * to_numpy(light)[:, 0].reshape(len(places), samples).mean(axis=1)


@pytest.mark.slow
def test_light_neither_leaks_under_a_wall_nor_darkens_before_it(scene):
    cameras = [
        mi.load_dict(camera((1.2, 0.8 * side, 0.6), (-0.5, 0.2 * side, -0.8), 80, (64, 48)))
        for side in (-1, 1)
    ]
    field = gpf.fit(scene, cameras, passes=12)
    rng = np.random.default_rng(0)
    for low, high in ((0.001, 0.01), (0.01, 0.03), (0.03, 0.1)):
        distance = HALF + rng.uniform(low, high, 400)
        x = np.column_stack([rng.uniform(-0.8, 0.8, 400), -distance, np.full(400, -0.8)])
        lit, dark = x.astype(np.float32), (x * [1, -1, 1]).astype(np.float32)
        n, every = from_numpy(mi.Normal3f, np.tile(UP, (400, 1))), dr.full(mi.Bool, True, 400)
        found = [
            to_numpy(field.query(from_numpy(mi.Point3f, side), n, every)[0])[:, 0].mean()
            for side in (lit, dark)
        ]
        expected = path_irradiance(scene, lit, 256).mean()
        # Twelve passes make a smooth field: in the corner it does not get quite as dark.
        assert found[0] == pytest.approx(expected, rel=0.08), (low, high)
        assert found[1] < 0.002 * expected, (low, high)
