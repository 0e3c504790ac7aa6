"""The pool: closed water, equal tiles, a sun that wastes few photons, a net of light."""

from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.core.structs import from_numpy
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.load import load_scene

NAME = "water_caustic_2"
SOURCE = Path(__file__).parents[2] / "scenes" / NAME
LEVEL, TROUGH, FLOOR, HALF_X, HALF_Z, TILE = -0.13, -0.158, -1.1, 1.5, 1.3, 0.1


@pytest.fixture(scope="module")
def scene(root):
    return load_scene(NAME, 8, 6, root)


def shape(scene, name):
    return next(s for s in scene.shapes() if s.id() == name)


def on(scene, si, name) -> np.ndarray:
    return np.array(si.shape == mi.ShapePtr(shape(scene, name)))


def under_water(count, seed):
    """Points anywhere in the basin below the lowest trough, and a sampler for more."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    depth, width, length = (sampler.next_1d() for _ in range(3))
    point = mi.Point3f(
        HALF_X * (2 * width - 1), FLOOR + (TROUGH - FLOOR) * depth, HALF_Z * (2 * length - 1)
    )
    return point * 0.9999, sampler


def test_the_sun_reaches_the_water_through_its_surface_alone(scene):
    point, _ = under_water(400_000, seed=3)
    sun = next(e for e in scene.emitters() if e.class_name() == "Projector")
    origin = mi.Point3f(mi.traverse(sun)["to_world"].translation())
    si = scene.ray_intersect(mi.Ray3f(origin, dr.normalize(point - origin)))
    water = on(scene, si, "water-surface")
    assert water.mean() > 0.7
    assert np.array(si.n.y)[water].min() > 0  # outwards: int_ior holds below
    # What does not enter the water ends above it.
    dry = water | on(scene, si, "coping") | on(scene, si, "deck") | on(scene, si, "block")
    assert dry.all()


def test_the_water_is_closed(scene):
    point, sampler = under_water(400_000, seed=4)
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si = scene.ray_intersect(mi.Ray3f(point, direction))
    water, walls = on(scene, si, "water-surface"), on(scene, si, "basin-walls")
    wet = water | walls
    for name in ("basin-floor", "steps", "step-edges", "ball"):
        wet |= on(scene, si, name)
    assert wet.all()
    assert (np.array(dr.dot(si.n, direction))[water] > 0).all()
    # A wall is met below the waterline only.
    assert np.array(si.p.y)[walls].max() < -0.1


def test_the_water_reaches_into_the_walls(scene):
    box = shape(scene, "water-surface").bbox()
    assert (float(box.max.x), float(box.min.x)) == pytest.approx((1.501, -1.501), abs=1e-5)
    assert (float(box.max.z), float(box.min.z)) == pytest.approx((1.301, -1.301), abs=1e-5)
    assert TROUGH < box.min.y < LEVEL < box.max.y < -0.1
    assert box.min.y > -0.3  # where the uppermost step is
    assert shape(scene, "water-surface").face_count() < 150_000


@pytest.mark.parametrize(
    ("name", "image", "tiles"),
    [
        ("basin-walls", "wall", (20, 11)),
        ("basin-floor", "floor", (30, 26)),
        ("steps", "tiles", (20, 20)),
    ],
)
def test_tiles_have_one_size_everywhere(scene, root, name, image, tiles):
    mesh = mi.traverse(shape(scene, name))
    p, uv = (np.array(mesh[f"vertex_{k}"]) for k in ("positions", "texcoords"))
    faces = np.array(mesh["faces"]).reshape(-1, 3)
    p, uv = p.reshape(-1, 3)[faces], uv.reshape(-1, 2)[faces] * tiles
    flat = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) > 1e-7
    p, uv = p[flat], uv[flat]
    # Along each edge: a length in the world for a length in tiles.
    for a, b in ((0, 1), (1, 2), (2, 0)):
        lengths = np.linalg.norm(p[:, a] - p[:, b], axis=1)
        counted = np.linalg.norm(uv[:, a] - uv[:, b], axis=1)
        np.testing.assert_allclose(lengths, TILE * counted, rtol=1e-3)
    with Image.open(root / NAME / f"textures/{image}.png") as picture:
        assert picture.size == (48 * tiles[0], 48 * tiles[1])


def test_the_mosaic_is_at_the_waterline(scene):
    """A bitmap's v runs downwards: a wall upside down would have its dark band at the floor."""
    y = np.linspace(FLOOR + 0.005, -0.005, 400)
    x = np.linspace(-0.9, 0.9, 50)
    places = np.stack([np.tile(x, 400), np.repeat(y, 50), np.zeros(20_000)], axis=1)
    grid = from_numpy(mi.Point3f, places)
    si = scene.ray_intersect_preliminary(mi.Ray3f(grid, mi.Vector3f(0, 0, -1)))
    si = si.compute_surface_interaction(mi.Ray3f(grid, mi.Vector3f(0, 0, -1)))
    walls = on(scene, si, "basin-walls")
    red = np.array(si.bsdf().eval_diffuse_reflectance(si).x)
    band = np.repeat(y, 50) > -0.3
    assert red[walls & band].mean() < 0.5 * red[walls & ~band].mean()


