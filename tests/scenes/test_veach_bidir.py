"""What holds of Veach Bidir alone: its egg, its tube, its lamp and its open side."""

from collections import Counter
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.scene.folders import load_views
from gpf.scene.load import load_scene
from gpf.scene.sensors import make_sensor

SCENES = Path(__file__).parents[2] / "scenes"


@pytest.fixture(scope="module")
def scene(root):
    return load_scene("veach_bidir", 8, 6, root)


def shape(scene, name):
    return next(shape for shape in scene.shapes() if shape.id() == name)


def arrays(mesh):
    """Points (N, 3), faces (M, 3), unit normals of the faces (M, 3)."""
    values = mi.traverse(mesh)
    points = np.array(values["vertex_positions"], dtype=float).reshape(-1, 3)
    faces = np.array(values["faces"]).astype(int).reshape(-1, 3)
    a, b, c = (points[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    return points, faces, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def rim(faces):
    """Directed edges whose opposite no face has; none where the mesh is closed."""
    edges = Counter((int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3))
    assert max(edges.values()) == 1  # consistently oriented, and no edge has a third face
    return [edge for edge in edges if edge[::-1] not in edges]


def first_hit(scene, origin, direction):
    """Id of the shape that a ray meets first, or None."""
    unit = np.array(direction, dtype=float) / np.linalg.norm(direction)
    hit = scene.ray_intersect(
        mi.Ray3f(mi.Point3f(list(map(float, origin))), mi.Vector3f(unit.tolist()))
    )
    return hit.shape[0].id() if hit.is_valid()[0] else None


def light(scene, name):
    """Centre, normal and half an edge of a rectangle."""
    matrix = np.array(mi.traverse(shape(scene, name))["to_world"].matrix).reshape(4, 4)
    return matrix[:3, 3], np.cross(matrix[:3, 0], matrix[:3, 1]), np.linalg.norm(matrix[:3, 0])


def test_egg_is_closed_smooth_and_faces_outwards(scene):
    points, faces, face_normals = arrays(shape(scene, "egg"))
    assert rim(faces) == []
    centre = points.mean(axis=0)
    assert (((points[faces].mean(axis=1) - centre) * face_normals).sum(axis=1) > 0).all()
    normals = np.array(mi.traverse(shape(scene, "egg"))["vertex_normals"]).reshape(-1, 3)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1, abs=1e-5)
    # No face is turned from its corners' normals by more than 4 degrees.
    cosines = (normals[faces] * face_normals[:, None]).sum(axis=-1)
    assert cosines.min() > np.cos(np.radians(4))


def test_egg_has_the_measured_size_and_is_clear_of_the_table(scene):
    points, faces, _ = arrays(shape(scene, "egg"))
    a, b, c = (points[faces[:, i]] for i in range(3))
    assert (a * np.cross(b, c)).sum() / 6 == pytest.approx(0.8868, rel=5e-3)
    assert np.ptp(points, axis=0) == pytest.approx([1.056, 1.510, 1.056], abs=2e-3)
    gap = points[:, 1].min() - float(shape(scene, "table-top").bbox().max[1])
    assert 0.005 < gap < 0.01


def test_tube_is_open_at_its_far_end_alone_and_its_light_shines_out(scene):
    centre, normal, half = light(scene, "spot-light")
    points, faces, _ = arrays(shape(scene, "spot-tube"))
    axis = normal / np.linalg.norm(normal)
    edge = rim(faces)
    assert len(edge) == len(set(np.ravel(edge))) == 64  # one loop
    along = (points[np.ravel(edge)] - centre) @ axis
    assert along == pytest.approx(0.94, abs=0.01)
    assert ((points - centre) @ axis).min() == pytest.approx(-0.045, abs=0.005)
    assert half == pytest.approx(0.068, abs=1e-4)
    start = centre + 1e-3 * axis
    assert first_hit(scene, start, axis) not in ("spot-tube", None)
    assert first_hit(scene, centre - 1e-3 * axis, -axis) == "spot-tube"
    assert first_hit(scene, start, np.cross(axis, [1, 0, 0]) + 0.5 * axis) == "spot-tube"


def test_lamp_lights_the_ceiling_from_inside_its_shade(scene):
    centre, normal, _ = light(scene, "lamp-light")
    assert normal / np.linalg.norm(normal) == pytest.approx([0, 1, 0], abs=1e-6)
    start = centre + 1e-3 * normal / np.linalg.norm(normal)
    assert first_hit(scene, start, [0, 1, 0]) == "ceiling"
    for direction in ([1, 0, 0.2], [-1, 0.1, 0], [0.3, 0, -1]):
        assert first_hit(scene, start, direction) == "lamp-shade"


def test_legs_stand_in_the_floor_and_end_in_the_table_top(scene):
    legs, top = (shape(scene, name).bbox() for name in ("table-legs", "table-top"))
    assert legs.min[1] < 0
    assert top.min[1] < legs.max[1] < top.max[1]
    for axis in (0, 2):
        assert top.min[axis] < legs.min[axis] and legs.max[axis] < top.max[axis]


def test_room_is_closed_but_for_the_side_of_the_camera(scene):
    centre = [2.0, 4.0, 0.0]
    found = {
        "left-wall": [0, 0, 1],
        "right-wall": [0, 0, -1],
        "floor": [0, -1, 0],
        "ceiling": [0, 1, 0],
        "back-wall": [-1, 0.5, 0],
        None: [1, 0, 0],
    }
    assert [first_hit(scene, centre, direction) for direction in found.values()] == list(found)


def test_first_view_is_the_camera_of_the_original(scene):
    view = load_views("veach_bidir", SCENES).train[0]
    ours, own = (
        np.array(mi.traverse(sensor)["to_world"].matrix).reshape(4, 4)
        for sensor in (make_sensor(view, 8, 6), scene.sensors()[0])
    )
    assert ours == pytest.approx(own, abs=1e-5)
    assert own[:3, 2] == pytest.approx([-0.99998, -0.00467, -0.00502], abs=1e-4)
    assert own[:3, 3] == pytest.approx([16.2155, 4.05167, 0.01149], abs=1e-4)
