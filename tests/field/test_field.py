"""The field's query against its plain twin, its limits, and its lack of seams."""

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import VisiblePoints, from_numpy
from gpf.field.field import blend_weight
from gpf.field.neighbour_search import LARGEST_REACH
from gpf.field.settings import FieldSettings
from tests.plain_field import (
    LOWER,
    UPPER,
    ask,
    flat_gaussians,
    make_field,
    neighbours_of,
    plain_query,
    random_gaussians,
    random_normals,
    weights_of,
)

UP = np.array([0.0, 0.0, 1.0])


def random_queries(rng, count, g):
    """Points in a box twice as large, and some that are means."""
    middle, half = (LOWER + UPPER) / 2, UPPER - LOWER
    x = np.concatenate([rng.uniform(middle - half, middle + half, (count - 5, 3)), g.means[:5]])
    return x.astype(np.float32).astype(float), random_normals(rng, count)


# --- against the twin -------------------------------------------------------------------------


@pytest.mark.parametrize("blend", ["divided", "sum"])
@pytest.mark.parametrize("neighbours", ["both", "radius", "knn"])
@pytest.mark.parametrize("normal_test", [True, False])
def test_query_is_its_plain_twin(neighbours, blend, normal_test):
    rng = np.random.default_rng(3)
    g = random_gaussians(rng, 150)
    settings = FieldSettings(
        search_radius=0.5, k=3, neighbours=neighbours, blend=blend, normal_test=normal_test
    )
    x, n = random_queries(rng, 90, g)
    value, reach = ask(make_field(g, settings), x, n)
    expected, expected_reach = plain_query(g, settings, x, n)
    # Every case is among the queries: points with an answer from the ball and from further away.
    in_ball = [
        len(neighbours_of(g, settings.model_copy(update={"neighbours": "radius"}), *q)[0])
        for q in zip(x, n, strict=True)
    ]
    assert min(in_ball) == 0 and max(in_ball) > settings.k and len(np.unique(in_ball)) > 4
    np.testing.assert_allclose(reach, expected_reach, rtol=1e-5)
    # A narrow Gaussian's exponent loses digits far out: where its weight is next to nothing.
    np.testing.assert_allclose(value, expected, rtol=2e-3, atol=1e-5)


def test_unequal_scales_stand_where_the_rotation_puts_them():
    g = flat_gaussians(np.zeros((2, 3)), [[1, 0, 0], [0, 1, 0]])
    g.log_scales[:] = np.log([0.5, 0.1, 0.02])
    half = np.sqrt(0.5)
    g.quats[1] = [0, 0, half, half]  # a quarter turn about z
    field = make_field(g, FieldSettings(search_radius=1.0, blend="sum", k=1))
    (along_x, along_y), _ = ask(field, np.array([[0.3, 0, 0], [0, 0.3, 0]]), np.array([UP, UP]))
    falloff = (1 - 0.3**2) ** 2
    long, short = falloff * np.exp(-0.5 * 0.36), falloff * np.exp(-0.5 * 9)
    np.testing.assert_allclose(along_x, [long, short, 0], atol=1e-5)
    np.testing.assert_allclose(along_y, [short, long, 0], atol=1e-5)


def test_weight_at_the_centre_and_at_the_edge():
    rows = tuple(mi.Vector3f(*(4.0 * (i == k) for i in range(3))) for k in range(3))
    d = mi.Vector3f([0.0, 0.25, 0.5, 0.7], 0.0, 0.0)
    weight = np.array(blend_weight(d, rows, mi.Float(0.25)))
    middle = (1 - 0.25) ** 2 * (np.exp(-0.5) + 1e-6)
    np.testing.assert_allclose(weight, [1 + 1e-6, middle, 0, 0], rtol=1e-5)


# --- limits -----------------------------------------------------------------------------------


def test_fewer_gaussians_than_k():
    g = flat_gaussians([[0, 0.5, 0], [0.2, 0.5, 0]], [[1, 2, 3], [3, 2, 1]])
    settings = FieldSettings(search_radius=0.1, k=5)
    x, n = np.array([[0.1, 0.5, 0.0], [-1, 2, 0.7]]), np.array([UP, UP])
    value, reach = ask(make_field(g, settings), x, n)
    expected, expected_reach = plain_query(g, settings, x, n)
    np.testing.assert_allclose(value, expected, rtol=1e-4)
    np.testing.assert_allclose(value[0], [2, 2, 2], rtol=1e-4)  # half way between the two
    np.testing.assert_allclose(reach, expected_reach, rtol=1e-5)


