"""What becomes of the emitters' power on the way."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.photons.emission import emit_light
from gpf.photons.tracing import PathSettings, record_photons
from gpf.sppm.fixed_points import FixedPoints
from tests.furnace import bitmap, diffuse, facing, floor, point_light, rgb, smooth_floor
from tests.photon_totals import BLACK_ROOM, L, closed_room, record, total, total_by_depth

ALBEDO = np.array([0.8, 0.5, 0.2])
PHI = 4 * np.pi * L


def test_each_bounce_keeps_the_albedo():
    """Without roulette no photon of a closed room is lost: Φ ρ^d at depth d, to rounding."""
    photons = record(closed_room(*ALBEDO), paths=20_000, max_depth=9, rr_depth=1000)
    expected = PHI * ALBEDO ** np.arange(8)[:, None]
    np.testing.assert_allclose(total_by_depth(photons, 8), expected, rtol=1e-4)
    assert dr.width(photons.p) == 8 * 20_000


def test_the_whole_map_is_a_geometric_series():
    """Φ / (1 - ρ), within the noise of the roulette."""
    photons = record(closed_room(*ALBEDO))
    np.testing.assert_allclose(total(photons), PHI / (1 - ALBEDO), rtol=0.01)


@pytest.mark.parametrize("rr_depth", [1, 3, 1000])
def test_russian_roulette_is_unbiased(rr_depth):
    photons = record(closed_room(0.6), paths=200_000, max_depth=12, rr_depth=rr_depth)
    by_depth = total_by_depth(photons, 11) / PHI
    survivors = 200_000 * 0.6 ** np.arange(11)[:, None]
    z = (by_depth / 0.6 ** np.arange(11)[:, None] - 1) * np.sqrt(survivors)
    assert np.abs(z).max() < 4
    # It ends paths only where it may; one in a million slips out through an edge of the room.
    kept = np.bincount(photons.depth.numpy(), minlength=11)
    assert (kept[: min(rr_depth, 11)] > 200_000 - 5).all()
    if rr_depth < 11:
        assert kept[rr_depth] < 0.7 * 200_000


def test_roulette_of_coloured_photons_is_unbiased():
    """A channel that dies out follows the one that lives."""
    photons = record(closed_room(0.9, 0.3, 0), paths=100_000, rr_depth=1, max_depth=7)
    by_depth = total_by_depth(photons, 6)
    expected = PHI * np.array([0.9, 0.3, 0]) ** np.arange(6)[:, None]
    np.testing.assert_allclose(by_depth, expected, rtol=0.015)


SIGNS = (1.0, 1.0, -0.4)


def signed(scene, sampler):
    """Light with less than no blue, as some skies have near the horizon."""
    ray, power, emitter = emit_light(scene, sampler)
    return ray, power * mi.Color3f(*SIGNS), emitter


@pytest.mark.parametrize("rr_depth", [1, 4])
def test_a_channel_below_zero_is_carried_like_the_others(rr_depth):
    """Although only blue, which is negative, survives more than a bounce or two."""
    scene = closed_room(0.05, 0.1, 0.9)
    settings = {"paths": 100_000, "rr_depth": rr_depth, "max_depth": 8}
    photons = record(scene, source=signed, **settings)
    expected = PHI * np.array(SIGNS) * np.array([0.05, 0.1, 0.9]) ** np.arange(7)[:, None]
    np.testing.assert_allclose(total_by_depth(photons, 7), expected, rtol=0.02)
    sizes = np.abs(to_numpy(photons.power)).max(axis=1)
    assert sizes.max() < 1.01 * np.abs(PHI * SIGNS).max() / 100_000


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_light_that_is_not_finite_is_not_stored(value):
    """One such photon would spoil every point around it."""

    def broken(scene, sampler):
        ray, power, emitter = emit_light(scene, sampler)
        tenth = dr.arange(mi.UInt32, 1000) % 10 == 0
        return ray, dr.select(tenth, mi.Color3f(1, value, 1), power), emitter

    photons = record(closed_room(0.5), paths=1000, max_depth=2, source=broken)
    assert dr.width(photons.p) == 900 and np.isfinite(total(photons)).all()


@pytest.mark.parametrize(("max_depth", "deposits"), [(0, None), (1, 0), (2, 1), (3, 2), (6, 5)])
def test_a_photon_interacts_once_less_than_a_path_has_edges(max_depth, deposits):
    photons = record(
        closed_room(0.5), paths=1000, max_depth=max_depth or -1, rr_depth=1000, capacity=200_000
    )
    depths = np.unique(photons.depth.numpy()).tolist()
    if deposits is None:  # no limit: on until nothing is left of the power
        assert depths == list(range(len(depths))) and len(depths) > 15
    else:
        assert depths == list(range(deposits))


def test_without_direct_light_the_others_stay_as_they_are():
    """Bit for bit, and in their order; what is left out needs no room."""
    grey, options = closed_room(0.5), {"paths": 2000, "max_depth": 6}
    every, indirect = record(grey, **options), record(grey, **options, indirect=True)
    later = every.depth.numpy() > 0
    assert later.mean() == pytest.approx(4 / 5, abs=1e-3)
    for name in ("p", "n", "power"):
        kept, found = (to_numpy(getattr(photons, name)) for photons in (every, indirect))
        np.testing.assert_array_equal(found, kept[later])
    np.testing.assert_array_equal(indirect.depth.numpy(), every.depth.numpy()[later])
    assert dr.width(record(grey, paths=2000, max_depth=2, indirect=True).p) == 0


def test_direct_light_may_come_through_cloth_and_panes():
    """As samples of the emitters bring it; light that bends, or that cloth sends, is not direct."""
    gauze = {"type": "mask", "opacity": 0.3, "nested": diffuse(0.5)}
    sheets = {
        "gauze": floor(gauze, z=1, size=2),
        "pane": floor({"type": "thindielectric"}, z=2, size=2),
        "glass": floor({"type": "dielectric"}, z=2.5, size=0.1),
        # Samples of the lamp do not come through it, so its photons are kept.
        "bumpy gauze": floor(
            {"type": "bumpmap", "map": bitmap(np.ones((2, 2, 3))), "cloth": gauze}, z=0.5, size=1
        ),
    }
    black = {"type": "scene", "floor": floor(diffuse(0)), "lamp": point_light((0, 0, 3), 1, 1, 1)}
    scene = mi.load_dict(black | sheets, optimize=False)
    every, indirect = (
        record_photons(scene, PathSettings(50_000, indirect=left_out), seed=3)
        for left_out in (False, True)
    )

    def on_floor(photons):
        return photons.power.numpy()[:, np.abs(photons.p.z.numpy()) < 1e-3].sum() / 3

    samples = on_floor(every) - on_floor(indirect)
    # The bulb's light on the floor that neither bends nor is sent by the cloth.
    points = dr.zeros(VisiblePoints, 200 * 200)
    x, y = (v.ravel() for v in np.meshgrid(*2 * [np.linspace(-2.985, 2.985, 200)]))
    points.p = from_numpy(mi.Point3f, np.float32([x, y, 0 * x]).T)
    points.n = mi.Normal3f(0, 0, 1)
    sample = mi.Point2f(dr.full(mi.Float, 0.5, 200 * 200), 0.5)
    direct = FixedPoints(scene, points).direct_irradiance(sample)
    assert samples == pytest.approx(direct.numpy().mean() * 36, rel=0.02)
    assert on_floor(indirect) > 0.04 * samples


def test_glass_loses_no_power_and_stores_none():
    """A lamp inside a glass ball: all of its power arrives on the walls, whatever the way."""
    glass = {
        "type": "sphere",
        "center": [0.3, -0.2, 0.1],
        "radius": 0.3,
        "bsdf": {"type": "dielectric", "int_ior": 1.5},
    }
    photons = record(BLACK_ROOM | {"glass": glass, "light": point_light((0.35, -0.2, 0.1), *L)})
    np.testing.assert_allclose(total(photons), PHI, rtol=5e-3)
    distance = np.linalg.norm(to_numpy(photons.p) - [0.3, -0.2, 0.1], axis=1)
    assert distance.min() > 0.31
    assert photons.depth.numpy().min() == 1


def test_plastic_divides_the_power():
    """Photons are stored with the diffuse lobe's dependence on their direction, and go on whole."""
    plastic = {"type": "plastic", "diffuse_reflectance": rgb(0), "nonlinear": True}
    ground = {"floor": floor(plastic, size=2), "sky": floor(diffuse(0), z=0.4, size=20)}
    ground["sky"]["flip_normals"] = True
    light = {
        "type": "spot",
        "to_world": facing((0.3, 0, 0.39), (0, 0, 0)),
        "intensity": rgb(1),
        "cutoff_angle": 2,
        "beam_width": 1.99,
    }
    photons = record(ground | {"light": light}, paths=200_000)
    by_depth = total_by_depth(photons, 2)[:, 0]
    cos = 0.39 / math.hypot(0.39, 0.3)
    fresnel = float(mi.fresnel(mi.Float(cos), mi.Float(1.49 / 1.000277))[0][0])
    # At depth 0 a black lobe keeps the photon's power as it is; at depth 1 the mirror image of
    # the light falls on the ceiling.
    assert by_depth[1] / by_depth[0] == pytest.approx(fresnel, rel=0.02)


