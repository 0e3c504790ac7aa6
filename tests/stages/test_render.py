"""The stage `render`: which fields it takes, and what it says about them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gpf.core.files import read_json, read_tensors
from gpf.core.images import read_exr
from gpf.field.io import read_field
from gpf.rendering.field_renderer import WEAK_COVERAGE

FIELD = "results/cornell_box/field.safetensors"


def test_a_field_of_another_scene_is_rendered_with_a_word(finished):
    outcome = finished.stage("render")
    assert outcome.code == 0 and "another scene" not in outcome.text, outcome.text
    trained_in = read_field(finished.folder / FIELD).record["scene"]
    # A comment: whether it matters, a hash cannot know.
    finished.replace("results/cornell_box/scene/scene.xml", "</scene>", "</scene><!-- -->")
    outcome = finished.stage("render")
    assert outcome.code == 0
    assert (
        f"{FIELD} was trained in another scene, or before this scene was changed "
        f"(scene {trained_in}," in outcome.text
    )
    assert "`gpf stage train --scene cornell_box` makes a new field." in outcome.text


def test_a_compact_field_is_trained_and_rendered(finished):
    exact = read_field(finished.folder / FIELD)
    size = (finished.folder / FIELD).stat().st_size
    views = sorted((finished.results / "renders" / "gpf").glob("*.exr"))
    before = [read_exr(view)[0]["radiance"] for view in views]
    finished.edit("params.yaml", field__precision="compact")
    for stage in ("train", "render"):
        outcome = finished.stage(stage)
        assert outcome.code == 0, outcome.text
    _, metadata = read_tensors(finished.folder / FIELD, "field")
    assert metadata["precision"] == "compact"
    assert metadata["record"]["params"]["field"]["precision"] == "compact"
    assert (finished.folder / FIELD).stat().st_size < 0.4 * size
    compact = read_field(finished.folder / FIELD)
    np.testing.assert_allclose(
        compact.tensors["irradiance"], exact.tensors["irradiance"], rtol=1e-3, atol=1e-6
    )
    for view, image in zip(views, before, strict=True):
        again = read_exr(view)[0]["radiance"]
        assert np.abs(again - image).mean() < 5e-3 * image.mean(), view.name


@pytest.mark.parametrize("suppress", [False, True])
def test_fireflies_are_suppressed_as_params_say(finished, asked_to_suppress, suppress):
    finished.edit("params.yaml", render__spp=16, render__suppress_fireflies=suppress)
    assert finished.stage("render").code == 0
    assert asked_to_suppress == [suppress] * 4


def test_costs_have_memory_and_the_unit_of_time(built):
    facts = read_json(built.results / "costs" / "render.json")["facts"]
    assert 100 < facts["peak_memory_megabytes"] < 20_000
    assert 0 < facts["path_seconds"] < 10


def test_how_much_of_the_pictures_has_little_support_is_said(finished):
    outcome = finished.stage("render")
    assert outcome.code == 0
    assert re.search(r"cornell_box: \d+\.\d\d% of the pixels are weakly covered", outcome.text)
    shares = read_json(finished.results / "costs" / "render.json")["facts"]
    views = sorted((finished.results / "renders" / "gpf").glob("*.exr"))
    measured = [(read_exr(view)[0]["coverage"] > WEAK_COVERAGE).mean() for view in views]
    assert sorted(shares["weakly_covered"]) == pytest.approx(sorted(measured))


def test_pictures_of_any_view(finished):
    """By the scene's name; what the stage rendered is left alone."""
    before = finished.snapshot()
    names = [word for name in ("front", "inside") for word in ("--view", name)]
    outcome = finished.gpf("render", "cornell_box", *names, "--size", "10x8", "--spp", "4")
    assert outcome.code == 0, outcome.text
    folder = finished.results / "pictures"
    assert sorted(p.name for p in folder.iterdir()) == [
        *(f"{name}.{suffix}" for name in ("front", "inside") for suffix in ("exr", "png")),
        "transforms.json",
    ]
    layers, _ = read_exr(folder / "front.exr")
    assert layers["radiance"].shape == (8, 10, 3) and layers["radiance"].mean() > 0.05
    assert before.items() <= finished.snapshot().items()


def test_frames_of_the_camera_path(finished, tmp_path):
    out = tmp_path / "a"
    outcome = finished.gpf(
        "render", "cornell_box", "--frames", "all", "--size", "4", "--spp", "1", "-o", str(out)
    )
    assert outcome.code == 0, outcome.text
    assert len(list(out.glob("frame_*.png"))) == 24


def test_pictures_of_what_is_not_there(finished):
    outcome = finished.gpf("render", "cornell_box", "--view", "fornt")
    assert outcome.code == 2 and "front" in outcome.text
    (finished.folder / FIELD).unlink()
    outcome = finished.gpf("render", "cornell_box")
    assert outcome.code == 2 and "gpf stage train" in outcome.text


def test_a_scene_without_novel_views(finished):
    views = finished.results / "views.yaml"
    head, _, rest = views.read_text(encoding="utf-8").partition("novel:")
    _, _, path = rest.partition("path:")
    views.write_text(f"{head}novel: []\npath:{path}", encoding="utf-8")
    for stage in ("render", "metrics"):
        outcome = finished.stage(stage)
        assert outcome.code == 2 and "has no novel views" in outcome.text, outcome.text
