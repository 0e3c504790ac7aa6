"""The denoiser; what needs the library itself is left out without it."""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.rendering.denoiser import LIMIT, ImageDenoiser, blend, denoise
from tests.rendering.test_aovs import GLASS, constant_field, make_scene

SIZE = (48, 40)


def test_bright_images_keep_their_brightness():
    pytest.importorskip("pyoidn")
    albedo, normal = np.full((40, 48, 3), 0.5), np.broadcast_to((0.0, 0.0, 1.0), (40, 48, 3))
    colour = np.broadcast_to((80.0, 40.0, 20.0), (40, 48, 3)).copy()
    colour[:, 24:] /= 100
    image = ImageDenoiser(SIZE, prefilter=False).denoise(colour, albedo, normal)
    inner = np.s_[8:32, [8, 40]]
    np.testing.assert_allclose(image[inner], colour[inner], rtol=0.05)


def test_noise_of_guides_gets_into_the_image_unless_they_are_denoised():
    pytest.importorskip("pyoidn")
    rng = np.random.default_rng(5)
    albedo = np.clip(0.5 + 0.2 * rng.standard_normal((40, 48, 3)), 0, 1)
    normal = np.broadcast_to((0.0, 0.0, 1.0), (40, 48, 3))
    colour = rng.gamma(2, 0.25, (40, 48, 3))
    spread = [
        ImageDenoiser(SIZE, prefilter=p).denoise(colour, albedo, normal).std()
        for p in (False, True)
    ]
    assert spread[1] < 0.7 * spread[0]


def test_an_image_of_another_size_is_refused():
    pytest.importorskip("pyoidn")
    wrong = np.zeros((48, 40, 3), np.float32)
    with pytest.raises(ValueError, match=r"color has the shape \(48, 40, 3\)"):
        ImageDenoiser(SIZE, prefilter=False).denoise(wrong, wrong, wrong)


class Smear:
    """In place of the library: the mean of the image everywhere."""

    def __init__(self) -> None:
        self.seen = []

    def denoise(self, radiance, albedo, normal):
        self.seen.append(radiance)
        return np.full_like(radiance, radiance.mean())


@pytest.mark.parametrize("known", [True, False])
def test_noise_is_removed_however_little_of_the_image_it_covers(known):
    """One percent of it; what is known to have no noise stays as it is."""
    rng, smear = np.random.default_rng(1), Smear()
    image, guides = np.ones((100, 120, 3)), (np.zeros((100, 120, 3)),) * 2
    noisy = np.s_[60:70, 30:42]
    image[noisy] += 0.2 * rng.standard_normal((10, 12, 3))
    variance = np.zeros((100, 120))
    variance[noisy] = 0.2**2
    clean = denoise(image, guides, variance if known else None, smear)
    assert np.abs(clean[noisy] - 1).max() < 0.02
    variance[56:74, 26:46] = 1  # around it, whatever the means over a few pixels reach
    rest = np.abs(clean - image)[variance == 0].max()
    assert rest < 1e-9 if known else rest > 1e-5


def test_the_denoiser_does_not_see_how_bright_a_lamp_is():
    smear = Smear()
    image, guides = np.full((40, 48, 3), 0.5), (np.zeros((40, 48, 3)),) * 2
    image[3, 5] = 30_000
    clean = denoise(image, guides, None, smear)
    assert smear.seen[0].max() == LIMIT * 0.5
    np.testing.assert_allclose(clean[0, 0], 0.5, atol=0.05)
    np.testing.assert_allclose(clean[3, 5], 30_000 - LIMIT * 0.5, atol=1)


def rendered(spp: int, **options) -> np.ndarray:
    scene = make_scene(GLASS)
    integrator = mi.load_dict({"type": "gpf", **options})
    integrator.field = constant_field(scene)
    return np.array(mi.render(scene, integrator=integrator, spp=spp, seed=1))


def test_the_plugin_denoises_and_keeps_the_channels():
    pytest.importorskip("pyoidn")
    plain, clean = (rendered(4, aovs="depth,albedo", denoise=d) for d in (False, True))
    assert clean.shape == plain.shape and clean.shape[2] == 7
    np.testing.assert_allclose(clean[..., 3:], plain[..., 3:], rtol=1e-5, atol=1e-6)
    assert np.abs(clean[..., :3] - plain[..., :3]).max() > 0.01
    truth = rendered(1024)
    inner = truth.max(-1) < 5  # without the lamp's edges
    assert clean[..., :3][inner].mean() == pytest.approx(truth[inner].mean(), rel=0.1)


def test_without_the_package_the_plugin_says_what_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    scene, integrator = make_scene(GLASS), mi.load_dict({"type": "gpf", "denoise": True})
    integrator.field = constant_field(scene)
    with pytest.raises(UserError, match="pip install pyoidn"):
        integrator.render(scene, spp=1)


def test_the_denoiser_changes_only_what_noise_explains():
    """Left, the image is noisy; right, it has a fine pattern. The denoised image is even."""
    rng = np.random.default_rng(6)
    image = np.ones((40, 48, 3))
    image[:, :24] += 0.1 * rng.standard_normal((40, 24, 3))
    image[:, 24:] += 0.1 * (np.indices((40, 24)).sum(axis=0) % 2 * 2 - 1)[..., None]
    variance = np.zeros((40, 48))
    variance[:, :24] = 0.1**2
    blended = blend(image, np.ones_like(image), variance)
    assert np.abs(blended[:, :20] - 1).max() < 1e-6
    np.testing.assert_allclose(blended[:, 28:], image[:, 28:], rtol=1e-9)


def test_with_adaptive_samples_the_denoiser_does_less_harm(monkeypatch):
    """Glass above a floor, and edges of a lamp, in 20 columns: too few for the denoiser."""
    pytest.importorskip("pyoidn")
    truth = rendered(4096)[..., :3]
    blended = rendered(16, adaptive=True, denoise=True)[..., :3]
    monkeypatch.setattr("gpf.rendering.denoiser.blend", lambda image, clean, variance: clean)
    clean = rendered(16, adaptive=True, denoise=True)[..., :3]
    errors = [np.square(image - truth).mean() for image in (blended, clean)]
    assert errors[0] < errors[1]
    plain = rendered(16, adaptive=True)[..., :3]
    assert np.abs(blended - plain).max() > 0.01
