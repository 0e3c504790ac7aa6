"""Errors against two noisy halves of a truth: the noise of the halves does not count."""

import numpy as np
import pytest

from metrics import image
from metrics.halves import Halves


def blurred(rng, side):
    coarse = rng.uniform(0.3, 0.8, (side // 8, side // 8, 3))
    return coarse.repeat(8, axis=0).repeat(8, axis=1)


def noisy(rng, truth, strength):
    return truth + strength * rng.normal(size=truth.shape)


def test_the_noise_of_the_halves_does_not_count():
    rng = np.random.default_rng(1)
    truth = blurred(rng, 256)
    halves = Halves(noisy(rng, truth, 0.03), noisy(rng, truth, 0.03))
    test = 1.05 * truth
    assert halves.relmse(test, truth) == pytest.approx(image.relmse(test, truth), rel=0.1)
    assert image.relmse(test, halves.first) > 1.5 * halves.relmse(test, truth)
    # What a display shows bends the noise a little.
    quiet = Halves(noisy(rng, truth, 0.01), noisy(rng, truth, 0.01))
    assert quiet.psnr(test, 0.8) == pytest.approx(image.psnr(test, truth, 0.8), abs=0.05)
    assert image.psnr(test, quiet.first, 0.8) < quiet.psnr(test, 0.8) - 0.3


def test_the_noise_of_the_image_counts():
    rng = np.random.default_rng(2)
    truth = blurred(rng, 256)
    halves = Halves(noisy(rng, truth, 0.05), noisy(rng, truth, 0.05))
    test = noisy(rng, truth, 0.05)
    assert halves.relmse(test, truth) == pytest.approx(image.relmse(test, truth), rel=0.1)


def test_halves_without_noise_are_the_truth():
    rng = np.random.default_rng(3)
    truth, test = blurred(rng, 64), noisy(rng, blurred(rng, 64), 0.1)
    halves = Halves(truth, truth)
    assert halves.relmse(test, truth) == pytest.approx(image.relmse(test, truth))
