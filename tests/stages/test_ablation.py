"""Variants of the field: made like the field, measured like it, and never twice."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gpf.core.files import read_json
from gpf.field.io import read_field
from tests.stages.results import NOVEL, files_below

ROWS = {
    "all": {"group": "components", "title": "all", "set": {}},
    "alike": {"group": "k", "set": {"field.k": 3}},
    "few": {"group": "gaussians", "set": {"field.gaussians": 30, "train.steps": 5}},
    "streaming": {"group": "switches", "set": {"train.supervision": "streaming"}},
    "lost": {"group": "switches", "title": "none", "set": {"train.points": "surface"}},
}


@pytest.fixture
def project(finished):
    finished.edit("params.yaml", ablations={"scenes": [], "run": [], "variants": ROWS})
    return finished


def ablate(project, variant: str, *more: str):
    return project.gpf("stage", "ablation", "--scene", "cornell_box", "--variant", variant, *more)


def result(project, variant: str) -> dict:
    return read_json(project.results / "ablations" / f"{variant}.json")


def never(monkeypatch, name: str) -> None:
    def fail(*_):
        raise AssertionError(f"{name} ran")

    monkeypatch.setattr(f"stages.ablation.{name}", fail)


def test_a_variant_is_trained_rendered_and_measured(project):
    before = project.snapshot()
    assert ablate(project, "few").code == 0
    found = result(project, "few")
    assert {k: found[k] for k in ("variant", "title", "group", "overrides", "gaussians")} == {
        "variant": "few",
        "title": "field.gaussians: 30, train.steps: 5",
        "group": "gaussians",
        "overrides": {"field.gaussians": 30, "train.steps": 5},
        "gaussians": 30,
    }
    # Measured like the field, of which it is a poor version.
    field = read_json(project.results / "metrics" / "gpf.json")
    assert found["views"].keys() == field["views"].keys() == set(NOVEL)
    assert found["mean"].keys() == field["mean"].keys()
    assert found["mean"]["psnr"] == pytest.approx(
        np.mean([view["psnr"] for view in found["views"].values()])
    )
    assert 5 < found["mean"]["psnr"] < field["mean"]["psnr"] - 0.1
    # It lies apart, whole, and nothing else was touched.
    folder = project.results / "ablations" / "few"
    stored = read_field(folder / "field.safetensors")
    assert len(stored.tensors["means"]) == 30 and stored.record["steps"] == 5
    assert found["storage_megabytes"] == (folder / "field.safetensors").stat().st_size / 1e6
    render = read_json(folder / "costs" / "render.json")
    seconds = render["parts"]["render"]["wall_seconds"]
    assert found["seconds_per_view"] == seconds / len(NOVEL)
    costs = read_json(project.results / "costs/ablations/few.json")
    assert costs["parts"].keys() == {"initialization", "training", "render", "metrics"}
    assert costs["parts"]["training"]["wall_seconds"] == found["train_seconds"] > 0
    after = project.snapshot()
    assert {name: after.get(name) for name in before} == before
    assert {name.split("/")[2] for name in after.keys() - before.keys()} == {"ablations", "costs"}


@pytest.mark.parametrize("variant", ["all", "alike"])
def test_the_field_as_it_is_is_not_made_again(project, variant, monkeypatch):
    never(monkeypatch, "fit")
    never(monkeypatch, "render_novel_views")
    outcome = ablate(project, variant)
    assert outcome.code == 0 and f"{variant} has the same parameters" in outcome.text
    found = result(project, variant)
    field = read_json(project.results / "metrics" / "gpf.json")
    assert found["same_as"] == "gpf"
    assert found["mean"] == field["mean"] and found["views"] == field["views"]
    assert found["gaussians"] == 2000
    assert files_below(project.results / "ablations" / variant) == set()


def test_all_have_as_many_gaussians_as_the_field_found_to_be_best(project, monkeypatch):
    """With `auto`, a variant searches no number of its own, and one that names it is alike."""
    never(monkeypatch, "fit")
    variants = {"named": {"group": "gaussians", "set": {"field.gaussians": 2000}}}
    project.edit("params.yaml", field__gaussians="auto", ablations__variants=variants)
    assert ablate(project, "named").code == 0
    assert result(project, "named")["same_as"] == "gpf"


def test_a_killed_run_goes_on_where_it_was(project, monkeypatch):
    with monkeypatch.context() as patch:
        never(patch, "render_novel_views")
        with pytest.raises(AssertionError, match="render_novel_views ran"):
            ablate(project, "few")
    assert not list(project.results.glob("ablations/few*"))
    with monkeypatch.context() as patch:
        never(patch, "fit")
        assert ablate(project, "few").code == 0
    assert result(project, "few")["gaussians"] == 30
    assert not (project.results / "checkpoints").exists()


def test_what_was_left_by_another_task_is_not_used(project, monkeypatch):
    with monkeypatch.context() as patch:
        never(patch, "render_novel_views")
        with pytest.raises(AssertionError):
            ablate(project, "few")
    project.edit("params.yaml", train__seed=77)
    never(monkeypatch, "fit")
    with pytest.raises(AssertionError, match="fit ran"):
        ablate(project, "few")


def test_streaming_has_the_parts_of_its_own(project, small_batches):
    assert ablate(project, "streaming").code == 0
    found = result(project, "streaming")
    parts = read_json(project.results / "costs/ablations/streaming.json")["parts"]
    assert {"stream", "training", "render"} <= parts.keys()
    learning = parts["stream"]["wall_seconds"] + parts["training"]["wall_seconds"]
    assert found["train_seconds"] == pytest.approx(learning)
    assert found["mean"]["psnr"] > 5


@pytest.mark.parametrize("go_on", [False, True])
def test_a_variant_that_cannot_run_says_so(project, go_on, environment):
    project.edit("params.yaml", reference__surface_points=0)
    assert project.stage("reference").code == 0
    outcome = ablate(project, "lost", *(["--go-on"] if go_on else []))
    assert outcome.code == (0 if go_on else 2)
    words = "train.points: 'surface' selects none of"
    assert words in outcome.text
    found = result(project, "lost")
    assert found["reason"].startswith(words) and found["title"] == "none"
    assert "mean" not in found
    assert files_below(project.results / "ablations" / "lost") == set()
    costs = read_json(project.results / "costs/ablations/lost.json")
    assert costs["facts"]["reason"] == found["reason"]


@pytest.mark.parametrize("broken", [None, "few"])
def test_all_that_are_listed_run_one_after_another(project, monkeypatch, broken):
    """Also after one that fails, which is named at the end."""
    called = []

    def run(command: list[str], **_: object) -> SimpleNamespace:
        called.append(command)
        return SimpleNamespace(returncode=2 if command[-2] == broken else 0)

    monkeypatch.setattr("stages.common.subprocesses.subprocess.run", run)
    project.edit("params.yaml", ablations__run=["few", "all"])
    outcome = project.stage("ablation")
    assert [command[-3:-1] for command in called] == [["--variant", "few"], ["--variant", "all"]]
    assert outcome.code == (2 if broken else 0)
    assert ("1 of 2 failed: few" in outcome.text) == bool(broken)


@pytest.mark.parametrize(
    ("file", "stage"),
    [
        ("reference/floor.exr", "reference"),
        ("targets.safetensors", "reference"),
        ("photons.safetensors", "photons"),
    ],
)
def test_what_is_missing_is_no_fault_of_the_variant(project, file, stage):
    (project.results / file).unlink()
    before = project.snapshot()
    outcome = ablate(project, "few", "--go-on")
    assert (
        outcome.code == 2 and f"{file}: is missing. Run `gpf stage {stage} --scene" in outcome.text
    )
    assert project.snapshot() == before


def test_an_unknown_variant_is_said_in_words(project):
    outcome = ablate(project, "fev")
    assert outcome.code == 2
    assert "variant 'fev': does not exist. Did you mean 'few'? The rows of" in outcome.text


@pytest.mark.parametrize(
    ("stage", "arguments", "words"),
    [
        ("train", ("--scene", "a", "--variant", "few"), "No such option: --variant"),
        ("train", (), "Missing option '--scene'"),
        ("report", ("--scene", "a"), "No such option: --scene"),
    ],
)
def test_options_of_other_stages(project, stage, arguments, words):
    outcome = project.gpf("stage", stage, *arguments)
    assert outcome.code == 2 and words in outcome.text
