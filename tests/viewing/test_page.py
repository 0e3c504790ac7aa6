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
from tests.browser import open_page, wait_for
from tests.commands.box import box_field
from tests.viewing.browsing import BOX, MARKS, drag, picture, viewing

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
def page(browser, viewer):
    with open_page(browser, viewer[1]) as page:
        wait_for(page, "viewer.ready && viewer.frames > 2")
        assert viewer[1].startswith("http://127.0.0.1:")
        yield page


def test_it_shows_the_scene_and_moves(page):
    assert page.evaluate("document.title") == "cornell_box"
    before = picture(page)
    assert before.mean() > 30 and before.std() > 10
    origin = page.evaluate("viewer.camera.origin")
    drag(page)
    wait_for(page, "viewer.frames > 2")
    assert page.evaluate("viewer.camera.origin") != origin
    assert np.abs(picture(page) - before).mean() > 5
    page.keyboard.press("1")
    wait_for(page, "viewer.frames > 2")
    assert np.abs(picture(page) - before).mean() < 3
    for _ in range(4):  # a busy machine leaves cameras out, but never the last of a move
        drag(page)
        wait_for(page, "viewer.frames > 2")
    assert len(page.evaluate("viewer.delays")) > 5


def test_keys_fly_and_the_panel_hides(page):
    origin = page.evaluate("viewer.camera.origin")
    page.keyboard.down("w")
    wait_for(page, f"viewer.camera.origin[2] < {origin[2]} - 0.2")
    page.keyboard.up("w")
    page.keyboard.press("h")
    assert page.evaluate("document.querySelector('#panel').hidden")


def test_exposure_and_layers_change_the_picture(page):
    before = picture(page)
    page.evaluate("document.querySelector('#stops').value = -3; look()")
    wait_for(page, "viewer.frames > 2")
    assert picture(page).mean() < 0.6 * before.mean()
    page.evaluate("document.querySelector('#layer').value = 'depth'; look()")
    wait_for(page, "viewer.frames > 2")
    page.evaluate("document.querySelector('#compare').value = 'path'; look()")
    wait_for(page, "document.querySelector('#other').width > 300")


def test_the_soft_curve_keeps_bright_places_apart(page):
    page.evaluate("document.querySelector('#stops').value = 4; look()")
    wait_for(page, "viewer.frames > 2")
    white = (picture(page) == 255).mean()
    page.evaluate("document.querySelector('#curve').value = 'soft'; look()")
    wait_for(page, "viewer.frames > 2")
    assert white > 0.2 and (picture(page) == 255).mean() < 0.3 * white


def test_one_finger_turns_and_two_come_nearer(page):
    session = page.context.new_cdp_session(page)  # Playwright's own touches are taps

    def touch(kind, *places):
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    start = np.array(page.evaluate("viewer.camera.origin"))
    touch("touchStart", (600, 400))
    touch("touchMove", (680, 400))
    touch("touchEnd")
    wait_for(page, "viewer.frames > 2")
    turned = np.array(page.evaluate("viewer.camera.origin"))
    assert np.linalg.norm(turned - start) > 0.2
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(start), rel=0.01)
    touch("touchStart", (550, 400), (650, 400))
    touch("touchMove", (450, 400), (750, 400))
    touch("touchEnd")
    wait_for(page, "viewer.frames > 2")
    assert np.linalg.norm(page.evaluate("viewer.camera.origin")) < 0.8 * np.linalg.norm(turned)


def test_pictures_cameras_and_films_are_kept(viewer, page):
    """The buttons, down to the first bytes of what they download."""
    # A script whose value is a function would be called.
    page.evaluate("window.kept = {}; download = (blob, name) => { kept[name] = blob; }; 0")
    rows = "document.querySelector('#rows')"  # few, so that the film takes seconds
    page.evaluate(f"{rows}.prepend(new Option(64)); {rows}.value = 64; look()")
    wait_for(page, "viewer.frames > 2")
    for button in ("png", "exr", "key"):
        page.evaluate(f"document.querySelector('#{button}').click()")
    drag(page)
    page.evaluate("document.querySelector('#key').click()")
    assert page.evaluate("document.querySelector('#film').textContent") == "MP4 (2 keys)"
    page.evaluate("document.querySelector('#film').click()")
    wait_for(page, "Object.keys(kept).length === 3")
    first = "Promise.all(Object.entries(kept).map(async ([name, blob]) => [name.split('.')[1], "
    first += "[...new Uint8Array(await blob.slice(0, 8).arrayBuffer())]]))"
    found = {suffix: bytes(start) for suffix, start in page.evaluate(first)}
    assert found["png"][1:4] == b"PNG" and found["mp4"][4:] == b"ftyp"
    assert found["exr"][:4] == bytes([0x76, 0x2F, 0x31, 0x01])
    before = page.evaluate("viewer.cameras.length")
    page.evaluate("document.querySelector('#save').click()")
    wait_for(page, f"viewer.cameras.length === {before + 1}")
    name = page.evaluate("viewer.cameras.at(-1).name")
    file = Path(f"/proc/{viewer[0].pid}/cwd") / "cornell_box.views.yaml"
    assert name in {view.name for view in read_views(file.resolve()).train}


def test_a_second_window_and_one_that_closes(browser, viewer, page):
    """It closes while a large picture is rendered for it."""
    for _ in range(2):
        with open_page(browser, viewer[1]) as other:
            wait_for(other, "viewer.ready")
            drag(other, 50)
            other.evaluate("document.querySelector('#rows').value = 1080; look()")
    drag(page)
    wait_for(page, "viewer.frames > 4")
    assert viewer[0].poll() is None


@pytest.mark.timeout(600)
def test_a_fit_that_is_watched_is_kept(browser, tmp_path):
    """Photon mapping at once, then fields that get better; Ctrl-C ends all and keeps the last."""
    # The file of views is where cameras will be saved: it does not have to exist.
    with (
        viewing(tmp_path, "--views", "new.yaml") as (process, address),
        open_page(browser, address, complains=True) as page,
    ):
        wait_for(page, "viewer.ready")
        end = time.monotonic() + 400
        while not page.evaluate("viewer.status.has_field && viewer.status.psnr > 20"):
            assert time.monotonic() < end, (tmp_path / "log.txt").read_text()
            time.sleep(0.5)
        drag(page)
        wait_for(page, "viewer.frames > 2")
        children = subprocess.run(
            ["pgrep", "-P", str(process.pid)], capture_output=True, text=True, check=False
        ).stdout.split()
        assert children
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
        assert not any(Path(f"/proc/{child}").exists() for child in children)
        wait_for(page, "document.querySelector('#message').textContent.includes('has stopped')")
    field = read_field(tmp_path / "field.safetensors")
    assert len(field.tensors["means"]) > 1000
    assert "field.safetensors: field after" in (tmp_path / "log.txt").read_text()
    with viewing(tmp_path) as (process, _):  # the same command shows it
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
    assert "field.safetensors: a field of this scene" in (tmp_path / "log.txt").read_text()
