"""What cameras can see, and what photon paths bring there: two rooms with a door between them."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.guiding import guided_emission
from gpf.guiding.guided_emission import Boxes, EmissionGuide
from gpf.guiding.photon_map import collect_photons
from gpf.guiding.pilot import Pilot, trace_pilot
from gpf.guiding.visible_region import VisibleRegion, by_sensor, sample_visible_points
from gpf.photons.emission import EmitterSample, emit_light
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings, PhotonPasses
from tests.guiding.rooms import RIGHT_ROOM, two_rooms
from tests.tiers import tiers

T = mi.ScalarTransform4f


@pytest.fixture(scope="module")
def rooms() -> mi.Scene:
    return two_rooms(gap=0.3)


@pytest.fixture(scope="module")
def region(rooms) -> VisibleRegion:
    return VisibleRegion(rooms, [make_sensor(RIGHT_ROOM, 8, 6)], seed=1, samples=1 << 18)


@pytest.fixture(scope="module")
def pilot(rooms, region) -> Pilot:
    return trace_pilot(rooms, region, PathSettings(280_000), seed=1)


def test_a_camera_in_one_room_does_not_see_the_other(region):
    def sees(p, n):
        return bool(region.contains(mi.Point3f(*p), mi.Normal3f(*n))[0])

    assert sees((1, -1, 0), (0, 1, 0)), "the floor"
    assert sees((2, 0, 0), (-1, 0, 0)), "the wall behind the camera"
    assert sees((0, 0, -0.3), (1, 0, 0)), "this side of the wall"
    assert not sees((0, 0, -0.3), (-1, 0, 0)), "its other side"
    assert not sees((-1.8, -1, -0.8), (0, 1, 0)), "the floor of the other room"
    assert not sees((1, 0.5, 0), (0, 1, 0)), "the air"


def test_selected_photons_are_those_within(rooms, region):
    photons = record_photons(rooms, PathSettings(4000), seed=2)
    kept = region.select(photons)
    inside = np.array(region.contains(photons.p, photons.n))
    assert 0 < inside.sum() < inside.size
    for name in ("p", "n", "power"):
        whole, part = to_numpy(getattr(photons, name)), to_numpy(getattr(kept, name))
        np.testing.assert_array_equal(whole[inside], part)


def test_what_is_seen_in_a_mirror_is_part_of_the_visible_region():
    facing = T().translate([3, 0, 0]).rotate([0, 1, 0], -90)
    behind = T().translate([-3, 0, 0]).rotate([0, 1, 0], 90)
    scene = mi.load_dict(
        {
            "type": "scene",
            "mirror": {"type": "rectangle", "to_world": facing, "bsdf": {"type": "conductor"}},
            # Behind the camera, and to be seen in the mirror alone.
            "board": {"type": "rectangle", "to_world": behind},
        }
    )
    view = View(name="a", origin=(0, 0, 0), target=(1, 0, 0), fov=20)
    region = VisibleRegion(scene, [make_sensor(view, 8, 6)], seed=1, samples=4096)
    assert bool(region.contains(mi.Point3f(-3, 0.1, 0.2), mi.Normal3f(1, 0, 0))[0])


def test_views_of_nothing_diffuse_have_no_visible_region(rooms):
    away = View(name="a", origin=(9, 0, 0), target=(10, 0, 0), fov=20)
    with pytest.raises(UserError, match="training views: see no diffuse surface. Point them"):
        VisibleRegion(rooms, [make_sensor(away, 8, 6)], seed=1, samples=256)


def test_cameras_of_all_kinds_look_together(rooms):
    """Rays of an orthographic camera have one direction, those of others one origin."""
    to_world = T().look_at(RIGHT_ROOM.origin, RIGHT_ROOM.target, (0, 0, 1))
    flat = {"type": "orthographic", "to_world": to_world, "film": {"type": "hdrfilm"}}
    sensors = [make_sensor(RIGHT_ROOM, 8, 6), mi.load_dict(flat), make_sensor(RIGHT_ROOM, 8, 6)]
    points = sample_visible_points(rooms, sensors, 100, seed=1, elsewhere=0)
    parts = by_sensor(points, 3)
    assert dr.width(points.p) == 300
    assert all(dr.width(part.p) == 100 and dr.any(part.valid) for part in parts)


def test_a_pilot_counts_what_the_recorder_finds(rooms, region):
    pilot = trace_pilot(rooms, region, PathSettings(3000), seed=5)
    kept = region.select(record_photons(rooms, PathSettings(3000), seed=5))
    assert pilot.photons.sum() == dr.width(kept.p)
    assert pilot.power.sum() == pytest.approx(to_numpy(kept.power).mean(axis=1).sum(), rel=1e-4)
    everywhere = trace_pilot(rooms, None, PathSettings(3000), seed=5)
    assert (everywhere.photons >= pilot.photons).all() and everywhere.photons_per_path > 2


def test_efficiency_is_one_for_equal_paths_and_one_in_n_for_a_lucky_one(rooms):
    pilot = trace_pilot(rooms, None, PathSettings(100), seed=5)
    equal = type(pilot)(power=np.full(100, 3.0), photons=np.ones(100), seed=0)
    lucky = type(pilot)(power=np.eye(100)[7], photons=np.ones(100), seed=0)
    none = type(pilot)(power=np.zeros(100), photons=np.zeros(100), seed=0)
    assert equal.efficiency == pytest.approx(1)
    assert lucky.efficiency == pytest.approx(0.01)
    assert none.efficiency == 0


@tiers(quick=3 / 8)
def test_guided_emission_brings_the_same_power_with_less_noise(tier):
    paths = tier.samples(400_000)
    least_gain = 1.5 if tier.share == 1 else 1.25  # a guide of fewer paths has larger cells
    rooms = two_rooms(gap=0.1)
    region = VisibleRegion(rooms, [make_sensor(RIGHT_ROOM, 8, 6)], seed=1, samples=1 << 18)
    plain = trace_pilot(rooms, region, PathSettings(paths), seed=1)
    guide = EmissionGuide.learn(rooms, plain)
    guided = trace_pilot(rooms, region, PathSettings(paths, source=guide.emit), seed=2)
    assert guided.efficiency > least_gain * plain.efficiency
    error = np.hypot(*(p.power.std() * np.sqrt(len(p.power)) for p in (plain, guided)))
    assert abs(plain.power.sum() - guided.power.sum()) < 4 * error


def test_a_guide_is_unbiased_whatever_it_has_learned():
    """Also one that is all wrong, with a lamp and a sky to choose from: a furnace test."""
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 0.5}}
    lamp = {"type": "point", "position": [0, 0, 0.7], "intensity": {"type": "rgb", "value": 0.3}}
    scene = mi.load_dict({"type": "scene", "floor": {"type": "disk"}, "sky": sky, "lamp": lamp})
    guide = EmissionGuide(some_boxes())
    plain = trace_pilot(scene, None, PathSettings(4_000_000), seed=1)
    guided = trace_pilot(scene, None, PathSettings(4_000_000, source=guide.emit), seed=2)
    error = np.hypot(*(p.power.std() * np.sqrt(len(p.power)) for p in (plain, guided)))
    assert error < 0.005 * plain.power.sum()
    assert abs(plain.power.sum() - guided.power.sum()) < 4 * error


def test_the_numbers_of_a_guide_are_below_one(monkeypatch):
    """Also the last of the last cell: (15 + .99999994) / 16 is 1 in single precision."""
    seen = []
    monkeypatch.setattr(
        guided_emission, "emit_from", lambda scene, start: (None, seen.append(start) or 1, None)
    )
    last = mi.Float(0.99999994)
    draw = EmitterSample(last, mi.Point2f(last, last), mi.Point2f(last, last))
    monkeypatch.setattr(EmitterSample, "draw", lambda sampler: draw)

    class Sampler:
        def next_1d(self):
            return mi.Float(last)

    edges = np.array([1 / 3, 1 / 4, 1 / 4, 1 / 16, 1 / 16])
    grid = np.stack(np.meshgrid(*(np.arange(0, 1, e) for e in edges), indexing="ij"), axis=-1)
    corner = grid.reshape(-1, 5)
    boxes = Boxes(corner, np.broadcast_to(edges, corner.shape), np.ones(len(corner)))
    EmissionGuide(boxes).emit(None, Sampler())
    for number in seen[0].numbers():
        assert 0.9 < number[0] < 1


def test_with_few_paths_to_learn_from_a_guide_is_coarse(rooms, region, pilot):
    few = [trace_pilot(rooms, region, PathSettings(paths), seed=1) for paths in (100, 20_000)]
    boxes = [len(EmissionGuide.learn(rooms, p).density) for p in (*few, pilot)]
    assert boxes[0] == 1 and 1 < boxes[1] <= 20_000 / 64 and boxes[1] < boxes[2]


def test_a_guide_finds_the_rays_that_matter():
    """A hundredth of the cube brings all light: after two pilots, four rays in ten start there."""
    guide, rng = EmissionGuide(Boxes.whole(2)), np.random.default_rng(0)
    for _ in range(3):
        boxes, density = guide.boxes, guide.density
        chance = density * boxes.volume
        box = rng.choice(len(density), 20_000, p=chance / chance.sum())
        numbers = boxes.corner[box] + boxes.edges[box] * rng.random((len(box), 5))
        hit = (numbers[:, 0] < 0.5) & (np.abs(numbers[:, 1:3] - [0.3, 0.8]) < 0.07).all(axis=1)
        weight = 1 / (len(box) * density[box])
        square = weight * hit
        guide = EmissionGuide(guided_emission._divide(boxes, numbers, box, weight, square))
        # What the paths stand for is the same, however they are spread.
        assert square.sum() == pytest.approx(0.5 * 0.14**2, rel=0.3)
    assert hit.mean() > 0.4


def test_a_guide_that_has_seen_no_power_takes_every_ray(rooms):
    none = Pilot(power=np.zeros(1000), photons=np.zeros(1000, int), seed=1)
    guide = EmissionGuide.learn(rooms, none)
    np.testing.assert_allclose(guide.density, 1, rtol=1e-6)
    np.testing.assert_allclose(EmissionGuide.learn(rooms, none, guide).density, 1, rtol=1e-6)


def some_boxes() -> Boxes:
    """Boxes of many sizes, with random means."""
    rng = np.random.default_rng(0)
    corner, edges = Boxes.whole(2).corner, Boxes.whole(2).edges
    for _ in range(300):
        box, axis = rng.integers(len(corner)), rng.integers(5)
        edges[box, axis] /= 2
        further = corner[box] + edges[box] * (np.arange(5) == axis)
        corner, edges = np.vstack([corner, further]), np.vstack([edges, edges[box]])
    return Boxes(corner, edges, rng.random(len(corner)) ** 16)


@tiers(quick=1 / 4)
def test_a_pass_with_guided_photons_agrees_with_one_without(rooms, pilot, tier):
    guide = EmissionGuide.learn(rooms, pilot)
    points = VisiblePoints(
        p=mi.Point3f([1, 0.5], [-1, -1], [0, -0.5]),
        n=mi.Normal3f([0, 0], [1, 1], [0, 0]),
        reflectance=mi.Color3f(0.6),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0),
        depth=mi.UInt32(0),
        valid=mi.Bool([True, True]),
    )
    settings = PassSettings(photons_per_pass=50_000, initial_radius=0.3, direct="photons")

    def passes(source, seeds):
        return np.array(
            [
                to_numpy(PhotonPasses(rooms, settings, s, source).trace(1).irradiance(points))
                for s in seeds
            ]
        )

    count = tier.samples(64)
    plain, guided = passes(emit_light, range(count)), passes(guide.emit, range(100, 100 + count))
    error = np.sqrt((plain.var(axis=0, ddof=1) + guided.var(axis=0, ddof=1)) / count)
    assert (error < tier.noise(0.03) * plain.mean(axis=0)).all()
    assert (np.abs(plain.mean(axis=0) - guided.mean(axis=0)) < 4 * error).all()


def test_collected_batches_have_the_power_of_all_paths(rooms, region, monkeypatch):
    monkeypatch.setattr("gpf.guiding.photon_map.BATCH", 40_000)

    def collected(paths: int, seeds: range) -> np.ndarray:
        """Number and power of the photons of so many paths, (2,), mean over seeds."""
        each = [collect_photons(rooms, region, PathSettings(paths), seed=s) for s in seeds]
        return np.mean([(dr.width(p.p), to_numpy(p.power).sum()) for p in each], axis=0)

    # Roulette has thinned them, so that the power of each collection varies by 3 %.
    photons, single = collected(60_000, range(3, 9)), collected(40_000, range(10, 16))
    assert photons[0] == pytest.approx(1.5 * single[0], rel=0.05)
    assert photons[1] == pytest.approx(single[1], rel=0.05)


def test_without_a_visible_region_all_photons_are_collected(rooms):
    everything = collect_photons(rooms, None, PathSettings(5000), seed=3)
    assert dr.width(everything.p) > 10_000
