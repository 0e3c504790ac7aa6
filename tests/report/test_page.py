"""The HTML page: complete in one file, within its size limit, with texts for all parts."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.files import read_json, write_json
from report.figures.sketch import Figure
from report.page import write_page
from report.page.books import make_books, order_views
from report.page.pictures import PRECISION, Picture
from report.page.words import describe_best, describe_scene, find_worse_metrics, main_numbers
from report.results import Results
from report.tables import make_tables
from tests.report.made_up import BOX, WATER, edit, made_up_params, make_results
from tests.report.pictured import make_figure, make_pictured, radiance
from tests.report.test_pictures import decode

ENOUGH = 10_000_000


class Reader(HTMLParser):
    """Elements with their attributes, texts and scripts; asserts that all elements are closed."""

    VOID = ("meta", "link", "img", "input", "br", "source")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: dict[str, str] = {}
        self.words: list[str] = []
        self.open: list[str] = []
        self.script: str | None = None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)
        if tag in ("script", "style"):
            self.script = dict(attrs).get("id", tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, (tag, self.getpos())
        self.script = None

    def handle_data(self, data):
        if self.script:
            self.scripts[self.script] = self.scripts.get(self.script, "") + data
        else:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]


def written(path, results, tables=(), figures=(), limit=ENOUGH) -> Reader:
    """The page, written and read."""
    write_page(results, tables, figures, path, limit)
    return Reader(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Results, and the page that was written from them."""
    root = tmp_path_factory.mktemp("page")
    results = make_pictured(root / "results")
    names = ("teaser", f"comparison_{BOX}", "quality_time", "convergence")
    figures = [make_figure(root / "figures", name) for name in names]
    figures[1] = replace(figures[1], scene=BOX)
    figures.append(Figure("training", "Training", reason="no curves"))
    path = root / "report.html"
    return results, path, written(path, results, make_tables(results), figures)


