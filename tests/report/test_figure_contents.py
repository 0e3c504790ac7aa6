"""Contents of figures of invented results: pixels, markers, labels."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from gpf.core.files import read_json, write_json
from report.figures.comparison import draw_comparison
from report.figures.convergence import draw_convergence
from report.figures.cumulative_cost import draw_cumulative_cost
from report.figures.novel_views import draw_novel_views
from report.figures.quality_time import draw_quality_time
from report.figures.style import marks
from report.figures.teaser import choose_view, draw_teaser
from report.figures.training import draw_training
from report.results import Results
from tests.report.drawn import (
    COST,
    CURVE,
    OTHER,
    PSNR,
    SCENE,
    SECONDS,
    at,
    colour,
    make_drawn,
    pixels,
)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return make_drawn(tmp_path_factory.mktemp("drawn") / "results")


def test_the_teaser_shows_each_method_in_its_column(results, tmp_path):
    choice = choose_view(results)
    assert choice.methods == ("sppm_3", "denoised_50", "gpf") and choice.lead == 37 - 24
    sketch = draw_teaser(results)
    shown = pixels(sketch, tmp_path)
    for column, method in enumerate((*choice.methods, "reference")):
        # A pixel of the whole image outside all frames.
        wanted = colour(method)
        for panel in (3 * column, 3 * column + 1):
            row, place = at(sketch, panel, 1, 1)
            assert np.abs(shown[row, place] - wanted).max() <= 2, method
    words = [axes.get_xlabel() for axes in sketch.canvas.axes[::3]]
    assert words == ["20.0 dB, 0.4 s", "23.0 dB, 2.5 s", "36.0 dB, 2 s", "6 s"]


def test_a_field_that_never_leads(tmp_path):
    results = make_drawn(tmp_path)
    for scene in (SCENE, OTHER):
        file = tmp_path / scene / "metrics" / "denoised_50.json"
        numbers = read_json(file)
        for view in numbers["views"].values():
            view["psnr"] = 50.0
        write_json(file, numbers)
    assert choose_view(results).lead < 0
    assert "is closest to the best of the others, " in draw_teaser(results).caption


def test_the_comparison_finds_caustic_and_error(results, tmp_path):
    sketch = draw_comparison(results, SCENE)
    shown = pixels(sketch, tmp_path)
    # For systems with two rows, the better one. EM-GMM is missing, with its reason.
    titles = [axes.get_title() for axes in sketch.canvas.axes if "dB" in axes.get_title()]
    assert [title.split("\n")[0] for title in titles[1:]] == [
        "Path tracer",
        "SPPM",
        *("Path tracer +", "GPF"),
    ]
    assert "50 spp" in titles[1] and "Missing: EM-GMM (no photons)." in sketch.caption
    assert "view far" in sketch.alt
    # Only the square where the field is black is bright in the error map.
    error = next(a for a in sketch.canvas.axes if a.get_title() == "Error of GPF")
    panel = sketch.canvas.axes.index(error)
    bright = shown[at(sketch, panel, 5.5, 21.5)].mean()
    assert bright > 150 and shown[at(sketch, panel, 30, 21.5)].mean() < 100
    # The white line of the frame around the caustic is at the right place.
    row, column = at(sketch, 0, 19.5, 10)
    assert shown[row, column - 2 : column + 3].max() > 240
    assert shown[row, column + 12].max() < 200


def test_novel_views_show_field_reference_and_error(results, tmp_path):
    sketch = draw_novel_views(results, SCENE)
    shown = pixels(sketch, tmp_path)
    for row, method in ((0, "gpf"), (1, "reference")):
        for column in (0, 1):
            place = at(sketch, 3 * row + column, 40, 28)
            assert np.abs(shown[place] - colour(method)).max() <= 2
    assert shown[at(sketch, 7, 6, 22)].mean() > 150 > 100 > shown[at(sketch, 6, 6, 22)].mean()


def test_points_of_quality_over_time_are_where_the_numbers_are(results, tmp_path):
    sketch = draw_quality_time(results)
    shown, styles = pixels(sketch, tmp_path), marks(results)
    for method, psnr in PSNR.items():
        row, column = at(sketch, 0, SECONDS[method], psnr)
        around = shown[row - 9 : row + 10, column - 9 : column + 10].reshape(-1, 3)
        if method == "gpf":
            assert (around.max(axis=1) < 30).mean() > 0.3
        hollow = styles[method]["fillstyle"] == "none"
        assert (shown[row, column].min() > 240) == hollow, method
    lines = {line.get_label(): line for line in sketch.canvas.axes[0].lines}
    curve = next(line for label, line in lines.items() if label.startswith("SPPM with"))
    assert list(curve.get_xdata()) == [0.2 * n for n in CURVE]
    assert "EM-GMM" not in lines and "GPF, 16 spp" in lines


def test_break_even_points_are_marked(results, tmp_path):
    sketch = draw_cumulative_cost(results)
    shown = pixels(sketch, tmp_path)
    for count in (9, 20, 33):
        row, column = at(sketch, 0, count, 32 + 2 * count)
        assert shown[row, column].min() > 240
        assert shown[row - 9 : row + 10, column].min() < 40
    row, column = at(sketch, 0, 50, 32 + 100)
    assert shown[row - 2 : row + 3, column].min() < 40
    assert [t.get_text() for t in sketch.canvas.axes[0].texts] == ["9", "33"]
    assert "from view 9 on" in sketch.alt and "(20 passes) from view 20 on" in sketch.caption


def test_sppm_that_does_not_reach_the_psnr_has_no_line(results, tmp_path):
    shutil.copytree(results.root, tmp_path / "results")
    passes = {"SPPM": 30, "SPPM at equal quality": ">30"}
    for scene in (SCENE, OTHER):
        write_json(tmp_path / "results" / scene / "amortize.json", COST | {"passes": passes})
    sketch = draw_cumulative_cost(Results(results.params, tmp_path / "results"))
    labels = [line.get_label() for line in sketch.canvas.axes[0].lines[:3]]
    assert labels == ["GPF", "SPPM, 30 passes", "SPPM, views together"]
    assert [t.get_text() for t in sketch.canvas.axes[0].texts] == ["9", "33"]
    assert "which has a lower PSNR" in sketch.alt


def test_the_level_of_the_field_crosses_the_curve(results, tmp_path):
    sketch = draw_convergence(results)
    shown = pixels(sketch, tmp_path)
    passes = 10 * 3 ** ((37 - 31) / (41 - 31))
    assert shown[at(sketch, 0, passes, 37)].max() < 30
    assert f"like SPPM with {passes:.0f} passes" in sketch.alt
    row, column = at(sketch, 0, 3, 21)
    assert shown[row, column, 2] > shown[row, column, 0] + 60


def test_training_curves_are_those_of_the_files(results, tmp_path):
    sketch = draw_training(results)
    shown = pixels(sketch, tmp_path)
    assert shown[at(sketch, 0, 50, 0.2)].max() < 40 and shown[at(sketch, 0, 100, 0.1)].max() < 40
    assert shown[at(sketch, 0, 120, 0.18)].min() > 220


def test_without_held_out_points_there_is_no_curve(tmp_path):
    """With `train.held_out: 0`, training logs an error of 0 for held-out points."""
    results = make_drawn(tmp_path)
    for scene in (SCENE, OTHER):
        file = tmp_path / scene / "training" / "plots" / "metrics" / "held_out_error.tsv"
        file.write_text("step\theld_out_error\n50\t0.0\n100\t0.0\n150\t0.0\n")
    sketch = draw_training(results)
    (line,) = sketch.canvas.axes[0].lines
    assert line.get_label() == "training points"
    assert "Water Caustic: 0.033" in sketch.alt
