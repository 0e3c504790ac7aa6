"""Energy of the photon map against the emitters' power, kind by kind."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, to_numpy
from tests.furnace import (
    bitmap,
    diffuse,
    facing,
    lamp,
    point_light,
    rectangle,
    rgb,
)
from tests.photon_totals import BLACK_ROOM, L, record, total


def test_point_light():
    photons = record(BLACK_ROOM | {"light": point_light((0.3, -0.2, 0.1), *L)})
    np.testing.assert_allclose(total(photons), 4 * np.pi * L, rtol=1e-4)
    assert (photons.depth.numpy() == 0).all()


def test_area_light():
    """Φ = π A L: a lamp of 0.4² that shines down from the middle of the room."""
    photons = record(BLACK_ROOM | {"light": lamp((0.2, 0.1, 0), (0.2, 0.1, -1), 0.4, *L)})
    np.testing.assert_allclose(total(photons), np.pi * 0.16 * L, rtol=1e-4)


def test_textured_area_light():
    texture = np.zeros((2, 3, 3), dtype=np.float32)
    texture[0, 0], texture[1, 2] = [6, 0, 3], [0, 12, 3]
    light = rectangle((0, 0, 0), (0, 0, -1), 0.4, 0.3, diffuse(0))
    light["emitter"] = {"type": "area", "radiance": bitmap(texture, filter_type="nearest")}
    photons = record(BLACK_ROOM | {"light": light}, paths=200_000)
    np.testing.assert_allclose(total(photons), np.pi * 0.12 * np.array([1, 2, 1]), rtol=0.01)


def test_emissive_sphere_and_mesh():
    """Lamps of other shapes than a rectangle: Φ = π A L."""
    emission = {"type": "area", "radiance": rgb(*L)}
    black = diffuse(0)
    sphere = {"type": "sphere", "radius": 0.2, "bsdf": black, "emitter": emission}
    photons = record(BLACK_ROOM | {"light": sphere})
    np.testing.assert_allclose(total(photons), np.pi * 4 * np.pi * 0.04 * L, rtol=1e-4)
    small = mi.ScalarTransform4f().scale([0.1, 0.2, 0.3])
    cube = {"type": "cube", "to_world": small, "bsdf": black, "emitter": emission}
    photons = record(BLACK_ROOM | {"light": cube})
    area = 8 * (0.1 * 0.2 + 0.2 * 0.3 + 0.3 * 0.1)
    np.testing.assert_allclose(total(photons), np.pi * area * L, rtol=1e-4)


def test_spot_light():
    """I falls off linearly in the angle between the beam's width and the cutoff."""
    light = {
        "type": "spot",
        "to_world": facing((0.3, 0.2, 0.1), (1, 0.3, 0.2)),
        "intensity": rgb(*L),
        "cutoff_angle": 30,
        "beam_width": 12,
    }
    photons = record(BLACK_ROOM | {"light": light}, paths=400_000)
    a = np.linspace(0, math.radians(30), 100_001)
    fall_off = np.clip((math.radians(30) - a) / math.radians(30 - 12), 0, 1)
    solid_angle = 2 * np.pi * np.trapezoid(fall_off * np.sin(a), a)
    np.testing.assert_allclose(total(photons), solid_angle * L, rtol=5e-3)


def test_projector():
    """On a plane at distance 1 it casts π times the value of its image (Mitsuba's convention)."""
    light = {
        "type": "projector",
        "to_world": facing((0.3, 0.2, 0.1), (1, 0.3, 0.2)),
        "irradiance": bitmap(np.ones((3, 4, 3)) * L),
        "fov": 40,
    }
    photons = record(BLACK_ROOM | {"light": light})
    width = 2 * math.tan(math.radians(20))
    np.testing.assert_allclose(total(photons), np.pi * width * width * 3 / 4 * L, rtol=2e-3)


