"""How the page's camera moves: around what it shows, upright, in the whole window."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.io import save_field
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from tests.browser import open_page, wait_for
from tests.plain_field import flat_gaussians, to_device
from tests.viewing.browsing import MARKS, drag, viewing

pytestmark = MARKS

# The vertical is z, and the camera 59 units from what it looks at: its matrix says neither.
LAWN = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="40"/>
    <float name="principal_point_offset_x" value="0.05"/>
    <transform name="to_world"><lookat origin="24,-20,50" target="0,0,0" up="0,0,1"/></transform>
    <film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/>
    </film>
  </sensor>
  <shape type="rectangle"><transform name="to_world"><scale value="400"/></transform></shape>
  <emitter type="point"><point name="position" x="0" y="0" z="90"/></emitter>
</scene>
"""


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lawn")
    (folder / "scene.xml").write_text(LAWN)
    scene = mi.load_file(str(folder / "scene.xml"), optimize=False)
    x = np.stack(np.meshgrid(*2 * [np.linspace(-400, 400, 40)]), axis=-1).reshape(-1, 2)
    means = np.column_stack([x, np.zeros(len(x))])
    found = GaussianPhotonField(
        to_device(flat_gaussians(means, np.ones((len(x), 3)), size=20.0)),
        FieldSettings(search_radius=40.0),
        scene_bounds(scene),
    )
    save_field(found, folder / "field.safetensors")
    words = ("--field", str(folder / "field.safetensors"))
    with viewing(folder, *words, scene=folder / "scene.xml") as (_, address):
        yield address


def camera(page):
    wait_for(page, "viewer.frames > 2")
    return {key: np.array(value) for key, value in page.evaluate("viewer.camera").items()}


def test_it_moves_around_what_it_shows_and_stays_upright(browser, address):
    with open_page(browser, address) as page:
        wait_for(page, "viewer.ready")
        start = camera(page)
        np.testing.assert_array_equal(start["up"], [0, 0, 1])
        far = np.linalg.norm(start["origin"])
        assert np.linalg.norm(start["target"]) < 0.1 * far
        drag(page, 150)
        turned = camera(page)
        assert turned["origin"][2] == pytest.approx(start["origin"][2], rel=1e-4)
        assert np.linalg.norm(turned["origin"]) == pytest.approx(far, rel=0.1)
        assert np.linalg.norm(turned["origin"] - start["origin"]) > 0.3 * far
        page.mouse.wheel(0, -500)
        nearer = camera(page)
        assert np.linalg.norm(nearer["origin"]) == pytest.approx(np.exp(-0.5) * far, rel=0.1)
        page.keyboard.press("1")
        again = camera(page)
        np.testing.assert_allclose(again["shift"], [0.05, 0], atol=1e-6)
        np.testing.assert_array_equal(again["origin"], start["origin"])
        page.keyboard.down("w")
        wait_for(page, f"viewer.camera.origin[2] < {0.8 * start['origin'][2]}")  # a second, not 30
        page.keyboard.up("w")


def test_it_comes_down_from_the_pole(browser, address):
    """A steep drag ends above the target, and the way back is free."""
    with open_page(browser, address) as page:
        wait_for(page, "viewer.ready")
        camera(page)
        page.evaluate("orbit(0, 9); 0")
        above = camera(page)
        way = above["origin"] - above["target"]
        assert way[2] / np.linalg.norm(way) == pytest.approx(np.cos(0.1), abs=1e-3)
        page.evaluate("orbit(0.5, -0.5); 0")
        below = camera(page)
        way = below["origin"] - below["target"]
        assert way[2] / np.linalg.norm(way) == pytest.approx(np.cos(0.6), abs=1e-3)


def test_the_picture_fills_the_window_and_follows_it(browser, address):
    with open_page(browser, address, width=1200, height=500) as page:
        for width, height in ((1200, 500), (600, 700)):
            page.set_viewport_size({"width": width, "height": height})
            wait_for(page, f"Math.abs(viewer.aspect - {width / height}) < 0.02")
            box = page.evaluate(
                "document.querySelector('#screen').getBoundingClientRect().toJSON()"
            )
            assert abs(box["width"] - width) < 9 and abs(box["height"] - height) < 9
            canvas = page.evaluate("[picture.width, picture.height]")
            assert canvas[0] / canvas[1] == pytest.approx(width / height, rel=0.02)
