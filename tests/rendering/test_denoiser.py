"""The denoiser; what needs the library itself is left out without it."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.rendering.denoiser import ImageDenoiser

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
