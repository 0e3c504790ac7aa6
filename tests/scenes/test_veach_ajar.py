"""What holds of Veach Ajar alone: its teapots, its door ajar, its textures and its floor."""

import importlib.util
from collections import Counter
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy
from gpf.scene.load import load_scene
from scenes.modelling.teapot import body_field

SCENES = Path(__file__).parents[2] / "scenes"
TABLE = 0.6506  # height of its top


@pytest.fixture(scope="module")
def scene(root):
    return load_scene("veach_ajar", 8, 6, root)


@pytest.fixture(scope="module")
def builder():
    spec = importlib.util.spec_from_file_location("ajar", SCENES / "veach_ajar" / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shape(scene, name):
    return next(shape for shape in scene.shapes() if shape.id() == name)


def arrays(mesh):
    """Points (N, 3) and faces (M, 3) in the scene, points that lie in one place being one."""
    values = mi.traverse(mesh)
    points = np.array(values["vertex_positions"], dtype=float).reshape(-1, 3)
    faces = np.array(values["faces"]).astype(int).reshape(-1, 3)
    merged, index = np.unique(points, axis=0, return_inverse=True)
    return merged, index.reshape(-1)[faces]


def hit(scene, origin, target):
    """The first surface on the way from ``origin`` to ``target``, and the target's distance."""
    start, end = (from_numpy(mi.Point3f, np.atleast_2d(p)) for p in (origin, target))
    return scene.ray_intersect(mi.Ray3f(start, dr.normalize(end - start))), dr.norm(end - start)


def reflectance(scene, origin, target):
    """Diffuse reflectance of what is seen from ``origin`` towards ``target``, (N, 3)."""
    si, _ = hit(scene, origin, target)
    return np.array(si.bsdf().eval_diffuse_reflectance(si)).T


def spread(count):
    """Evenly spread points of the unit square, (N,) twice."""
    return (np.arange(count) + 0.5) / count, np.arange(count) * 0.618 % 1


@pytest.mark.parametrize(("name", "tunnels"), [("glass-pot", 2), ("glass-lid", 0)])
def test_glass_is_one_closed_surface_that_faces_outwards(scene, name, tunnels):
    points, faces = arrays(shape(scene, name))
    edges = Counter((int(f[i]), int(f[(i + 1) % 3])) for f in faces for i in range(3))
    assert max(edges.values()) == 1  # consistently oriented
    assert all(edge[::-1] in edges for edge in edges)  # closed
    a, b, c = (points[faces[:, i]] for i in range(3))
    volume = np.einsum("ij,ij->i", a - a[0], np.cross(b - a[0], c - a[0])).sum() / 6
    assert volume > 0
    # V - E + F = 2 - 2g: one tunnel through the handle, one through spout and mouth.
    assert len(points) - len(edges) // 2 + len(faces) == 2 - 2 * tunnels


def test_normals_of_the_pots_agree_with_their_faces(scene):
    values = mi.traverse(shape(scene, "glass-pot"))
    points, normals = (
        np.array(values[f"vertex_{name}"], dtype=float).reshape(-1, 3)
        for name in ("positions", "normals")
    )
    faces = np.array(values["faces"]).astype(int).reshape(-1, 3)
    a, b, c = (points[faces[:, i]] for i in range(3))
    facing = np.cross(b - a, c - a)
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    cosine = np.einsum("ij,ikj->ik", facing, normals[faces])
    assert cosine.mean(axis=1).min() > 0.3
    assert np.mean(cosine < 0.3) < 1e-4


@pytest.mark.parametrize(
    ("name", "height"), [("metal", 0.0005), ("china", 0.0005), ("glass", 0.0036)]
)
def test_pots_stand_just_above_the_table(scene, name, height):
    body, _ = arrays(shape(scene, f"{name}-pot"))
    assert body[:, 1].min() - TABLE == pytest.approx(height, abs=0.0002)


def test_lids_touch_no_pot(scene):
    lid, _ = arrays(shape(scene, "glass-lid"))
    local = (lid - [-1.95645, 0.651268, -3.57687]) / 0.0891049
    assert 0.005 < body_field(*local.T).min() < 0.03


def test_pots_are_hollow(scene):
    # Level through the axis of the glass: four walls, not two.
    si, count = None, 0
    ray = mi.Ray3f(mi.Point3f(-0.9, 0.85, -3.57687), mi.Vector3f(-1, 0, 0))
    for _ in range(8):
        si = scene.ray_intersect(ray)
        if si.shape[0].id() != "glass-pot":
            break
        count += 1
        ray = si.spawn_ray(ray.d)
    assert count == 4


def test_door_lets_light_by_at_its_edge_alone(scene):
    u, v = spread(4000)
    lamp = np.stack([-5.16 + 1.44 * u, 0.2 + 2.6 * v, np.full(4000, -4.445)], axis=1)
    # On the wall to the right of the door there is a strip that sees most of the lamp.
    si, distance = hit(scene, lamp, np.broadcast_to([-1.1, 1.5, -7.59], lamp.shape))
    assert np.mean(np.array(si.t > 0.999 * distance)) > 0.7
    # The table sees nothing of it.
    table = np.stack([-2.7 + 1.9 * v, np.full(4000, TABLE + 0.001), -4.2 + 3.1 * u], axis=1)
    si, distance = hit(scene, lamp[np.arange(4000) * 1597 % 4000], table)
    assert not np.any(np.array(si.t > 0.999 * distance))


def test_doorway_is_open_and_the_rest_of_the_wall_is_not(scene):
    for height, depth, blocked in ((1.4, -5.63, False), (2.85, -5.63, True), (1.4, -4.0, True)):
        # along x, from the lamp's room to the back of the door, which stands behind the doorway
        si, _ = hit(scene, [-4, height, depth], [4, height, depth])
        x = float(si.p.x[0])
        assert (x < -2.8) == blocked


def test_door_turns_about_its_hinges(scene):
    points, _ = arrays(shape(scene, "door"))
    assert np.ptp(points[:, 1]) == pytest.approx(2.781, abs=0.001)
    near, far = points[:, 2].argmax(), points[:, 2].argmin()
    swing = np.degrees(np.arctan2(*(points[far] - points[near])[[0, 2]] * [1, -1]))
    assert swing == pytest.approx(17, abs=2)
    assert points[points[:, 0] > -2.32, 2].max() < -6.1  # the free edge is far from the hinges
    pins, _ = arrays(shape(scene, "hinges"))
    assert np.abs(pins[:, [0, 2]] - points[near, [0, 2]]).max() < 0.06


def test_textures_have_the_means_that_the_builder_states(scene, builder):
    u, v = spread(4000)
    # Points of the door's two sides, from where it turns about: 0.03 in front of and behind it.
    along, out = np.array([0.2921, 0, -0.9564]), np.array([0.9564, 0, 0.2921])
    front = np.array([-2.768, 0, -4.674]) + 1.55 * u[:, None] * along
    front[:, 1] = 0.01 + 2.74 * v
    seen = reflectance(scene, front + 0.03 * out, front)
    assert seen[seen.max(axis=1) > 0].mean(axis=0) == pytest.approx(builder.DOOR_FRONT, rel=0.03)
    back = front - 0.0524 * out
    inside = back[u > 0.4]  # nearer to the hinges the door stands in its frame
    seen = reflectance(scene, inside - 0.03 * out, inside)
    assert seen.mean(axis=0) == pytest.approx(builder.DOOR_BACK, rel=0.15)

    top = np.stack([-2.75 + 1.98 * u, np.full(4000, TABLE), -4.23 + 3.18 * v], axis=1)
    bare = np.min(np.abs(top[:, 2:] - [-1.77687, -2.67687, -3.57687]), axis=1) > 0.42
    seen = reflectance(scene, top[bare] + [0, 0.001, 0], top[bare])
    assert seen.mean(axis=0) == pytest.approx(builder.TABLE, rel=0.03)


def test_picture_hangs_upright(scene):
    u, _ = spread(200)
    across = np.stack([np.zeros(200), np.full(200, 2.2), -3.5 + 1.7 * u], axis=1)
    sky, meadow = (
        reflectance(scene, across, np.add(across, [-2.798, height, 0])).mean(axis=0)
        for height in (0.44, -0.36)
    )
    assert sky[2] > 4 * meadow[2]
    assert meadow[1] > 2 * meadow[2]


def test_floor_is_a_checkerboard_of_metal(scene):
    cell = np.array([10.26 / 23.94312, 8.2 / 18.50968]) / 2
    start = np.array([2.0, -3.0])

    def weight(i, j):
        x, z = start + cell * [i, j]
        si, _ = hit(scene, [x, 1, z], [x, 0, z])
        _, value = si.bsdf().sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.3, 0.6))
        return float(value[1][0])

    assert max(weight(1, 0), weight(0, 0)) == pytest.approx(4 * min(weight(1, 0), weight(0, 0)))
    assert weight(1, 0) == pytest.approx(weight(0, 1))
    assert weight(1, 1) == pytest.approx(weight(0, 0))
