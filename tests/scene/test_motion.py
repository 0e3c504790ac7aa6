"""Points of surfaces in another frame, against where they were put."""

import mitsuba as mi
import numpy as np
import pytest

import gpf  # noqa: F401
from gpf.core.structs import to_numpy
from gpf.scene.motion import Motion

T = mi.ScalarTransform4f
PLANE = '<shape type="rectangle"/>'


def make_scene(angle=0.0, lift=0.0, bend=0.0, cells=4, **more) -> mi.Scene:
    """A floor, a ball that turns and rises, and a sheet that bends."""
    x = np.linspace(-1, 1, cells + 1)
    sheet = mi.Mesh("sheet", (cells + 1) ** 2, 2 * cells**2)
    grid = np.stack(np.meshgrid(x, x, indexing="ij"), -1).reshape(-1, 2)
    params = mi.traverse(sheet)
    params["vertex_positions"] = np.column_stack([grid + 5, bend * np.sin(3 * grid[:, 0])]).ravel()
    k = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    other = cells + 1
    params["faces"] = np.concatenate(
        [np.column_stack(t) for t in ((k, k + other, k + 1), (k + 1, k + other, k + other + 1))]
    ).ravel()
    params.update()
    ball = T().translate([0, 0, 0.5 + lift]).rotate([0, 0, 1], angle).scale(0.3)
    return mi.load_dict(
        {
            "type": "scene",
            "floor": {"type": "rectangle", "to_world": T().scale(2)},
            "ball": {"type": "sphere", "to_world": ball},
            "sheet": sheet,
            **more,
        },
        optimize=False,
    )


def carried(start, end, p, n, reach=0.0):
    motion = Motion(start, end)
    p, n = (np.atleast_2d(v).T for v in (p, n))
    found = motion.carry(mi.Point3f(*p), mi.Normal3f(*n), mi.Float(reach))
    return motion, *(to_numpy(each) for each in found[:2]), np.array(found[2])


def test_what_does_not_move_stays_bit_for_bit():
    p, n = [[0.3, 0.7, 0], [1, 1, 0.0]], [[0, 0, 1], [0, 0, -1.0]]
    motion, q, m, known = carried(make_scene(), make_scene(lift=1), p, n)
    np.testing.assert_array_equal(q, np.float32(p))
    np.testing.assert_array_equal(m, np.float32(n))
    assert known.all() and not motion.still and not motion.lost
    assert Motion(make_scene(), make_scene()).still


def test_a_ball_turns_and_rises():
    n = np.array([[1, 0, 0], [0, 0.6, 0.8]])
    _, q, m, known = carried(make_scene(), make_scene(90, 2), [0, 0, 0.5] + 0.3 * n, n)
    turned = np.array([[0, 1, 0], [-0.6, 0, 0.8]])
    np.testing.assert_allclose(q, [0, 0, 2.5] + 0.3 * turned, atol=1e-5)
    np.testing.assert_allclose(m, turned, atol=1e-5)
    assert known.all()


@pytest.mark.parametrize("side", [1, -1])
def test_a_sheet_bends(side):
    """The corners of triangles follow the sheet, and the normal keeps its side."""
    p, n = [[5, 5, 0], [5.5, 4.5, 0]], [[0, 0, side]] * 2
    _, q, m, known = carried(make_scene(), make_scene(bend=0.2), p, n)
    height = 0.2 * np.sin(3 * (np.array(p)[:, 0] - 5))
    np.testing.assert_allclose(q, np.column_stack([np.array(p)[:, :2], height]), atol=1e-5)
    assert (side * m[:, 2] > 0.5).all() and (np.abs(m[:, 0]) > 0.1).all()
    np.testing.assert_allclose(np.linalg.norm(m, axis=1), 1, atol=1e-5)
    assert known.all()


def test_places_that_have_no_counterpart():
    start = make_scene()
    motion, q, _, known = carried(
        start, make_scene(cells=5), [[5, 5, 0], [0, 0, 0]], [[0, 0, 1]] * 2
    )
    assert motion.lost == ["sheet"]
    assert known.tolist() == [False, True]
    np.testing.assert_array_equal(q, np.float32([[5, 5, 0], [0, 0, 0]]))


def test_a_shape_that_comes_and_goes():
    """The others keep their counterparts by their ids, though their places change."""
    whole = make_scene(bend=0.2)
    less = mi.load_dict({"type": "scene", "sheet": whole.shapes()[2]}, optimize=False)
    assert [shape.id() for shape in less.shapes()] == ["sheet"]
    motion, q, _, known = carried(make_scene(), less, [[5.5, 5, 0], [0, 0, 0]], [[0, 0, 1]] * 2)
    assert motion.lost == ["floor", "ball"] and known.tolist() == [True, False]
    np.testing.assert_allclose(q[0], [5.5, 5, 0.2 * np.sin(1.5)], atol=1e-5)
    motion, q, _, known = carried(less, make_scene(), q[:1], [[0, 0, 1]])
    assert not motion.lost and known.all()
    np.testing.assert_allclose(q, [[5.5, 5, 0]], atol=1e-5)


