"""The report in headless Chromium: no network requests, and keys and buttons that work."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.core.images import tone_map
from report.figures.pictures import ERRORS
from report.page import write_page
from report.page.pictures import to_codes, to_radiance
from report.tables import make_tables
from tests.browser import look, needs_browser, open_page, wait_for
from tests.report.made_up import BOX, WATER
from tests.report.pictured import HEIGHT, WIDTH, make_figure, make_pictured, radiance
from tests.report.test_films import add_film

pytestmark = needs_browser
BOOK = f"document.querySelector('#scene-{BOX} .book')"
METHOD, VIEW = "gpf", "above"  # what a flip-book shows first


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    root = tmp_path_factory.mktemp("browser")
    make_pictured(root / "results")
    results = add_film(root / "results", BOX)
    figures = [make_figure(root, "teaser"), make_figure(root, f"comparison_{WATER}")]
    write_page(results, make_tables(results), figures, root / "report.html")
    return root / "report.html"


@pytest.fixture(scope="module")
def page(browser, file):
    with open_page(browser, file) as page:
        yield page


@pytest.fixture
def book(page):
    """The page with the first flip-book in sight, in its first state."""
    page.evaluate(f"{BOOK}.scrollIntoView({{behavior: 'instant', block: 'center'}})")
    wait_for(page, f"{BOOK}.dataset.shows !== undefined")
    page.evaluate(
        f"(() => {{ const book = {BOOK}.flipBook; book.fit(); "
        f"return book.set({{method: '{METHOD}', view: 0, stops: 0, error: false}}); }})()"
    )
    page.evaluate(f"{BOOK}.querySelector('canvas').focus({{preventScroll: true}})")
    return page


def shown(page) -> np.ndarray:
    """The first flip-book's canvas at the centre of each pixel, (H, W, 3) in [0, 1]."""
    box = page.evaluate(
        f"(() => {{ const b = {BOOK}.querySelector('canvas').getBoundingClientRect();"
        "return [b.left, b.top, b.width, b.height]; })()"
    )
    picture = look(page, *box) / 255
    scale = min(box[2] / WIDTH, box[3] / HEIGHT)
    left, top = (box[2] - WIDTH * scale) / 2, (box[3] - HEIGHT * scale) / 2
    x = (left + (np.arange(WIDTH) + 0.5) * scale).astype(int)
    y = (top + (np.arange(HEIGHT) + 0.5) * scale).astype(int)
    return picture[y[:, None], x[None, :]]


def expected(method: str, view: str = VIEW, stops: float = 0) -> np.ndarray:
    """The same, from the radiance."""
    stored = to_radiance(to_codes(radiance(method, view)))
    return tone_map(stored, 1.5 * 2**stops)


def assert_shows(page, picture: np.ndarray) -> None:
    np.testing.assert_allclose(shown(page), picture, atol=1.5 / 255)


def state(page, script: str):
    return page.evaluate(f"{BOOK}{script}")


def test_the_page_is_visible(page, book):
    page.evaluate("scrollTo({top: 0, behavior: 'instant'})")
    picture = look(page, 0, 0, 1400, 900)
    assert picture.shape == (900, 1400, 3)
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100


def test_the_picture_is_what_was_rendered(book):
    assert state(book, ".dataset.shows") == f"{VIEW}/{METHOD}"
    assert_shows(book, expected(METHOD))


def test_numbers_and_arrows_switch_methods(book):
    for key, method in {
        "1": "reference",
        "3": "second_reference",
        "ArrowLeft": "gpf",
        "4": "path_10",
    }.items():
        book.keyboard.press(key)
        wait_for(book, f"{BOOK}.dataset.shows === '{VIEW}/{method}'")
    assert_shows(book, expected("path_10"))
    assert state(book, ".querySelector('.methods :checked').value") == "path_10"
    assert "Path tracer, 10 spp" in state(book, ".querySelector('canvas').ariaLabel")
    assert "40.0 dB" in state(book, ".querySelector('.spoken').textContent")
    book.keyboard.press("v")
    wait_for(book, f"{BOOK}.dataset.shows === 'below/path_10'")
    assert_shows(book, expected("path_10", "below"))


def test_a_click_switches_methods(book):
    state(book, ".querySelector('.methods input[value=path_50]').click()")
    wait_for(book, f"{BOOK}.dataset.shows === '{VIEW}/path_50'")
    assert_shows(book, expected("path_50"))


def test_exposure_changes_pixels(book):
    book.keyboard.press(".")
    book.keyboard.press(".")
    assert state(book, ".querySelector('.exposure output').textContent") == "+1.00"
    assert_shows(book, expected(METHOD, stops=1))
    state(book, ".querySelector('.exposure button').click()")
    assert_shows(book, expected(METHOD))


