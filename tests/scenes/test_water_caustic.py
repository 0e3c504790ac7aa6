"""The first water scene: its dimensions, and that its water has no holes."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.scene.load import load_scene


def test_water_has_the_dimensions_of_the_original(root):
    meshes = {s.id(): s for s in load_scene("water_caustic", root=root).shapes()}
    surface, sheet = meshes["water-surface"], meshes["water-sheet"]
    assert surface.face_count() == pytest.approx(100_000, rel=0.01)
    box = surface.bbox()
    assert (float(box.min.y), float(box.max.y)) == pytest.approx((1.326, 1.667), abs=1e-5)
    points = [
        np.array(mi.traverse(mesh)["vertex_positions"]).reshape(-1, 3) for mesh in (surface, sheet)
    ]
    edge = points[0][points[0][:, 2] == 1]
    # the sheet takes the surface's edge over: the same numbers, not close ones
    assert set(map(tuple, edge)) <= set(map(tuple, points[1]))
    assert len(edge) * 2 == len(points[1])
    assert (points[1][:, 2] == 1).all()


def under_water(sampler) -> mi.Point3f:
    return mi.Point3f(
        2 * sampler.next_1d() - 1, 1.32 * sampler.next_1d(), 2 * sampler.next_1d() - 1
    )


def shares_of(si, scene) -> dict[str, float]:
    hit = {s.id(): np.array(si.shape == mi.ShapePtr(s)) for s in scene.shapes()}
    return {name: float(mask.mean()) for name, mask in hit.items() if mask.any()}


def test_light_reaches_the_water_through_its_surface_alone(root):
    scene = load_scene("water_caustic", root=root)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 400_000)
    lamp = mi.Point3f(
        -0.005 + 0.005 * (sampler.next_1d() - 0.5),
        1.9799,
        -0.03 + 0.004 * (sampler.next_1d() - 0.5),
    )
    si = scene.ray_intersect(mi.Ray3f(lamp, dr.normalize(under_water(sampler) - lamp)))
    assert shares_of(si, scene) == {"water-surface": 1.0}
    assert np.array(si.n.y > 0).all()  # outwards: int_ior holds below


def test_water_has_no_holes(root):
    scene = load_scene("water_caustic", root=root)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(4, 400_000)
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si = scene.ray_intersect(mi.Ray3f(under_water(sampler), direction))
    shares = shares_of(si, scene)
    assert np.array(si.is_valid()).all()
    assert "light" not in shares
    assert "ceiling" not in shares
    water = np.array(si.shape == mi.ShapePtr(next(s for s in scene.shapes() if "sheet" in s.id())))
    leaves = np.array(dr.dot(si.n, direction) > 0)
    assert water.any()
    assert leaves[water].all()
