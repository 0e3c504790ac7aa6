"""Stage `train`: the ways of supervision, and what is left to the emitters."""

from __future__ import annotations

import pytest

from gpf.core.files import read_json, read_tensors, write_tensors
from gpf.core.images import read_exr
from gpf.field.io import read_field
from tests.stages.results import LEAST_PSNR, share_of_light


def assert_like_the_references(project):
    for stage in ("render", "metrics", "amortize"):
        outcome = project.stage(stage)
        assert outcome.code == 0, (stage, outcome.text)
    assert read_json(project.results / "metrics" / "gpf.json")["mean"]["psnr"] > LEAST_PSNR
    assert share_of_light(project.results) == pytest.approx(1, abs=0.12)


def test_streaming_needs_no_targets(finished, small_batches):
    """Passes of its own teach the field what the references teach it."""
    for file in ("targets.safetensors", "photons.safetensors"):
        (finished.results / file).unlink()
    finished.edit("params.yaml", train__supervision="streaming", stream__passes=12)
    outcome = finished.stage("train")
    assert outcome.code == 0, outcome.text
    cost = read_json(finished.results / "costs" / "train.json")
    assert set(cost["parts"]) == {"stream", "initialization", "training"}
    record = read_field(finished.results / "field.safetensors").record
    assert record["params"]["stream"]["passes"] == 12
    before = read_json(finished.results / "amortize.json")["preparation_seconds"]
    assert_like_the_references(finished)
    after = read_json(finished.results / "amortize.json")["preparation_seconds"]
    spent = sum(part["wall_seconds"] for part in cost["parts"].values())
    assert after == pytest.approx(spent) and after != before


def test_direct_light_left_to_the_emitters(finished):
    """The field has less, the picture is the same."""
    whole = read_field(finished.results / "field.safetensors")
    name = sorted((finished.results / "renders" / "gpf").glob("*.exr"))[0]
    before = read_exr(name)[0]["radiance"]
    finished.edit("params.yaml", field__direct="emitters")
    outcome = finished.stage("train")
    assert outcome.code == 0, outcome.text
    rest = read_field(finished.results / "field.safetensors")
    assert rest.settings.direct == "emitters"
    # Over seeds, the Gaussians have 94 to 99 % of the share that the targets have.
    targets, _ = read_tensors(finished.results / "targets.safetensors", "targets")
    left = 1 - targets["direct"].mean() / targets["irradiance"].mean()
    ratio = rest.tensors["irradiance"].mean() / whole.tensors["irradiance"].mean()
    assert ratio == pytest.approx(left, rel=0.13)
    assert_like_the_references(finished)
    after = read_exr(name)[0]["radiance"]
    # Two fields from the same photons: over seeds, one is 0.3 to 2.3 % darker.
    assert after.mean() == pytest.approx(before.mean(), rel=0.06)
    assert (after != before).any()


def test_direct_light_has_to_be_told_apart(finished):
    finished.edit("params.yaml", field__direct="emitters", reference__direct="photons")
    outcome = finished.stage("train")
    assert outcome.code == 2
    assert "Set both to emitters" in outcome.text


def test_the_number_of_gaussians_is_the_best_of_a_trial(finished, monkeypatch):
    monkeypatch.setattr("stages.config.training.MAX_GAUSSIANS", 640)
    finished.edit("params.yaml", field__gaussians="auto")
    outcome = finished.stage("train")
    assert outcome.code == 0, outcome.text
    count = read_json(finished.results / "costs" / "train.json")["facts"]["gaussians"]
    assert count in (40, 160, 640) and f"{count} Gaussians" in outcome.text
    tensors = read_field(finished.results / "field.safetensors").tensors
    assert len(tensors["means"]) == count
    errors = {}
    for fixed in (40, 160, 640):
        finished.edit("params.yaml", field__gaussians=fixed)
        assert finished.stage("train").code == 0
        record = read_json(finished.results / "costs" / "train.json")["facts"]
        errors[fixed] = record["held_out_error"]
    assert errors[count] < 1.1 * min(errors.values())


def test_targets_of_an_earlier_version_are_said_to_be_so(finished):
    path = finished.results / "targets.safetensors"
    tensors, _ = read_tensors(path, "targets")
    del tensors["direct"]
    write_tensors(path, "targets", tensors, {})
    outcome = finished.stage("train")
    assert outcome.code == 2
    assert "has no tensor direct" in outcome.text and "gpf stage reference" in outcome.text


def test_photons_that_are_all_direct_light(finished):
    path = finished.results / "photons.safetensors"
    tensors, _ = read_tensors(path, "photons")
    tensors["depth"][:] = 0
    write_tensors(path, "photons", tensors, {})
    finished.edit("params.yaml", field__direct="emitters")
    outcome = finished.stage("train")
    assert outcome.code == 2
    assert "Set field.direct to field" in outcome.text


def test_splats_without_direct_light_are_said_to_be_so(finished, tmp_path):
    finished.edit("params.yaml", field__direct="emitters")
    assert finished.stage("train").code == 0
    outcome = finished.gpf("export", "cornell_box", "--ply", str(tmp_path / "a.ply"))
    assert outcome.code == 0
    assert "does not store the direct light of all" in outcome.text
