"""Images in parts or for a time, and the scene's own camera."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from baselines import sampling
from baselines.options import BaselineOptions
from baselines.protocol import CannotServe
from baselines.sampling import Samples, own_camera, render_in_batches
from gpf.core.structs import from_numpy
from gpf.rendering.batches import split_samples
from gpf.scene.sensors import make_sensor
from tests.baselines.classical import INSIDE, SIZE, lit_floor, task_for
from tests.furnace import camera, furnace


@pytest.mark.parametrize(
    ("spp", "pixels", "largest", "parts"),
    [
        (50, 48, 1 << 26, [50]),
        (50, 48, 48 * 50, [50]),
        (50, 48, 48 * 20, [16, 17, 17]),
        (7, 48, 48 * 3 + 47, [2, 2, 3]),
        (3, 48, 10, [1, 1, 1]),  # a part has a sample per pixel at least
    ],
)
def test_samples_are_split_evenly(spp, pixels, largest, parts):
    assert split_samples(spp, pixels, largest) == parts


def test_parts_are_independent_of_each_other():
    scene = mi.load_dict(furnace("point"))
    path = mi.load_dict({"type": "path"})
    sensor = make_sensor(INSIDE, *SIZE)

    def images(largest: int) -> np.ndarray:
        return np.stack([render_in_batches(scene, path, sensor, 7, k, largest) for k in range(40)])

    whole, parts = images(1 << 26), images(2 * 48)
    assert parts.shape == (40, 6, 8, 3)
    assert parts.dtype == np.float32
    assert parts.mean() == pytest.approx(1, abs=0.01)
    # Four parts with the same numbers would have four times the variance.
    ratio = parts.var(0).mean() / whole.var(0).mean()
    assert 0.7 < ratio < 1.5


def test_parts_weigh_what_they_have(monkeypatch):
    def fake(*args, spp, **more):
        return from_numpy(mi.TensorXf, np.full((6, 8, 3), spp, np.float32))

    monkeypatch.setattr(mi, "render", fake)
    sensor = make_sensor(INSIDE, *SIZE)
    image = render_in_batches(None, None, sensor, 5, seed=1, largest=3 * 48)
    np.testing.assert_allclose(image, np.full((6, 8, 3), (2 * 2 + 3 * 3) / 5), rtol=1e-6)


def test_the_own_camera_is_that_of_the_scene_with_another_film():
    task = task_for(lit_floor(sensor=camera((1, -2, 0.5), (0.2, 0.1, 0), 33, (16, 12))))
    mine, own = own_camera(task), task.scene.sensors()[0]
    assert tuple(mine.film().crop_size()) == SIZE
    place = mi.Point2f([0.1, 0.7, 0.9], [0.2, 0.4, 0.8])
    rays = [s.sample_ray(mi.Float(0), mi.Float(0), place, mi.Point2f(0))[0] for s in (mine, own)]
    np.testing.assert_allclose(rays[0].d.numpy(), rays[1].d.numpy(), atol=1e-5)
    # They begin at different near clips on the same lines.
    apart = rays[0].o - rays[1].o
    np.testing.assert_allclose(dr.cross(apart, rays[1].d).numpy(), 0, atol=1e-6)
    assert dr.all(dr.norm(apart) < 0.01)


def test_a_scene_without_a_camera_is_refused_in_words():
    with pytest.raises(CannotServe, match="analytic: has no perspective camera .* Add a <sensor>"):
        own_camera(task_for(lit_floor()))


def test_what_else_a_view_takes_is_off_its_time(monkeypatch):
    asked = []
    known = np.zeros((2, 3, 3)), 7
    monkeypatch.setattr(
        sampling,
        "sample_for",
        lambda seconds, trace, alike: (asked.append(seconds), known)[1],
    )
    samples = Samples(None, 3.0)
    assert samples.spp == 0
    samples.trace(lambda spp, seed: known[0], 1, spent=0.5)
    assert asked == [2.5] and samples.spp == 7
    fixed = Samples(4)
    np.testing.assert_array_equal(fixed.trace(lambda spp, seed: np.array([spp, seed]), 9), [4, 9])
    assert fixed.spp == 4 and not fixed.taken


@pytest.mark.parametrize("system", ["path_tracer", "particle_tracer", "denoised"])
def test_rows_of_params_may_ask_for_equal_time(system):
    row = {"system": system, "spp": "equal_time"}
    options = TypeAdapter(BaselineOptions).validate_python(row)
    assert options.waits_for_field and options.title.endswith(", equal time")
    assert not options.model_copy(update={"spp": 8}).waits_for_field
    with pytest.raises(ValidationError, match="equal_time"):
        TypeAdapter(BaselineOptions).validate_python(row | {"spp": "as long"})