def test_the_nearest_answers_up_to_the_largest_reach_and_beyond_it_is_black():
    g = flat_gaussians([[0, 0.5, 0], [1, 0.5, 0.0]], [[1, 2, 3], [9, 9, 9]], size=0.01)
    distance = LARGEST_REACH * 0.1 * np.array([0.3, 0.99, 1.01, 3])
    x = np.stack([-distance, np.full(4, 0.5), np.zeros(4)], axis=1)
    value, reach = ask(make_field(g, FieldSettings(search_radius=0.1, k=1)), x, np.array([UP] * 4))
    np.testing.assert_allclose(value, [[1, 2, 3], [1, 2, 3], [0, 0, 0], [0, 0, 0]], rtol=1e-5)
    np.testing.assert_allclose(reach, [*distance[:2] / 0.1, np.inf, np.inf], rtol=1e-5)


def test_too_narrow_gaussians_give_their_mean_and_never_black():
    colours = [[1, 2, 3], [2, 4, 1], [4, 1, 2]]
    g = flat_gaussians([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], colours, size=1e-3)
    value, reach = ask(
        make_field(g, FieldSettings(search_radius=0.25, k=3)), np.array([[0.6, 0.6, 0]]), [UP]
    )
    assert (value[0] > np.min(colours, axis=0)).all() and (value[0] < np.max(colours, axis=0)).all()
    assert reach[0] == pytest.approx(np.hypot(0.6, 0.6) / 0.25, rel=1e-4)


@pytest.mark.parametrize(
    ("settings", "normal"),
    [
        (FieldSettings(search_radius=0.1, neighbours="radius"), UP),
        (FieldSettings(search_radius=0.1, neighbours="both"), -UP),
        (FieldSettings(search_radius=0.1, neighbours="knn"), -UP),
    ],
)
def test_where_nothing_is_known_the_reach_is_infinite(settings, normal):
    g = flat_gaussians([[0, 0.5, 0]], [[1, 2, 3]])
    value, reach = ask(make_field(g, settings), np.array([[0, 0.9, 0.0]]), np.array([normal]))
    assert (value == 0).all() and np.isinf(reach).all()


def test_the_other_side_of_a_wall_does_not_count():
    g = flat_gaussians([[0, 0.5, 0.001], [0, 0.5, -0.001]], [[1, 0, 0], [0, 1, 0]])
    g.normals[1] = -UP
    x = np.tile([0, 0.5, 0.0], (2, 1))
    sides = np.array([UP, -UP])
    value, _ = ask(make_field(g, FieldSettings(search_radius=0.1, k=1)), x, sides)
    np.testing.assert_allclose(value, [[1, 0, 0], [0, 1, 0]], atol=1e-6)
    value, _ = ask(
        make_field(g, FieldSettings(search_radius=0.1, k=1, normal_test=False)), x, sides
    )
    np.testing.assert_allclose(value, [[0.5, 0.5, 0], [0.5, 0.5, 0]], atol=1e-4)


def test_a_lamp_in_front_of_a_wall_does_not_leak_onto_it():
    """The back of the lamp has the wall's normal, and a thousand times its light."""
    radius = 0.1
    g = flat_gaussians([[0, 0.5, 0], [0, 0.5, 0.4 * radius]], [[1, 1, 1], [1000, 1000, 1000]])
    g.log_scales[:] = np.log(0.6 * radius)
    x = np.array([[0.3 * radius, 0.5, 0], [0, 0.5, 0.4 * radius]])
    value, _ = ask(make_field(g, FieldSettings(search_radius=radius, k=1)), x, np.tile(UP, (2, 1)))
    np.testing.assert_allclose(value[:, 0], [1, 1000], rtol=1e-5)


def test_a_copy_with_the_arrays_of_another_field_answers_like_it():
    """Of the error, too: a recorded function takes all of them as arguments."""
    rng = np.random.default_rng(4)
    settings = FieldSettings(search_radius=0.5, k=3)
    first, other = (
        make_field(random_gaussians(rng, 80), settings, error=rng.uniform(0.1, 1, 80))
        for _ in range(2)
    )
    x, n = from_numpy(mi.Point3f, rng.uniform(LOWER, UPPER, (60, 3))), mi.Normal3f(0, 0, 1)
    copy = first.with_arrays(other.arrays())
    for part in ("whole", "error"):
        fields = (f if part == "whole" else f.part(part) for f in (copy, other, first))
        ours, theirs, before = (np.array(f.query(x, n, mi.Bool(True))[0]) for f in fields)
        np.testing.assert_array_equal(ours, theirs)
        assert np.abs(ours - before).max() > 0.1


def test_inactive_lanes_get_nothing():
    g = flat_gaussians([[0, 0.5, 0]], [[1, 2, 3]])
    x = np.tile([0, 0.5, 0.0], (3, 1))
    active = mi.Bool([True, False, True])
    value, reach = ask(
        make_field(g, FieldSettings(search_radius=0.1)), x, np.tile(UP, (3, 1)), active
    )
    np.testing.assert_allclose(value, [[1, 2, 3], [0, 0, 0], [1, 2, 3]], rtol=1e-5)
    assert np.isfinite(reach).tolist() == [True, False, True]