def test_nothing_reflects_too_much(root):
    for file in sorted((root / NAME / "textures").glob("*.png")):
        with Image.open(file) as picture:
            value = np.asarray(picture) / 255
        assert (((value + 0.055) / 1.055) ** 2.4).max() < 0.85, file.name


def test_the_ball_lies_on_the_floor(scene):
    box = shape(scene, "ball").bbox()
    assert float(box.min.y) == pytest.approx(FLOOR, abs=1e-5)
    assert box.max.y < TROUGH - 0.2


def test_most_photons_are_of_use(scene):
    paths = 60_000
    photons = record_photons(scene, PathSettings(paths, max_depth=3), seed=5)
    depth = np.array(photons.depth)
    x, y, z = np.array(photons.p)
    wet = (abs(x) < HALF_X + 0.01) & (abs(z) < HALF_Z + 0.01) & (y > FLOOR - 0.01) & (y < TROUGH)
    assert not wet[depth == 0].any()
    in_the_air, under_water = (depth == 0).sum() / paths, (wet & (depth == 1)).sum() / paths
    assert under_water > 0.35
    assert in_the_air + under_water > 0.8


def test_the_sky_is_above(scene):
    si = dr.zeros(mi.SurfaceInteraction3f)
    seen = []
    for direction in ([0, 1, 0], [1, 0.05, 0], [0, -1, 0]):
        si.wi = -mi.Vector3f(direction)
        seen.append(np.array(scene.environment().eval(si)).ravel())
    zenith, horizon, nadir = seen
    assert zenith[2] > 2 * zenith[0]  # blue
    assert horizon.sum() > zenith.sum() > 3 * nadir.sum()


def test_the_ripples_focus_light_on_the_floor(scene):
    photons = record_photons(
        scene, PathSettings(400_000, max_depth=3), seed=6
    )  # light, water, floor
    x, y, z, power = (np.array(v) for v in (photons.p.x, photons.p.y, photons.p.z, photons.power.y))
    # A part of the floor that neither steps nor shadows touch, in cells of 0.02.
    area = (y < FLOOR + 1e-4) & (abs(x + 0.2) < 0.4) & (abs(z - 0.6) < 0.3)
    cells, _, _ = np.histogram2d(
        x[area], z[area], bins=(40, 30), range=((-0.6, 0.2), (0.3, 0.9)), weights=power[area]
    )
    counts, _, _ = np.histogram2d(x[area], z[area], bins=(40, 30), range=((-0.6, 0.2), (0.3, 0.9)))
    assert counts.mean() > 5
    bright, typical = np.percentile(cells, (97, 50))
    assert bright > 2.5 * typical
