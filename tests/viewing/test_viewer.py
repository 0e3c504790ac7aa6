"""The viewer, without a server: pages ask, and get pictures."""

from __future__ import annotations

import io
from dataclasses import dataclass, field

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from gpf.core.errors import UserError
from gpf.core.images import read_exr, tone_map
from gpf.rendering.denoiser import ImageDenoiser
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.sensors import views_of_sensors
from gpf.scene.views import Keyframe, read_views
from gpf.viewing import rendering, screens
from gpf.viewing import viewer as module
from gpf.viewing.messages import Camera, GetFile, GetFilm, Look, SaveView
from gpf.viewing.screen import Screen, to_display
from gpf.viewing.subject import Subject
from gpf.viewing.viewer import Viewer
from tests.commands.box import box_field

FRONT = Keyframe(origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3)
LEFT = Keyframe(origin=(-0.5, 0.2, 2.5), target=(0.1, -0.3, 0), fov=45)


@dataclass
class Screenless:
    """A page that remembers what it is sent."""

    waits: bool = True
    pictures: list = field(default_factory=list)
    told: list = field(default_factory=list)

    def show(self, header, picture):
        self.pictures.append((header, np.asarray(Image.open(io.BytesIO(picture)))))

    def tell(self, header, data=b""):
        self.told.append((header, data))


@pytest.fixture(scope="module")
def scene():
    return mi.load_dict(mi.cornell_box(), optimize=False)


@pytest.fixture(scope="module")
def box(scene):
    return box_field(scene)


@pytest.fixture
def viewer(scene, box, tmp_path, monkeypatch):
    monkeypatch.setattr(screens, "has_denoiser", lambda: False)
    monkeypatch.setattr(module, "_REST_SECONDS", 0.0)
    monkeypatch.setattr(rendering, "_PICTURE_SECONDS", 0.0)
    return Viewer(subject(scene, tmp_path, exposure=1.0), box)


def subject(scene, folder, exposure):
    return Subject(scene, "box", views_of_sensors(scene), 1.0, exposure, folder / "views.yaml")


@pytest.fixture
def page(viewer):
    page = Screenless()
    viewer.opened(page)
    viewer.received(page, Look(number=1, rows=64))
    viewer.received(page, Camera(camera=FRONT, number=1))
    return page


def rest(viewer):
    for _ in range(1000):
        if not viewer.step():
            return
    raise AssertionError("never at rest")


def test_a_page_is_told_what_there_is(viewer, page):
    hello, status = (header for header, _ in page.told)
    assert hello["title"] == "box" and hello["aspect"] == 1
    assert set(hello["cameras"][0]) >= {"name", "origin", "target", "up", "fov"}
    assert status["has_field"] and not status["fits"]


def test_a_camera_at_rest_gets_the_picture_of_the_field(viewer, page, scene, box, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 24)
    rest(viewer)
    header, pixels = page.pictures[-1]
    assert header["frames"] == 24 and header["number"] == 1 and pixels.shape == (64, 64, 3)
    renderer = FieldRenderer.make(scene, box, RenderSettings(spp=64, adaptive=False))
    view = views_of_sensors(scene)[0].model_copy(update=FRONT.model_dump())
    expected = tone_map(renderer.render(view, (64, 64), seed=1)["radiance"], 1.0)
    assert np.abs(pixels / 255 - expected).mean() < 0.01
    count = len(page.pictures)
    assert not viewer.step() and len(page.pictures) == count


def test_a_moved_camera_gets_another_picture_at_once(viewer, page):
    rest(viewer)
    before = page.pictures[-1][1]
    viewer.received(page, Camera(camera=LEFT, number=2))
    assert viewer.step()
    header, pixels = page.pictures[-1]
    assert header["number"] == 2 and header["frames"] == 1
    assert np.abs(pixels.astype(float) - before).mean() > 10


def test_pages_have_cameras_of_their_own(viewer, page):
    other = Screenless()
    viewer.opened(other)
    viewer.received(other, Look(number=1, rows=64))
    viewer.received(other, Camera(camera=LEFT, number=7))
    rest(viewer)
    assert page.pictures[-1][0]["number"] == 1 and other.pictures[-1][0]["number"] == 7
    viewer.closed(other)
    viewer.received(page, Camera(camera=LEFT, number=8))
    count = len(other.pictures)
    rest(viewer)
    assert len(other.pictures) == count


def test_nothing_is_rendered_for_a_page_that_is_not_ready(viewer, page):
    page.waits = False
    assert not viewer.step() and page.pictures == []


