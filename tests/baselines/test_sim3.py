"""The similarity between two sets of cameras."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baselines.anysplat.sim3 import Similarity, align_cameras, align_points
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View

TRUE = Similarity(
    0.37, Rotation.from_euler("xyz", [40, -110, 15], degrees=True).as_matrix(), np.array([1, -2, 3])
)


def some_poses(count: int, line: bool = False) -> np.ndarray:
    """Cameras that look about, at random places or on a line."""
    rng = np.random.default_rng(3)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, random_state=4).as_matrix()
    places = rng.normal(size=(count, 3))
    poses[:, :3, 3] = np.linspace(0, 2, count)[:, None] * [1, 2, -1] if line else places
    return poses


def moved(poses: np.ndarray, by: Similarity) -> np.ndarray:
    result = poses.copy()
    result[:, :3, :3] = by.rotation @ poses[:, :3, :3]
    result[:, :3, 3] = by.apply(poses[:, :3, 3])
    return result


def assert_same(found: Similarity, expected: Similarity) -> None:
    assert found.scale == pytest.approx(expected.scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-9)
    np.testing.assert_allclose(found.translation, expected.translation, atol=1e-9)


def test_points_and_cameras_that_were_moved_tell_how() -> None:
    poses = some_poses(3)
    assert_same(align_points(poses[:, :3, 3], TRUE.apply(poses[:, :3, 3])), TRUE)
    assert_same(align_cameras(poses, moved(poses, TRUE)), TRUE)


def test_where_cameras_look_tells_what_places_on_a_line_do_not() -> None:
    poses = some_poses(3, line=True)
    assert_same(align_cameras(poses, moved(poses, TRUE)), TRUE)
    two = some_poses(2)
    assert_same(align_cameras(two, moved(two, TRUE)), TRUE)


def test_points_that_differ_are_aligned_in_least_squares() -> None:
    rng = np.random.default_rng(5)
    source = rng.normal(size=(12, 3))
    target = TRUE.apply(source) + 0.1 * rng.normal(size=(12, 3))
    best = align_points(source, target)

    def error(by: Similarity) -> float:
        return float(((by.apply(source) - target) ** 2).sum())

    assert error(best) < error(TRUE)
    for axis in np.eye(3):
        turned = Rotation.from_rotvec(0.01 * axis).as_matrix() @ best.rotation
        shifted = target.mean(axis=0) - best.scale * turned @ source.mean(axis=0)
        assert error(Similarity(best.scale, turned, shifted)) > error(best)
        assert error(Similarity(best.scale, best.rotation, best.translation + 0.01 * axis)) > error(
            best
        )
    for factor in (0.99, 1.01):
        scale = factor * best.scale
        shifted = target.mean(axis=0) - scale * best.rotation @ source.mean(axis=0)
        assert error(Similarity(scale, best.rotation, shifted)) > error(best)


def test_a_mirror_is_no_rotation() -> None:
    points = np.random.default_rng(6).normal(size=(8, 3))
    found = align_points(points, points * [1, 1, -1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_cameras_in_one_place_or_unlike_the_others_are_refused() -> None:
    poses = some_poses(4)
    with pytest.raises(ValueError, match="all are in one place"):
        same = poses.copy()
        same[:, :3, 3] = [4, 5, 6]
        align_cameras(same, poses)
    with pytest.raises(ValueError, match="they are too different"):
        opposite = poses.copy()
        opposite[:, :3, 3] *= -1
        align_cameras(opposite, poses)


def test_there_and_back() -> None:
    points = np.random.default_rng(7).normal(size=(5, 3))
    np.testing.assert_allclose(TRUE.inverse().apply(TRUE.apply(points)), points, atol=1e-12)
    view = View(name="a", origin=(1, 2, 3), target=(0, -1, 1), fov=50)
    camera = make_pinhole(view, (8, 6))
    before, depth = camera.project(points)
    after, deeper = TRUE.apply_camera(camera).project(TRUE.apply(points))
    np.testing.assert_allclose(after, before, atol=1e-9)
    np.testing.assert_allclose(deeper, TRUE.scale * depth, atol=1e-12)