TILTED = np.tile([0.9, 0, 0.2], (4, 1))
"""Shading normals at the corners of a floor, 77° beside it."""


def test_shading_normals_make_no_photon_much_brighter():
    """Light that grazes the floor meets the shading normals: without a limit, by 1 / .003."""
    light = point_light((2.9, 0, 0.02), *L)
    photons = record({"floor": smooth_floor(diffuse(0.5), TILTED), "light": light})
    gain = to_numpy(photons.power) / (PHI / 100_000)
    towards = np.array([2.9, 0, 0.02]) - to_numpy(photons.p)
    slant = towards @ TILTED[0] / np.linalg.norm(TILTED[0]) / towards[:, 2]
    direct = photons.depth.numpy() == 0
    expected = np.minimum(slant, 16)[direct, None] * np.ones(3)
    assert (expected == 16).sum() > 1000
    np.testing.assert_allclose(gain[direct], expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("side", [1, -1])
def test_winding_does_not_matter_beside_normals(side):
    """Of downloads, many are wound against their normals: these say which side is the front."""
    normals = np.tile([0.0, 0.0, side], (4, 1))  # the floor is wound upwards
    sky = floor(diffuse(0), z=side, size=80) | {"flip_normals": side > 0}
    light = point_light((0, 0, 0.5 * side), *L)
    scene = {"floor": smooth_floor(diffuse(0.5), normals), "sky": sky, "light": light}
    by_depth = total_by_depth(record(scene), 2)
    on_floor = by_depth[0] - PHI / 2
    np.testing.assert_allclose(by_depth[1], 0.5 * on_floor, rtol=0.02)


def test_light_does_not_leak_through_shading_normals():
    """A third of the directions above the shading frame are below the floor."""
    below = floor(diffuse(0), z=-1, size=20)
    light = point_light((0, 0, 1), *L)
    scene = {"floor": smooth_floor(diffuse(0.5), TILTED), "below": below, "light": light}
    depth = record(scene).depth.numpy()
    assert (depth == 0).sum() > 20_000 and (depth > 0).sum() == 0
