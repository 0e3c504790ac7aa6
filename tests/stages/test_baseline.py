"""Stage `baseline`: images, costs, reasons for their absence, and preparations that go on."""

from __future__ import annotations

import csv
from dataclasses import dataclass, field

import numpy as np
import pytest

from baselines.protocol import CannotServe, Task
from gpf.core.files import read_json, write_text
from gpf.core.images import read_exr


@dataclass
class Grey:
    """A system that knows one colour, and needs three steps to find it."""

    task: Task
    facts: dict[str, float] = field(default_factory=lambda: {"steps": 3.0})
    storage_bytes: int = 12

    def render(self, view, seed):
        width, height = self.task.size
        return np.full((height, width, 3), 0.25, np.float32)


class Stubborn:
    """Fails once after its first step, and goes on from there."""

    steps: list[int] = []  # noqa: RUF012

    def __init__(self, options):
        self.options = options

    def prepare(self, task):
        mark = task.state / "step.txt"
        for step in range(int(mark.read_text()) if mark.exists() else 0, 3):
            self.steps.append(step)
            write_text(mark, str(step + 1))
            task.report(step + 1, 3)
            if len(self.steps) == 1:
                raise KeyboardInterrupt
        return Grey(task)


@pytest.fixture
def stubborn(monkeypatch):
    monkeypatch.setattr("stages.baseline.make_baseline", Stubborn)
    monkeypatch.setattr(Stubborn, "steps", [])


def test_images_costs_and_numbers(built):
    images = sorted((built.results / "renders" / "path_10").glob("*.exr"))
    assert [path.stem for path in images] == ["above", "ceiling", "floor", "inside"]
    layers, record = read_exr(images[0])
    assert layers["radiance"].shape == (16, 20, 3) and record["options"]["spp"] == 10
    cost = read_json(built.results / "costs" / "baselines" / "path_10.json")
    assert set(cost["parts"]) == {"prepare", "render"}
    assert cost["facts"]["storage_megabytes"] == 0 and cost["facts"]["views"] == 4
    assert 100 < cost["facts"]["peak_memory_megabytes"] < 20_000
    assert 0 < cost["facts"]["path_seconds"] < 10
    summary = read_json(built.results / "summary.json")
    assert list(summary) == ["gpf", "path_10", "second_reference"]
    assert 5 < summary["path_10"]["psnr"] < 40


def test_an_unknown_method_is_said_in_words(finished):
    outcome = finished.gpf("stage", "baseline", "--scene", "cornell_box", "--method", "path_11")
    assert outcome.code == 2
    assert "method 'path_11': does not exist. Did you mean 'path_10'?" in outcome.text


@pytest.mark.parametrize("go_on", [True, False])
def test_a_reason_takes_the_place_of_images(finished, go_on):
    """Also of those that a system made when it still could."""
    finished.edit("params.yaml", baselines__path_10__scenes=["veach_ajar"])
    arguments = ["stage", "baseline", "--scene", "cornell_box", "--method", "path_10"]
    outcome = finished.gpf(*arguments, *(["--go-on"] if go_on else []))
    assert outcome.code == (0 if go_on else 2)
    assert "not requested. Add cornell_box there" in outcome.text
    assert not list((finished.results / "renders" / "path_10").glob("*.exr"))
    assert finished.stage("metrics").code == 0
    report = read_json(finished.results / "metrics" / "path_10.json")
    assert report == {"cannot_serve": "not requested"}
    with (finished.results / "quality.csv").open() as table:
        rows = {row["method"]: row for row in csv.DictReader(table)}
    assert rows["path_10"]["psnr"] == "" and rows["path_10"]["reason"] == "not requested"
    assert float(rows["gpf"]["psnr"]) > 10 and rows["gpf"]["reason"] == ""


def test_training_views_without_images(finished):
    row = {"system": "splatting", "views": 10}
    finished.edit("params.yaml", baselines__splatting_10=row)
    outcome = finished.gpf(
        "stage", "baseline", "--scene", "cornell_box", "--method", "splatting_10"
    )
    assert outcome.code == 2
    assert "10 training views with images are needed, but only 3" in outcome.text


def test_a_method_that_is_not_listed_any_more_has_no_numbers(finished):
    finished.edit("params.yaml", methods__classical=[])
    assert finished.stage("metrics").code == 0
    assert set(read_json(finished.results / "summary.json")) == {
        "gpf",
        "second_reference",
    }
    assert not (finished.results / "metrics" / "path_10.json").exists()


def test_a_preparation_that_was_stopped_goes_on(finished, stubborn):
    arguments = ["stage", "baseline", "--scene", "cornell_box", "--method", "path_10"]
    assert finished.gpf(*arguments).code == 130
    assert finished.gpf(*arguments).code == 0
    assert Stubborn.steps == [0, 1, 2]
    cost = read_json(finished.results / "costs" / "baselines" / "path_10.json")
    assert cost["facts"]["steps"] == 3 and cost["facts"]["storage_megabytes"] == 12e-6
    assert not (finished.results / "checkpoints").exists()


def test_what_a_stopped_run_left_for_other_options_is_no_use(finished, stubborn):
    arguments = ["stage", "baseline", "--scene", "cornell_box", "--method", "path_10"]
    assert finished.gpf(*arguments).code == 130
    finished.edit("params.yaml", baselines__path_10__spp=11)
    assert finished.gpf(*arguments).code == 0
    assert Stubborn.steps == [0, 0, 1, 2]


def test_a_reason_says_where_and_what_to_do(finished, monkeypatch):
    def refuse(options):
        raise CannotServe("somewhere", "package not installed: thing", "pip install thing")

    monkeypatch.setattr("stages.baseline.make_baseline", refuse)
    outcome = finished.gpf("stage", "baseline", "--scene", "cornell_box", "--method", "path_10")
    assert outcome.code == 2
    assert "somewhere: package not installed: thing. pip install thing" in outcome.text


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"methods__classical": ["path_11"]}, r"is not in baselines. Did you mean 'path_10'"),
        ({"methods__classical": ["path_10", "path_10"]}, "more than once"),
        ({"baselines__gpf": {"system": "path_tracer"}}, "Give the row another name"),
        ({"baselines__path_10__spp": 0}, "baselines.path_10"),
        ({"baselines__path_10__passes": 3}, "is an unknown key. Known keys are scenes, spp, sys"),
        ({"baselines__path_10__system": "path_trace"}, "path_trace"),
    ],
)
def test_bad_rows(finished, changes, words):
    finished.edit("params.yaml", **changes)
    outcome = finished.stage("metrics")
    assert outcome.code == 2
    assert words in outcome.text, outcome.text
