"""Fields with levels before training: every point finds Gaussians near it."""

from __future__ import annotations

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from scipy.spatial import cKDTree

from gpf.core.structs import concatenate, from_numpy, to_numpy
from gpf.field.by_detail import Moves, field_by_detail, field_of_frame
from gpf.field.detail import Detail
from gpf.field.gaussians import rotation_columns
from gpf.field.initialization import DISTANCE
from gpf.field.settings import FieldSettings

BOX = mi.ScalarPoint3f(-1, -1, -0.1), mi.ScalarPoint3f(1, 1, 0.9)
RADIUS = 0.8
MIDDLE = DISTANCE * RADIUS / 2
BALL = np.array([-MIDDLE, MIDDLE, MIDDLE])
"""In the middle of a cell of the coarsest level, so that all of it has the same height there."""


@pytest.fixture(scope="module")
def scene():
    """A small ball above a floor, and a wall beside it."""
    turned = mi.ScalarTransform4f().translate([-MIDDLE + 0.3, 0, 0]).rotate([0, 1, 0], -90)
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle"},
            "wall": {"type": "rectangle", "to_world": turned},
            "ball": {"type": "sphere", "center": BALL.tolist(), "radius": 0.1},
        }
    )


def on_ball_and_floor(rng, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Few points on the ball, many on the floor, with their normals."""
    n = rng.normal(size=(count // 10, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    floor = np.column_stack([rng.uniform(-1, 1, (count, 2)), np.zeros(count)])
    ball = BALL + 0.1 * n
    return np.concatenate([ball, floor]), np.concatenate([n, np.tile([0.0, 0, 1], (count, 1))])


def reach(field, points: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    p, n = from_numpy(mi.Point3f, points[0]), from_numpy(mi.Normal3f, points[1])
    return field.query(p, n, dr.full(mi.Bool, True, len(points[0])))[1].numpy()


def make(scene, points, fill_gaps: bool, fine: int = 1):
    table = np.zeros((4, 4, 2), np.uint8)
    table[2:] = fine
    detail = Detail(table, 0.5, np.array([-1.0, -1.0, -0.1]), RADIUS)
    settings = FieldSettings(search_radius=RADIUS)
    return field_by_detail(scene, detail, settings, BOX, points, 1, fill_gaps)


def test_what_is_smaller_than_the_search_radius_has_gaussians_all_around(scene):
    rng = np.random.default_rng(4)
    points, others = on_ball_and_floor(rng, 4000), on_ball_and_floor(rng, 4000)
    plain, filled = make(scene, points, False), make(scene, points, True)
    assert np.isinf(reach(plain, others)).any()  # no Gaussian that faces their way
    assert (reach(filled, points) == 1).all() and reach(filled, others).max() < 1.5
    # Where enough are near, none is added.
    added = to_numpy(filled.gaussians.means)[dr.width(plain.gaussians.means) :]
    assert len(added) > 0 and (filled.detail.fold(added)[:, 2] > 0.05).all()


def test_gaussians_move_and_turn_with_their_surfaces(scene):
    """Half of them on a grid that reaches farther down; the others are lost."""
    points = on_ball_and_floor(np.random.default_rng(4), 4000)
    field = make(scene, points, True)
    before, n = field.detail.fold(to_numpy(field.gaussians.means)), field.gaussians.normals
    count = dr.width(n)
    shift = np.tile(np.float32([0.02, 0.01, -0.03]), (count, 1))
    angle = 0.5
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    turned, known = to_numpy(n) @ turn.T, np.arange(count) < count // 2
    detail = field.detail.around(np.array([-1, -1, -0.8]), np.array([1, 1, 0.9]), 64)
    assert detail.table.shape == (4, 4, 4) and detail.corner[2] == pytest.approx(-1.1)
    far = np.full(3, 1e6)  # whose cells no memory could hold
    assert field.detail.around(-far, far, 1 << 19) is None
    settings = field.settings.model_copy(update={"direct": (1,)})
    moves = Moves(shift, turned, known)
    found = field_of_frame(scene, field, detail, settings, BOX, points, moves, 1)
    assert found.settings.direct == (1,)
    after = detail.fold(to_numpy(found.gaussians.means))
    distance, there = cKDTree(after).query((before + shift)[known])
    half = np.flatnonzero(distance < 1e-6)  # but for a few that are too dense
    assert len(half) > 0.8 * count // 2
    there = there[half]
    np.testing.assert_allclose(to_numpy(found.gaussians.normals)[there], turned[half], atol=1e-6)
    # A direction across the normal keeps its angle to it, and one along it follows it.
    start, end = (
        np.stack([to_numpy(each) for each in rotation_columns(one.gaussians.quats)])[:, rows]
        for one, rows in ((field, half), (found, there))
    )
    across = np.einsum("kni,ni->kn", end, turned[half])
    np.testing.assert_allclose(across, np.einsum("kni,ni->kn", start, to_numpy(n)[half]), atol=1e-5)
    floor = to_numpy(n)[half][:, 2] > 0.9999
    np.testing.assert_allclose(end[:, floor], start[:, floor] @ turn.T, atol=1e-5)


def next_frame(scene, field, points):
    """The start of the next frame, in which nothing moves."""
    normals = to_numpy(field.gaussians.normals)
    moves = Moves(np.zeros_like(normals), normals, np.ones(len(normals), bool))
    settings, detail = field.settings, field.detail
    return field_of_frame(scene, field, detail, settings, BOX, points, moves, 1)


def places(field) -> dict[bytes, int]:
    """The number of the Gaussian at each place."""
    means = to_numpy(field.gaussians.means)
    return {each.tobytes(): number for number, each in enumerate(means)}


def with_shapes(field, *change: float):
    """With other scales than before training."""
    g = field.gaussians
    field.update(replace(g, log_scales=g.log_scales + mi.Vector3f(change)))
    return field


def test_places_that_are_still_keep_their_bits(scene):
    points = on_ball_and_floor(np.random.default_rng(4), 4000)
    field = with_shapes(make(scene, points, True, fine=2), 0.4, 0, -2)
    found = next_frame(scene, field, points)
    before, after = places(field), places(found)
    stay = [place for place in before if place in after]
    assert len(stay) > 0.9 * len(before)  # but for a few that are too close together
    rows, there = [before[place] for place in stay], [after[place] for place in stay]
    for name in ("quats", "irradiance", "normals"):
        first, second = (to_numpy(vars(each.gaussians)[name]) for each in (field, found))
        np.testing.assert_array_equal(second[there], first[rows])


@pytest.mark.parametrize(("fine", "kept"), [(1, (0.2, 0, -1)), (2, (0.4, 0, -2))])
def test_where_light_is_smooth_shapes_become_rounder(scene, fine, kept):
    points = on_ball_and_floor(np.random.default_rng(4), 4000)
    field = make(scene, points, False, fine)
    usual = to_numpy(field.gaussians.log_scales)[0, 0]
    found = next_frame(scene, with_shapes(field, 0.4, 0, -2), points)
    level = found.detail.levels_of(to_numpy(found.gaussians.means))
    more = to_numpy(found.gaussians.log_scales) - usual
    new = (more == 0).all(axis=1)
    for number, expected in ((0, (0.2, 0, -1)), (fine, kept)):
        some = more[(level == number) & ~new]
        assert len(some) > 5
        np.testing.assert_allclose(some, np.tile(expected, (len(some), 1)), atol=1e-5)


def test_what_is_still_keeps_its_gaussians(scene):
    """Also on the ball, where they are close together."""
    points = on_ball_and_floor(np.random.default_rng(4), 4000)
    field = next_frame(scene, make(scene, points, True), points)
    for _ in range(3):
        before, field = places(field), next_frame(scene, field, points)
        assert len(before.keys() ^ places(field).keys()) <= 0.02 * len(before)


def test_their_number_does_not_grow(scene):
    """Training gathers them along lines of light; between the lines, each frame adds some."""
    points = on_ball_and_floor(np.random.default_rng(4), 4000)
    field, counts = make(scene, points, True), []
    for _ in range(12):
        means = to_numpy(field.gaussians.means)
        line = 1.5 * RADIUS * np.round(means[:, 0] / (1.5 * RADIUS))
        means[:, 0] += 0.8 * (line - means[:, 0])
        field.update(replace(field.gaussians, means=from_numpy(mi.Point3f, means)))
        field = next_frame(scene, field, points)
        counts.append(dr.width(field.gaussians.means))
    assert max(counts[6:]) < 1.1 * counts[5]


def test_of_those_close_together_the_oldest_stays(scene):
    """A second set beside the first one, and one that faces the other way."""
    rng = np.random.default_rng(4)
    floor = np.column_stack([rng.uniform(-1, 1, (4000, 2)), np.zeros(4000)])
    points = floor, np.tile([0.0, 0, 1], (4000, 1))
    field = make(scene, points, False)
    g = field.gaussians
    width = 0.02 * DISTANCE * RADIUS
    second = replace(g, means=mi.Point3f(g.means + mi.Vector3f(width, 0, 0)))
    behind = replace(g, normals=-g.normals)
    field.update(concatenate([g, second, behind]))
    count, found = dr.width(g.means), places(next_frame(scene, field, points))
    means = to_numpy(field.gaussians.means)
    stay = np.array([each.tobytes() in found for each in means])
    assert stay[:count].mean() > 0.9 and stay[count : 2 * count].mean() < 0.2
    assert stay[2 * count :].mean() > 0.9


def test_gaussians_in_gaps_end_at_walls(scene):
    rng = np.random.default_rng(4)
    filled = make(scene, on_ball_and_floor(rng, 4000), True)
    means = filled.detail.fold(to_numpy(filled.gaussians.means))
    assert len(filled.limits) == len(means)
    top = (means[:, 2] > BALL[2] - 0.05) & (to_numpy(filled.gaussians.normals)[:, 2] > 0.9)
    assert top.any() and (filled.limits[top][:, 0, 0] > 0.9).all()