@pytest.mark.parametrize(
    "layer", ["irradiance", "albedo", "normal", "depth", "coverage", "gaussians", "photons"]
)
def test_every_layer_has_a_picture(viewer, page, layer, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 2)
    viewer.received(page, Look(number=1, rows=64, layer=layer))
    rest(viewer)
    pixels = page.pictures[-1][1].astype(float)
    assert pixels.std() > 5
    if layer == "normal":  # the floor faces up, the back wall the camera
        assert (np.abs(pixels[62, 32] - [127, 255, 127]) < 12).all()
        assert (np.abs(pixels[20, 32] - [127, 127, 255]) < 12).all()
    if layer == "albedo":  # the left wall is red
        assert pixels[32, 2, 0] > 2 * pixels[32, 2, 1]


@pytest.mark.parametrize(("aspect", "rows"), [(2.0, 64), (0.5, 128)])
def test_pictures_of_another_aspect_have_those_of_the_camera_in_their_middle(
    viewer, page, aspect, rows, monkeypatch
):
    monkeypatch.setattr(rendering, "_FRAMES", 16)
    camera = LEFT.model_copy(update={"shift": (0.1, -0.2)})
    viewer.received(page, Camera(camera=camera, number=2))
    rest(viewer)
    own = page.pictures[-1][1].astype(float)
    viewer.received(page, Look(number=3, rows=rows, aspect=aspect))
    rest(viewer)
    found = page.pictures[-1][1].astype(float)
    assert found.shape == (rows, rows * aspect, 3)
    middle = found[:, 32:96] if aspect > 1 else found[32:96]
    assert np.abs(middle - own).mean() < 6 < np.abs(found[:64, :64] - own).mean()


def test_the_photons_of_a_camera_with_a_shift(viewer):
    plain = viewer.renderer.screens.photons(FRONT, (64, 48))
    shifted = FRONT.model_copy(update={"shift": (0.25, 0.0)})
    moved = viewer.renderer.screens.photons(shifted, (64, 48))
    np.testing.assert_array_equal(moved[:, 1:46], plain[:, 17:62])
    assert plain[:, 17:62].max() > 100


def test_the_depth_is_that_of_the_middle_or_else_of_all():
    def depth(**shapes):
        light = {"type": "constant"}
        scene = mi.load_dict({"type": "scene", "light": light, **shapes}, optimize=False)
        screen = Screen(scene, mi.load_dict({"type": "path"}), (12, 8))
        screen.frame(Keyframe(origin=(0, 0, 3), target=(0, 0, 2), fov=60))
        return screen.depth()

    place = mi.ScalarTransform4f().translate
    wall = {"type": "rectangle", "to_world": place([0, 0, -2]).scale(50)}
    post = {"type": "rectangle", "to_world": place([0, 0, 1]).scale(0.5)}
    aside = {"type": "rectangle", "to_world": place([1, 0, 1]).scale(0.1)}
    assert depth(wall=wall) == pytest.approx(5, abs=0.01)
    assert depth(wall=wall, post=post) == pytest.approx(2, abs=0.01)
    assert depth(aside=aside) == pytest.approx(2, abs=0.01)
    assert depth() == 0


def test_beside_the_path_tracer(viewer, page, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 4)
    viewer.received(page, Look(number=1, rows=64, compare="path"))
    rest(viewer)
    roles = [header["role"] for header, _ in page.pictures]
    assert "compare" in roles and "picture" in roles


def test_beside_the_reference_of_its_camera_alone(viewer, page, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 2)
    reference = np.random.default_rng(1).uniform(0, 1, (64, 64, 3)).astype(np.float32)
    camera = viewer.subject.cameras[0]
    viewer.subject.references._images = [(camera, reference)]
    own = Keyframe(**camera.model_dump(exclude={"name", "fov_axis"}))
    viewer.received(page, Look(number=1, rows=64, compare="reference"))
    shifted = own.model_copy(update={"shift": (0.1, 0.0)})
    for camera, shows in ((own, True), (LEFT, False), (shifted, False)):
        page.pictures.clear()
        viewer.received(page, Camera(camera=camera, number=2))
        rest(viewer)
        beside = [pixels for header, pixels in page.pictures if header["role"] == "compare"]
        assert bool(beside) == shows
        if shows:
            expected = to_display(reference, viewer.subject.exposure).astype(float)
            assert np.abs(beside[-1] - expected).mean() < 12  # a JPEG of noise


def test_the_expected_error_is_shown_where_it_is_known(viewer, page, box, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 2)
    viewer.received(page, Look(number=1, rows=64, layer="error"))
    rest(viewer)
    plain = page.pictures[-1][1].astype(float)  # the picture: there is no error to show
    assert not viewer._status_message()["has_error"]
    try:
        box.set_error(np.full(len(box.gaussians.means.numpy().T), 0.1, np.float32))
        viewer.received(page, Look(number=2, rows=64, layer="error"))
        rest(viewer)
        shown = page.pictures[-1][1].astype(float)
        assert viewer._status_message()["has_error"]
        assert np.abs(shown - plain).mean() > 30
        assert (np.abs(shown[50, 8] - [253, 231, 37]) < 20).all()  # the brightest false colour
    finally:
        box.update(box.gaussians)


