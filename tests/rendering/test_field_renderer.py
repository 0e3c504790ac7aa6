"""Views from a field."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.rendering.field_renderer import FieldRenderer, variance_of_mean
from gpf.rendering.settings import RenderSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.views import View
from tests.furnace import diffuse, floor
from tests.plain_field import flat_gaussians, to_device

VIEW = View(name="it", origin=(0, 0, 5), target=(0, 0, 0), up=(0, 1, 0), fov=40)


def make_renderer(settings: RenderSettings) -> FieldRenderer:
    scene = mi.load_dict({"type": "scene", "floor": floor(diffuse(0.5))})
    gaussians = to_device(flat_gaussians([[0, 0, 0]], [[1, 2, 3]]))
    field = GaussianPhotonField(gaussians, FieldSettings(search_radius=1.0), scene_bounds(scene))
    return FieldRenderer.make(scene, field, settings)


def test_other_numbers_of_samples_than_squares_need_no_warning(capfd):
    renderer = make_renderer(RenderSettings(spp=32))
    image = renderer.render(VIEW, (8, 8), seed=1)["radiance"]
    assert image.any()
    assert "WARN" not in "".join(capfd.readouterr())


@pytest.mark.parametrize(
    ("adaptive", "seconds", "parts"),
    [(True, 1, [1, 1, 2, 4, 8, 16]), (False, 1, [1, 1, 2]), (False, None, [3, 5])],
)
def test_an_image_is_denoised_once(monkeypatch, adaptive, seconds, parts):
    """However many parts it has: of a given time, or as many as fit into memory."""
    pytest.importorskip("pyoidn")

    def timed(seconds, trace):
        images = [spp * trace(spp, part) for part, spp in enumerate(parts)]
        return sum(images) / sum(parts), sum(parts)

    seen = []

    def denoise(image, guides, variance, denoiser):
        seen.append((image, guides, variance))
        return 0 * image + 7

    monkeypatch.setattr("gpf.rendering.field_renderer.sample_for", timed)
    monkeypatch.setattr("gpf.rendering.gpf.denoise", denoise)
    if seconds is None:
        monkeypatch.setattr("gpf.rendering.batches.split_samples", lambda *_: parts)
    settings = RenderSettings(spp=8, adaptive=adaptive, denoise=True)
    layers = make_renderer(settings).render(VIEW, (8, 6), 1, seconds)
    assert len(seen) == 1 and (layers["radiance"] == 7).all()
    image, (albedo, normal), variance = seen[0]
    assert image.shape == albedo.shape == normal.shape == (6, 8, 3) and image.any()
    assert (variance is not None) == adaptive


def test_the_variance_of_a_mean_of_parts():
    """Samples of variance 12 in parts of 4, 16 and 32, of which the first is not known."""
    known = [(16, np.full((2, 3), 12 / 16)), (32, np.full((2, 3), 12 / 32))]
    np.testing.assert_allclose(variance_of_mean(known, 52), np.full((2, 3), 12 / 52))
    assert variance_of_mean([], 4) is None
