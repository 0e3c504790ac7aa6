"""Corrections of a field's picture by gathered light."""

from __future__ import annotations

import numpy as np
import pytest

from gpf.rendering.correction import corrected, is_wrong
from gpf.rendering.denoiser import ImageDenoiser

pytest.importorskip("pyoidn")

HEIGHT, WIDTH = 96, 128
ACROSS = np.linspace(0, 1, WIDTH)[None, :, None]
TRUTH = np.broadcast_to(0.5 + ACROSS, (HEIGHT, WIDTH, 3)).astype(np.float32)
NORMAL = np.broadcast_to(np.float32([0, 0, 1]), TRUTH.shape).copy()


@pytest.fixture(scope="module")
def denoiser() -> ImageDenoiser:
    return ImageDenoiser((WIDTH, HEIGHT), prefilter=False)


def gathered(noise: float, seed: int = 0) -> np.ndarray:
    """Two pictures with independent noise, without any error."""
    rng = np.random.default_rng(seed)
    factors = rng.gamma(1 / noise**2, noise**2, (2, HEIGHT, WIDTH, 1))
    return (TRUTH * factors).astype(np.float32)


def error(picture: np.ndarray) -> float:
    return float(np.sqrt(np.mean((picture / TRUTH - 1) ** 2)))


def test_a_blotch_goes(denoiser):
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    blotch = 0.3 * np.exp(-((y - 48) ** 2 + (x - 40) ** 2) / 200)
    wrong = TRUTH * (1 + blotch[..., None]).astype(np.float32)
    assert error(corrected(wrong, gathered(0.3), NORMAL, denoiser)) < error(wrong) / 3


def test_a_wrong_level_is_found_in_the_noise(denoiser):
    wrong = np.float32(0.8) * TRUTH
    assert error(corrected(wrong, gathered(1), NORMAL, denoiser)) < 0.05


def test_noise_alone_changes_nothing_that_shows(denoiser):
    changed = corrected(TRUTH, gathered(0.5), NORMAL, denoiser)
    mean = gathered(0.5).mean(axis=0)
    assert error(changed) < 0.01 < 0.3 < error(mean)


def test_light_that_few_rays_find_is_not_lost(denoiser):
    """Half of the light is in one sample of two thousand: the field has it, most pixels not."""
    rng = np.random.default_rng(0)
    bright = rng.random((2, HEIGHT, WIDTH, 1)) < 1 / 2000
    halves = gathered(0.2) * (0.5 + 1000 * bright)
    changed = corrected(TRUTH, halves.astype(np.float32), NORMAL, denoiser)
    assert changed.mean() == pytest.approx(TRUTH.mean(), rel=0.03)
    alone = denoiser.denoise(np.minimum(halves.mean(axis=0), 30), np.ones_like(NORMAL), NORMAL)
    assert alone.mean() < 0.8 * TRUTH.mean()


def test_what_is_black_stays_black(denoiser):
    picture = TRUTH.copy()
    picture[:40] = 0
    halves = gathered(0.3)
    halves[:, :40] = 0
    changed = corrected(picture, halves, NORMAL, denoiser)
    assert np.abs(changed[:36]).max() < 0.005
    assert np.isfinite(changed).all()


def test_chance_is_seldom_an_error():
    """Few samples with much noise: products of near means scatter by more than what shows. One
    standard error is exceeded by chance in 16 % of cases."""
    found = [is_wrong(TRUTH, gathered(3, seed)) for seed in range(32)]
    assert sum(found) < 9


def test_an_error_that_shows_is_found():
    assert is_wrong(np.float32(0.95) * TRUTH, gathered(0.5))
