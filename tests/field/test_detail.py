"""Fields that are not equally fine everywhere: the unfolded space, queries in it, and files."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, to_numpy
from gpf.field.by_detail import place_by_detail
from gpf.field.detail import FADE, Detail
from gpf.field.field import GaussianPhotonField
from gpf.field.io import load_field, read_field, save_field
from gpf.field.ply import write_splats
from gpf.field.settings import FieldSettings
from tests.plain_field import flat_gaussians, to_device

RADIUS, WIDTH = 0.4, 0.5
CORNER = np.array([-1.0, -2.0, 0.0])
BOX = mi.ScalarPoint3f(-1, -2, 0), mi.ScalarPoint3f(1, 0, 0.5)


def make_detail() -> Detail:
    """Level 0 on the left, 2 on the right, 1 in one corner of it."""
    table = np.zeros((4, 4, 1), np.uint8)
    table[2:] = 2
    table[3, 3] = 1
    return Detail(table, WIDTH, CORNER, RADIUS)


def floor(rng, count):
    """Points on the floor z = 0.1, and their normals."""
    p = np.column_stack([rng.uniform(-1, 1, count), rng.uniform(-2, 0, count), np.full(count, 0.1)])
    return p, np.tile([0.0, 0.0, 1.0], (count, 1))


def device(p: np.ndarray) -> mi.Point3f:
    return from_numpy(mi.Point3f, p)


def make_field(detail: Detail, rng) -> GaussianPhotonField:
    """Gaussians with E = 1, 2 and 3 at the levels 0, 1 and 2."""
    p, n = floor(rng, 40_000)
    g = place_by_detail(detail, p, n, seed=1)
    level = from_numpy(mi.Float, detail.levels_of(to_numpy(g.means)))
    g.irradiance = mi.Color3f(level + 1)
    return GaussianPhotonField(g, FieldSettings(search_radius=RADIUS), BOX, detail=detail)


def test_unfolded_points_come_back():
    detail, rng = make_detail(), np.random.default_rng(1)
    p, _ = floor(rng, 1000)
    for level in range(3):
        unfolded = detail.unfold_all(p, level)
        assert (detail.levels_of(unfolded) == level).all()
        np.testing.assert_allclose(detail.fold(unfolded), p, atol=1e-9)
        same = detail.unfold_to(device(p), dr.full(mi.UInt32, level, len(p)))
        np.testing.assert_allclose(to_numpy(same), unfolded, atol=1e-5)


def test_queries_have_the_level_of_their_cell_and_fade_into_the_next():
    detail, rng = make_detail(), np.random.default_rng(2)
    p, _ = floor(rng, 20_000)
    levels = detail.levels_of(to_numpy(detail.unfold(device(p))))
    known = detail.levels_at(p)
    inside = np.abs((p[:, :2] - CORNER[:2]) / WIDTH % 1 - 0.5) < 0.5 - FADE
    inside = inside.all(axis=1)
    np.testing.assert_array_equal(levels[inside], known[inside])
    # At the border between two levels, one half of the queries have either.
    border = (np.abs(p[:, 0]) < 0.01) & (p[:, 1] < -0.8)
    assert border.sum() > 50 and 0.3 < (levels[border] == 2).mean() < 0.7
    assert set(levels[border]) == {0, 2}


def test_a_field_answers_with_the_gaussians_of_one_level():
    detail, rng = make_detail(), np.random.default_rng(3)
    field = make_field(detail, rng)
    p, n = floor(rng, 5000)
    value, reach = field.query(device(p), mi.Normal3f(device(n)), dr.full(mi.Bool, True, 5000))
    levels = detail.levels_of(to_numpy(detail.unfold(device(p))))
    np.testing.assert_allclose(to_numpy(value)[:, 0], levels + 1, rtol=1e-5)
    # As dense at each level as the radius asks for: no query has to look farther.
    assert (to_numpy(reach) == 1).mean() > 0.98


def test_a_copy_with_the_arrays_of_another_field_has_its_levels():
    rng = np.random.default_rng(7)
    turned = Detail(make_detail().table[::-1], WIDTH, CORNER, RADIUS)
    first, other = make_field(make_detail(), rng), make_field(turned, rng)
    p, n = floor(rng, 2000)
    every = dr.full(mi.Bool, True, 2000)
    ours, theirs, before = (
        to_numpy(f.query(device(p), mi.Normal3f(device(n)), every)[0])
        for f in (first.with_arrays(other.arrays()), other, first)
    )
    np.testing.assert_array_equal(ours, theirs)
    assert (ours != before).any(axis=1).mean() > 0.9


def test_a_query_is_that_of_a_plain_field_on_a_smaller_scale():
    """A table with a single level makes the same field as none, with all lengths scaled."""
    rng = np.random.default_rng(4)
    p, _ = floor(rng, 300)
    g = flat_gaussians(p, rng.uniform(1, 2, (300, 3)), size=0.1)
    plain = GaussianPhotonField(to_device(g), FieldSettings(search_radius=0.2), BOX)
    detail = Detail(np.full((1, 1, 1), 1, np.uint8), 2.0, CORNER, 0.4)
    scaled = replace(g, means=detail.unfold_all(g.means, 1), log_scales=g.log_scales + np.log(2))
    field = GaussianPhotonField(
        to_device(scaled), FieldSettings(search_radius=0.4), BOX, detail=detail
    )
    q, m = floor(rng, 1000)
    every = dr.full(mi.Bool, True, 1000)
    values = [
        to_numpy(f.query(device(q), mi.Normal3f(device(m)), every)[0]) for f in (plain, field)
    ]
    np.testing.assert_allclose(*values, rtol=2e-4)


@pytest.mark.parametrize("precision", ["float32", "compact"])
def test_files_keep_the_levels(tmp_path, precision):
    detail, rng = make_detail(), np.random.default_rng(5)
    field = make_field(detail, rng)
    save_field(field, tmp_path / "field.safetensors", precision)
    stored = read_field(tmp_path / "field.safetensors")
    # In world units, for whoever reads the file.
    means = stored.tensors["means"]
    assert (means >= CORNER - 1e-3).all() and (means <= [1.001, 0.001, 0.101]).all()
    size = np.exp(stored.tensors["log_scales"].mean(axis=1)) / (0.6 * RADIUS)
    np.testing.assert_allclose(size, 0.5 ** stored.tensors["levels"].astype(float), rtol=0.05)
    again = load_field(tmp_path / "field.safetensors")
    p, n = floor(rng, 2000)
    every = dr.full(mi.Bool, True, 2000)
    values = [
        to_numpy(f.query(device(p), mi.Normal3f(device(n)), every)[0]) for f in (field, again)
    ]
    np.testing.assert_allclose(*values, rtol=1e-3)


def test_splats_do_not_overlap_where_levels_meet(tmp_path):
    detail, rng = make_detail(), np.random.default_rng(6)
    save_field(make_field(detail, rng), tmp_path / "field.safetensors")
    stored = read_field(tmp_path / "field.safetensors")
    own = stored.tensors["levels"] == detail.levels_at(stored.tensors["means"])
    assert 0 < own.sum() < len(own)
    assert write_splats(tmp_path / "a.ply", stored, 1.0) == own.sum()
