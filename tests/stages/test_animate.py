"""Stage `animate`: frames that are kept, those that are missing, and flicker as a number."""

from __future__ import annotations

import time

import numpy as np
import pytest
from PIL import Image

from gpf.core.files import read_json, write_text
from gpf.core.images import read_exr, tone_map, write_exr
from gpf.scene.views import read_views
from metrics.flicker import change_of_noise
from stages.animation.frame_points import SeenPoints
from tests.stages.results import files_below

FRAMES = 3


class Grey:
    """A system of one colour with noise, that counts what it is asked for and may fail once."""

    asked: list[str] = []  # noqa: RUF012
    fails_at: str | None = None
    storage_bytes = 0
    facts: dict[str, float] = {}  # noqa: RUF012

    def __init__(self, options=None):
        pass

    def prepare(self, task):
        self.asked.append("prepare")
        self.size = task.size
        return self

    def render(self, view, seed):
        if view.name == Grey.fails_at:
            Grey.fails_at = None
            raise KeyboardInterrupt
        self.asked.append(view.name)
        noise = np.random.default_rng(seed).normal(size=(self.size[1], self.size[0], 1))
        return (0.2 + 0.01 * noise * np.ones(3)).astype(np.float32)


class StillField:
    """In place of the field: the same colour in every frame."""

    def __init__(self, work, spp):
        pass

    def render(self, view, size, seed):
        return {"radiance": np.full((size[1], size[0], 3), 0.3)}


@pytest.fixture
def walked(fresh, monkeypatch):
    """A scene with a short path, and systems that take no time."""
    monkeypatch.setattr("stages.baseline.make_baseline", Grey)
    monkeypatch.setattr("stages.animate.open_renderer", StillField)
    monkeypatch.setattr(Grey, "asked", [])
    fresh.replace("scenes/cornell_box/views.yaml", "frames: 24", f"frames: {FRAMES}")
    fresh.edit(
        "params.yaml",
        animation__scenes=["cornell_box"],
        animation__methods=["gpf", "path_10", "splatting_3"],
    )
    assert fresh.stage("scene").code == 0
    return fresh


def test_frames_films_and_flicker(walked):
    outcome = walked.stage("animate")
    assert outcome.code == 0, outcome.text
    folder = walked.results / "animation"
    frames = {f"{m}/{k:02d}.exr" for m in ("gpf", "path_10") for k in range(FRAMES)}
    films = {"animation.mp4", "animation.webp"}
    assert files_below(folder) == frames | films
    layers, record = read_exr(folder / "path_10" / "02.exr")
    assert layers["radiance"].shape == (16, 20, 3) and record["view"]["name"] == "frame_002"
    with Image.open(folder / "animation.webp") as picture:
        assert picture.n_frames == FRAMES
    told = read_json(walked.results / "flicker.json")["methods"]
    assert told["splatting_3"] == {"cannot_serve": "not requested"}
    assert told["gpf"]["directly"]["change"] == pytest.approx(0, abs=1e-9)
    low, high = tone_map(np.array([0.19, 0.21]), read_views(walked.results / "views.yaml").exposure)
    noise = 255 * (high - low) / 2
    assert told["path_10"]["directly"]["noise"] == pytest.approx(noise, rel=0.1)
    assert 0.1 < told["gpf"]["directly"]["share"] < 1 and "refracted" not in told["gpf"]
    assert read_json(walked.results / "costs/animate.json")["facts"] == {"frames": FRAMES}


def test_a_run_that_was_killed_goes_on(walked, monkeypatch):
    monkeypatch.setattr(Grey, "fails_at", "frame_001")
    assert walked.stage("animate").code == 130
    assert Grey.asked == ["prepare", "frame_000"]
    assert walked.stage("animate").code == 0
    assert Grey.asked == ["prepare", "frame_000", "prepare", "frame_001", "frame_002"]
    before = walked.snapshot()
    assert walked.stage("animate").code == 0
    # Nothing is prepared for nothing, and what is made anew is the same.
    assert len(Grey.asked) == 5
    after = walked.snapshot()
    made = {n for n in before if "/animation/" in n or n.endswith("/flicker.json")}
    assert all(before[name][0] == after[name][0] for name in made) and len(made) == 2 * FRAMES + 3


def test_what_changed_is_rendered_again(walked):
    assert walked.stage("animate").code == 0
    del Grey.asked[:]
    walked.edit("params.yaml", baselines__path_10__spp=11)
    assert walked.stage("animate").code == 0
    assert Grey.asked == ["prepare", "frame_000", "frame_001", "frame_002"]
    walked.edit("params.yaml", animation__methods=["gpf"])
    assert walked.stage("animate").code == 0
    folders = {path.name for path in (walked.results / "animation").glob("*/")}
    assert folders == {"gpf"}
    walked.replace("scenes/cornell_box/views.yaml", f"frames: {FRAMES}", "frames: 2")
    assert walked.stage("scene").code == 0 and walked.stage("animate").code == 0
    assert len(list((walked.results / "animation" / "gpf").iterdir())) == 2


