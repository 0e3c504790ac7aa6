"""The denoiser; what needs the library itself is left out without it."""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.rendering.denoiser import ImageDenoiser
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
