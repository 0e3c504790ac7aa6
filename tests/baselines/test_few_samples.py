"""The field with few samples per pixel, as a row of the tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baselines.few_samples import FewSamples
from baselines.options import FewSamplesOptions
from baselines.protocol import CannotServe, SharedField, Task
from gpf.field.io import save_field
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.load import load_scene_file
from gpf.scene.views import View
from tests.baselines.adapters import make_task
from tests.commands.box import box_field

SOURCE = Path(__file__).parents[2] / "scenes" / "cornell_box" / "scene.xml"
VIEW = View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3)
SIZE = (40, 40)


@pytest.fixture(scope="module")
def task(tmp_path_factory) -> Task:
    scene, folder = load_scene_file(SOURCE), tmp_path_factory.mktemp("few")
    save_field(box_field(scene), folder / "field.safetensors")
    return replace(
        make_task(folder, scene, SIZE), field=SharedField(file=folder / "field.safetensors")
    )


def images(task: Task, options: FewSamplesOptions, count: int = 4) -> np.ndarray:
    prepared = FewSamples(options).prepare(task)
    assert prepared.storage_bytes > 10_000 and prepared.facts == {"spp": options.spp}
    return np.stack([prepared.render(VIEW, seed) for seed in range(count)])


def test_a_denoiser_removes_no_light(task):
    few = FewSamplesOptions(system="few_samples", spp=2, denoise=False)
    noisy = images(task, few)
    smooth = images(task, few.model_copy(update={"denoise": True}))
    assert noisy.shape == (4, *SIZE, 3) and noisy.dtype == np.float32
    assert smooth.mean() == pytest.approx(noisy.mean(), rel=0.02)
    assert (smooth != noisy).mean() > 0.5


def test_it_is_the_field_with_these_samples(task):
    few = FewSamplesOptions(system="few_samples", spp=4, denoise=False)
    field = FewSamples(few).prepare(task).renderer.integrator.field
    settings = RenderSettings(spp=4)
    expected = FieldRenderer.make(task.scene, field, settings).render(VIEW, SIZE, 0)["radiance"]
    np.testing.assert_array_equal(images(task, few, 1)[0], expected)


def test_without_the_denoiser_there_are_no_images(task, monkeypatch):
    monkeypatch.setattr("baselines.few_samples.available", lambda: False)
    with pytest.raises(CannotServe, match="pyoidn is missing"):
        FewSamples(FewSamplesOptions(system="few_samples")).prepare(replace(task, name="box"))
