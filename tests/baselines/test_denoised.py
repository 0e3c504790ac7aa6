"""Path tracing with a denoiser; what needs the library itself is left out without it."""

from __future__ import annotations

import sys
import time

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from baselines.denoised import baseline
from baselines.denoised.baseline import Denoised
from baselines.options import DenoisedOptions, PathTracerOptions
from baselines.path_tracer import PathTracer
from baselines.protocol import CannotServe
from gpf.scene.views import View
from tests.baselines.classical import task_for
from tests.furnace import cornell_box

FRONT = View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), up=(0, 1, 0), fov=39.3)
SIZE = (48, 40)


def prepare(spp, scene=None, **task):
    options = DenoisedOptions(system="denoised", spp=spp)
    return Denoised(options).prepare(task_for(scene or cornell_box(), SIZE, **task))


def test_without_the_package_the_command_that_brings_it_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    with pytest.raises(CannotServe, match=r"not installed.* pip install pyoidn==2\.5\.1"):
        prepare(4)


def test_equal_time_needs_the_time_of_the_field():
    with pytest.raises(CannotServe, match="analytic: .*no equal time.*Set `seconds_per_view`"):
        prepare("equal_time")


def test_the_image_is_nearer_to_the_truth_than_a_path_tracer_of_four_times_the_samples():
    pytest.importorskip("pyoidn")
    task = task_for(cornell_box(), SIZE)

    def trace(spp, seed):
        options = PathTracerOptions(system="path_tracer", spp=spp)
        return PathTracer(options).prepare(task).render(FRONT, seed)

    truth = trace(1500, 0)
    prepared = prepare(8)
    image = prepared.render(FRONT, 1)
    assert image.shape == (40, 48, 3)
    assert image.dtype == np.float32
    assert (image >= 0).all()
    # Not the lamp and its outline: there, single samples decide on the error of both.
    dim = ~binary_dilation(truth.max(-1) > 2, np.ones((3, 3)))
    error = np.square(image - truth)[dim].mean()
    assert error < np.square(trace(32, 2) - truth)[dim].mean()
    assert image[dim].mean() == pytest.approx(truth[dim].mean(), rel=0.03)
    assert prepared.storage_bytes == 0
    assert prepared.facts["spp"] == 8
    assert prepared.facts["guides"] == "as they are"
    assert str(prepared.facts["on"]).startswith("Open Image Denoise 2")


def test_guides_are_denoised_where_there_is_glass():
    pytest.importorskip("pyoidn")
    assert prepare(1, cornell_box(glass=True)).facts["guides"] == "prefiltered"


def test_equal_time_is_time_for_samples_or_a_reason(monkeypatch):
    pytest.importorskip("pyoidn")
    times = iter([1.0, 0.5, 1.0, 0.5])
    monkeypatch.setattr(baseline, "time_of", lambda action: (action(), next(times))[1])
    with pytest.raises(CannotServe, match=r"takes 1\.5 s, .* take 1\.5 s, so .* no equal time"):
        prepare("equal_time", seconds_per_view=1.5)
    prepared = prepare("equal_time", seconds_per_view=2.5)
    start = time.perf_counter()
    image = prepared.render(FRONT, 1)
    assert time.perf_counter() - start > 1  # 2.5 s, less half a second for the denoiser
    assert prepared.facts["spp"] > 8
    dim = image.max(-1) < 2
    monkeypatch.undo()
    assert image[dim].mean() == pytest.approx(prepare(32).render(FRONT, 2)[dim].mean(), rel=0.05)
