"""Flicker of made-up frames whose answer is known."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from metrics.flicker import FramePoints, change_of_noise, link_frames, measure_flicker

EXPOSURE = 1.0


def see(x: float = 0.0, tilt: float = 0.0, size: tuple[int, int] = (64, 48)) -> FramePoints:
    """The plane z = 0 seen from (x, 0, 1), with the camera tilted by ``tilt`` from vertical."""
    width, height = size
    u, v = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    ray = np.stack([u / 100, v / 100, -np.ones_like(u)], axis=-1)
    c, s = math.cos(tilt), math.sin(tilt)
    ray = ray @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T
    return FramePoints(
        np.array([x, 0, 1]) - ray / ray[..., 2:], np.ones((height, width), dtype=bool)
    )


def paint(frame: FramePoints) -> np.ndarray:
    """A smooth texture on the points."""
    x, y = frame.points[..., 0], frame.points[..., 1]
    wave = 0.5 + 0.2 * np.sin(18 * x + 1) * np.cos(15 * y)
    return np.stack([wave, 0.7 * wave, 0.3 + 0 * wave], axis=-1)


def walk(count: int = 4) -> tuple[list[FramePoints], list]:
    frames = [see(0.0137 * k, -0.022 * k) for k in range(count)]
    return frames, [link_frames(a, b) for a, b in pairwise(frames)]


def test_matches_see_the_same_points():
    frames, links = walk(2)
    points = frames[0].points.reshape(-1, 3)
    found = np.einsum("mk,mkc->mc", links[0].weights, points[links[0].earlier])
    pixel = 1 / 100
    error = np.linalg.norm(found - frames[1].points.reshape(-1, 3)[links[0].later], axis=1)
    assert len(error) > 0.85 * 64 * 48 and error.max() < 0.02 * pixel


def test_a_still_texture_under_a_moving_camera_does_not_flicker():
    frames, links = walk()
    flicker = measure_flicker([paint(f) for f in frames], links, EXPOSURE)
    assert flicker.change < 0.25 and 0.85 < flicker.share < 1
    # Compared pixel by pixel, the same images differ much.
    still = [link_frames(frames[0], frames[0])] * 3
    assert measure_flicker([paint(f) for f in frames], still, EXPOSURE).change > 5


@pytest.mark.parametrize("deviation", [2.0, 6.0])
def test_noise_has_its_standard_deviation(deviation):
    frames, links = walk(6)
    rng = np.random.default_rng(3)
    images = []
    for _ in frames:
        level = (128 + deviation * rng.normal(size=(48, 64, 3))) / 255
        images.append(((level + 0.055) / 1.055) ** 2.4)
    flicker = measure_flicker(images, links, EXPOSURE)
    assert flicker.noise == pytest.approx(deviation, rel=0.03)
    assert flicker.change == pytest.approx(2 * deviation / math.sqrt(math.pi), rel=0.03)


def test_a_change_of_all_pixels_is_exact():
    """Matches at pixel centres are not scaled."""
    frame = see()
    links = [link_frames(frame, frame)]
    low, high = (np.full((48, 64, 3), ((n / 255 + 0.055) / 1.055) ** 2.4) for n in (100, 107))
    assert measure_flicker([low, high], links, EXPOSURE).change == pytest.approx(7)


def test_pixels_of_other_surfaces_have_no_weight():
    """No match uses such a pixel, not even as a diagonal neighbour."""
    earlier, later = see(), see(0.005, 0)  # half a pixel to the side
    other = (20, 30)
    hole = earlier.usable.copy()
    hole[other] = False
    behind = earlier.points.copy()
    behind[other] += [0, 0, -1]
    flat = other[0] * 64 + other[1]
    for frame in (FramePoints(earlier.points, hole), FramePoints(behind, earlier.usable)):
        link = link_frames(frame, FramePoints(later.points + np.array([0, 0.005, 0]), later.usable))
        assert len(link.later) > 0.8 * 64 * 48
        assert not ((link.earlier == flat) & (link.weights > 0)).any()


def test_a_closed_path_has_one_more_link():
    frame = see()
    link = link_frames(frame, frame)
    low, high = np.full((48, 64, 3), 0.2), np.full((48, 64, 3), 0.3)
    open_path = measure_flicker([low, low, high], [link] * 2, EXPOSURE).change
    closed = measure_flicker([low, low, high], [link] * 3, EXPOSURE).change
    assert closed == pytest.approx(open_path * 4 / 3)


def test_hidden_points_have_no_match():
    """A card hides the left half of the plane in the earlier frame."""
    plane = see()
    points = plane.points.copy()
    points[:, :32] = points[:, :32] * 0.5 + np.array([0, 0, 0.5])
    link = link_frames(FramePoints(points, plane.usable), plane)
    columns = link.later % 64
    assert len(columns) > 1000 and columns.min() >= 32


def test_a_point_in_front_of_another_is_no_match():
    """The earlier frame sees a sheet close above the plane, at the same x and y."""
    plane = see()
    sheet = plane.points + np.array([0, 0, 0.02])
    link = link_frames(FramePoints(sheet, plane.usable), plane)
    assert len(link.later) == 0
    near = plane.points + np.array([0, 0, 0.001])
    assert len(link_frames(FramePoints(near, plane.usable), plane).later) > 2000


def test_unusable_pixels_and_edges_are_left_out():
    plane = see()
    usable = plane.usable.copy()
    usable[20, 30] = False
    link = link_frames(plane, FramePoints(plane.points, usable))
    missing = set(range(64 * 48)) - set(link.later.tolist())
    inside = {n for n in missing if 0 < n % 64 < 63 and 0 < n // 64 < 47}
    assert inside == {20 * 64 + 30, 19 * 64 + 30, 21 * 64 + 30, 20 * 64 + 29, 20 * 64 + 31}
    folded = plane.points.copy()
    folded[:, 40:, 2] += folded[:, 40:, 0] - folded[:, 40:41, 0]
    link = link_frames(FramePoints(folded, plane.usable), FramePoints(folded, plane.usable))
    assert not np.isin(link.later % 64, [40]).any() and np.isin(link.later % 64, [38, 42]).any()


def test_frames_without_matches_are_errors():
    links = [link_frames(see(0), see(50))]
    image = np.zeros((48, 64, 3))
    with pytest.raises(ValueError, match="no pixel of any frame has a match"):
        measure_flicker([image, image], links, EXPOSURE)
    with pytest.raises(ValueError, match="3 images cannot have 1 links"):
        measure_flicker([image] * 3, links, EXPOSURE)
    with pytest.raises(ValueError, match="images have 4 pixels"):
        measure_flicker([np.zeros((2, 2, 3))] * 2, links, EXPOSURE)


def test_the_flicker_of_noise_follows_from_the_standard_error():
    """It agrees with the flicker of frames with that noise."""
    frames, links = walk(6)
    rng = np.random.default_rng(5)
    radiance, error = np.full((48, 64, 3), 0.3), np.full((48, 64, 3), 0.01)
    images = [radiance + error * rng.normal(size=radiance.shape) for _ in frames]
    measured = measure_flicker(images, links, 1.5).change
    assert change_of_noise(radiance, error, 1.5) == pytest.approx(measured, rel=0.03)
