"""Films in the page: at full size, at half size, or left out."""

from __future__ import annotations

import base64
from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from gpf.core.errors import UserError
from gpf.core.files import write_json
from report.page import write_page
from report.page.books import make_books
from report.page.films import halve, open_films, share_room
from report.results import Results
from report.tables import make_tables
from tests.report.made_up import BOX, WATER, made_up_params, make_results
from tests.report.pictured import make_pictured
from tests.report.test_page import ENOUGH, Reader

FRAMES, SIZE = 3, (96, 40)


def add_film(root, scene=WATER) -> Results:
    """A film with three different frames of noise."""
    noise = np.random.default_rng(2).integers(0, 256, (FRAMES, *SIZE[::-1], 3), dtype=np.uint8)
    first, *others = map(Image.fromarray, noise)
    file = root / scene / "animation" / "animation.webp"
    file.parent.mkdir(parents=True)
    first.save(file, save_all=True, append_images=others, duration=80, loop=0)
    known = {"directly": {"change": 2.5, "share": 0.5, "noise": 2.2}}
    methods = {"gpf": known, "path_50": known, "splatting_3": {"cannot_serve": "no views"}}
    told = {"methods": methods, "noise_of_references": {}}
    write_json(root / scene / "flicker.json", told)
    animation = {"scenes": [scene], "methods": ["path_50", "splatting_3", "gpf"]}
    return Results(made_up_params(animation=animation), root)


@pytest.fixture
def results(tmp_path):
    make_pictured(tmp_path / "results")
    return add_film(tmp_path / "results")


def decode(uri: str) -> Image.Image:
    head, _, data = uri.partition(",")
    assert head == "data:image/webp;base64"
    return Image.open(BytesIO(base64.b64decode(data)))


def read(results, path, most_bytes=ENOUGH, tables=()):
    write_page(results, tables, [], path, most_bytes)
    return Reader(path.read_text(encoding="utf-8"))


def test_a_film_has_texts_and_a_still_first_frame(results, tmp_path):
    page = read(results, tmp_path / "report.html", tables=make_tables(results))
    (source,) = page.all("source")
    assert "(prefers-reduced-motion: reduce)" in source["media"]
    still = decode(source["srcset"])
    (film,) = (image for image in page.all("img") if "camera path" in image["alt"])
    moving = decode(film["src"])
    assert (moving.n_frames, moving.size, moving.info["loop"]) == (FRAMES, SIZE, 0)
    assert getattr(still, "n_frames", 1) == 1 and still.size == SIZE
    first = np.asarray(moving.convert("RGB"), dtype=float)
    assert np.abs(np.asarray(still.convert("RGB")) - first).mean() < 25
    shown = "Path tracer, 50 spp; GPF, 16 spp"
    assert film["alt"].startswith("Water Caustic: 3 frames") and film["alt"].endswith(shown)
    assert (film["width"], film["height"]) == ("96", "40")
    assert f"at the same exposure: {shown}." in page.text
    assert "Missing: 3D Gaussian splatting, 3 views (no views)." in page.text
    assert "results/water_caustic/animation/animation.mp4" in page.text
    assert "half size" not in page.text and page.text.count("Pause") == 1
    assert "Not animated yet" not in page.text and "Flicker" in page.text


def test_a_film_that_is_not_listed_is_not_shown(results):
    assert list(open_films(results)) == [WATER]
    assert open_films(Results(made_up_params(), results.root)) == {}


def test_a_scene_without_a_film(tmp_path):
    results = make_pictured(tmp_path / "results")
    page = read(results, tmp_path / "report.html")
    assert not page.all("source") and "camera path by several" not in page.text
    assert "animation.webp" not in page.text and open_films(results) == {}


def test_films_are_halved_before_views_are_left_out(results, tmp_path):
    films = open_films(results)
    assert list(films) == [WATER]
    books = make_books(results, ENOUGH).size
    full = books + films[WATER].size
    shown, shelf = share_room(results, films, full)
    assert not shown[WATER].halved and shelf.is_whole
    shown, shelf = share_room(results, films, full - 1)
    half = shown[WATER]
    assert half.halved and shelf.is_whole and half.size + shelf.size < full
    moving = decode(half.moving)
    assert (moving.n_frames, moving.size, moving.info["loop"]) == (FRAMES, (48, 20), 0)
    assert moving.tell() == 0 and decode(half.still).size == (48, 20)
    moving.seek(1)
    moving.load()
    assert moving.info["duration"] == 80
    # Its size in the page does not change.
    assert (half.width, half.height) == SIZE
    # With less room, views are left out, and then the film.
    shown, shelf = share_room(results, films, books + half.size - 1)
    assert shown[WATER].halved and shelf.shrunk == 1 and not shelf.is_whole
    firsts = sum(book.views[0].size for book in make_books(results, ENOUGH).books)
    shown, shelf = share_room(results, films, firsts)
    assert shown == {} and shelf.shrunk == 1 and shelf.size <= firsts


def test_images_are_not_shrunk_for_a_film(tmp_path):
    make_pictured(tmp_path / "results", 64, 48)
    results = add_film(tmp_path / "results")
    films = open_films(results)
    firsts = sum(book.views[0].size for book in make_books(results, ENOUGH).books)
    assert make_books(results, firsts - 1).shrunk == 2
    shown, shelf = share_room(results, films, firsts + 10)
    assert shown == {} and shelf.shrunk == 1
    # If images must be shrunk anyway, the film stays.
    shown, shelf = share_room(results, films, firsts - 1)
    assert shown[WATER].halved and shelf.shrunk == 2
    assert shown[WATER].size + shelf.size <= firsts - 1


def test_the_page_keeps_its_limit_and_says_what_is_missing(results, tmp_path, monkeypatch):
    page = read(results, tmp_path / "whole.html")
    size = (tmp_path / "whole.html").stat().st_size
    film = open_films(results)[WATER]
    limit = size - film.size // 8
    page = read(results, tmp_path / "half.html", limit)
    assert (tmp_path / "half.html").stat().st_size <= limit
    assert "Shown at half size" in page.text and len(page.all("source")) == 1
    monkeypatch.setattr(
        "report.page.page.share_room", lambda results, _, room: ({}, make_books(results, room))
    )
    page = read(results, tmp_path / "none.html")
    assert "Left out to keep this file small: the film" in page.text and not page.all("source")


def test_without_books_a_film_too_large_is_left_out(tmp_path):
    make_results(tmp_path / "results")
    results = add_film(tmp_path / "results", BOX)
    films = open_films(results)
    assert share_room(results, films, films[BOX].size)[0] == films
    half = halve(films[BOX]).size
    assert share_room(results, films, half)[0][BOX].halved
    assert share_room(results, films, half - 1)[0] == {}


def test_a_broken_film_is_an_error(results):
    file = results.root / WATER / "animation" / "animation.webp"
    file.write_bytes(file.read_bytes()[:20])
    with pytest.raises(UserError, match=r"animation\.webp.*picture.*gpf stage animate --scene wat"):
        open_films(results)
