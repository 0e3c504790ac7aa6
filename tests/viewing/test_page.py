"""The page in headless Chromium, served by `gpf view`."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.io import read_field, save_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.light_groups import LightGroups
from gpf.scene.views import read_views
from tests.browser import find_browser, open_page
from tests.commands.box import box_field
from tests.plain_field import flat_gaussians, to_device

PROGRAM = find_browser()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium on the path"),
]

BOX = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"


@contextmanager
def viewing(folder, *words, scene=BOX):
    """`gpf view` in a folder, and the address that it prints."""
    command = [sys.executable, "-m", "gpf.cli", "view", str(scene), "--no-open", *words]
    with (folder / "log.txt").open("w") as log:
        process = subprocess.Popen(
            command, cwd=folder, stdout=subprocess.PIPE, stderr=log, text=True
        )
        try:
            address = process.stdout.readline().strip()
            assert address, (folder / "log.txt").read_text()
            yield process, address
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
            process.stdout.close()


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


def picture(page) -> np.ndarray:
    """The middle of the window, (H, W, 3)."""
    return page.look(400, 200, 500, 500).astype(float)


def drag(page, way=120, button="left"):
    page.point(650, 450, "mousePressed", button=button, buttons=1, clickCount=1)
    for k in range(12):
        page.point(650 + way * k / 11, 450, "mouseMoved", button=button, buttons=1)
        time.sleep(0.02)
    page.point(650 + way, 450, "mouseReleased", button=button)


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


TWO_LAMPS = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0,0,4" target="0,0,0" up="0,1,0"/></transform>
    <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/>
    </film>
  </sensor>
  <shape type="rectangle" id="floor"><transform name="to_world"><scale value="2"/></transform>
    <bsdf type="diffuse"/></shape>
  <emitter type="point" id="left"><point name="position" x="-9" y="0" z="1"/>
    <rgb name="intensity" value="1,1,1"/></emitter>
  <emitter type="point" id="right"><point name="position" x="9" y="0" z="1"/>
    <rgb name="intensity" value="1,1,1"/></emitter>
</scene>
"""


@pytest.fixture(scope="module")
def lamps(tmp_path_factory):
    """A floor whose left half has the light of one lamp, and its right half that of another."""
    folder = tmp_path_factory.mktemp("lamps")
    (folder / "scene.xml").write_text(TWO_LAMPS)
    scene = mi.load_file(str(folder / "scene.xml"), optimize=False)
    x = np.stack(np.meshgrid(*2 * [np.linspace(-2, 2, 60)]), axis=-1).reshape(-1, 2)
    means = np.column_stack([x, np.zeros(len(x))])
    parts = np.repeat(np.stack([x[:, 0] < 0, x[:, 0] > 0])[..., None], 3, axis=2)
    lights = FieldLights(LightGroups.each(scene), parts.astype(np.float32))
    found = GaussianPhotonField(
        to_device(flat_gaussians(means, np.ones((len(x), 3)), size=0.1)),
        FieldSettings(search_radius=0.2),
        scene_bounds(scene),
        lights=lights,
    )
    save_field(found, folder / "field.safetensors")
    words = ("--field", str(folder / "field.safetensors"))
    with viewing(folder, *words, scene=folder / "scene.xml") as found:
        yield found


def move_slider(page, name, value):
    page.evaluate(
        f"(() => {{ const s = document.querySelector('[data-light={name}]'); s.value = {value};"
        "s.dispatchEvent(new Event('input')); })()"
    )


def test_a_slider_changes_its_part_of_the_picture(lamps, tmp_path):
    with open_page(PROGRAM, lamps[1], tmp_path) as page:
        page.wait_for("viewer.ready && viewer.frames > 2")
        before = picture(page)
        assert page.evaluate("viewer.lights") == "left,right"
        move_slider(page, "left", 0)
        page.wait_for("viewer.status.lights.left[0] === 0 && viewer.frames > 2")
        after = picture(page)
        left, right = np.s_[:, :200], np.s_[:, 300:]
        assert after[left].mean() < 0.2 * before[left].mean()
        assert after[right].mean() == pytest.approx(before[right].mean(), rel=0.02)
        # A window that is opened later shows the lights as they are.
        page.call("Page.reload")
        page.wait_for("window.viewer && viewer.ready && viewer.frames > 2")
        page.wait_for("document.querySelector('[data-light=left]').value === '0'")
        assert np.abs(picture(page) - after).mean() < 3
        assert page.complaints == []


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


def memory(process) -> float:
    """Resident memory, MB."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def test_random_input_does_no_harm(lamps, tmp_path):
    """The same input three times; memory ends where it was after the second."""
    with open_page(PROGRAM, lamps[1], tmp_path) as page:
        page.wait_for("viewer.ready && viewer.frames > 2")
        used = []
        for _ in range(3):
            give_random_input(page, random.Random(5))
            assert lamps[0].poll() is None
            used.append(memory(lamps[0]))
        assert used[2] < 1.15 * used[1] + 30, used
        assert page.complaints == []


def give_random_input(page, dice):
    """As many times as GPF_RANDOM_INPUTS says, or 60; then the page is loaded again."""
    layers, others, curves = (
        page.evaluate(f"[...document.querySelector('#{menu}').options].map(o => o.value)")
        for menu in ("layer", "compare", "curve")
    )
    for _ in range(int(os.environ.get("GPF_RANDOM_INPUTS", "60"))):
        kind = dice.randrange(7)
        if kind == 0:
            page.press(dice.choice("wasdqe123456789h"))
        elif kind == 1:
            drag(page, dice.randint(-300, 300), dice.choice(["left", "right", "middle"]))
        elif kind == 2:
            page.evaluate(
                f"document.querySelector('#layer').value = '{dice.choice(layers)}';"
                f"document.querySelector('#compare').value = '{dice.choice(others)}';"
                f"document.querySelector('#curve').value = '{dice.choice(curves)}';"
                f"document.querySelector('#stops').value = {dice.uniform(-6, 6)}; look()"
            )
        elif kind == 3:
            page.point(600, 400, "mouseWheel", deltaX=0, deltaY=dice.randint(-3000, 3000))
        elif kind == 4:
            button = dice.choice(["save", "png", "exr", "key", "film", "clear"])
            page.evaluate(f"document.querySelector('#{button}').click()")
        elif kind == 5:
            page.wait_for("document.querySelector('[data-light]') !== null")  # after a reload
            move_slider(page, dice.choice(["left", "right"]), dice.uniform(0, 2))
        else:
            page.call("Page.reload")
            page.wait_for("document.readyState === 'complete'")
    page.call("Page.reload")
    page.wait_for("window.viewer && viewer.ready")


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
    assert "field.safetensors: the field of this scene" in (tmp_path / "log.txt").read_text()