def test_without_ids_shapes_have_an_order():
    """As many of them, or none corresponds."""
    one, two = (
        mi.load_string(f'<scene version="3.0.0">{n * PLANE}</scene>', optimize=False)
        for n in (1, 2)
    )
    assert Motion(two, two).still and len(Motion(two, one).lost) == 2


def test_what_is_above_a_surface_moves_with_it():
    """Within its reach; farther away, it stays."""
    start, end, p = make_scene(), make_scene(lift=1, bend=0.2), [[0, 0, 0.9], [5.5, 5, 0.05]]
    up = [[0, 0, 1]] * 2
    _, q, _, known = carried(start, end, p, up, 0.2)
    np.testing.assert_allclose(q, [[0, 0, 1.9], [5.5, 5, 0.05 + 0.2 * np.sin(1.5)]], atol=1e-5)
    assert known.all()
    _, q, _, known = carried(start, end, p, up, 0.02)
    np.testing.assert_array_equal(q, np.float32(p))
    assert known.all()


def test_many_points_at_once():
    rng = np.random.default_rng(1)
    n = rng.normal(size=(1000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    _, q, _, known = carried(make_scene(), make_scene(lift=1), [0, 0, 0.5] + 0.3 * n, n)
    np.testing.assert_allclose(q, [0, 0, 1.5] + 0.3 * n, atol=1e-5)
    assert known.all() and known.shape == (1000,)


def test_the_nearest_surface_carries():
    """A place on the floor stays there, though a plate above it rises."""

    def scene(height):
        plate = {"type": "rectangle", "to_world": T().translate([1, 1, height]).scale(0.2)}
        return make_scene(plate=plate)

    _, q, _, known = carried(
        scene(0.02), scene(0.5), [[1, 1, 0], [1, 1, 0.018]], [[0, 0, 1]] * 2, 0.03
    )
    np.testing.assert_allclose(q, [[1, 1, 0], [1, 1, 0.498]], atol=1e-5)
    assert known.all()


def test_normals_of_stretched_shapes():
    def scene(turn, stretch):
        tilted = T().scale([1, 1, stretch]).rotate([1, 0, 0], turn)
        return mi.load_dict(
            {"type": "scene", "plate": {"type": "rectangle", "to_world": tilted}}, optimize=False
        )

    n = np.array([0, -np.sin(np.pi / 4), np.cos(np.pi / 4)])
    _, _, m, _ = carried(scene(45, 1), scene(45, 3), [0, 0, 0], n)
    np.testing.assert_allclose(m[0], np.array([0, -3, 1]) / np.sqrt(10), atol=1e-5)


def test_a_shape_that_moves_in_its_group():
    """Where the others are still, what is instanced is not taken for still."""

    def scene(height):
        ball = {"type": "sphere", "center": [0, 0, height], "radius": 0.3}
        group = {"type": "shapegroup", "ball": ball}
        return make_scene(
            group=group, one={"type": "instance", "group": {"type": "ref", "id": "group"}}
        )

    assert Motion(scene(3), scene(3)).still
    motion, _, _, known = carried(scene(3), scene(4), [[0, 0, 3.3], [1, 1, 0]], [[0, 0, 1]] * 2)
    assert not motion.still and known.tolist() == [False, True]


@pytest.mark.parametrize("counts", [(1, 2), (2, 1)])
def test_instances_that_appear_or_vanish(counts):
    def scene(count):
        parts = {}
        for k in range(count):
            ball = {"type": "sphere", "center": [k, 0, 3], "radius": 0.3}
            parts[f"group_{k}"] = {"type": "shapegroup", "ball": ball}
            parts[f"one_{k}"] = {"type": "instance", "of": {"type": "ref", "id": f"group_{k}"}}
        return make_scene(**parts)

    motion, q, _, known = carried(*map(scene, counts), [[0, 0, 3.3], [1, 1, 0]], [[0, 0, 1]] * 2)
    assert not motion.still and known.tolist() == [False, True]
    np.testing.assert_array_equal(q[1], [1, 1, 0])


def test_curves_that_stay(tmp_path):
    file = tmp_path / "hair.txt"
    file.write_text("0 0 1 0.01\n0 0 2 0.01\n0.1 0 3 0.01\n0.2 0 4 0.01\n")

    def scene(lift):
        curve = {"type": "bsplinecurve", "filename": str(file)}
        return make_scene(lift=lift, hair=curve)

    assert not Motion(scene(0), scene(1)).lost
    assert Motion(scene(0), scene(0)).still


def test_materials_do_not_move_a_shape(tmp_path):
    file = tmp_path / "hair.txt"
    file.write_text("0 0 1 0.01\n0 0 2 0.01\n0.1 0 3 0.01\n0.2 0 4 0.01\n")

    def scene(grey):
        colour = {"type": "rgb", "value": [grey] * 3}
        bsdf = {"type": "diffuse", "reflectance": colour}
        return make_scene(hair={"type": "bsplinecurve", "filename": str(file), "bsdf": bsdf})

    assert Motion(scene(0.2), scene(0.3)).still