def test_the_page_loads_nothing(made):
    _, path, page = made
    assert not page.open  # all elements are closed
    for tag, attributes in page.elements:
        for key in ("src", "href", "srcset", "poster", "data", "action"):
            if value := attributes.get(key):
                assert value.startswith(("data:", "#")), (tag, value)
    assert not {"iframe", "object", "embed", "base", "form"} & {tag for tag, _ in page.elements}
    code = page.scripts["script"] + page.scripts["style"]
    assert not re.search(r"https?:|@import|\burl\(|\bfetch\(|XMLHttpRequest|\bimport\b", code)
    policy = next(a["content"] for a in page.all("meta") if a.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert [p.name for p in path.parent.iterdir() if p.name.startswith(".")] == []


def test_figures_of_a_scene_are_in_its_section(made):
    _, path, _ = made
    text = path.read_text(encoding="utf-8")
    first, second = (text.index(f'id="scene-{scene}"') for scene in (BOX, WATER))
    assert first < text.index(f"Caption of comparison_{BOX}") < second
    assert text.count(f"Caption of comparison_{BOX}") == 1
    assert not first < text.index("Caption of convergence") < second


def test_every_picture_and_control_has_a_text(made):
    _, _, page = made
    images = page.all("img")
    assert len(images) == 4 + 2 * 2  # figures; each scene in the opening and for printing
    assert all(image["alt"] and image["width"] and image["height"] for image in images)
    assert {"Alt of teaser", "Alt of convergence"} <= {image["alt"] for image in images}
    assert all(canvas["aria-label"] and canvas["tabindex"] == "0" for canvas in page.all("canvas"))
    for part in (a for tag, a in page.elements if a.get("role") in ("region", "group")):
        assert part["aria-label"]
    names = [a["id"] for _, a in page.elements if "id" in a]
    assert len(names) == len(set(names))
    targets = {a["href"] for a in page.all("a")}
    assert targets <= {f"#{name}" for name in names}
    parts = ("summary", "scenes", f"scene-{BOX}", "methods", "cost", "tables", "origin")
    assert {f"#{part}" for part in parts} <= targets


def test_tables_figures_reasons_and_origin_are_there(made):
    results, _, page = made
    for table in make_tables(results):
        assert table.title in page.text
    for words in (
        "Caption of quality_time",
        "Left out: no curves",
        "Missing: RenderFormer (glass and water are beyond it)",
        "3D Gaussian splatting, 3 views",
        "Not measured yet: Veach Ajar",
        "A <processor>",
        "0123456",
        "3.9.1",
        "photons_per_pass: auto",
    ):
        assert words in page.text, words
    seeds = page.text[page.text.index("Seeds ") :]
    assert re.match(
        r"Seeds visible_region 5 reference 1 photons 2 train 3 stream 6 render 4 ", seeds
    )


def test_flip_books_hold_what_was_rendered(made):
    _, _, page = made
    content = json.loads(page.scripts["content"])
    assert [book["scene"] for book in content["books"]] == [BOX, WATER]
    for book in content["books"]:
        assert [view["name"] for view in book["views"]] == ["above", "below", "inside"]
        methods = [m["name"] for m in book["methods"]]
        assert methods[:3] == ["reference", "gpf", "second_reference"]
        assert ("splatting_3" in methods) == (book["scene"] == WATER)
        assert book["exposure"] == 1.5 and book["start"] == "gpf"
    for view in content["books"][1]["views"]:
        for method, picture in view["pictures"].items():
            packed = Picture(picture["width"], picture["height"], page.scripts[picture["id"]])
            wanted = radiance(method, view["name"])
            np.testing.assert_allclose(decode(packed), wanted, rtol=PRECISION, atol=0)
    assert content["books"][0]["views"][1]["numbers"]["gpf"]["psnr"] == 31.5


def test_typical_and_worst_views_come_first(made):
    results, _, _ = made
    order = order_views(results.scene(BOX))
    assert [name for name, _ in order] == ["above", "below", "inside"]
    assert ["typical" in order[0][1], "lowest" in order[1][1], order[2][1]] == [True, True, ""]


def test_views_that_do_not_fit_are_left_out(made, tmp_path):
    results, _, _ = made
    whole = make_books(results, ENOUGH)
    assert [len(book.views) for book in whole.books] == [3, 3]
    firsts = sum(book.views[0].size for book in whole.books)
    tight = make_books(results, firsts + whole.books[0].views[1].size)
    assert [len(book.views) for book in tight.books] == [2, 1]
    assert tight.books[1].left_out == ["below", "inside"]
    assert tight.size <= firsts + whole.books[0].views[1].size


def test_large_images_are_shrunk_until_the_page_fits(tmp_path):
    results = make_pictured(tmp_path / "results", 64, 48)
    whole = written(tmp_path / "large.html", results)
    large = (tmp_path / "large.html").stat().st_size
    # Room for one view of each scene, but not for the texts.
    limit = sum(book.views[0].size for book in make_books(results, ENOUGH).books)
    page = written(tmp_path / "small.html", results, limit=limit)
    assert (tmp_path / "small.html").stat().st_size <= limit < large
    content = json.loads(page.scripts["content"])
    sizes = {
        p["width"] for b in content["books"] for v in b["views"] for p in v["pictures"].values()
    }
    assert sizes == {32}
    assert "2 × 2 pixels became one" in page.text and "pixels became one" not in whole.text


def test_figures_larger_than_the_page_are_an_error(tmp_path):
    results = make_results(tmp_path / "results")
    figure = make_figure(tmp_path / "figures", "teaser", 300)
    with pytest.raises(UserError, match=r"report\.html.*without flip-books.*figures smaller"):
        write_page(results, [], [figure], tmp_path / "report.html", 60_000)
    assert not (tmp_path / "report.html").exists()
    figure.svg.unlink()
    with pytest.raises(UserError, match=r"teaser\.svg.*figure teaser.*gpf stage report"):
        write_page(results, [], [figure], tmp_path / "report.html")


def test_large_figures_are_compressed(tmp_path):
    results = make_results(tmp_path / "results")
    figure = make_figure(tmp_path / "figures", "teaser", 400)
    figure.svg.write_text("<svg>" + " " * 300_000 + "</svg>", encoding="utf-8")
    assert figure.png.stat().st_size > 400_000
    page = written(tmp_path / "report.html", results, figures=[figure], limit=600_000)
    (image,) = page.all("img")
    assert image["src"].startswith("data:image/webp;base64,") and len(image["src"]) < 300_000
    assert (image["width"], image["height"]) == ("403", "400")


def test_without_images_the_page_still_has_its_numbers(tmp_path):
    results = make_results(tmp_path / "results")
    page = written(tmp_path / "report.html", results, make_tables(results))
    assert page.text.count("No flip-book") == 2 and not page.all("canvas")
    assert "Table 1" in page.text


def test_the_main_numbers_are_means_over_the_scenes(made):
    results, _, _ = made
    frame = results.quality.set_index(["scene", "method"])["psnr"]
    quality, equivalent, speed, even = main_numbers(results)
    assert quality.value == f"{(frame[BOX, 'gpf'] + frame[WATER, 'gpf']) / 2:.1f}"
    means = {m: frame[:, m].mean() for m in ("path_10", "path_50", "sppm_3")}
    best = max(means, key=means.__getitem__)  # splatting has numbers in only one scene
    assert f"{means[best]:.1f} dB ({results.methods[best]})" in quality.detail
    assert equivalent.value == "17"
    assert "6 novel views" in equivalent.detail and "<3 to >30" in equivalent.detail
    assert speed.value == "40×" and "0.50 s against 20 s" in speed.detail
    assert (even.value, even.unit) == ("3", "views")


def test_metrics_in_which_others_are_better(tmp_path):
    results = make_pictured(tmp_path / "results")
    files = tmp_path / "results" / BOX / "metrics"
    for name in ("path_10", "path_50", "sppm_3", "gpf"):
        edit(
            files / f"{name}.json", mean__psnr=20.0, mean__ssim=0.5, mean__lpips=0.5, mean__flip=0.5
        )
        edit(files / f"{name}.json", mean__flip_hdr=0.5, mean__relmse=0.5)
    assert find_worse_metrics(results, BOX) == []
    edit(files / "gpf.json", mean__psnr=19.996)  # has the same text
    edit(files / "path_50.json", mean__lpips=0.4)
    edit(files / "second_reference.json", mean__ssim=0.99)  # is not compared
    results = type(results)(results.params, results.root)
    (metric,) = find_worse_metrics(results, BOX)
    assert (metric.number, metric.field) == ("LPIPS", "0.500")
    assert metric.better == [("Path tracer, 50 spp", "0.400")]
    page = written(tmp_path / "report.html", results)
    assert "Cornell Box. LPIPS 0.500 (better: Path tracer, 50 spp 0.400)." in page.text


def test_only_compared_metrics_are_called_best(tmp_path):
    results = make_pictured(tmp_path / "results")
    told = describe_best(results)
    assert (
        "in each scene the field has the best PSNR, SSIM, LPIPS, FLIP, HDR-FLIP and relMSE" in told
    )
    for file in (tmp_path / "results").glob("*/metrics/*.json"):
        if "mean" in read_json(file):
            edit(file, mean__lpips=None)
    edit(tmp_path / "results" / BOX / "metrics" / "gpf.json", mean__flip=None)
    told = describe_best(type(results)(results.params, results.root))
    assert "in each scene the field has the best PSNR, SSIM, HDR-FLIP and relMSE of all" in told
    assert "LPIPS and FLIP: not every scene has the numbers." in told


def test_a_field_that_never_pays_off(tmp_path):
    results = make_pictured(tmp_path / "results")
    file = tmp_path / "results" / BOX / "amortize.json"
    write_json(file, read_json(file) | {"break_even_views": {"SPPM": None}})
    assert describe_scene(results, results.scene(BOX)).breaks_even == "never"
    assert "never in Cornell Box" in main_numbers(results)[3].detail


def test_the_same_results_give_the_same_page(made, tmp_path):
    results, _, _ = made
    for name in ("first", "second"):
        write_page(results, make_tables(results), [], tmp_path / f"{name}.html")
    assert (tmp_path / "first.html").read_bytes() == (tmp_path / "second.html").read_bytes()


def test_without_any_scene_the_page_says_so(tmp_path):
    page = written(tmp_path / "report.html", Results(made_up_params(), tmp_path))
    assert "No scene has been measured yet: make repro" in page.text
    assert "Not measured yet: Cornell Box, Water Caustic and Veach Ajar." in page.text