def test_a_moved_gaussian_is_found_at_its_new_place():
    g = flat_gaussians([[0, 0.5, 0]], [[1, 2, 3]])
    field = make_field(g, FieldSettings(search_radius=0.1, neighbours="radius"))
    there = mi.Point3f(1.5, 1.5, 0.25)
    field.update(replace(field.gaussians, means=there))
    value, _ = ask(field, np.array([[1.5, 1.45, 0.25], [0, 0.5, 0]]), np.array([UP, UP]))
    assert (value[0] > 0).all() and (value[1] == 0).all()


# --- radiance ---------------------------------------------------------------------------------


@pytest.mark.parametrize("stores", ["irradiance", "radiance"])
def test_radiance_of_visible_points(stores):
    g = flat_gaussians([[0, 0.5, 0]], [[1, 2, 3]])
    field = make_field(g, FieldSettings(search_radius=0.1, stores=stores))
    points = VisiblePoints(
        p=mi.Point3f([0.0, 0.0], 0.5, 0.0),
        n=mi.Normal3f([0.0, 0.0], 0.0, 1.0),
        reflectance=mi.Color3f(0.5, 0.25, 0.125),
        throughput=mi.Color3f(0.5, 1, 0.75),
        emission=mi.Color3f(0.125, 0.25, 7),
        depth=mi.UInt32(0),
        valid=mi.Bool([True, False]),
    )
    radiance = field.reflect(points, field.query(points.p, points.n, points.valid)[0])
    reflected = np.array([0.5, 2, 2.25])  # β E
    if stores == "irradiance":
        reflected *= np.array([0.5, 0.25, 0.125]) / np.pi
    emission = np.array([0.125, 0.25, 7])
    np.testing.assert_allclose(np.array(radiance).T, [emission + reflected, emission], rtol=1e-5)


def test_light_that_training_made_negative_is_black():
    """As a black spot it would take light away from what is seen behind glass."""
    g = flat_gaussians([[0, 0.5, 0]], [[-1, 2, -3]])
    field = make_field(g, FieldSettings(search_radius=0.1))
    points = VisiblePoints(
        p=mi.Point3f(0, 0.5, 0),
        n=mi.Normal3f(0, 0, 1),
        reflectance=mi.Color3f(np.pi),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0.25),
        depth=mi.UInt32(0),
        valid=mi.Bool(True),
    )
    radiance = field.reflect(points, field.query(points.p, points.n, points.valid)[0])
    np.testing.assert_allclose(np.array(radiance).ravel(), [0.25, 2.25, 0.25], rtol=1e-5)


# --- seams ------------------------------------------------------------------------------------

STEPS = 4000


def line(start, end):
    t = np.linspace(0, 1, STEPS)[:, None]
    return (1 - t) * np.asarray(start, float) + t * np.asarray(end, float)


def jumps(values: np.ndarray) -> float:
    """The largest change from one point to the next, over the range of values."""
    return np.abs(np.diff(values, axis=0)).max() / np.ptp(values, axis=0).max()


def test_no_seams_where_gaussians_enter_and_leave_the_ball():
    rng = np.random.default_rng(2)
    means = np.column_stack(
        [rng.uniform(-1, 2, 400), rng.uniform(0, 2, 400), rng.normal(0, 0.01, 400)]
    )
    # Wide ones: without the falloff each would come and go with a fifth of its peak or more.
    g = flat_gaussians(means, rng.uniform(0, 3, (400, 3)), size=0.2)
    settings = FieldSettings(search_radius=0.35, k=1)
    x, n = line([-0.5, 0.4, 0], [1.5, 1.5, 0]), np.tile(UP, (STEPS, 1))
    sets = [frozenset(neighbours_of(g, settings, point, UP)[0]) for point in x]
    assert len(set(sets)) > 100 and min(map(len, sets)) > 3
    value, _ = ask(make_field(g, settings), x, n)
    assert jumps(value) < 0.005
    hard = np.array(
        [
            weights_of(g, indices, 1e9, point)
            @ g.irradiance[indices]
            / weights_of(g, indices, 1e9, point).sum()
            for point in x
            for indices, _ in [neighbours_of(g, settings, point, UP)]
        ]
    )
    assert jumps(hard) > 0.02  # the line is one on which a hard edge would show


def test_no_seams_between_the_ball_and_the_supplement():
    rng = np.random.default_rng(2)
    means = np.column_stack([rng.uniform(-1, 2, 200), rng.uniform(0, 2, 200), np.zeros(200)])
    g = flat_gaussians(means, rng.uniform(0, 3, (200, 3)), size=0.1)
    x, n = line([-0.5, 0.4, 0], [1.5, 1.5, 0]), np.tile(UP, (STEPS, 1))
    value, reach = ask(make_field(g, FieldSettings(search_radius=0.2, k=3)), x, n)
    crossings = np.count_nonzero(np.diff(reach > 1))
    assert crossings > 5  # in and out of regions with too few Gaussians
    assert jumps(value) < 0.05