def test_the_error_map_has_the_colours_of_the_figures(book):
    book.keyboard.press("e")
    assert state(book, ".querySelector('.error').ariaPressed") == "true"
    error = np.abs(expected(METHOD) - expected("reference")).mean(-1)
    assert error.min() < 0.001 and error.max() > 0.05
    np.testing.assert_allclose(shown(book), ERRORS.to_rgba(error)[..., :3], atol=0.05)
    book.keyboard.press("1")  # the error of the reference is 0
    np.testing.assert_allclose(shown(book), 0, atol=0.03)


def test_the_reference_while_a_key_is_held(book):
    book.keyboard.down("r")
    wait_for(book, f"{BOOK}.dataset.shows === '{VIEW}/reference'")
    assert_shows(book, expected("reference"))
    book.keyboard.up("r")
    wait_for(book, f"{BOOK}.dataset.shows === '{VIEW}/{METHOD}'")


def test_zoom_keeps_the_place_while_methods_change(book):
    box = state(book, ".querySelector('canvas').getBoundingClientRect().toJSON()")
    scale = min(box["width"] / WIDTH, box["height"] / HEIGHT)
    left = box["left"] + (box["width"] - WIDTH * scale) / 2
    x, y = left + 9.5 * scale, box["top"] + box["height"] / 2 + 1.5 * scale  # column 9, row 5
    book.mouse.move(x, y)
    assert state(book, ".querySelector('.place').textContent") == "x 9, y 5"
    book.mouse.wheel(0, -600)
    wait_for(book, f"{BOOK}.flipBook.place.zoom === 4")
    book.keyboard.press("1")
    wait_for(book, f"{BOOK}.dataset.shows === '{VIEW}/reference'")
    assert state(book, ".querySelector('.place').textContent") == "x 9, y 5"
    values = state(book, ".querySelector('.value').textContent").split()
    np.testing.assert_allclose(
        [float(v) for v in values], radiance("reference", VIEW)[5, 9], rtol=0.03
    )
    book.keyboard.press("f")
    assert_shows(book, expected("reference"))


def test_tables_sort_by_click_and_keyboard(page):
    table = "document.querySelector('#title-table_1_psnr').parentElement.querySelector('table')"
    column = f"[...{table}.tBodies[0].rows].map((row) => row.cells[1].dataset.value ?? '')"
    before = page.evaluate(column)
    page.evaluate(f"{table}.querySelectorAll('.sort')[1].click()")
    falling = page.evaluate(column)
    known = [float(value) for value in falling if value]
    assert known == sorted(known, reverse=True) and len(known) > 3
    assert falling[len(known) :] == [""] * (len(falling) - len(known))  # missing values last
    page.evaluate(f"{table}.querySelectorAll('.sort')[1].focus()")
    page.keyboard.press("Enter")
    rising = page.evaluate(column)
    assert [float(value) for value in rising if value] == known[::-1]
    assert (
        page.evaluate(f"{table}.querySelectorAll('th')[1].getAttribute('aria-sort')") == "ascending"
    )
    assert sorted(before) == sorted(rising) and before != rising


def test_a_film_plays_unless_reduced_motion_is_preferred(page):
    film = f"document.querySelector('#film-{BOX}')"
    page.evaluate(f"{film}.scrollIntoView({{behavior: 'instant', block: 'center'}})")
    moves = f"{film}.querySelector('img').currentSrc === {film}.querySelector('img').src"
    word = f"{film}.querySelector('button').textContent"
    still = f"{film}.querySelector('img').currentSrc === {film}.querySelector('source').srcset"
    wait_for(page, moves)
    assert page.evaluate(word) == "Pause"
    page.evaluate(f"{film}.querySelector('button').click()")
    wait_for(page, still)
    assert page.evaluate(word) == "Play"
    page.evaluate(f"{film}.querySelector('img').click()")
    wait_for(page, moves)
    page.emulate_media(reduced_motion="reduce")
    wait_for(page, still)
    page.evaluate(f"{film}.querySelector('img').click()")
    wait_for(page, moves)
    page.emulate_media(reduced_motion="no-preference")
    wait_for(page, moves)


def test_on_a_phone_in_dark_mode_the_page_fits(browser, file):
    with open_page(browser, file, 390, 844, dark=True) as phone:
        phone.evaluate(f"{BOOK}.scrollIntoView({{behavior: 'instant'}})")
        wait_for(phone, f"{BOOK}.dataset.shows !== undefined")
        assert phone.evaluate("document.documentElement.scrollWidth") == 390
        assert look(phone, 0, 0, 390, 40).mean() < 60
