"""Views that are written are read again as they were, and look like those that people write."""

import pytest

from gpf.scene.views import CameraPath, Keyframe, SceneViews, View, ViewSets, read_views
from gpf.scene.views_file import write_views


def view(name: str, **more: object) -> View:
    return View(name=name, origin=(0.123456789, -2e-5, 4), target=(0, 0, 0), fov=39.3077, **more)


def test_what_is_written_is_read_again(tmp_path):
    keys = (
        Keyframe(origin=(0, 0, 4), target=(0, 0, 0), fov=40),
        Keyframe(origin=(2, 0, 4), target=(0, 1, 0), fov=60, up=(0, 0, 1)),
    )
    views = SceneViews(
        exposure=0.31,
        aspect=16 / 9,
        fov_axis="smaller",
        views=ViewSets(
            train=(view("own"), view("1", up=(0, 0, 1)), view("true", fov_axis="x")),
            novel=(view("aside", fov_axis="smaller"),),
        ),
        path=CameraPath(keyframes=keys, frames=7, closed=True),
    )
    write_views(tmp_path / "views.yaml", views, "Made by hand.")
    again = read_views(tmp_path / "views.yaml")
    assert (again.train, again.novel) == (views.train, views.novel)
    assert again.path == views.path
    assert (again.exposure, again.fov_axis) == (0.31, "smaller")
    assert again.aspect == pytest.approx(16 / 9, rel=1e-8)


def test_files_look_as_if_written_by_hand(tmp_path):
    views = SceneViews(views=ViewSets(train=(view("own", fov_axis="x"),)))
    write_views(tmp_path / "views.yaml", views)
    assert (tmp_path / "views.yaml").read_text() == (
        "exposure: 1\n"
        "aspect: 1\n"
        "fov_axis: x\n"
        "views:\n"
        "  train:\n"
        "    - {name: own, origin: [0.123456789, -2e-05, 4], target: [0, 0, 0], fov: 39.3077}\n"
        "  novel: []\n"
    )
