"""The page of a scene whose lamps are kept apart: sliders, and random input."""

from __future__ import annotations

import os
import random
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.io import save_field
from gpf.field.lights import FieldLights
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.light_groups import LightGroups
from tests.browser import open_page, wait_for
from tests.plain_field import flat_gaussians, to_device
from tests.viewing.browsing import MARKS, drag, picture, viewing

pytestmark = MARKS

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


def test_a_slider_changes_its_part_of_the_picture(browser, lamps):
    with open_page(browser, lamps[1]) as page:
        wait_for(page, "viewer.ready && viewer.frames > 2")
        before = picture(page)
        assert page.evaluate("viewer.lights") == "left,right"
        move_slider(page, "left", 0)
        wait_for(page, "viewer.status.lights.left[0] === 0 && viewer.frames > 2")
        after = picture(page)
        left, right = np.s_[:, :200], np.s_[:, 300:]
        assert after[left].mean() < 0.2 * before[left].mean()
        assert after[right].mean() == pytest.approx(before[right].mean(), rel=0.02)
        # A window that is opened later shows the lights as they are.
        page.reload()
        wait_for(page, "window.viewer && viewer.ready && viewer.frames > 2")
        wait_for(page, "document.querySelector('[data-light=left]').value === '0'")
        assert np.abs(picture(page) - after).mean() < 3


def memory(process) -> float:
    """Resident memory, MB."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


def test_random_input_does_no_harm(browser, lamps):
    """The same input three times; memory ends where it was after the second."""
    with open_page(browser, lamps[1]) as page:
        wait_for(page, "viewer.ready && viewer.frames >= 8")  # the denoiser is there, too
        used = []
        for _ in range(3):
            give_random_input(page, random.Random(5))
            assert lamps[0].poll() is None
            used.append(memory(lamps[0]))
        assert used[2] < 1.15 * used[1] + 30, used


def give_random_input(page, dice):
    """As many times as GPF_RANDOM_INPUTS says, or 60; then the page is loaded again."""
    layers, others, curves = (
        page.evaluate(f"[...document.querySelector('#{menu}').options].map(o => o.value)")
        for menu in ("layer", "compare", "curve")
    )
    for _ in range(int(os.environ.get("GPF_RANDOM_INPUTS", "60"))):
        kind = dice.randrange(7)
        if kind == 0:
            page.keyboard.press(dice.choice("wasdqe123456789h"))
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
            page.mouse.move(600, 400)
            page.mouse.wheel(0, dice.randint(-3000, 3000))
        elif kind == 4:
            button = dice.choice(["save", "png", "exr", "key", "film", "clear"])
            page.evaluate(f"document.querySelector('#{button}').click()")
        elif kind == 5:
            wait_for(page, "document.querySelector('[data-light]') !== null")  # after a reload
            move_slider(page, dice.choice(["left", "right"]), dice.uniform(0, 2))
        else:
            page.reload()
            wait_for(page, "document.readyState === 'complete'")
    page.reload()
    wait_for(page, "window.viewer && viewer.ready")
