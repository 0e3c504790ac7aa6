"""The part of a kernel's disc that lies on a surface, against areas that are known."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import Photons, from_numpy
from gpf.photons.density import PhotonDensity
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums, trace_pass
from gpf.photons.tracing import PathSettings
from gpf.scene.bounds import scene_bounds
from gpf.sppm.edge_correction import area_correction, covered_share, near_edges
from tests.furnace import camera, diffuse, floor, point_light, rectangle, render, room, sppm
from tests.tiers import tiers

RADIUS = 0.2
PLATE = floor(diffuse(0.5), size=2)  # -1 … 1 in x and y


def corrections(shapes, p, n=(0, 0, 1), seed=1, radius=RADIUS):
    scene = mi.load_dict({"type": "scene"} | shapes)
    p = np.asarray(p, dtype=np.float32)
    n = np.broadcast_to(np.asarray(n, dtype=np.float32), p.shape)
    points, normals = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
    valid = dr.full(mi.Bool, True, len(p))
    return np.array(area_correction(scene, points, normals, valid, radius, seed))


def line(x, count=40_000, z=0.0):
    """Points on a line through the plate, all with the same distance from its edge."""
    y = np.linspace(-0.7, 0.7, count)
    return np.stack([np.full(count, x), y, np.full(count, z)], axis=1)


def test_away_from_edges_nothing_changes():
    np.testing.assert_array_equal(corrections({"plate": PLATE}, line(0.3, 500)), 1)


@pytest.mark.parametrize("distance", [0.0, 0.05, 0.15])
def test_along_a_straight_edge(distance):
    """A disc without the segment that reaches beyond the edge."""
    d = distance / RADIUS
    share = 1 - (np.arccos(d) - d * np.sqrt(1 - d * d)) / np.pi
    found = corrections({"plate": PLATE}, line(1 - distance))
    error = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - 1 / share) < 4 * error + 0.01
    assert error < 0.01


def test_a_wall_in_the_corner_does_not_belong_to_the_floor():
    wall = rectangle((1, 0, 0.5), (0, 0, 0.5), 2, 1, diffuse(0.5))
    found = corrections({"plate": PLATE, "wall": wall}, line(0.999))
    assert found.mean() == pytest.approx(2, rel=0.03)


def test_glass_and_lamps_that_stand_on_the_surface_do_not_hide_it():
    ball = {"type": "sphere", "center": [0, 0, 0.1], "radius": 0.1, "bsdf": {"type": "dielectric"}}
    found = corrections({"plate": PLATE, "ball": ball}, line(0.02))
    assert found.mean() == pytest.approx(1, abs=2e-3)


def test_a_mirror_let_into_the_surface_takes_no_photons():
    half = rectangle((1, 0, 0), (1, 0, 1), 2, 2, {"type": "conductor"})
    left = rectangle((-1, 0, 0), (-1, 0, 1), 2, 2, diffuse(0.5))
    found = corrections({"mirror": half, "left": left}, line(-0.001))
    assert found.mean() == pytest.approx(2, rel=0.03)


def test_on_a_sphere():
    """A ball around a point of a sphere cuts off a cap of the area π r², whatever the radii."""
    rng = np.random.default_rng(3)
    n = rng.normal(size=(20_000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    found = corrections({"s": {"type": "sphere", "bsdf": diffuse(0.5)}}, n, n, radius=0.3)
    assert found.mean() == pytest.approx(1, abs=3e-3)


@pytest.mark.parametrize("degrees", [20, 32, 38, 43])
def test_beside_a_crease(degrees):
    """Uniform light, density times correction: whatever the kernel takes of the other facet."""
    rng = np.random.default_rng(5)
    # Some 36,000 photons lie within a radius of the line: a standard error of 0.5 %.
    count, angle = 100_000, np.radians(degrees)
    flat = np.stack([rng.uniform(-1, 0, count), rng.uniform(-1, 1, count), np.zeros(count)], axis=1)
    along = rng.uniform(0, 1, (count, 1))
    rising = along * [np.cos(angle), 0, np.sin(angle)] + rng.uniform(-1, 1, (count, 1)) * [0, 1, 0]
    p = np.concatenate([flat, rising])
    n = np.repeat([[0, 0, 1], [-np.sin(angle), 0, np.cos(angle)]], count, axis=0)
    photons = Photons(
        from_numpy(mi.Point3f, p),
        from_numpy(mi.Normal3f, n),
        mi.Color3f(2 / count),
        dr.zeros(mi.UInt32, 2 * count),
    )
    tilted = rectangle(
        (np.cos(angle) / 2, 0, np.sin(angle) / 2),
        (np.cos(angle) / 2 - np.sin(angle), 0, np.sin(angle) / 2 + np.cos(angle)),
        2,
        1,
        diffuse(0.5),
    )
    left = rectangle((-0.5, 0, 0), (-0.5, 0, 1), 1, 2, diffuse(0.5))
    x = line(-0.03, 20_000)
    factor = corrections({"left": left, "tilted": tilted}, x)
    density = PhotonDensity(photons, RADIUS, ((-2, -2, -2), (2, 2, 2)))
    e = density.irradiance(from_numpy(mi.Point3f, x), mi.Normal3f(0, 0, 1)).numpy()[0]
    assert (e * factor).mean() == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("degrees", [20, 32, 38, 43, 46, 52, 58, 64, 70])
def test_beside_a_crease_with_photons_in_cells(degrees):
    """The same for photons that were added up in cells, whose normals are rounded: up to 62° they
    may count as those of one surface, and then the area does, too."""
    angle = np.radians(degrees)
    tilted = rectangle(
        (np.cos(angle) / 2, 0, np.sin(angle) / 2),
        (np.cos(angle) / 2 - np.sin(angle), 0, np.sin(angle) / 2 + np.cos(angle)),
        2,
        1,
        diffuse(0.5),
    )
    left = rectangle((-0.5, 0, 0), (-0.5, 0, 1), 1, 2, diffuse(0.5))
    scene = mi.load_dict({"type": "scene", "left": left, "tilted": tilted})
    rng = np.random.default_rng(6)
    count = 200_000
    along, aside = rng.uniform(0, 1, (count, 1)), rng.uniform(-1, 1, (count, 1)) * [0, 1, 0]
    rising = np.arange(count)[:, None] % 2 == 1
    p = along * np.where(rising, [np.cos(angle), 0, np.sin(angle)], [-1, 0, 0]) + aside
    n = np.where(rising, [-np.sin(angle), 0, np.cos(angle)], [0, 0, 1])
    place, normal = from_numpy(mi.Point3f, p), from_numpy(mi.Vector3f, n)

    def evenly(scene, sampler):
        """One watt per square metre on both facets, which are four square metres."""
        lane = dr.arange(mi.UInt32, sampler.wavefront_size())
        o, d = dr.gather(mi.Point3f, place, lane), dr.gather(mi.Vector3f, normal, lane)
        return mi.Ray3f(o + 0.01 * d, -d), mi.Color3f(4), None

    settings = PathSettings(count, max_depth=2, source=evenly)
    sums = PhotonSums(PhotonCells(0.02, scene_bounds(scene)), settings)
    trace_pass(scene, 1, 0, sums)
    x = line(-0.03, 20_000)
    points = from_numpy(mi.Point3f, x)
    up = from_numpy(mi.Normal3f, np.tile([0.0, 0, 1], (20_000, 1)))
    share = np.array(covered_share(scene, points, up, RADIUS, 1, 32))
    density = PhotonDensity(sums.photons(0), RADIUS, scene_bounds(scene), smooth=True)
    e = density.irradiance(points, up).numpy()[0]
    # The smooth kernel takes distances through the air, the disc those along the bent surface.
    assert (e / share).mean() == pytest.approx(1, abs=0.025)


@pytest.mark.parametrize("distance", [0.0, 0.05, 0.1, 0.15])
def test_the_covered_share_along_a_straight_edge(distance):
    """Of a disc whose places count less towards its rim, with little noise."""
    rng = np.random.default_rng(0)
    radii = RADIUS * np.sqrt(1 - np.sqrt(rng.random(500_000)))
    expected = np.mean(radii * np.cos(rng.uniform(0, 2 * np.pi, 500_000)) < distance)
    scene = mi.load_dict({"type": "scene", "plate": PLATE})
    p = from_numpy(mi.Point3f, line(1 - distance, 20_000))
    n = from_numpy(mi.Normal3f, np.tile([0.0, 0, 1], (20_000, 1)))
    share = np.array(covered_share(scene, p, n, RADIUS, 1, 32))
    assert share.mean() == pytest.approx(expected, abs=3e-3)
    assert (share.std() / expected) < 0.05  # area_correction: 0.7 at the edge itself
    other = np.array(covered_share(scene, p, n, RADIUS, 2, 32))
    assert abs(np.corrcoef(share, other)[0, 1]) < 0.05


def test_edges_are_found_where_they_are():
    scene = mi.load_dict({"type": "scene", "plate": PLATE})
    for distance, share in ((0.0, 1), (0.1, 1), (0.18, 1), (0.205, 0), (0.3, 0)):
        p = from_numpy(mi.Point3f, line(1 - distance, 500))
        n = from_numpy(mi.Normal3f, np.tile([0.0, 0, 1], (500, 1)))
        assert np.array(near_edges(scene, p, n, RADIUS, 1)).mean() == share, distance


def test_on_something_smaller_than_the_disc_it_stays_finite():
    crumb = floor(diffuse(0.5), size=0.02)
    found = corrections({"crumb": crumb}, np.zeros((200, 3)) + 1e-3)
    assert found.max() <= 8


def test_a_point_draws_the_same_numbers_in_any_company():
    points = line(0.95, 300)
    alone = corrections({"plate": PLATE}, points[100:150])
    np.testing.assert_array_equal(corrections({"plate": PLATE}, points)[100:150], alone)
    assert (
        corrections({"plate": PLATE}, points, seed=2) != corrections({"plate": PLATE}, points)
    ).any()


@tiers(quick=1 / 4)
def test_sppm_has_no_dark_edges(tier):
    """A closed room, every pixel of it: with the correction as `path` has it, darker without.

    The corrected mean has a standard error of 0.07 %, or 0.16 % in the quick tier.
    """
    scene = {
        "type": "scene",
        "sensor": camera((-1.3, -0.8, 0.6), (0.7, 0.5, -0.3), 70, (24, 18)),
        "room": room(diffuse(0.5)),
        "light": point_light((-0.3, 0.2, 0.1), 3, 2, 1),
    }
    truth = render(scene, {"type": "path", "max_depth": 4}, 4096, 1)[0]
    settings = sppm(60_000, radius=0.2, max_depth=4)
    passes = tier.samples(48)
    corrected = render(scene, settings, passes, 4).mean(0)
    dark = render(scene, settings | {"edge_correction": False}, passes, 4).mean(0)
    assert corrected.mean() / truth.mean() == pytest.approx(1, abs=tier.noise(5e-3))
    assert dark.mean() / truth.mean() < 0.98
    wrong = [np.sqrt(np.mean((image / truth - 1) ** 2)) for image in (corrected, dark)]
    assert wrong[0] < wrong[1] / 2
