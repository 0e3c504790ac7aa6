"""Normals and depths in tags, and what counts as the same surface."""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.spatial_hash import Record, SpatialHash
from gpf.core.structs import from_numpy
from gpf.core.surface_tags import pack_tag, same_surface, unpack_depth, unpack_normal


def unit_vectors(count: int, seed: int = 1) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(count, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    v[:6] = np.concatenate([np.eye(3), -np.eye(3)])
    return v


def test_tags_hold_normal_and_depth():
    n = unit_vectors(5120)
    depth = (np.arange(5120) % 256).astype(np.uint32)
    tag = pack_tag(from_numpy(mi.Normal3f, n), from_numpy(mi.UInt32, depth))
    np.testing.assert_allclose(unpack_normal(tag).numpy().T, n, atol=4e-3)
    np.testing.assert_array_equal(np.array(unpack_depth(tag)), depth)


def test_depths_saturate():
    tag = pack_tag(mi.Normal3f(0, 0, 1), mi.UInt32([0, 254, 255, 256, 0xFFFFFFFF]))
    assert np.array(unpack_depth(tag)).tolist() == [0, 254, 255, 255, 255]


def test_tags_survive_the_hash():
    """Read as a float, many tags are no numbers; their bits have to arrive all the same."""
    n = unit_vectors(4096, seed=2)
    depth = np.random.default_rng(3).integers(0, 256, 4096).astype(np.uint32)
    tag = pack_tag(from_numpy(mi.Normal3f, n), from_numpy(mi.UInt32, depth))
    assert np.isnan(tag.numpy()).any()
    grid = SpatialHash(
        from_numpy(mi.Point3f, n), cell=0.1, bounds=((-1, -1, -1), (1, 1, 1)), tag=tag
    )
    record = grid.record(dr.arange(mi.UInt32, 4096), mi.Bool(True))
    order = grid.order.numpy()
    np.testing.assert_array_equal(np.array(unpack_depth(record.tag)), depth[order])
    np.testing.assert_allclose(unpack_normal(record.tag).numpy().T, n[order], atol=4e-3)


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether a record with normal ``a`` and a photon with normal ``b`` lie on one surface."""
    record = Record(mi.Point3f(0), pack_tag(mi.Normal3f(a.tolist())), mi.Color3f(0))
    return bool(same_surface(record, mi.Point3f(0), mi.Normal3f(b.tolist()), mi.Float(1))[0])


@pytest.mark.parametrize(("degrees", "one"), [(0, True), (30, True), (43, True), (47, False)])
def test_surfaces_that_bend_by_less_than_45_degrees_are_one(degrees, one):
    a = math.radians(degrees)
    for axes in ((0, 1), (1, 2), (2, 0)):
        other = np.zeros(3)
        other[axes[0]], other[axes[1]] = math.cos(a), math.sin(a)
        assert same(np.eye(3)[axes[0]], other) is one
        assert same(-other, -np.eye(3)[axes[0]]) is one


def test_other_sides_and_corners_are_other_surfaces():
    for n in unit_vectors(40, seed=4):
        across = np.cross(n, [0.3, 0.5, 0.81])
        across /= np.linalg.norm(across)
        assert same(n, n)
        assert not same(n, -n)
        assert not same(n, across)
        assert not same(n, -across)


@pytest.mark.parametrize(
    ("aside", "above", "one"),
    [(0, 0.49, True), (0, 0.51, False), (0.8, -0.49, True), (0.8, -0.51, False), (4, 1.9, True)],
)
def test_inside_and_outside_of_a_thin_tube_are_two_surfaces(aside, above, one):
    """Where the normals agree: more than half a radius above one another, or too steep a way."""
    n = np.array([2, 3, 6]) / 7
    across = np.array([3, -2, 0]) / math.sqrt(13)
    p = np.array([0.1, 0.2, 0.3])
    place = p + aside * across + above * n
    tag = pack_tag(mi.Normal3f(n.tolist()))
    record = Record(mi.Point3f(place.tolist()), tag, mi.Color3f(0))
    p, n = mi.Point3f(p.tolist()), mi.Normal3f(n.tolist())
    radius2 = dr.maximum(1, dr.squared_norm(record.p - p))
    assert bool(same_surface(record, p, n, radius2)[0]) is one
