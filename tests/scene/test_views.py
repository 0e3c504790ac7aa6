"""views.yaml: what it may say, how paths are interpolated, which sensors come out."""

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.scene.sensors import make_sensor
from gpf.scene.views import interpolate, name_view, read_views

GOOD = """\
exposure: 2.5
aspect: 1.5
fov_axis: y
views:
  train:
    - {name: front, origin: [0, 0, 4], target: [0, 0, 0], fov: 40}
  novel:
    - {name: side, origin: [1, 0, 4], target: [0, 0, 0], fov: 50, fov_axis: x}
path:
  frames: 4
  closed: true
  keyframes:
    - {origin: [0, 0, 4], target: [0, 0, 0], fov: 40}
    - {origin: [2, 0, 4], target: [0, 1, 0], fov: 60}
"""


def write(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "views.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def test_views_are_read_with_defaults(tmp_path):
    views = read_views(write(tmp_path, GOOD))
    assert [view.name for view in views.train] == ["front"]
    assert views.exposure == 2.5
    assert views.size(6) == (9, 6)
    assert views.train[0].up == (0, 1, 0)
    # a view takes the scene's axis over unless it names its own
    assert (views.train[0].fov_axis, views.novel[0].fov_axis) == ("y", "x")
    assert views.find("side").fov == 50
    assert views.find("frame_001").fov_axis == "y"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "exposure: 2.5",
            "exposrue: 2.5",
            r"exposrue: is an unknown key\. Did you mean 'exposure'",
        ),
        (", fov: 40}", ", fov: 40, lens: 3}", r"views\.train\.0\.lens: is an unknown key.*origin"),
        ("frames: 4", "frame: 4", r"path\.frame: is an unknown key\. Did you mean 'frames'"),
        ("fov: 40", "fov: 180", r"views\.train\.0\.fov: is 180\. Input should be less than 180"),
        ("exposure: 2.5", "exposure: -1", r"exposure: is -1\. Input should be greater than 0"),
        ("exposure: 2.5", "exposure: .nan", r"exposure: is nan\. Input should be"),
        ("origin: [1, 0, 4]", "origin: [1, 4]", r"views\.novel\.0\.origin\.2: is missing"),
        ("name: side", "name: front", r"views: 2 views are called 'front'\. Give every view"),
        ("name: side", "name: frame_3", r"begins with frame_"),
        ("name: side", "name: ../side", r"views\.novel\.0\.name: is '\.\./side'"),
        ("target: [0, 1, 0]", "target: [2, 9, 4]", r"keyframes\.1: looks along its own up vector"),
        ("  train:", "  novell:", r"views\.novell: is an unknown key\. Did you mean 'novel'"),
        ("exposure: 2.5", "exposure: 1\nexposure: 2", r"is not YAML: .*duplicate key"),
        ("train:\n", "train: [\n", r"is not YAML: .*line \d+.*Correct that line"),
    ],
)
def test_bad_views_are_told_in_words(tmp_path, old, new, words):
    assert old in GOOD
    with pytest.raises(UserError, match=words):
        read_views(write(tmp_path, GOOD.replace(old, new, 1)))


def test_training_views_are_needed_for_training_only(tmp_path):
    path_alone = GOOD[: GOOD.index("views:")] + GOOD[GOOD.index("path:") :]
    with pytest.raises(UserError, match=r"has no training views\. List at least one"):
        read_views(write(tmp_path, path_alone))
    assert len(read_views(write(tmp_path, path_alone), need_training=False).frames()) == 4
    with pytest.raises(UserError, match="has no training views"):
        read_views(write(tmp_path, ""))


def test_missing_file_and_missing_view_are_told_in_words(tmp_path):
    with pytest.raises(UserError, match=r"views\.yaml: cannot be read"):
        read_views(tmp_path / "views.yaml")
    with pytest.raises(UserError, match=r"'frnt': does not exist\. Did you mean 'front'"):
        read_views(write(tmp_path, GOOD)).find("frnt")


def test_open_path_by_hand():
    keys = np.array([[0.0, 1.0], [2.0, 1.0], [2.0, 5.0]])
    # At s = ½ the weights are (-1, 9, 9, -1) / 16; a is reflected: (-2, 1).
    rows = interpolate(keys, 5, closed=False)
    np.testing.assert_allclose(rows[[0, 2, 4]], keys)
    np.testing.assert_allclose(rows[1], [1.125, 0.75])


def test_closed_path_comes_back_without_repeating_its_start():
    keys = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    rows = interpolate(keys, 8, closed=True)
    np.testing.assert_allclose(rows[::2], keys)
    # weights (-1, 9, 9, -1) / 16 again, for instance on (0, -1), (1, 0), (0, 1), (-1, 0)
    np.testing.assert_allclose(rows[1::2], 0.625 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]))


def test_sensor_sees_what_the_view_says(tmp_path):
    view = read_views(write(tmp_path, GOOD)).train[0]
    sensor = make_sensor(view, 9, 6, spp=3)
    assert list(sensor.film().size()) == [9, 6]
    assert sensor.film().rfilter().is_box_filter()
    assert sensor.sampler().sample_count() == 3
    # The middle of the upper edge is fov / 2 = 20° above the axis: fov_axis is y.
    middle_top = mi.Point2f(0.5, 0.0)
    ray, _ = sensor.sample_ray(0.0, 0.0, middle_top, mi.Point2f(0.5))
    angle = np.degrees(np.arctan2(ray.d.y, -ray.d.z))
    np.testing.assert_allclose(np.array(angle).ravel(), 20, atol=1e-3)
    np.testing.assert_allclose(np.array(ray.o).ravel(), [0, 0, 4], atol=2e-3)


def test_a_path_that_swings_too_far_is_told_in_words(tmp_path):
    """Between two narrow views the curve of the angle would go below zero."""
    keys = "".join(
        f"    - {{origin: [{k}, 0, 4], target: [0, 0, 0], fov: {fov}}}\n"
        for k, fov in enumerate((60, 5, 5, 60))
    )
    start, _, _ = GOOD.partition("    - {origin: [0, 0, 4], target: [0, 0, 0], fov: 40}\n")
    text = start.replace("frames: 4", "frames: 7").replace("closed: true", "closed: false") + keys
    with pytest.raises(UserError, match=r"leads through impossible cameras: fov.*keyframes"):
        read_views(write(tmp_path, text))
    assert len(read_views(write(tmp_path, text.replace("fov: 5}", "fov: 30}"))).frames()) == 7


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "aspect: 1.5",
            "aspect: 1.0e+12",
            r"views\.yaml: aspect: is 1000000000000\.0\. Input should",
        ),
        (
            "front",
            "a" * 101,
            r"views\.yaml: views\.train\.0\.name: is 'aaa.*at most 100 characters",
        ),
        ("aspect: 1.5", "aspect: 1.0e-12", r"views\.yaml: aspect: is 1e-12\. Input should"),
        ("frames: 4", "frames: 1000000000", r"views\.yaml: path\.frames: is 1000000000\. Input"),
    ],
)
def test_names_and_sizes_that_are_too_large_are_told(tmp_path, old, new, words):
    file = tmp_path / "views.yaml"
    assert old in GOOD
    file.write_text(GOOD.replace(old, new))
    with pytest.raises(UserError, match=words):
        read_views(file)


def test_names_from_any_text_are_short_enough_for_files():
    names = {name_view("a" * 3000, set(), "camera")}
    names.add(name_view("a" * 3000, names, "camera"))
    assert sorted(map(len, names)) == [80, 82]
