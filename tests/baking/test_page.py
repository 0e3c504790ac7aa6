"""The page in headless Chromium shows what the renderer shows, alone and without network."""

from __future__ import annotations

from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.page import pack_rgb9e5, write_page
from gpf.baking.three_js import find_three
from gpf.core.images import tone_map, undo_tone_map
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.materials import is_glossy
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.baking.showroom import EXPOSURE, VIEWS, bake_showroom, grouped_field, showroom
from tests.browser import look, needs_browser, open_page, wait_for

SIZE = (200, 160)
SCALE = 2


@pytest.mark.parametrize("scale", [1e-3, 1, 300])
def test_colours_with_a_common_exponent(scale):
    colours = scale * np.random.default_rng(0).uniform(0, 1, (500, 3)) ** 3
    packed = pack_rgb9e5(colours)
    mantissas = np.stack([packed >> shift & 511 for shift in (0, 9, 18)], axis=-1)
    found = mantissas * 2.0 ** ((packed >> 27).astype(int)[:, None] - 15 - 9)
    least = np.maximum(colours.max(axis=1, keepdims=True) / 510, 2.0**-25)
    assert (np.abs(found - colours) <= least).all()


def test_colours_beyond_what_can_be_said():
    packed = pack_rgb9e5(np.array([[0.0, 0, 0], [1e9, 0, 1e-9], [-1, 0, 0]]))
    assert (packed & 511).tolist() == [0, 511, 0] and packed[1] >> 27 == 31


@pytest.fixture(scope="module")
def shown(tmp_path_factory) -> tuple[Path, FieldRenderer]:
    folder = tmp_path_factory.mktemp("page")
    scene = showroom(folder)
    field = grouped_field(scene)
    baked, stage, members = bake_showroom(scene, field, 512)
    text = write_page(stage, baked, EXPOSURE, "A <room>", members, find_three())
    (folder / "page.html").write_text(text)
    settings = RenderSettings(spp=64, adaptive=False, suppress_fireflies=False, denoise=False)
    return folder / "page.html", FieldRenderer.make(scene, field, settings)


@pytest.fixture(scope="module")
def page(browser, shown):
    with open_page(browser, shown[0], *SIZE, scale=SCALE) as page:
        wait_for(page, "page.ready")
        page.evaluate("document.getElementById('panel').hidden = true")
        yield page


def picture(page) -> np.ndarray:
    """The window, its pixels averaged in linear light, (H, W, 3)."""
    width, height = SIZE
    fine = undo_tone_map(look(page, 0, 0, width, height) / 255)
    step = fine.shape[0] // height
    return tone_map(fine.reshape(height, step, width, step, 3).mean(axis=(1, 3)), 1)


def choose(page, name: str) -> None:
    page.evaluate(
        """name => {
          const cameras = document.getElementById("cameras");
          cameras.selectedIndex = [...cameras.options].findIndex(option => option.text === name);
          cameras.onchange();
        }""",
        name,
    )


def move(page, label: str, value: str) -> None:
    page.evaluate(
        """([label, value]) => {
          const input = document.querySelector(`[aria-label="${label}"]`);
          input.value = value;
          input.oninput();
        }""",
        [label, value],
    )


def is_matte(scene: mi.Scene, view: View, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Pixels that show nothing but purely diffuse surfaces and the sky, (H, W)."""
    width, height = size
    fine = np.mgrid[0 : 4 * height, 0 : 4 * width].reshape(2, -1)[::-1] + 0.5
    place = mi.Point2f(fine / [[4 * width], [4 * height]])
    ray, _ = make_sensor(view, width, height).sample_ray(0.0, 0.5, place, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    bsdf = si.bsdf()
    diffuse = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse) & ~is_glossy(bsdf)
    seen = np.array(~si.is_valid() | diffuse)
    return seen.reshape(height, 4, width, 4).all(axis=(1, 3))


def compare(
    page, renderer: FieldRenderer, view: View, lights: str = "", exposure: float = EXPOSURE
) -> float:
    """PSNR against the renderer where surfaces are matte."""
    choose(page, view.name)
    renderer.integrator.lights = lights
    radiance = renderer.render(view, SIZE, 0)["radiance"]
    matte = is_matte(renderer.scene, view)
    assert matte.mean() > 0.7
    error = (picture(page) - tone_map(radiance, exposure))[matte]
    return float(-10 * np.log10(np.mean(error**2)))


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.name)
def test_it_shows_what_the_renderer_shows(page, shown, view):
    assert page.title() == "A <room>"
    assert compare(page, shown[1], view) > 35


@pytest.mark.slow
@needs_browser
def test_lamps_can_be_dimmed_and_coloured(page, shown):
    view = VIEWS[0]
    before = picture(page)
    move(page, "level of lamp", "0.25")
    move(page, "colour of sky", "#ffa040")
    try:
        assert compare(page, shown[1], view, "lamp=0.25,sky=1,#ffa040") > 35
        assert np.abs(picture(page) - before).mean() > 0.05
    finally:
        move(page, "level of lamp", "1")
        move(page, "colour of sky", "#ffffff")
    assert compare(page, shown[1], view) > 35


@pytest.mark.slow
@needs_browser
def test_exposure_counts_stops(page, shown):
    set_stops = (
        "stops => { const i = document.getElementById('stops'); i.value = stops; i.oninput(); }"
    )
    page.evaluate(set_stops, "-1")
    assert compare(page, shown[1], VIEWS[1], exposure=EXPOSURE / 2) > 35
    page.evaluate(set_stops, "0")


@pytest.mark.slow
@needs_browser
def test_it_turns_by_itself(page):
    choose(page, "front")
    before = picture(page)
    page.evaluate("document.getElementById('turn').checked = true")
    drawn = page.evaluate("page.drawn")
    wait_for(page, f"page.drawn > {drawn + 5}")
    page.evaluate("document.getElementById('turn').checked = false")
    assert np.abs(picture(page) - before).mean() > 0.003


@pytest.mark.slow
@needs_browser
def test_fingers_turn_it(page):
    choose(page, "front")
    before = picture(page)
    session = page.context.new_cdp_session(page)

    def touch(kind: str, *points: dict[str, int]) -> None:
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": list(points)})

    touch("touchStart", {"x": 90, "y": 80})
    for k in range(8):
        touch("touchMove", {"x": 90 + 5 * k, "y": 80})
    touch("touchEnd")
    assert np.abs(picture(page) - before).mean() > 0.03
    choose(page, "front")
    assert np.abs(picture(page) - before).mean() < 0.01
