"""Steps through occupied cells, compositing and its adjoint, each beside a plain twin."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from baselines.instant_ngp.occupancy_grid import TURNS, OccupancyGrid
from baselines.instant_ngp.ray_marching import (
    Rays,
    Samples,
    clip_rays,
    composite,
    composite_adjoint,
    take_samples,
)
from baselines.neural.hash_encoding import Cube
from gpf.core.structs import from_numpy
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View

SIDE, STEP = 6, 0.013
ZERO, ONE = mi.Point3f(0), mi.Point3f(1)


def make_grid(occupied: np.ndarray) -> OccupancyGrid:
    """A grid with these cells occupied, (z, y, x)."""
    grid = OccupancyGrid(len(occupied), STEP)
    grid.occupied = from_numpy(mi.Bool, occupied.ravel())
    return grid


def random_rays(count: int) -> tuple[Rays, np.ndarray, np.ndarray]:
    """Rays from all around and from within, some of which miss the cube."""
    rng = np.random.default_rng(2)
    o = rng.uniform(-0.6, 1.6, (count, 3))
    d = rng.uniform(-0.2, 1.2, (count, 3)) - o
    d[:5, 0] = 0  # along a side of the cells
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    columns = [np.ascontiguousarray(v.T, dtype=np.float32) for v in (o, d)]
    return clip_rays(mi.Point3f(columns[0]), mi.Vector3f(columns[1]), ZERO, ONE), o, d


# --- clipping ---------------------------------------------------------------------------------


def test_rays_are_clipped_to_the_box_in_front_of_them():
    o = mi.Point3f([-1, 0.5, 3, -1], [0.5, 0.5, 0.5, 2.0], [0.25, 0.25, 0.25, 0.25])
    rays = clip_rays(o, mi.Vector3f([1, 1, 1, 1], 0, 0), ZERO, mi.Point3f(1, 1, 0.5))
    assert list(rays.near)[:2] == [1, 0] and list(rays.far)[:2] == [2, 0.5]
    assert all(rays.near[k] >= rays.far[k] for k in (2, 3))


# --- marching ---------------------------------------------------------------------------------


def plain_samples(
    occupied: np.ndarray, o: np.ndarray, d: np.ndarray, first: float, far: float
) -> list[float]:
    """Distances of all steps that end in occupied cells."""
    found, k = [], 0
    while first + k * STEP < far:
        t = first + k * STEP
        x, y, z = np.clip(((o + t * d) * SIDE), 0, SIDE - 1).astype(int)
        if occupied[z, y, x]:
            found.append(t)
        k += 1
    return found


def test_samples_are_the_steps_in_occupied_cells():
    occupied = np.random.default_rng(1).random((SIDE,) * 3) < 0.3
    rays, o, d = random_rays(60)
    first = rays.near + 0.4 * STEP
    samples = take_samples(make_grid(occupied), rays, first, room=20_000)
    t, ray = samples.distance.numpy(), samples.ray.numpy()
    total = differing = 0
    for k in range(60):
        expected = plain_samples(occupied, o[k], d[k], float(first[k]), float(rays.far[k]))
        begin, count = samples.begin[k], samples.count[k]
        assert (ray[begin : begin + count] == k).all()
        mine = t[begin : begin + count]
        total += len(expected)
        # A step that ends on the border between two cells may count for either.
        near = [np.abs(mine - e).min(initial=1) < 1e-4 for e in expected]
        differing += near.count(False) + abs(len(mine) - len(expected))
        assert (np.diff(mine) > 0.9 * STEP).all()
    assert total > 500 and differing < 0.005 * total
    assert samples.total == int(dr.sum(samples.count)[0])


def test_rays_without_room_have_no_samples():
    rays, _, _ = random_rays(60)
    grid = make_grid(np.ones((SIDE,) * 3, dtype=bool))
    every = take_samples(grid, rays, rays.near, room=20_000)
    some = take_samples(grid, rays, rays.near, room=500)
    assert 400 < some.total <= 500 < every.total
    counts = some.count.numpy()
    fit = counts > 0
    assert (counts[fit] == every.count.numpy()[fit]).all()
    assert (some.begin.numpy() + counts)[fit].max() <= 500


# --- compositing ------------------------------------------------------------------------------


def make_samples() -> tuple[Samples, np.ndarray, np.ndarray]:
    """Three rays with 4, 0 and 3 samples, and padding."""
    begin, count = mi.UInt32(0, 4, 4), mi.UInt32(4, 0, 3)
    samples = Samples(dr.zeros(mi.Float, 9), dr.zeros(mi.UInt32, 9), begin, count, 7)
    rng = np.random.default_rng(3)
    return samples, rng.uniform(5, 60, 9), rng.uniform(0.1, 2, (9, 3))


def plain_composite(density: np.ndarray, colour: np.ndarray) -> np.ndarray:
    seen = np.zeros((3, 3))
    for ray, (begin, count) in enumerate([(0, 4), (4, 0), (4, 3)]):
        through = 1.0
        for i in range(begin, begin + count):
            opacity = 1 - np.exp(-density[i] * STEP)
            seen[ray] += through * opacity * colour[i]
            through *= 1 - opacity
    return seen


def to_colour(rows: np.ndarray) -> mi.Color3f:
    return from_numpy(mi.Color3f, rows)


def test_compositing_is_front_to_back():
    samples, density, colour = make_samples()
    step = mi.Float(STEP)
    seen = composite(samples, from_numpy(mi.Float, density), to_colour(colour), step)
    expected = plain_composite(density, colour)
    np.testing.assert_allclose(seen.colour.numpy().T, expected, rtol=1e-5)
    assert list(seen.used) == [4, 0, 3]
    density[1] = 1e4  # a wall
    seen = composite(samples, from_numpy(mi.Float, density), to_colour(colour), step)
    np.testing.assert_allclose(seen.colour.numpy().T, plain_composite(density, colour), rtol=1e-5)
    assert list(seen.used) == [2, 0, 3]


def test_the_adjoint_agrees_with_differences():
    samples, density, colour = make_samples()
    step, adjoint = mi.Float(STEP), np.random.default_rng(4).normal(size=(3, 3))
    arrays = from_numpy(mi.Float, density), to_colour(colour)
    seen = composite(samples, *arrays, step)
    dr.eval(seen)
    numbers, by_density, by_colour = composite_adjoint(
        samples, *arrays, step, seen, to_colour(adjoint)
    )
    assert list(numbers) == list(range(7))

    def loss(density: np.ndarray, colour: np.ndarray) -> float:
        return float((plain_composite(density, colour) * adjoint).sum())

    h = 1e-5
    for i in range(7):
        shift = h * (np.arange(9) == i)
        difference = (loss(density + shift, colour) - loss(density - shift, colour)) / (2 * h)
        assert by_density[i] == pytest.approx(difference, rel=1e-3, abs=1e-6)
        for c in range(3):
            more = np.zeros_like(colour)
            more[i, c] = h
            difference = (loss(density, colour + more) - loss(density, colour - more)) / (2 * h)
            assert by_colour[c][i] == pytest.approx(difference, rel=1e-3, abs=1e-6)


# --- the occupancy grid -----------------------------------------------------------------------


def slab(place: mi.Point3f) -> mi.Float:
    """Dense in the first third of the cube along x alone."""
    return dr.select(place.x < 1 / 3, mi.Float(200), 0)


def occupied_cells(grid: OccupancyGrid) -> np.ndarray:
    return grid.occupied.numpy().reshape((grid.resolution,) * 3)


def test_updates_find_what_is_dense():
    grid = OccupancyGrid(SIDE, STEP)
    assert grid.share == 1
    for turn in range(4 * TURNS):
        grid.update(slab, seed=3, turn=turn)
    cells = occupied_cells(grid)
    assert cells[..., :2].all() and not cells[..., 2:].any()
    assert grid.share == pytest.approx(1 / 3)
    # What has gone is forgotten, in time.
    for turn in range(30 * TURNS):
        grid.update(lambda place: slab(mi.Point3f(1 - place)), seed=3, turn=turn)
    cells = occupied_cells(grid)
    assert cells[..., 4:].all() and not cells[..., :4].any()


def test_what_no_camera_sees_is_empty():
    cube = Cube((-1.0, -1.0, -1.0), 2.0)
    view = View(name="v", origin=(0, 0, 3), target=(0, 0, 0), fov=24)
    grid = OccupancyGrid(8, STEP)
    grid.hide_unseen([make_pinhole(view, (8, 6))], cube, near=1.25)
    cells = occupied_cells(grid)
    z, y, x = np.stack(np.nonzero(cells))
    middle = (np.stack([x, y, z], 1) + 0.5) / 4 - 1
    depth = 3 - middle[:, 2]
    across = np.tan(np.radians(12)) * depth
    assert len(z) and (depth > 2.5).all()
    assert (np.abs(middle[:, 0]) <= across + 1e-6).all()
    assert (np.abs(middle[:, 1]) <= 0.75 * across + 1e-6).all()
    assert cells[0].sum() > cells[5].sum() > 0 and not cells[6:].any()
    for turn in range(2 * TURNS):
        grid.update(lambda place: mi.Float(500) + place.x, seed=1, turn=turn)
    assert (occupied_cells(grid) == cells).all()
