"""Which medium rays are in, and flights and transmittance through it."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.photons.tracing import PathSettings, record_all
from gpf.scene.lamps import Lamps
from gpf.scene.media import Media
from gpf.scene.media_checks import check_media, wrong_boundaries
from gpf.sppm.fixed_points import FixedPoints
from stages.importing.report import describe_media
from tests.foggy import NULL, cloud, fog_box, medium
from tests.furnace import camera, cornell_box, point_light, rgb

COUNT = 200_000


def load(inside, **objects):
    return mi.load_dict(fog_box(inside, **objects))


def rays(origin, direction, count=COUNT):
    """Parallel rays, almost at the same place."""
    near = np.random.default_rng(3).uniform(-1e-3, 1e-3, (count, 3))
    d = np.broadcast_to(np.asarray(direction) / np.linalg.norm(direction), (count, 3))
    return mi.Ray3f(from_numpy(mi.Point3f, near + origin), from_numpy(mi.Vector3f, d))


def test_no_media():
    assert not Media(mi.load_dict(cornell_box())).there


@pytest.mark.parametrize(
    ("origin", "direction", "inside"),
    [
        ((0.7, 0, 0.7), (1, 0, 0), True),
        ((0.7, 0, 0.7), (-1, 0, -1), True),  # behind the ball
        ((0, -5, 0), (0, 1, 0), False),
        ((0, -5, 0), (0, -1, 0), False),
        ((0, 0, 0), (0, 0, 1), True),  # in the ball, which names no medium
    ],
)
def test_the_medium_around_a_place(origin, direction, inside):
    scene = load(medium(1))
    found = Media(scene).around(rays(origin, direction, 3), dr.full(mi.Bool, True, 3))
    own = next(s.interior_medium() for s in scene.shapes() if s.interior_medium() is not None)
    assert dr.all(found == mi.MediumPtr(own if inside else None))


def endless(extinction, lamp=(0, 0, 2)):
    """A ball in a medium without a boundary, and a lamp, by default above it."""
    named = {"medium": {"type": "ref", "id": "air"}}
    parts = {
        "air": medium(extinction) | {"id": "air"},
        "view": camera((0, -5, 0), (0, 0, 0)) | named,
        "light": point_light(lamp, 1) | named,
        "ball": {"type": "sphere"},
    }
    return mi.load_dict({"type": "scene"} | parts)


def test_a_medium_without_a_boundary_is_everywhere():
    scene = endless(0.5)
    found = Media(scene).around(rays((9, 0, 0), (1, 0, 0), 2), dr.full(mi.Bool, True, 2))
    assert dr.all(found == mi.MediumPtr(scene.sensors()[0].get_medium()))


def test_transmittance_is_exponential_in_each_channel():
    media = Media(load(medium([0.5, 1, 2])))
    ray, every = rays((0.7, -0.9, 0.7), (0, 1, 0), 4), dr.full(mi.Bool, True, 4)
    length, random = mi.Float(1.5), mi.Float(0)
    found = media.transmittance(media.around(ray, every), ray, length, random, every)
    expected = np.exp(-1.5 * np.array([0.5, 1, 2]))
    np.testing.assert_allclose(to_numpy(found), np.tile(expected, (4, 1)), rtol=2e-3)


def optical_depth(scene, origin, direction, length, steps=4000):
    """By quadrature."""
    t = (np.arange(steps) + 0.5) / steps * length
    at = np.asarray(origin) + t[:, None] * np.asarray(direction)
    own = next(s.interior_medium() for s in scene.shapes() if s.interior_medium() is not None)
    here = dr.zeros(mi.MediumInteraction3f, steps)
    here.p = from_numpy(mi.Point3f, at)
    every = dr.full(mi.Bool, True, steps)
    found = mi.MediumPtr(own).get_scattering_coefficients(here, every)[2]
    return to_numpy(found).mean(axis=0) * length


@pytest.mark.parametrize("density", [2, 12])
def test_transmittance_of_a_grid_is_right_on_average(density):
    scene = load(cloud(density))
    media, ray = Media(scene), rays((0.6, -0.9, 0.3), (0, 1, 0))
    every = dr.full(mi.Bool, True, COUNT)
    medium, length, random = media.around(ray, every), mi.Float(1.8), mi.Float(0.5)
    found = to_numpy(media.transmittance(medium, ray, length, random, every))
    expected = np.exp(-optical_depth(scene, (0.6, -0.9, 0.3), (0, 1, 0), 1.8))
    error = found.std(axis=0) / COUNT**0.5
    np.testing.assert_allclose(
        found.mean(axis=0), expected, atol=4 * error.max() + 2e-3 * expected[0]
    )


@pytest.mark.parametrize("kind", ["point", "directional"])
def test_samples_through_a_grid_are_independent_where_the_ray_is_always_the_same(kind):
    """At a fixed point, towards a lamp without a size."""
    lamp = {
        "point": point_light((0.6, 0.1, 2.8), 16),
        "directional": {"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(1)},
    }
    scene, below = load(cloud(3), lamp=lamp[kind]), (0.6, 0.1, -1.2)
    points = dr.zeros(VisiblePoints, 1000)
    points.p += mi.Point3f(*below)
    points.n = mi.Normal3f(0, 0, 1)
    fixed = FixedPoints(scene, points)
    one, many = (fixed.mean_direct(Lamps(scene), samples, seed=7)[:, 0] for samples in (1, 64))
    expected = np.exp(-optical_depth(scene, (0.6, 0.1, -1), (0, 0, 1), 2)[0])
    assert 0 < many.std() < 0.15 * one.std()
    assert many.mean() == pytest.approx(expected, abs=float(many.std()) / 8)


def test_thin_fog_without_walls_leaves_few_photons():
    _, floating = record_all(endless([1, 1, 1e-6]), PathSettings(1000), seed=1)
    assert 1e4 < dr.width(floating.p) < 5e4
    assert np.abs(to_numpy(floating.p)).max() < 300


def test_fog_around_a_far_lamp_has_photons():
    _, floating = record_all(endless([0.1] * 3, (0, 0, 300)), PathSettings(1000), seed=1)
    assert (np.linalg.norm(to_numpy(floating.p) - [0, 0, 300], axis=1) < 30).sum() > 1000


@pytest.mark.parametrize(
    ("inside", "extinction", "length"),
    [
        ("gray", [1, 1, 1], 1.5),
        ("colour", [0.3, 1, 3], 1.5),
        ("endless", [0.3, 0.05, 3], 60),
        ("grid", None, 1.5),
    ],
)
def test_flights(inside, extinction, length):
    """The visits' weights add up to the integral of the transmittance, and the weights of the
    collisions, divided by the albedo, to what the transmittance lacks."""
    makes = {"endless": endless, "grid": lambda _: load(cloud(2))}
    scene = makes.get(inside, lambda each: load(medium(each)))(extinction)
    start = (2, -30, 0) if inside == "endless" else (0.6, -0.9, 0.3)
    media, ray = Media(scene), rays(start, (0, 1, 0))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, COUNT)
    every, total = dr.full(mi.Bool, True, COUNT), dr.zeros(mi.Color3f, 1)
    dr.make_opaque(total)

    def visit(place, weight, active):
        for k in range(3):
            dr.scatter_reduce(dr.ReduceOp.Add, total[k], weight[k], mi.UInt32(0), active)

    channel = mi.UInt32(3 * sampler.next_1d())
    flight = media.fly(
        media.around(ray, every),
        ray,
        mi.Float(length),
        channel,
        mi.Color3f(1),
        sampler,
        every,
        visit,
    )
    lost = to_numpy(dr.select(flight.scatters, flight.weight, 0)).mean(axis=0) / 0.9
    passed = to_numpy(dr.select(flight.scatters, 0, flight.weight)).mean(axis=0)
    if inside == "grid":
        through = np.exp(-optical_depth(scene, (0.6, -0.9, 0.3), (0, 1, 0), 1.5))
        lengths = np.linspace(1.5 / 60, 1.5, 60)
        within = [np.exp(-optical_depth(scene, (0.6, -0.9, 0.3), (0, 1, 0), t)) for t in lengths]
        integral = (np.mean(within, axis=0) + (1 - through) / 120) * 1.5
    else:
        extinction = np.array(extinction)
        through = np.exp(-length * extinction)
        integral = (1 - through) / extinction
    np.testing.assert_allclose(passed, through, atol=0.01)
    np.testing.assert_allclose(lost, 1 - through, atol=0.01)
    np.testing.assert_allclose(to_numpy(total)[0] / COUNT, integral, rtol=0.01)


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        (medium(1) | {"albedo": 1.2}, "1.2 in the albedo of the medium interior"),
        (medium(1) | {"scale": -2.0}, "-2 in the density"),
        (medium(1) | {"scale": float("nan")}, "NaN or infinite values in the density"),
        (medium(1) | {"id": "milk", "sigma_t": -1.0}, "the medium milk"),
    ],
)
def test_impossible_coefficients(inside, words):
    with pytest.raises(UserError, match=words):
        check_media(load(inside))


def test_media_that_do_not_fit_together():
    """A ball of glass in fog whose outside is not named, and one whose is."""
    glass = {"type": "sphere", "radius": 0.4, "bsdf": {"type": "dielectric"}}
    inner = glass | {"interior": medium(3)}
    scene = load(medium(1), ball=inner)
    with pytest.raises(UserError, match="do not fit together"):
        check_media(scene)
    fog = medium(1) | {"id": "fog"}
    named = {"type": "ref", "id": "fog"}
    box = {"type": "cube", "bsdf": NULL, "interior": named}
    fitting = mi.load_dict(
        {"type": "scene", "fog": fog}
        | {
            k: v
            for k, v in fog_box(medium(1), ball=inner | {"exterior": named}).items()
            if k != "type"
        }
        | {"box": box}
    )
    assert wrong_boundaries(fitting)[0] == 0
    check_media(fitting)


def test_a_description():
    assert describe_media(load(cloud(1))) == "participating medium: 1 grid"
    two = load(
        medium(1), more={"type": "sphere", "center": [3, 0, 0], "bsdf": NULL, "interior": medium(2)}
    )
    assert describe_media(two) == "participating media: 2 homogeneous"
    assert describe_media(mi.load_dict(cornell_box())) == ""


def test_media_in_instances():
    scene = fog_box(medium(1))
    box = scene.pop("box")
    scene["group"] = {"type": "shapegroup", "box": box}
    scene["copy"] = {"type": "instance", "group": {"type": "ref", "id": "group"}}
    loaded = mi.load_dict(scene, optimize=False)
    media = Media(loaded)
    found = media.around(rays((0.7, 0, 0.7), (1, 0, 0), 3), dr.full(mi.Bool, True, 3))
    assert media.there and dr.all(found == mi.MediumPtr(media.every[0]))
    check_media(loaded)