def test_another_scene_is_not_asked_for(walked):
    walked.edit("params.yaml", animation__scenes=[])
    outcome = walked.stage("animate")
    assert outcome.code == 0 and "animation.scenes in params.yaml does not list it" in outcome.text
    assert not (walked.results / "animation").exists()


def test_a_scene_without_a_path_is_said_in_words(walked):
    views = walked.results / "views.yaml"
    text = views.read_text(encoding="utf-8")
    write_text(views, text[: text.index("path:")])
    outcome = walked.stage("animate")
    assert outcome.code == 2 and "has no camera path. Add a path" in outcome.text


def test_what_was_learned_is_kept_for_the_animation(walked, monkeypatch):
    """Of a system that learns from images, as it was left; of another, nothing."""

    class Learner(Grey):
        def prepare(self, task):
            known = task.state / "learned.txt"
            self.asked.append("again" if known.exists() else "learn")
            write_text(known, "all of it")
            return super().prepare(task)

    monkeypatch.setattr("stages.baseline.make_baseline", Learner)
    monkeypatch.setattr("stages.baseline.training_views", lambda *_: ())
    row = {"system": "splatting", "views": 3}
    walked.edit("params.yaml", baselines__splatting_3=row)
    for method in ("splatting_3", "path_10"):
        arguments = ("--scene", "cornell_box", "--method", method)
        assert walked.gpf("stage", "baseline", *arguments).code == 0
    del Grey.asked[:]
    assert walked.stage("animate").code == 0
    assert [word for word in Grey.asked if word in ("again", "learn")] == ["learn", "again"]
    kept = [path.name for path in (walked.results / "checkpoints").iterdir()]
    assert kept == ["baseline-splatting_3"]


def test_learning_for_the_animation_counts_when_the_method_is_run(walked, monkeypatch):
    class Learner(Grey):
        def prepare(self, task):
            known = task.state / "learned.txt"
            if not known.exists():
                time.sleep(0.5)
                write_text(known, "all of it")
            return super().prepare(task)

    monkeypatch.setattr("stages.baseline.make_baseline", Learner)
    monkeypatch.setattr("stages.baseline.training_views", lambda *_: ())
    walked.edit("params.yaml", baselines__splatting_3={"system": "splatting", "views": 3})
    assert walked.stage("animate").code == 0
    arguments = ("--scene", "cornell_box", "--method", "splatting_3")
    assert walked.gpf("stage", "baseline", *arguments).code == 0
    costs = read_json(walked.results / "costs/baselines/splatting_3.json")
    assert costs["parts"]["prepare"]["wall_seconds"] > 0.5


def test_of_who_learns_nothing_nothing_is_left(walked):
    assert walked.stage("animate").code == 0
    assert walked.stage("animate").code == 0
    assert not (walked.results / "checkpoints").exists()


def test_the_noise_of_references_is_that_of_the_same_kinds_of_pixels(walked, monkeypatch):
    """Left half seen directly, right half through glass; noise differs between them and what
    neither shows."""
    columns = np.arange(20)
    left, right = columns < 9, columns >= 11

    def see(scene, view, size):
        width, height = size
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        points = np.stack([x, y, 0 * x], axis=-1).astype(float)
        ways = (np.broadcast_to(half, (height, width)) for half in (left, right))
        return SeenPoints(points, *ways)

    monkeypatch.setattr("stages.animation.frame_flicker.see_points", see)
    views = read_views(walked.results / "views.yaml")
    error = np.where(left, 0.001, np.where(right, 0.002, 5.0))[None, :, None]
    layers = {"radiance": np.full((16, 20, 3), 0.3), "standard_error": error * np.ones((16, 20, 3))}
    layers = {name: layer.astype(np.float32) for name, layer in layers.items()}
    for view in views.novel:
        write_exr(walked.results / "reference" / f"{view.name}.exr", layers, {})
    assert walked.stage("animate").code == 0
    told = read_json(walked.results / "flicker.json")
    noise = told["noise_of_references"]
    assert set(noise) == {"directly", "refracted"}
    # Without the edges: 14 of 16 rows, 7 of the 9 columns of each half.
    assert noise["directly"]["share"] == noise["refracted"]["share"] == pytest.approx(98 / 320)
    ratio = noise["refracted"]["change"] / noise["directly"]["change"]
    assert ratio == pytest.approx(2, rel=0.01)
    alone = change_of_noise(*(layers[key][:, :9] for key in layers), views.exposure)
    assert noise["directly"]["change"] == pytest.approx(alone, rel=1e-5)