def test_without_a_field_photons_are_mapped(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "_PASSES", 3)
    monkeypatch.setattr(module, "_REST_SECONDS", 0.0)
    viewer = Viewer(subject(scene, tmp_path, exposure=None), None)
    page = Screenless()
    viewer.opened(page)
    viewer.received(page, Look(number=1, rows=64))
    rest(viewer)
    header, pixels = page.pictures[-1]
    assert header["passes"] and header["frames"] == 3 and pixels.mean() > 30


def test_files_for_the_page(viewer, page, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "_FRAMES", 2)
    rest(viewer)
    viewer.received(page, GetFile())
    viewer.received(page, SaveView(name="My corner"))
    viewer.received(page, GetFilm(keyframes=(FRONT, LEFT), frames=3, spp=1))
    rest(viewer)
    files = {header["name"]: data for header, data in page.told if header["type"] == "file"}
    assert sorted(files) == ["box.exr", "box.mp4"] and files["box.mp4"][4:8] == b"ftyp"
    (tmp_path / "box.exr").write_bytes(files["box.exr"])
    assert read_exr(tmp_path / "box.exr")[0]["radiance"].shape == (64, 64, 3)
    # The first one is a training view, so that `gpf fit`, `render` and `view` take the file.
    saved = read_views(tmp_path / "views.yaml").train
    assert [view.name for view in saved] == ["my_corner"] and saved[0].origin == FRONT.origin
    assert saved[0].fov_axis == "x"
    cameras = viewer.subject.cameras
    for taken in (cameras, cameras[:1]):  # as after another start
        viewer.subject.cameras = list(taken)
        viewer.received(page, SaveView(name="My corner"))
        rest(viewer)
    assert [v.name for v in read_views(tmp_path / "views.yaml").novel] == [
        "my_corner_2",
        "my_corner_3",
    ]


def test_a_film_through_impossible_cameras_is_an_error_and_no_end(viewer, page):
    """In the middle, the camera would be where it looks."""
    back = Keyframe(origin=(0, 0, -3.9), target=(0, 0, 0), fov=39.3)
    viewer.received(page, GetFilm(keyframes=(FRONT, back), frames=3, spp=1))
    rest(viewer)
    header, _ = page.told[-1]
    assert header["type"] == "error" and "Add keyframes" in header["text"]


def test_what_cannot_be_rendered_is_told_and_the_viewer_goes_on(viewer, page, monkeypatch):
    monkeypatch.setattr(module, "_ERROR_SECONDS", 0.0)
    errors = iter([UserError("oidn", "does not load", "Install it again."), KeyboardInterrupt()])

    def step():
        raise next(errors)

    monkeypatch.setattr(viewer, "step", step)
    with pytest.raises(KeyboardInterrupt):
        viewer.run()
    assert page.told[-1][0] == {
        "type": "error",
        "text": "oidn: does not load. Install it again.",
    }


def test_a_page_cannot_wait_for_any_number_of_files(viewer, page):
    for _ in range(100):
        viewer.received(page, GetFilm(keyframes=(FRONT, LEFT), frames=600, spp=256))
    assert len(viewer._pages[0].tasks) == module._MOST_TASKS


def test_a_moving_camera_is_not_recorded_anew(scene, box):
    integrator = mi.load_dict({"type": "gpf", "record": True})
    integrator.field = box
    screen = Screen(scene, integrator, (64, 64))
    for k in range(6):
        angle = 0.1 * k
        origin = (3 * np.sin(angle), 0.0, 3 * np.cos(angle))
        screen.frame(FRONT.model_copy(update={"origin": origin, "fov": 40.0 + k}))
        if k == 2:
            recordings = integrator.recorded_frames.frozen.n_recordings
    assert integrator.recorded_frames.frozen.n_recordings == recordings <= 3


def test_a_first_field_in_the_middle_of_a_film(viewer, page, box, monkeypatch):
    """Pictures of photon mapping have no layers for the denoiser."""
    monkeypatch.setattr(screens, "has_denoiser", lambda: True)
    monkeypatch.setattr(ImageDenoiser, "denoise", lambda _, picture, *guides: picture)
    viewer.renderer.screens = screens.Screens(viewer.subject.scene, None)
    viewer.received(page, Look(number=1, rows=64, layer="photons"))
    viewer.received(page, GetFilm(keyframes=(FRONT, LEFT), frames=2, spp=2))
    steps = 0
    while viewer.step():
        steps += 1
        if viewer._pages[0].tasks and steps in (2, 3):
            viewer.renderer.screens.take(box)
    kinds = [header["type"] for header, _ in page.told]
    assert kinds[-1] == "file" and "error" not in kinds
