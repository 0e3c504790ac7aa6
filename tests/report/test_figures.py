"""Figures of invented results: files, texts, layout, and figures without data."""

from __future__ import annotations

import shutil

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

from gpf.core.files import read_json, write_json
from report.figures import draw_figures
from report.figures.comparison import draw_comparison
from report.figures.convergence import draw_convergence
from report.figures.cumulative_cost import draw_cumulative_cost
from report.figures.novel_views import draw_novel_views
from report.figures.quality_time import draw_quality_time
from report.figures.sketch import Missing, save
from report.figures.style import marks
from report.figures.teaser import draw_teaser
from report.figures.training import draw_training
from report.results import Results
from tests.report.drawn import COST, METHODS, OTHER, SCENE, make_drawn

NAMES = [
    "teaser",
    *(f"{kind}_{scene}" for scene in (SCENE, OTHER) for kind in ("comparison", "views")),
    *("quality_time", "cumulative_cost", "convergence", "training"),
]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return make_drawn(tmp_path_factory.mktemp("drawn") / "results")


@pytest.fixture(scope="module")
def drawn(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("figures")
    return folder, draw_figures(results, folder)


# --- all figures ------------------------------------------------------------------------------


def test_all_figures_have_files_texts_and_content(drawn):
    folder, figures = drawn
    assert [figure.name for figure in figures] == NAMES
    assert all(figure.scene == figure.name.partition("_")[2] for figure in figures[1:5])
    assert not any(figure.scene for figure in (figures[0], *figures[5:]))
    shown = [figure for figure in figures if not figure.name.endswith(OTHER)]
    wanted = {f"{figure.name}.{suffix}" for figure in shown for suffix in ("svg", "png")}
    assert {path.name for path in folder.iterdir()} == wanted
    for figure in shown:
        assert not figure.reason and figure.title and len(figure.alt) > 60 and figure.caption
        image = Image.open(figure.png)
        assert image.width >= 1000
        # More dark pixels than those of a frame.
        assert np.mean(np.asarray(image.convert("L")) < 128) > 0.004, figure.name
        text = figure.svg.read_text(encoding="utf-8")
        assert "<dc:date>" not in text and text.count("<path") > 20


def test_equal_results_give_equal_files_and_others_do_not(results, drawn, tmp_path):
    folder, _ = drawn
    draw_figures(Results(results.params, results.root), tmp_path / "again")
    for path in sorted(folder.iterdir()):
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes(), path.name
    shutil.copytree(results.root, tmp_path / "results")
    write_json(tmp_path / "results" / SCENE / "amortize.json", COST | {"preparation_seconds": 50.0})
    save(draw_cumulative_cost(Results(results.params, tmp_path / "results")), "cost", "", tmp_path)
    assert (tmp_path / "cost.png").read_bytes() != (folder / "cumulative_cost.png").read_bytes()


@pytest.mark.parametrize(
    "draw",
    [
        draw_teaser,
        lambda r: draw_comparison(r, SCENE),
        lambda r: draw_novel_views(r, SCENE),
        draw_quality_time,
        draw_cumulative_cost,
        draw_convergence,
        draw_training,
    ],
)
def test_no_text_is_cut_and_no_two_meet(results, draw, tmp_path):
    sketch = draw(results)
    save(sketch, "one", "One", tmp_path)
    canvas = sketch.canvas
    width, height = canvas.get_size_inches() * canvas.dpi
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown_texts(canvas)]
    assert len(boxes) > 4
    for words, box in boxes:
        assert box.x0 > -1 and box.y0 > -1 and box.x1 < width + 1 and box.y1 < height + 1, words
    for k, (words, box) in enumerate(boxes):
        for others, other in boxes[:k]:
            assert not (box.shrunk(0.9, 0.8).overlaps(other.shrunk(0.9, 0.8))), (words, others)


def shown_texts(canvas) -> list[Text]:
    """All texts without the labels of ticks outside an axis, which are not drawn."""
    axes = [one for one in canvas.axes if one.axison]
    both = [a for one in canvas.axes for a in (one.xaxis, one.yaxis)]
    every = {id(text) for axis in both for text in axis.findobj(Text)}
    drawn = [t.label1 for one in axes for a in (one.xaxis, one.yaxis) for t in a._update_ticks()]
    drawn += [a.label for one in axes for a in (one.xaxis, one.yaxis)]
    others = [text for text in canvas.findobj(Text) if id(text) not in every]
    return [text for text in (*drawn, *others) if text.get_visible() and text.get_text().strip()]


def test_methods_differ_in_more_than_colour(results):
    styles = marks(results)
    shapes = [(s["marker"], s["fillstyle"]) for m, s in styles.items() if m != "second_reference"]
    assert len(shapes) == len(METHODS) + 1 and len(set(shapes)) == len(shapes)


# --- figures without data -------------------------------------------------------------------------


def test_a_figure_without_data_is_left_out_with_a_reason(results, tmp_path):
    shutil.copytree(results.root, tmp_path / "results")
    folder = tmp_path / "figures"
    folder.mkdir()
    (folder / "training.png").write_bytes(b"old")
    for scene in (SCENE, OTHER):
        shutil.rmtree(tmp_path / "results" / scene / "training")
        (tmp_path / "results" / scene / "metrics" / "denoised_50.json").unlink()
        (tmp_path / "results" / scene / "convergence.json").unlink()
        (tmp_path / "results" / scene / "amortize.json").unlink()
    copied = Results(results.params, tmp_path / "results")
    figures = {figure.name: figure for figure in draw_figures(copied, folder)}
    left_out = {name: figure.reason for name, figure in figures.items() if figure.reason}
    assert set(left_out) == {
        *("teaser", "cumulative_cost", "convergence", "training"),
        *(f"comparison_{OTHER}", f"views_{OTHER}"),
    }
    assert "run the stage train" in left_out["training"]
    assert "denoised path tracer" in left_out["teaser"]
    assert all(figures[n].svg is None and figures[n].png is None for n in left_out)
    drawn = {f"{n}.{s}" for n in figures if n not in left_out for s in ("svg", "png")}
    assert {path.name for path in folder.iterdir()} == drawn


def test_nothing_measured_gives_no_figure(results, tmp_path):
    empty = Results(results.params, tmp_path / "results")
    figures = draw_figures(empty, tmp_path / "figures")
    assert len(figures) == 5 and all(figure.reason for figure in figures)
    with pytest.raises(Missing, match="no method|no scene"):
        draw_quality_time(empty)


def test_numbers_of_captions_are_those_of_the_files(results, tmp_path):
    shutil.copytree(results.root, tmp_path / "results")
    path = tmp_path / "results" / SCENE / "metrics" / "gpf.json"
    report = read_json(path)
    report["views"]["far"]["psnr"] = 35.25
    write_json(path, report)
    sketch = draw_novel_views(Results(results.params, tmp_path / "results"), SCENE)
    assert "far 35.2 dB" in sketch.alt and "near 38.0 dB" in sketch.alt
