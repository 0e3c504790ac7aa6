"""The viewer corrects pictures of a camera at rest by gathered light."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import to_numpy
from gpf.viewing import rendering
from gpf.viewing.messages import Camera, Look
from gpf.viewing.viewer import Viewer
from tests.commands.box import box_field
from tests.viewing.test_viewer import FRONT, LEFT, Screenless, rest, subject


@pytest.fixture
def page(tmp_path, monkeypatch):
    """A page that looks into the Cornell Box, and its viewer. The field has ten times the light on
    all surfaces; what is gathered has the lamp's own light."""
    pytest.importorskip("pyoidn")
    monkeypatch.setattr("gpf.viewing.viewer._REST_SECONDS", 0.0)
    scene = mi.load_dict(mi.cornell_box(), optimize=False)
    field = box_field(scene)
    colours = to_numpy(field.gaussians.irradiance)
    field.recolour(10 * colours)
    field.set_caustics(0 * colours)
    viewer = Viewer(subject(scene, tmp_path, exposure=0.1), field)
    page = Screenless()
    viewer.opened(page)
    viewer.received(page, Look(number=1, rows=64))
    viewer.received(page, Camera(camera=FRONT, number=1))
    return viewer, page


def test_a_picture_at_rest_is_corrected(page):
    viewer, shown = page
    rest(viewer)
    own = viewer._pages[0]
    assert own.picture.frames == rendering._FRAMES
    assert own.gathered.frames == rendering._FRAMES // rendering.PER_PAIR
    field, gathered = own.picture.mean()[..., :3].mean(), own.gathered.mean().mean()
    assert abs(gathered - field) > 0.2 * field
    assert own.denoised.mean() == pytest.approx(gathered, rel=0.05)
    assert np.abs(shown.pictures[-1][1] / 255 - shown.pictures[0][1] / 255).mean() > 0.02
    assert not viewer.step()


def test_a_moved_camera_is_gathered_anew(page):
    viewer, shown = page
    rest(viewer)
    viewer.received(shown, Camera(camera=LEFT, number=2))
    viewer.step()
    own = viewer._pages[0]
    assert own.gathered.frames == 0 and own.denoised is None


def test_other_layers_are_not_gathered(page):
    viewer, shown = page
    viewer.received(shown, Look(number=2, rows=64, layer="albedo"))
    rest(viewer)
    assert viewer._pages[0].gathered.frames == 0
