"""The neighbour search against scipy's cKDTree.

Coordinates are multiples of 2⁻⁸ below 4: differences, squares and their sums are exact in single
precision, so that points exactly at the radius are no matter of rounding.
"""

from __future__ import annotations

import itertools
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpf.core.spatial_hash import NOT_FOUND, SpatialHash
from gpf.core.structs import from_numpy

STEP = 2.0**-8
BOX = ((-2, -2, -2), (2, 2, 2))
# Powers of two plus odd steps: no radius is a multiple of a cell.
RADIUS = 13 * STEP


def to_points(array: np.ndarray) -> mi.Point3f:
    return from_numpy(mi.Point3f, array)


def opaque(value: float) -> mi.Float:
    """A number that is no part of the kernel: the next one needs no other kernel."""
    return dr.opaque(mi.Float, value)


def snap(array: np.ndarray) -> np.ndarray:
    return np.clip(np.round(array / STEP) * STEP, -4, 4 - STEP)


def cloud(kind: str, count: int, seed: int = 1) -> np.ndarray:
    """Points in a box of edges 4, 2 and 1 (no two axes alike) and beyond."""
    rng = np.random.default_rng(seed)
    if kind == "uniform":
        return snap(rng.uniform(-1, 1, (count, 3)) * [2, 1, 0.5])
    if kind == "clustered":  # most cells are empty, some hold hundreds; many duplicates
        centres = rng.uniform(-2, 2, (40, 3))
        return snap(centres[rng.integers(0, 40, count)] + rng.normal(0, 0.02, (count, 3)))
    if kind == "wall":  # a plane: what photons on a floor look like
        return snap(rng.uniform(-2, 2, (count, 3)) * [1, 0, 1] + [0, 0.5, 0])
    if kind == "duplicates":
        return snap(np.repeat(rng.uniform(-1, 1, (count // 50 + 1, 3)), 50, axis=0)[:count])
    assert kind == "outside"
    return snap(rng.uniform(-4, 4, (count, 3)))


def hash_of(points: np.ndarray, cell: float = 2.02 * RADIUS, **options: Any) -> SpatialHash:
    return SpatialHash(to_points(points), cell=cell, **({"bounds": BOX} | options))


def queries(points: np.ndarray, count: int, seed: int = 2) -> np.ndarray:
    """A third at points, a third near points, a third anywhere, also outside the bounds."""
    rng = np.random.default_rng(seed)
    near = points[rng.integers(0, len(points), 2 * count // 3)]
    near = near + (np.arange(len(near)) % 2)[:, None] * rng.normal(0, RADIUS, near.shape)
    return snap(np.concatenate([near, rng.uniform(-4, 4, (count - len(near), 3))]))


def visit(grid: SpatialHash, x: np.ndarray, radius: float, active: Any = True) -> np.ndarray:
    """Number of points inside, and two sums over their indices that a double visit would change.

    (N, 3), modulo 2³².
    """
    order = grid.order

    def body(state, index, record, distance2, inside):  # type: ignore[no-untyped-def]
        count, total, squares = state
        original = dr.gather(mi.UInt32, order, index, inside)
        one = dr.select(inside, mi.UInt32(1), 0)
        return [count + one, total + one * original, squares + one * original * original]

    zeros = [mi.UInt32(0), mi.UInt32(0), mi.UInt32(0)]
    state = grid.visit(to_points(x), opaque(radius), body, zeros, mi.Bool(active))
    dr.eval(state)  # or each sum is a kernel of its own
    return np.stack([np.broadcast_to(s.numpy(), len(x)) for s in state], axis=1)


def summarise(lists: Any) -> np.ndarray:
    rows = [np.asarray(ids, dtype=np.uint64) for ids in lists]
    sums = [(len(r), r.sum(dtype=np.uint64), (r * r).sum(dtype=np.uint64)) for r in rows]
    return (np.array(sums, dtype=np.uint64).reshape(-1, 3) % 2**32).astype(np.uint32)


@pytest.mark.parametrize("cell", [2.02 * RADIUS, RADIUS / 3, 1.5])
@pytest.mark.parametrize("kind", ["uniform", "clustered", "wall", "duplicates", "outside"])
def test_visit_finds_what_ckdtree_finds(kind, cell):
    points = cloud(kind, 100_000)
    x = queries(points, 1500)
    grid = hash_of(points, cell=cell)
    expected = summarise(cKDTree(points).query_ball_point(x, RADIUS))
    np.testing.assert_array_equal(visit(grid, x, RADIUS), expected)
    assert expected[:, 0].max() > 1, "the test compares empty balls"


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_visit_is_exact_far_from_the_origin(scale):
    """A box at 1000 times its own size: single precision has few digits left for the cells."""
    rng = np.random.default_rng(3)
    corner = np.array([1000.0, -1000, 500]) * scale
    points = (corner + rng.uniform(0, scale, (20_000, 3))).astype(np.float32)
    x = points[::20]
    radius = 0.05 * scale
    grid = hash_of(points, cell=radius, bounds=(corner, corner + scale))
    found = visit(grid, x, radius)[:, 0]
    # Single precision decides what lies within rounding of the radius.
    tree = cKDTree(points.astype(np.float64))
    less, more = (
        tree.query_ball_point(x.astype(np.float64), radius * f, return_length=True)
        for f in (1 - 1e-5, 1 + 1e-5)
    )
    assert (found >= less).all() and (found <= more).all() and less.max() > 3


@pytest.mark.parametrize("cell", [2.02 * RADIUS, RADIUS / 2, 2 * RADIUS])
def test_points_exactly_at_the_radius_count(cell):
    """3-4-5 and axis-parallel offsets of exactly the radius, around cell corners too."""
    r = 5 * STEP
    steps = [s for s in itertools.product((-5, -4, -3, 0, 3, 4, 5), repeat=3)]
    on_sphere = np.array([s for s in steps if sum(c * c for c in s) == 25]) * STEP
    beyond = np.array([[0, 0, 6], [5, 1, 0], [-4, -3, 1], [3, 4, -1]]) * STEP
    for x in ([0, 0, 0], [cell, cell, cell], [-2, 2, -2], [1 - STEP, 0.5, 3 * STEP]):
        x = snap(np.array([x], dtype=np.float64))
        grid = hash_of(x + np.concatenate([on_sphere, beyond]), cell=cell)
        assert visit(grid, x, r)[0, 0] == len(on_sphere)
        assert visit(grid, x, r - STEP / 64)[0, 0] == 0


@pytest.mark.parametrize(
    "bounds",
    [((-300, -200, -100), (300, 200, 100)), ((-2, -2, -2), (-2 + (2**21 - 1) / 8, 2, 2))],
    ids=["large", "all rows in one"],
)
def test_a_wrapped_table_gives_the_same(bounds):
    """Far more cells than points: rows share buckets; in the second box even neighbours do."""
    points = cloud("clustered", 3000)
    x = queries(points, 1000)
    grid = hash_of(points, cell=1 / 8, bounds=bounds, far=True)
    assert grid.levels.wraps
    tree = cKDTree(points)
    for radius in (RADIUS, 11 * RADIUS):
        expected = summarise(tree.query_ball_point(x, radius))
        np.testing.assert_array_equal(visit(grid, x, radius), expected)
    check_nearest(grid, points, x, k=5, limit=16.0)


def test_records_carry_the_tag():
    points = cloud("uniform", 5000)
    tag = np.arange(5000, dtype=np.float32) + 0.5
    grid = hash_of(points, cell=0.1, tag=from_numpy(mi.Float, tag), far=True)
    order = grid.order.numpy()
    np.testing.assert_array_equal(np.sort(order[:5000]), np.arange(5000))
    records = grid.records.numpy().reshape(-1, 4)
    assert len(records) % 5000 == 0 and len(records) > 5000
    np.testing.assert_array_equal(records[:, :3], points[order])
    np.testing.assert_array_equal(records[:, 3], tag[order])


def test_records_carry_the_colour():
    points = cloud("uniform", 3000)
    colour = np.random.default_rng(1).uniform(size=(3000, 3)).astype(np.float32)
    grid = hash_of(points, cell=0.1, colour=from_numpy(mi.Color3f, colour))
    chosen = dr.arange(mi.UInt32, 3000)
    record = grid.record(chosen, chosen < 2000)
    order = grid.order.numpy()[:2000]
    np.testing.assert_array_equal(record.p.numpy().T[:2000], points[order])
    np.testing.assert_array_equal(record.colour.numpy().T[:2000], colour[order])
    assert not record.colour.numpy().T[2000:].any()


def nearest(
    grid: SpatialHash, x: np.ndarray, k: int, start: float, limit: float, **more: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Original indices (-1: none) and squared distances, both (N, k)."""
    index, distance2 = grid.nearest(to_points(x), k, opaque(start), opaque(limit), **more)
    dr.eval(index, distance2)  # or each rank is a kernel of its own
    index = np.stack([np.broadcast_to(i.numpy(), len(x)) for i in index], axis=1)
    distance2 = np.stack([np.broadcast_to(d.numpy(), len(x)) for d in distance2], axis=1)
    missing = index == NOT_FOUND
    original = grid.order.numpy()[np.where(missing, 0, index)].astype(np.int64)
    return np.where(missing, -1, original), distance2


def check_nearest(
    grid: SpatialHash,
    points: np.ndarray,
    x: np.ndarray,
    k: int,
    limit: float,
    start: float = RADIUS,
    taken: np.ndarray | None = None,
    **more: Any,
) -> None:
    """Compare with cKDTree up to the radius of the last ball; equal distances may swap."""
    ids = np.arange(len(points)) if taken is None else np.flatnonzero(taken)
    found, distance2 = nearest(grid, x, k, start, limit, **more)
    last_ball = start
    while last_ball < limit:
        last_ball *= 2
    d, _ = cKDTree(points[ids]).query(x, k=np.arange(1, k + 1))
    d = np.where(d <= last_ball, d, np.inf)
    # Sums of squares of multiples of 2⁻⁸ are exact in both precisions.
    np.testing.assert_array_equal(distance2, np.round(d**2 / STEP**2) * STEP**2)
    there = found >= 0
    np.testing.assert_array_equal(there, np.isfinite(d))
    own = ((points[np.where(there, found, 0)] - x[:, None]) ** 2).sum(2)
    np.testing.assert_array_equal(own[there], distance2[there])
    assert np.isin(found[there], ids).all()
    for row, mask in zip(found, there, strict=True):
        assert len(set(row[mask])) == mask.sum(), "a point was returned twice"


@pytest.mark.parametrize("k", [1, 3, 8])
@pytest.mark.parametrize("kind", ["uniform", "clustered", "duplicates", "outside"])
def test_nearest_finds_what_ckdtree_finds(kind, k):
    points = cloud(kind, 100_000)
    check_nearest(hash_of(points, far=True), points, queries(points, 1000), k, limit=16.0)


@pytest.mark.parametrize("start", [STEP / 2, RADIUS, 3.0])
def test_nearest_is_the_same_from_any_first_radius(start):
    points = cloud("clustered", 20_000)
    grid = hash_of(points, far=True)
    check_nearest(grid, points, queries(points, 500), 4, limit=16.0, start=start)


def test_nearest_with_a_first_radius_of_its_own_per_query():
    points = cloud("uniform", 20_000)
    x = queries(points, 400)
    grid = hash_of(points, far=True)
    start = from_numpy(mi.Float, np.random.default_rng(5).uniform(0.01, 1, 400))
    _, distance2 = grid.nearest(to_points(x), 1, start, mi.Float(16))
    d, _ = cKDTree(points).query(x)
    np.testing.assert_array_equal(distance2[0].numpy(), np.round(d**2 / STEP**2) * STEP**2)


def test_neighbours_that_do_not_exist_are_marked_as_missing():
    points = cloud("uniform", 5)
    x = cloud("outside", 50)
    grid = hash_of(points, cell=0.1, far=True)
    check_nearest(grid, points, x, k=9, limit=16.0)
    found, distance2 = nearest(grid, x, 9, 0.1, 16.0)
    assert (found[:, :5] >= 0).all() and (found[:, 5:] == -1).all()
    assert np.isinf(distance2[:, 5:]).all()


def test_a_single_point_is_found_from_anywhere():
    points = np.array([[0.5, -0.25, 1.0]])
    grid = hash_of(points, cell=0.1, far=True)
    check_nearest(grid, points, cloud("outside", 20), k=2, limit=16.0)
    assert visit(grid, points, 0.0)[0].tolist() == [1, 0, 0]


def test_nearest_gives_up_at_the_limit():
    """Everything within the last ball, and nothing beyond: also where that is fewer than k."""
    points = cloud("clustered", 2000)
    x = queries(points, 600)
    grid = hash_of(points, far=True)
    check_nearest(grid, points, x, k=6, limit=4 * RADIUS)
    found, _ = nearest(grid, x, 6, RADIUS, 4 * RADIUS)
    assert (found == -1).any() and (found >= 0).all(1).any()


def test_nearest_among_accepted_records():
    points = cloud("clustered", 20_000)
    kind = np.random.default_rng(6).integers(0, 4, len(points)).astype(np.float32)
    grid = hash_of(points, tag=from_numpy(mi.Float, kind), far=True)
    check_nearest(
        grid,
        points,
        queries(points, 600),
        k=3,
        limit=16.0,
        taken=kind == 2,
        accept=lambda index, record, inside: inside & (record.tag == 2),
    )


def test_inactive_queries_visit_nothing_and_have_no_neighbours():
    points = cloud("uniform", 5000)
    x = points[:101]
    active = np.arange(101) % 3 == 0
    grid = hash_of(points, far=True)
    lanes = from_numpy(mi.Bool, active)
    found = visit(grid, x, RADIUS, lanes)
    assert not found[~active].any() and (found[active, 0] >= 1).all()
    found, _ = nearest(grid, x, 2, 0.1, 16.0, active=lanes)
    assert (found[active] >= 0).all() and (found[~active] == -1).all()
