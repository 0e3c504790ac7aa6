"""What the stages make of the emission plan, and that they notice when it changes."""

from __future__ import annotations

import json

import numpy as np

from gpf.core.files import read_tensors


def test_automatic_counts_go_through_the_pipeline(finished):
    finished.edit("params.yaml", photons__paths="auto", reference__photons_per_pass="auto")
    assert finished.stage("photons").code == 0
    facts = json.loads((finished.results / "costs/photons.json").read_text())["facts"]
    assert facts["paths"] == 100_000
    assert facts["emission_guided"] is False
    assert 2.5 < facts["photons_in_region_per_path"] < 3.5
    assert 0.5 < facts["path_efficiency"] <= 1
    _, metadata = read_tensors(finished.results / "photons.safetensors", "photons")
    assert metadata["paths"] == 100_000


def test_without_a_visible_region_photons_are_kept_everywhere(finished):
    finished.stage("photons")
    within = json.loads((finished.results / "costs/photons.json").read_text())["facts"]["stored"]
    finished.edit("params.yaml", visible_region__use=False)
    assert finished.stage("photons").code == 0
    facts = json.loads((finished.results / "costs/photons.json").read_text())["facts"]
    assert facts["stored"] > within


def test_another_training_view_moves_the_samples_of_the_surfaces(finished, no_probe):
    def samples() -> np.ndarray:
        path = finished.results / "reference/surfaces.safetensors"
        return read_tensors(path, "surfaces")[0]["position"]

    before = samples()
    views = finished.folder / "scenes/cornell_box/views.yaml"
    text = views.read_text(encoding="utf-8")
    more = "    - {name: another, origin: [0.5, -0.5, 0.9], target: [0, 0, 0], fov: 60}\n"
    views.write_text(text.replace("  novel:\n", more + "  novel:\n"), encoding="utf-8")
    assert finished.stage("scene").code == 0
    novel = {p: p.stat().st_mtime_ns for p in finished.results.glob("second_reference/*.exr")}
    assert finished.stage("reference").code == 0
    assert samples().shape != before.shape or (samples() != before).any()
    # Those of the second reference know nothing of training views.
    assert {
        p: p.stat().st_mtime_ns for p in finished.results.glob("second_reference/*.exr")
    } == novel


def test_an_image_more_than_needed_is_left_alone(finished):
    files = [finished.results / f"reference/{name}.exr" for name in ("front", "left", "right")]
    before = [file.stat().st_mtime_ns for file in files]
    finished.edit("params.yaml", reference__images=1)
    assert finished.stage("reference").code == 0
    assert [file.stat().st_mtime_ns for file in files] == before