def test_directional_area_light():
    """Light along the normal only: Φ = A L."""
    light = rectangle((0, 0, 0.2), (0, 0, -1), 0.4, 0.3, diffuse(0))
    light["emitter"] = {"type": "directionalarea", "radiance": rgb(*L)}
    photons = record(BLACK_ROOM | {"light": light})
    np.testing.assert_allclose(total(photons), 0.12 * L, rtol=1e-4)
    p = to_numpy(photons.p)
    np.testing.assert_allclose(p[:, 2], -0.8, atol=1e-5)
    assert (np.abs(p[:, 0]) < 0.201).all() and (np.abs(p[:, 1]) < 0.151).all()


# Light from infinity falls on a lone sphere: a convex body, so that nothing is counted twice.
R = 0.7
BALL = {"ball": {"type": "sphere", "center": [0.1, 0.2, 0.3], "radius": R, "bsdf": diffuse(0)}}


def test_directional_light():
    light = {"type": "directional", "direction": [1, 2, -3], "irradiance": rgb(*L)}
    photons = record(BALL | {"light": light}, paths=400_000)
    np.testing.assert_allclose(total(photons), np.pi * R**2 * L, rtol=5e-3)
    # All of it from one side.
    towards = -np.array([1, 2, -3]) / math.sqrt(14)
    assert (to_numpy(photons.n) @ towards > -1e-3).all()


def test_constant_environment():
    """E = π L all over the sphere."""
    photons = record(BALL | {"light": {"type": "constant", "radiance": rgb(*L)}}, paths=400_000)
    np.testing.assert_allclose(total(photons), np.pi * L * 4 * np.pi * R**2, rtol=5e-3)
    np.testing.assert_allclose(to_numpy(photons.n).mean(0), 0, atol=0.01)


@pytest.mark.parametrize("turn", [0, 70], ids=["upright", "turned"])
def test_environment_map(turn):
    """The power is that of the solid angles of its pixels; bright pixels shine from their place."""
    pixels = np.full((16, 32, 3), 0.1, dtype=np.float32)
    pixels[3:6, 20:26] = [5, 10, 20]
    pixels[11, 4:6] = [40, 0, 0]
    to_world = mi.ScalarTransform4f().rotate([1, 0, 0], turn).rotate([0, 0, 1], turn)
    light = {"type": "envmap", "bitmap": mi.Bitmap(pixels), "to_world": to_world}
    photons = record(BALL | {"light": light}, paths=800_000)
    # Mitsuba interpolates between pixel centres; what it shows to a camera is what counts.
    loaded = mi.load_dict({"type": "scene"} | BALL | {"light": light})
    side = 700
    z, phi = np.meshgrid((np.arange(side) + 0.5) / side * 2 - 1, np.arange(side) / side * 2 * np.pi)
    s = np.sqrt(1 - z**2)
    si = dr.zeros(mi.SurfaceInteraction3f, side * side)
    d = np.stack([s * np.cos(phi), s * np.sin(phi), z]).reshape(3, -1)
    si.wi = from_numpy(mi.Vector3f, d.T)  # the environment is seen along -wi
    seen = to_numpy(loaded.environment().eval(si)).astype(np.float64)
    np.testing.assert_allclose(total(photons), np.pi * R**2 * 4 * np.pi * seen.mean(0), rtol=0.01)
    # First moment: ∫ n cos dA over the lit half of a sphere is 2/3 π R² along the light.
    moment = to_numpy(photons.power).T.astype(np.float64) @ to_numpy(photons.n)
    expected = np.pi * R**2 * 2 / 3 * 4 * np.pi * (seen.T @ -d.T) / side**2
    np.testing.assert_allclose(moment, expected, atol=0.01 * np.abs(expected).max())


def test_several_emitters_add_up():
    lights = {
        "a": point_light((0.3, -0.2, 0.1), *L),
        "b": lamp((0.2, 0.1, 0.799), (0.2, 0.1, -1), 0.4, 7, 0, 1),
    }
    expected = 4 * np.pi * L + np.pi * 0.16 * np.array([7, 0, 1])
    np.testing.assert_allclose(total(record(BLACK_ROOM | lights)), expected, rtol=0.01)
