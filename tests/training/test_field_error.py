"""What a field says about its error, against references that it did not learn from."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest
from scipy.stats import trim_mean

import gpf
from gpf.core.images import tone_map
from gpf.field.settings import FieldSettings
from gpf.rendering.aovs import expected_psnr
from gpf.rendering.field_renderer import FieldRenderer
from gpf.rendering.settings import RenderSettings
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings
from gpf.training.field_error import estimate_error
from gpf.training.half_colours import HalfColours
from stages.references.renderer import ReferenceRenderer
from tests.plain_field import flat_gaussians, make_field, surface_points
from tests.small_fit import make_small

VIEWS = [
    View(name="front", origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3),
    View(name="floor", origin=(0.3, 0.2, 2.5), target=(0.1, -0.9, 0), fov=40),
]
SIZE = 48, 48


@pytest.fixture(scope="module")
def scene():
    return mi.load_dict(mi.cornell_box(), optimize=False)


@pytest.fixture(scope="module")
def truth(scene):
    """Two independent references of each view, (V, 2, H, W, 3)."""
    sensors = {view.name: make_sensor(view, *SIZE) for view in VIEWS}
    settings = PassSettings(photons_per_pass=40_000, initial_radius=0.05)
    found = []
    for seed in (71, 72):
        renderer = ReferenceRenderer(scene, sensors, {}, settings, seed)
        sums = renderer.run(150)
        found.append([renderer.image(view.name, sums) for view in VIEWS])
    return np.stack(found, axis=1)


@pytest.mark.slow
def test_pixels_are_as_wrong_as_their_field_says(scene, truth, monkeypatch):
    make_small(monkeypatch, passes=20, steps=60, paths=20_000)
    sensors = [make_sensor(view, *SIZE) for view in VIEWS]
    a, b = truth[:, 0], truth[:, 1]
    mean = []
    for passes in (20, 80):
        field = gpf.fit(scene, sensors, passes=passes, seed=5)
        exposure = field.record["exposure"]
        renderer = FieldRenderer.make(scene, field, RenderSettings(spp=256), ["error"])
        layers = [renderer.render(view, SIZE, seed=1) for view in VIEWS]
        image, error = (np.stack([each[k] for each in layers]) for k in ("radiance", "error"))
        f, a_shown, b_shown = (tone_map(each, exposure) for each in (image, a, b))
        measured = -10 * np.log10(np.mean((f - a_shown) * (f - b_shown)))
        predicted = expected_psnr(image, error, exposure)
        assert predicted == pytest.approx(measured, abs=2)
        light = np.maximum((a + b).mean(axis=-1) / 2, 1e-6)
        square = ((image - a) * (image - b)).mean(axis=-1) / light**2
        lit = error > 0  # not the lamp
        worse = error > np.median(error[lit])
        # A twentieth of the pixels at either end are edges for the most part.
        wrong, right = (trim_mean(square[lit & half], 0.05) for half in (worse, ~worse))
        assert wrong > 2 * right
        mean.append(np.mean(error[lit] ** 2))
    assert mean[1] < 0.7 * mean[0]  # four times as many photons


# --- a Gaussian for each point ----------------------------------------------------------------


def error_of(colour: np.ndarray, halves: list[np.ndarray], blur: float = 0.0) -> np.ndarray:
    """Of Gaussians that are alone at their points, (N,)."""
    x, y = np.divmod(np.arange(len(colour)), 40)
    means = np.column_stack([-0.9 + 0.06 * x, 0.1 + 0.04 * y, 0 * x])
    settings = FieldSettings(search_radius=0.03, neighbours="radius")
    field = make_field(flat_gaussians(means, colour), settings)
    up = np.tile([0.0, 0.0, 1.0], (len(means), 1))
    first, second = (surface_points(means, up, half) for half in halves)
    fitted = HalfColours.fit(field, (first, second))
    return estimate_error(field, fitted, np.full(len(means), blur, np.float32))


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_what_follows_all_noise_is_as_wrong_as_the_mean_of_the_halves(noise):
    truth = np.broadcast_to([2.0, 3.0, 4.0], (1600, 3))
    rng = np.random.default_rng(1)
    halves = [truth * (1 + noise * rng.normal(size=truth.shape)) for _ in range(2)]
    colour = (halves[0] + halves[1]) / 2
    wrong = np.mean((colour - truth) ** 2) / np.mean(truth**2)
    assert np.mean(error_of(colour, halves) ** 2) == pytest.approx(wrong, rel=0.15)


def test_without_noise_the_error_is_what_is_missing():
    truth = np.broadcast_to([2.0, 3.0, 4.0], (1600, 3))
    np.testing.assert_allclose(error_of(0.8 * truth, [truth, truth]), 0.25, rtol=1e-3)


def test_the_width_of_the_kernels_is_an_error_too():
    truth = np.broadcast_to([2.0, 2.0, 2.0], (1600, 3))
    np.testing.assert_allclose(error_of(truth, [truth, truth], blur=0.09), 0.15, rtol=1e-3)
