"""The page in headless Chromium, served by `gpf view`."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.io import read_field, save_field
from gpf.scene.views import read_views
from tests.browser import open_page
from tests.commands.box import box_field
from tests.viewing.browsing import BOX, MARKS, PROGRAM, drag, picture, viewing

pytestmark = MARKS


@pytest.fixture(scope="module")
def field_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("field") / "box.safetensors"
    save_field(box_field(mi.load_file(str(BOX), optimize=False)), path)
    return path


@pytest.fixture(scope="module")
def viewer(field_file, tmp_path_factory):
    words = ("--field", str(field_file), "--changed-scene")
    with viewing(tmp_path_factory.mktemp("view"), *words) as found:
        yield found


@pytest.fixture
def page(viewer, tmp_path):
    with open_page(PROGRAM, viewer[1], tmp_path) as page:
        page.wait_for("viewer.ready && viewer.frames > 2")
        yield page
        assert page.complaints == []
        here = viewer[1].removeprefix("http://").partition("/")[0]
        ours = tuple(f"{kind}://{here}/" for kind in ("http", "ws"))
        assert here.startswith("127.0.0.1:") and page.requests
        assert all(url.startswith((*ours, "data:", "blob:")) for url in page.requests)


def test_it_shows_the_scene_and_moves(page):
    assert page.evaluate("document.title") == "cornell_box"
    before = picture(page)
    assert before.mean() > 30 and before.std() > 10
    origin = page.evaluate("viewer.camera.origin")
    drag(page)
    page.wait_for("viewer.frames > 2")
    assert page.evaluate("viewer.camera.origin") != origin
    assert np.abs(picture(page) - before).mean() > 5
    page.press("1")
    page.wait_for("viewer.frames > 2")
    assert np.abs(picture(page) - before).mean() < 3
    for _ in range(4):  # a busy machine leaves cameras out, but never the last of a move
        drag(page)
        page.wait_for("viewer.frames > 2")
    assert len(page.evaluate("viewer.delays")) > 5


def test_keys_fly_and_the_panel_hides(page):
    origin = page.evaluate("viewer.camera.origin")
    page.call("Input.dispatchKeyEvent", type="keyDown", key="w")
    page.wait_for(f"viewer.camera.origin[2] < {origin[2]} - 0.2")
    page.call("Input.dispatchKeyEvent", type="keyUp", key="w")
    page.press("h")
    assert page.evaluate("document.querySelector('#panel').hidden")


def test_exposure_and_layers_change_the_picture(page):
    before = picture(page)
    page.evaluate("document.querySelector('#stops').value = -3; look()")
    page.wait_for("viewer.frames > 2")
    assert picture(page).mean() < 0.6 * before.mean()
    page.evaluate("document.querySelector('#layer').value = 'depth'; look()")
    page.wait_for("viewer.frames > 2")
    page.evaluate("document.querySelector('#compare').value = 'path'; look()")
    page.wait_for("document.querySelector('#other').width > 300")


def test_the_soft_curve_keeps_bright_places_apart(page):
    page.evaluate("document.querySelector('#stops').value = 4; look()")
    page.wait_for("viewer.frames > 2")
    white = (picture(page) == 255).mean()
    page.evaluate("document.querySelector('#curve').value = 'soft'; look()")
    page.wait_for("viewer.frames > 2")
    assert white > 0.2 and (picture(page) == 255).mean() < 0.3 * white


def touch(page, kind, *places):
    points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
    page.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)


def test_one_finger_turns_and_two_come_nearer(page):
    start = np.array(page.evaluate("viewer.camera.origin"))
    touch(page, "touchStart", (600, 400))
    touch(page, "touchMove", (680, 400))
    touch(page, "touchEnd")
    page.wait_for("viewer.frames > 2")
    turned = np.array(page.evaluate("viewer.camera.origin"))
    assert np.linalg.norm(turned - start) > 0.2
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(start), rel=0.01)
    touch(page, "touchStart", (550, 400), (650, 400))
    touch(page, "touchMove", (450, 400), (750, 400))
    touch(page, "touchEnd")
    page.wait_for("viewer.frames > 2")
    assert np.linalg.norm(page.evaluate("viewer.camera.origin")) < 0.8 * np.linalg.norm(turned)


def test_pictures_cameras_and_films_are_kept(viewer, page):
    """The buttons, down to the first bytes of what they download."""
    page.evaluate("window.kept = {}; download = (blob, name) => { kept[name] = blob; }")
    rows = "document.querySelector('#rows')"  # few, so that the film takes seconds
    page.evaluate(f"{rows}.prepend(new Option(96)); {rows}.value = 96; look()")
    page.wait_for("viewer.frames > 2")
    for button in ("png", "exr", "key"):
        page.evaluate(f"document.querySelector('#{button}').click()")
    drag(page)
    page.evaluate("document.querySelector('#key').click()")
    assert page.evaluate("document.querySelector('#film').textContent") == "MP4 (2 keys)"
    page.evaluate("document.querySelector('#film').click()")
    page.wait_for("Object.keys(kept).length === 3")
    first = "Promise.all(Object.entries(kept).map(async ([name, blob]) => [name.split('.')[1], "
    first += "[...new Uint8Array(await blob.slice(0, 8).arrayBuffer())]]))"
    found = {suffix: bytes(start) for suffix, start in page.evaluate(first)}
    assert found["png"][1:4] == b"PNG" and found["mp4"][4:] == b"ftyp"
    assert found["exr"][:4] == bytes([0x76, 0x2F, 0x31, 0x01])
    before = page.evaluate("viewer.cameras.length")
    page.evaluate("document.querySelector('#save').click()")
    page.wait_for(f"viewer.cameras.length === {before + 1}")
    name = page.evaluate("viewer.cameras.at(-1).name")
    file = Path(f"/proc/{viewer[0].pid}/cwd") / "views.yaml"
    assert name in {view.name for view in read_views(file.resolve()).train}


def test_a_second_window_and_one_that_closes(viewer, page, tmp_path):
    """It closes while a large picture is rendered for it."""
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        with open_page(PROGRAM, viewer[1], tmp_path / name) as other:
            other.wait_for("viewer.ready")
            drag(other, 50)
            other.evaluate("document.querySelector('#rows').value = 1080; look()")
    drag(page)
    page.wait_for("viewer.frames > 4")
    assert viewer[0].poll() is None


@pytest.mark.timeout(600)
def test_a_fit_that_is_watched_is_kept(tmp_path):
    """Photon mapping at once, then fields that get better; Ctrl-C ends all and keeps the last."""
    # The file of views is where cameras will be saved: it does not have to exist.
    with (
        viewing(tmp_path, "--views", "new.yaml") as (process, address),
        open_page(PROGRAM, address, tmp_path) as page,
    ):
        page.wait_for("viewer.ready")
        end = time.monotonic() + 400
        while not page.evaluate("viewer.status.has_field && viewer.status.psnr > 20"):
            assert time.monotonic() < end, (tmp_path / "log.txt").read_text()
            time.sleep(0.5)
        drag(page)
        page.wait_for("viewer.frames > 2")
        children = subprocess.run(
            ["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=False
        ).stdout.split()
        assert children
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
        assert not any(Path(f"/proc/{child}").exists() for child in children)
        page.wait_for("document.querySelector('#message').textContent.includes('has stopped')")
    field = read_field(tmp_path / "field.safetensors")
    assert len(field.tensors["means"]) > 1000
    assert "field.safetensors: field after" in (tmp_path / "log.txt").read_text()
    with viewing(tmp_path) as (process, _):  # the same command shows it
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
    assert "field.safetensors: a field of this scene" in (tmp_path / "log.txt").read_text()
