"""RenderFormer's files, and what scenes are normalised to in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from baselines.protocol import CannotServe
from baselines.renderformer.files import (
    IRRADIANCE,
    find_placement,
    mean_irradiance,
    set_camera,
    split_lights,
    write_scene,
)
from baselines.renderformer.triangle_scene import Triangles
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View


def a_floor_and_lamps(radiance: np.ndarray) -> Triangles:
    """A floor of four facets and lamps above it, (N, 3), each a small triangle that looks down."""
    floor = np.array([[[-2, 0, 0], [2, 0, 0], [2, 3, 0]], [[-2, 0, 0], [2, 3, 0], [-2, 3, 0]]])
    lamp = np.array([[0, 0, 0], [0, 0.1, 0], [0.1, 0, 0]])
    places = [[k, 1, 2] for k in range(len(radiance))]
    corners = np.concatenate([floor, [lamp + place for place in places]]).astype(float)
    count = len(corners)
    return Triangles(
        corners,
        np.tile([0.0, 0, 1], (count, 3, 1)),
        np.tile([0.1, 0.2, 0.3], (count, 1)),
        np.tile([0.04, 0.04, 0.04], (count, 1)),
        np.full(count, 0.7),
        np.concatenate([np.zeros((2, 3)), radiance]),
    )


def test_scenes_fill_the_box_that_the_network_knows() -> None:
    triangles = a_floor_and_lamps(np.ones((1, 3)))
    placement = find_placement(triangles)
    placed = placement.place(triangles).corners.reshape(-1, 3)
    np.testing.assert_allclose(placed.min(0), [-0.5, -0.375, -0.25])
    np.testing.assert_allclose(placed.max(0), [0.5, 0.375, 0.25])
    view = View(name="a", origin=(1, -3, 2), target=(0, 1, 0), up=(0, 0, 1), fov=30)
    matrix = placement.place_camera(make_pinhole(view, (8, 6)))
    above = np.array([0, 0, 0.1])
    # Blender's camera: what it looks at is at -z, and what is above it at +y.
    target = (np.array([0, 1, 0]) - placement.centre) * placement.scale
    seen = np.linalg.inv(matrix) @ [*target, 1]
    np.testing.assert_allclose(seen[:2], 0, atol=1e-12)
    assert seen[2] == pytest.approx(-placement.scale * np.linalg.norm([1, -4, 2]))
    assert (np.linalg.inv(matrix) @ [*(target + above), 1])[1] > 0
    assert np.linalg.det(matrix[:3, :3]) == pytest.approx(1)


def test_lamps_of_a_colour_share_a_lighting_and_light_is_not_lost() -> None:
    radiance = np.array([[4, 2, 1], [1, 3, 3], [8, 4, 2]], dtype=float)
    triangles = find_placement(a_floor_and_lamps(radiance)).place(a_floor_and_lamps(radiance))
    lightings = split_lights(triangles, "scene.xml")
    assert len(lightings) == 2
    for lighting in lightings:
        assert mean_irradiance(triangles, lighting.emission) == pytest.approx(IRRADIANCE)
    total = sum(light.emission[:, None] * light.colour for light in lightings)
    np.testing.assert_allclose(total, triangles.radiance, rtol=1e-3)
    warm = next(light for light in lightings if light.emission[2] > 0)
    assert warm.emission[4] == pytest.approx(2 * warm.emission[2]) and warm.emission[3] == 0
    with pytest.raises(CannotServe, match="9 glowing triangles .*; 8 are allowed"):
        split_lights(a_floor_and_lamps(np.ones((9, 3))), "scene.xml")


def test_irradiance_is_that_of_small_lamps_by_formula() -> None:
    triangles = a_floor_and_lamps(np.full((1, 3), 7.0))
    emission = np.array([0, 0, 7.0])
    lamp = np.array([1 / 30, 1 + 1 / 30, 2])
    expected = []
    for facet in triangles.corners[:2]:  # of equal areas
        way = lamp - facet.mean(axis=0)
        expected.append(7 * 0.005 * way[2] ** 2 / (way @ way) ** 2)
    assert mean_irradiance(triangles, emission) == pytest.approx(np.mean(expected))


def test_files_have_what_the_published_code_reads(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    triangles = a_floor_and_lamps(np.array([[4, 2, 1.0]]))
    lighting = split_lights(triangles, "scene.xml")[0]
    file = tmp_path / "scene.h5"
    write_scene(file, triangles, lighting)
    matrix = np.arange(16.0).reshape(4, 4)
    set_camera(file, matrix, 33)
    with h5py.File(file, "r") as stored:
        assert set(stored) == {"triangles", "texture", "vn", "c2w", "fov"}
        assert all(stored[name].dtype == np.float32 for name in stored)
        np.testing.assert_allclose(stored["triangles"], triangles.corners, rtol=1e-6)
        np.testing.assert_allclose(stored["vn"], triangles.normals)
        np.testing.assert_array_equal(stored["c2w"], matrix[None])
        np.testing.assert_array_equal(stored["fov"], [33])
        texture = np.asarray(stored["texture"])
    assert texture.shape == (3, 13, 32, 32)
    expected = [0.1, 0.2, 0.3, 0.04, 0.04, 0.04, 0.7, 0.5, 0.5, 1, 0, 0, 0]
    np.testing.assert_allclose(texture[0, :, 4, 20], expected, rtol=1e-6)
    np.testing.assert_allclose(texture[2, 10:, 31, 1], [lighting.emission[2]] * 3, rtol=1e-6)
    # The half of the square beyond the triangle is empty, the diagonal is not.
    assert (texture[:, :, 16, 17] == 0).all() and (texture[:, 6, 16, 16] > 0).all()
