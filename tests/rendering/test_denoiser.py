"""The denoiser; what needs the library itself is left out without it."""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.rendering.denoiser import LIMIT, ImageDenoiser, blend, denoise, relative_noise
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


def test_an_image_whose_noise_nobody_sees_is_left_alone():
    rng, smear = np.random.default_rng(1), Smear()
    image, guides = rng.gamma(8, 0.1, (40, 48, 3)), (np.zeros((40, 48, 3)),) * 2
    level = image.mean(axis=2)
    assert denoise(image, guides, (0.005 * level) ** 2, smear) is image and not smear.seen
    denoise(image, guides, (0.05 * level) ** 2, smear)
    denoise(image, guides, None, smear)  # how much noise there is, is not known
    assert len(smear.seen) == 2


def test_relative_noise_is_the_share_of_the_radiance():
    image = np.full((40, 48, 3), 2.0)
    noise = [relative_noise(image, np.full((40, 48), (e * 2.0) ** 2)) for e in (0.01, 0.03, 5.0)]
    # A level that is the median of the image counts (1 + 1/16) and 1 % more.
    np.testing.assert_allclose(noise, [0.01 / 1.036, 0.03 / 1.036, 0.1], rtol=0.001)
    assert relative_noise(0 * image, np.ones((40, 48))) == 0


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
