"""What becomes of the emitters' power on the way, and the photon map's bookkeeping."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, VisiblePoints, from_numpy, to_numpy
from gpf.photons.emission import emit_light
from gpf.photons.tracing import PathSettings, record_photons, trace_photons
from gpf.sppm.fixed_points import FixedPoints
from tests.furnace import (
    Scene,
    bitmap,
    diffuse,
    facing,
    floor,
    point_light,
    rgb,
    room,
    smooth_floor,
    two_sided,
)
from tests.photon_totals import BLACK_ROOM, L, record, total, total_by_depth

# --- what becomes of it -----------------------------------------------------------------------

ALBEDO = np.array([0.8, 0.5, 0.2])
PHI = 4 * np.pi * L


def closed_room(*albedo: float) -> Scene:
    return {"room": room(diffuse(*albedo)), "light": point_light((0.3, -0.2, 0.1), *L)}


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
    room, options = closed_room(0.5), {"paths": 2000, "max_depth": 6}
    every, indirect = record(room, **options), record(room, **options, indirect=True)
    later = every.depth.numpy() > 0
    assert later.mean() == pytest.approx(4 / 5, abs=1e-3)
    for name in ("p", "n", "power"):
        kept, found = (to_numpy(getattr(photons, name)) for photons in (every, indirect))
        np.testing.assert_array_equal(found, kept[later])
    np.testing.assert_array_equal(indirect.depth.numpy(), every.depth.numpy()[later])
    assert dr.width(record(room, paths=2000, max_depth=2, indirect=True).p) == 0


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


def test_light_does_not_leak_through_shading_normals():
    """A third of the directions above the shading frame are below the floor."""
    below = floor(diffuse(0), z=-1, size=20)
    light = point_light((0, 0, 1), *L)
    scene = {"floor": smooth_floor(diffuse(0.5), TILTED), "below": below, "light": light}
    depth = record(scene).depth.numpy()
    assert (depth == 0).sum() > 20_000 and (depth > 0).sum() == 0


# --- sides, order, room -----------------------------------------------------------------------


def between_two_lights(bsdf: Scene) -> Scene:
    """A sheet in the plane z = 0 with one lamp above and one below."""
    return {
        "sheet": floor(bsdf, size=2),
        "above": point_light((0.1, 0, 0.5), 3),
        "below": point_light((0, 0.2, -0.5), 1),
    }


def test_two_sided_walls_store_either_side():
    photons = record(between_two_lights(two_sided(0.5)), max_depth=2)
    n, power = to_numpy(photons.n), to_numpy(photons.power)
    np.testing.assert_allclose(np.abs(n[:, 2]), 1, atol=1e-6)
    up, down = n[:, 2] > 0, n[:, 2] < 0
    assert up.sum() > 1000 and down.sum() > 1000

    def solid_angle(x: float, y: float) -> float:
        """Of the sheet, seen from height 0.5: four rectangles that meet below the light."""
        angles = [
            math.atan(a * b / (0.5 * math.sqrt(a * a + b * b + 0.25)))
            for a in (1 - x, 1 + x)
            for b in (1 - y, 1 + y)
        ]
        return sum(angles)

    assert power[up].sum(0)[0] == pytest.approx(3 * solid_angle(0.1, 0), rel=0.02)
    assert power[down].sum(0)[0] == pytest.approx(1 * solid_angle(0, 0.2), rel=0.02)


def test_one_sided_walls_store_and_reflect_nothing_behind():
    ceiling = {"ceiling": floor(two_sided(0.5), z=-1, size=4)}
    photons = record(between_two_lights(diffuse(0.5)) | ceiling)
    n, p, depth = to_numpy(photons.n), to_numpy(photons.p), photons.depth.numpy()
    sheet = np.abs(p[:, 2]) < 1e-4
    assert sheet.sum() > 1000
    assert (n[sheet, 2] > 0).all()
    # Light from below ends at the sheet's back: the ceiling sees none of it.
    assert (depth[~sheet] == 0).all()


def test_photons_lie_on_surfaces_with_unit_normals():
    """The normal is on the side that the light came from: inside the room."""
    photons = record(closed_room(0.5), paths=20_000)
    p, n = to_numpy(photons.p), to_numpy(photons.n)
    half = np.array([1.5, 1.0, 0.8])
    wall = np.abs(np.abs(p) - half).argmin(1)
    lane = np.arange(len(p))
    np.testing.assert_allclose(np.abs(p[lane, wall]), half[wall], atol=1e-5)
    np.testing.assert_allclose(n[lane, wall], -np.sign(p[lane, wall]), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-6)
    for side in range(3):
        assert (wall == side).any()


def as_rows(photons: Photons) -> np.ndarray:
    fields = [to_numpy(v) for v in (photons.p, photons.n, photons.power)]
    return np.concatenate([*fields, to_numpy(photons.depth)[:, None]], axis=1)


def test_the_same_seed_gives_the_same_photons():
    first, again = (record(closed_room(0.5), paths=60_000, seed=7) for _ in range(2))
    a, b = as_rows(first), as_rows(again)
    assert a.shape == b.shape
    np.testing.assert_array_equal(a[np.lexsort(a.T)], b[np.lexsort(b.T)])
    # And in the same order, walls included, on which photons share a coordinate: what is made
    # from a photon map is then a function of the seed as well.
    np.testing.assert_array_equal(a, b)


def test_another_seed_gives_other_photons():
    a, b = (as_rows(record(closed_room(0.5), paths=1000, seed=s)) for s in (7, 8))
    assert not {tuple(row) for row in a} & {tuple(row) for row in b}


def test_the_walk_alone_finds_what_the_recorder_keeps():
    """`trace_photons` hands every interaction to its caller once."""
    sums = dr.zeros(mi.Float, 2)

    def deposit(photons: Photons, diffused: mi.Bool, active: mi.Bool) -> None:
        dr.scatter_add(sums, photons.power.y, mi.UInt32(0), active)
        dr.scatter_add(sums, mi.Float(1), mi.UInt32(1), active)

    loaded = mi.load_dict({"type": "scene"} | closed_room(0.5))
    trace_photons(loaded, deposit, PathSettings(5000), seed=3)
    photons = record(closed_room(0.5), paths=5000, seed=3)
    assert sums.numpy()[0] == pytest.approx(total(photons)[1], rel=1e-4)
    assert sums.numpy()[1] == dr.width(photons.p)


def test_more_photons_than_there_was_room_for():
    """They are traced once more: none is missing, whatever the first guess was."""
    expected = record(closed_room(0.5), paths=1000)
    for capacity in (10, dr.width(expected.p) - 1):
        photons = record(closed_room(0.5), paths=1000, capacity=capacity)
        for name in ("p", "n", "power", "depth"):
            a, b = getattr(photons, name), getattr(expected, name)
            np.testing.assert_array_equal(a.numpy(), b.numpy(), err_msg=name)
    # A single path may be longer than any guess from the mean.
    assert dr.width(record(closed_room(0.99), paths=3, rr_depth=1000).p) > 3 * 37


def test_a_white_room_fits():
    """The longest walks there are: only the roulette ends them."""
    photons = record(closed_room(1), paths=2000)
    assert 15 < dr.width(photons.p) / 2000 < 26


def test_the_recorder_may_be_full_to_the_brim():
    assert dr.width(record(closed_room(0.5), paths=1000, capacity=1000, max_depth=2).p) == 1000


@pytest.mark.parametrize(
    "scene",
    [
        {"light": point_light((0, 0, 0), 1)},
        {"floor": floor(diffuse(0.5))},
        {"floor": floor({"type": "conductor"}), "light": point_light((0, 0, 1), 1)},
        {"room": room(diffuse(0.5)), "light": point_light((0, 0, 0), 0)},
    ],
    ids=["no surface", "no emitter", "no diffuse surface", "no power"],
)
def test_scenes_without_photons(scene):
    assert dr.width(record(scene, paths=1000).p) == 0
