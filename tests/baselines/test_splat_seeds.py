"""Where Gaussians start: at surfaces, or where surfaces seem to be."""

import numpy as np
import pytest

from baselines.protocol import Task
from baselines.splatting.seeds import SKY, Seeds, find_seeds
from baselines.splatting.training import Picture
from gpf.core.images import tone_map
from gpf.scene.pinhole import make_pinhole
from tests.baselines.splat_cases import INDEX, PICTURE_SIZE, wall_task

PLACES = [(-0.8, 0.1), (0.1, -0.5), (0.9, 0.2), (0.2, 0.8)]


def seeds_of(task: Task, count: int = 500) -> Seeds:
    pictures = [
        Picture(make_pinhole(shot.view, task.size), tone_map(shot.radiance, task.exposure))
        for shot in task.training
    ]
    return find_seeds(task.scene, pictures, count, seed=3)


def test_seeds_of_a_wall_lie_on_it(tmp_path):
    seeds = seeds_of(wall_task(tmp_path, False, PLACES))
    assert seeds.points.shape == seeds.colours.shape == (500, 3)
    assert np.median(seeds.points[:, 2]) == pytest.approx(-1, abs=0.05)
    assert np.mean(abs(seeds.points[:, 2] + 1) < 0.3) > 0.8


def test_seeds_of_a_wall_under_water_lie_where_it_seems_to_be(tmp_path):
    seeds = seeds_of(wall_task(tmp_path, True, PLACES))
    assert np.median(seeds.points[:, 2]) == pytest.approx(-1 / INDEX, abs=0.07)


def test_a_single_picture_leaves_its_points_where_they_are(tmp_path):
    task = wall_task(tmp_path, False, PLACES[:1])
    np.testing.assert_allclose(seeds_of(task).points[:, 2], -1, atol=1e-3)


def test_seeds_have_the_colours_of_their_pixels(tmp_path):
    task = wall_task(tmp_path, False, PLACES[:1])
    camera, image = make_pinhole(task.training[0].view, task.size), task.training[0].radiance
    seeds = seeds_of(task, PICTURE_SIZE[0] * PICTURE_SIZE[1])
    columns, rows = np.floor(camera.project(seeds.points)[0]).astype(int).T
    np.testing.assert_allclose(
        seeds.colours, tone_map(image[rows, columns], task.exposure), atol=1e-6
    )
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == len(rows)


def test_black_pixels_have_no_seeds_and_the_sky_is_far(tmp_path):
    task = wall_task(tmp_path, False, PLACES[:1])
    shot = task.training[0]
    shot.layers["radiance"][:, : PICTURE_SIZE[0] // 2] = 0
    away = shot.view.model_copy(update={"target": (0, 0, 9)})
    object.__setattr__(shot, "view", away)
    seeds = seeds_of(task, 10**6)
    assert len(seeds.points) == PICTURE_SIZE[0] * PICTURE_SIZE[1] // 2
    distances = np.linalg.norm(seeds.points - away.origin, axis=1)
    np.testing.assert_allclose(distances, SKY * 18 * np.sqrt(2), rtol=1e-3)
