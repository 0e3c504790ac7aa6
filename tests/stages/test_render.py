"""The stage `render`: which fields it takes, and what it says about them."""

from __future__ import annotations

import numpy as np

from gpf.artifacts import read_tensors
from gpf.field_files import read_field
from gpf.images import read_exr

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
        f"{FIELD} was trained in another scene, or before this one was changed (scene {trained_in},"
        in outcome.text
    )
    assert "`gpf stage train --scene cornell_box` makes a new field." in outcome.text


def test_a_compact_field_is_trained_and_rendered(finished):
    exact = read_field(finished.folder / FIELD)
    size = (finished.folder / FIELD).stat().st_size
    views = sorted((finished.results / "renders" / "gpf").glob("*.exr"))
    before = [read_exr(view, "render")[0]["radiance"] for view in views]
    finished.edit("params.yaml", field__precision="compact")
    for stage in ("train", "render"):
        outcome = finished.stage(stage)
        assert outcome.code == 0, outcome.text
    _, metadata = read_tensors(finished.folder / FIELD, "field", "train")
    assert metadata["precision"] == "compact"
    assert metadata["record"]["params"]["field"]["precision"] == "compact"
    assert (finished.folder / FIELD).stat().st_size < 0.4 * size
    compact = read_field(finished.folder / FIELD)
    np.testing.assert_allclose(
        compact.tensors["irradiance"], exact.tensors["irradiance"], rtol=1e-3, atol=1e-6
    )
    for view, image in zip(views, before, strict=True):
        again = read_exr(view, "render")[0]["radiance"]
        assert np.abs(again - image).mean() < 5e-3 * image.mean(), view.name
