"""Sums of photons in cells: nothing is lost, mixed up or counted twice, whoever lands first."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import to_numpy
from gpf.photons.cell_table import CellTable
from gpf.photons.emission import emit_light
from gpf.photons.photon_cells import PhotonCells
from gpf.photons.photon_grid import PhotonSums, trace_pass
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from tests.foggy import fog_box, medium
from tests.furnace import diffuse, floor, point_light, two_sided

PATHS = 6000


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    """A lamp between a floor and a ceiling: two depths and two normals at least."""
    return mi.load_dict(
        {
            "type": "scene",
            "floor": floor(diffuse(0.5)),
            "ceiling": floor(two_sided(0.7), z=2),
            "light": point_light((0, 0, 1), 2, 1, 0.5),
        }
    )


def add_up(scene: mi.Scene, passes: int = 2, indirect: bool = False, **options: int) -> PhotonSums:
    settings = PathSettings(PATHS, rr_depth=5, indirect=indirect)
    sums = PhotonSums(PhotonCells(0.11, scene_bounds(scene)), settings, **options)
    for seed in range(passes):
        trace_pass(scene, seed, 0, sums)
    return sums


def single(scene: mi.Scene, passes: int = 2, least_depth: int = 0) -> dict[str, np.ndarray]:
    """The same photons one by one, with powers of paths of all passes."""
    found: dict[str, list[np.ndarray]] = {"p": [], "n": [], "power": [], "depth": []}
    for seed in range(passes):
        photons = record_photons(scene, PathSettings(PATHS, rr_depth=5), seed=seed)
        kept = to_numpy(photons.depth) >= least_depth
        for name, parts in found.items():
            parts.append(to_numpy(getattr(photons, name))[kept])
    rows = {name: np.concatenate(parts).astype(np.float64) for name, parts in found.items()}
    return {**rows, "power": rows["power"] / passes}


def cells_of(scene: mi.Scene, rows: dict[str, np.ndarray]) -> np.ndarray:
    lower = np.array([scene_bounds(scene)[0][k] for k in range(3)])
    corner = np.floor((rows["p"] - lower) / np.float32(0.11)).clip(0)
    # Photons of a depth above 0 come from diffuse surfaces here.
    return np.column_stack([corner, np.round(3 * rows["n"]), rows["depth"] > 0])


@pytest.mark.parametrize("least_depth", [0, 1])
def test_sums_are_those_of_single_photons(scene, least_depth):
    sums = add_up(scene, indirect=bool(least_depth))
    photons, rows = sums.photons(0), single(scene, least_depth=least_depth)
    power, p = to_numpy(photons.power).astype(np.float64), to_numpy(photons.p)
    np.testing.assert_allclose(power.sum(axis=0), rows["power"].sum(axis=0), rtol=1e-5)
    _, which = np.unique(cells_of(scene, rows), axis=0, return_inverse=True)
    which = which.ravel()
    # A handful lie on the edge of a cell, where rounding decides.
    assert len(power) == pytest.approx(which.max() + 1, abs=0.01 * len(power))
    expected = np.sort(np.bincount(which, rows["power"][:, 0]))
    np.testing.assert_allclose(np.sort(power[:, 0])[-200:], expected[-200:], rtol=0.03)
    mean = (rows["p"]).mean(axis=0)
    counts = np.bincount(which)
    assert counts.max() > 3
    np.testing.assert_allclose(p.mean(axis=0), mean, atol=0.25)


def test_normals_are_told_apart(scene):
    photons = add_up(scene).photons(0)
    n, p = to_numpy(photons.n), to_numpy(photons.p)
    np.testing.assert_allclose(np.abs(n[:, 2]), 1, atol=1e-6)
    assert (n[p[:, 2] < 0.5, 2] > 0).all() and (n[p[:, 2] > 1.5, 2] < 0).all()


def test_a_small_table_grows_and_knows_the_same(scene):
    small, large = add_up(scene, capacity=64), add_up(scene, capacity=1 << 16)
    assert small.table.capacity >= 1.4 * dr.width(small.photons(0).p) > 64
    for name in ("p", "n", "power"):
        ours, theirs = (to_numpy(getattr(sums.photons(0), name)) for sums in (small, large))
        np.testing.assert_array_equal(ours, theirs)


def test_a_cell_may_hold_very_many_photons(scene):
    """Sums of whole numbers do not overflow at a hundred thousand of them."""
    cells, settings = PhotonCells(10, scene_bounds(scene)), PathSettings(200_000)
    sums = PhotonSums(cells, settings)
    trace_pass(scene, 0, 0, sums)
    power = to_numpy(sums.photons(0).power).astype(np.float64)
    photons = record_photons(scene, settings, seed=0)
    up, first = to_numpy(photons.n)[:, 2] > 0, photons.depth.numpy() == 0
    sides = [up & first, up & ~first, ~up & first, ~up & ~first]
    expected = [to_numpy(photons.power)[side].astype(np.float64).sum(0) for side in sides]
    assert max(side.sum() for side in sides) > 70_000
    order = np.argsort(power[:, 0])
    np.testing.assert_allclose(power[order], sorted(expected, key=lambda x: x[0]), rtol=1e-5)


def test_channels_below_zero_take_away(scene):
    """As whole numbers without a sign, they would be 10¹²."""

    def signed(scene, sampler):
        ray, power, emitter = emit_light(scene, sampler)
        return ray, power * mi.Color3f(1, -0.5, 0), emitter

    settings = PathSettings(PATHS, rr_depth=5, source=signed)
    sums = PhotonSums(PhotonCells(0.11, scene_bounds(scene)), settings)
    for seed in range(2):
        trace_pass(scene, seed, 0, sums)
    power = to_numpy(sums.photons(0).power).astype(np.float64)
    plain = to_numpy(add_up(scene).photons(0).power).astype(np.float64)
    whole = plain.sum(axis=0) * [1, -0.5, 0]
    np.testing.assert_allclose(power.sum(axis=0), whole, rtol=0.03, atol=1e-9)
    assert (power[:, 1] <= 0).all() and (power[:, 2] == 0).all()


def test_photons_that_do_not_fit_are_not_lost_in_silence(scene, monkeypatch):
    monkeypatch.setattr(CellTable, "_grow", lambda table, capacity: None)
    with pytest.raises(RuntimeError, match="photons did not fit into 64 cells"):
        add_up(scene, capacity=64)


def test_no_photons_are_no_cells():
    dark = mi.load_dict(
        {"type": "scene", "floor": floor(diffuse(0.5)), "light": point_light((0, 0, -5), 1, 1, 1)}
    )
    sums = PhotonSums(
        PhotonCells(0.1, scene_bounds(dark)), PathSettings(100, rr_depth=5, indirect=True)
    )
    trace_pass(dark, 1, 0, sums)
    assert dr.width(sums.photons(0).p) == 0


def test_halves_are_kept_apart(scene):
    """Each half has its own light, at the mean positions of both."""
    settings = PathSettings(PATHS, rr_depth=5)
    both = PhotonSums(PhotonCells(0.11, scene_bounds(scene)), settings, capacity=64)
    trace_pass(scene, 0, 0, both)
    trace_pass(scene, 1, 1, both)
    joined = add_up(scene)
    whole = to_numpy(joined.photons(0).power).astype(np.float64).sum(axis=0)
    parts = []
    for half in range(2):
        alone = PhotonSums(PhotonCells(0.11, scene_bounds(scene)), settings)
        trace_pass(scene, half, 0, alone)
        ours, theirs = both.photons(half), alone.photons(0)
        np.testing.assert_allclose(to_numpy(ours.power), to_numpy(theirs.power), rtol=1e-5)
        assert np.abs(to_numpy(ours.p) - to_numpy(theirs.p)).max() < 0.11
        parts.append(to_numpy(ours.power).astype(np.float64).sum(axis=0) / 2)
    np.testing.assert_allclose(np.sum(parts, axis=0), whole, rtol=1e-5)


def test_a_table_from_a_file_goes_on(scene):
    whole, part = add_up(scene, passes=3), add_up(scene, passes=2)
    cells = PhotonCells(0.11, scene_bounds(scene))
    copy = PhotonSums(cells, PathSettings(PATHS, rr_depth=5), capacity=64)
    copy.restore(part.tensors())
    trace_pass(scene, 2, 0, copy)
    for name in ("p", "n", "power"):
        ours, theirs = (to_numpy(getattr(sums.photons(0), name)) for sums in (copy, whole))
        np.testing.assert_array_equal(ours, theirs)


def test_photons_from_diffuse_surfaces_can_be_left_out():
    """Where all surfaces are diffuse, those of depth 0 are left; a mirror's and those that went
    straight through something count by where they were scattered last."""
    mirror = floor({"type": "twosided", "bsdf": {"type": "conductor"}}, z=-1)
    veil = floor({"type": "mask", "opacity": 0.5, "bsdf": two_sided(0.7)}, z=1.5)
    light = point_light((0, 0, 1), 2, 1, 0.5)
    for shapes, bounced in (
        ({"floor": floor(diffuse(0.5)), "ceiling": floor(two_sided(0.7), z=2)}, False),
        ({"veil": veil, "ceiling": floor(two_sided(0.7), z=2)}, False),
        ({"floor": mirror, "ceiling": floor(two_sided(0.7), z=2)}, True),
    ):
        scene = mi.load_dict({"type": "scene", "light": light} | shapes)
        sums = add_up(scene, passes=1)
        power = sums.photons(0, diffused=False).power.numpy().sum()
        never = PhotonSums(PhotonCells(0.11, scene_bounds(scene)), PathSettings(PATHS, rr_depth=5))
        trace_pass(scene, 0, 0, never, diffused=False)
        assert never.photons(0).power.numpy().sum() == pytest.approx(power, rel=1e-6)
        photons = record_photons(scene, PathSettings(PATHS, rr_depth=5), seed=0)
        at = photons.depth.numpy()
        first = photons.power.numpy()[:, at == 0].sum()
        assert first > 0
        if bounced:
            assert power > 1.2 * first
        elif "veil" not in shapes:
            assert power == pytest.approx(first, rel=1e-4)
        else:  # light that the veil lets pass, too, but none that it scattered
            straight = photons.power.numpy()[:, (at == 1) & (photons.p.z.numpy() > 1.9)].sum()
            assert first < power < first + 1.01 * straight


@pytest.mark.parametrize(("floating", "degrees"), [(True, 0.2), (False, 17)])
def test_directions_of_light_in_media(floating, degrees):
    """Parallel light through fog that only absorbs: the mean direction of a cell, or a rounded
    one."""
    d = np.array([0.31, 0.17, -1.0]) / np.linalg.norm([0.31, 0.17, -1.0])
    sun = {
        "type": "directional",
        "direction": d.tolist(),
        "irradiance": {"type": "rgb", "value": 1},
    }
    black = {"floor": floor(diffuse(0), z=-1.2), "ball": floor(diffuse(0), z=-1.3)}
    foggy = mi.load_dict(fog_box(medium(1, albedo=0), lamp=sun, **black))
    cells = PhotonCells(0.11, scene_bounds(foggy))
    sums = PhotonSums(cells, PathSettings(PATHS, rr_depth=5), floating=floating)
    trace_pass(foggy, 1, 0, None, sums)
    n = to_numpy(sums.photons(0).n)
    assert len(n) > 100
    length = np.linalg.norm(n, axis=1)
    np.testing.assert_allclose(length, 1, atol=2e-3)
    apart = np.degrees(np.arccos(np.clip(n @ d / length, -1, 1)))
    assert apart.max() < degrees
    assert floating or apart.max() > 2


def test_light_that_a_medium_has_not_scattered_is_known():
    """Parallel light through thin fog without anything else: what is not straight is scattered."""
    sun = {
        "type": "directional",
        "direction": [0, 0, -1],
        "irradiance": {"type": "rgb", "value": 1},
    }
    black = {"floor": floor(diffuse(0), z=-1.2), "ball": floor(diffuse(0), z=-1.3)}
    foggy = mi.load_dict(fog_box(medium(0.5, albedo=0.9), lamp=sun, **black))
    sums = PhotonSums(
        PhotonCells(0.11, scene_bounds(foggy)), PathSettings(PATHS, rr_depth=5), floating=True
    )
    trace_pass(foggy, 1, 0, None, sums, diffused=False)
    straight, every = sums.photons(0, diffused=False), sums.photons(0)
    z, power = every.n.z.numpy(), every.power.numpy()[0]
    assert straight.n.z.numpy().max() < -0.99
    beam = straight.power.numpy()[0].sum()
    # A thousandth of the scattered light goes on almost straight.
    assert beam == pytest.approx(power[z < -0.99].sum(), rel=0.01)
    assert power.sum() > 1.3 * beam
