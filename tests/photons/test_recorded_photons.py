"""The photon map: sides of surfaces, the order of photons, and the room for them."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, to_numpy
from gpf.photons.tracing import PathSettings, trace_photons
from tests.furnace import Scene, diffuse, floor, point_light, room, two_sided
from tests.photon_totals import closed_room, record, total


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


def test_the_same_seed_gives_the_same_photons_in_the_same_order():
    """Walls included, on which photons share a coordinate: what is made from a photon map is then a
    function of the seed as well."""
    first, again = (as_rows(record(closed_room(0.5), paths=60_000, seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


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


def test_no_photon_is_lost_for_lack_of_room():
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
def test_scenes_without_light_or_diffuse_surfaces_have_no_photons(scene):
    assert dr.width(record(scene, paths=1000).p) == 0
