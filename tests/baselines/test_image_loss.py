"""The loss of 3DGS: its values, and its gradient."""

import mitsuba as mi
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from baselines.splatting.image_loss import C1, C2, SIGMA, WINDOW, ImageLoss
from gpf.core.structs import from_numpy


def pair(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Two images that resemble each other."""
    rng = np.random.default_rng(0)
    target = rng.random((height, width, 3))
    return np.clip(target + 0.2 * rng.normal(size=target.shape), 0, 1), target


def loss_of(image: np.ndarray, target: np.ndarray, share: float) -> float:
    flat = from_numpy(mi.Float, image.ravel())
    return float(ImageLoss(target, share)(flat).loss[0])


def test_equal_images_differ_by_nothing():
    _, target = pair(6, 8)
    assert loss_of(target, target, 0.2) == pytest.approx(0, abs=1e-6)


def test_without_ssim_it_is_the_mean_distance():
    image, target = pair(6, 8)
    assert loss_of(image, target, 0) == pytest.approx(abs(image - target).mean(), rel=1e-5)


def test_ssim_equals_a_plain_twins():
    def mean(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, (SIGMA, SIGMA, 0), mode="constant", radius=WINDOW // 2)

    x, y = pair(16, 23)
    mean_x, mean_y = mean(x), mean(y)
    variances = mean(x * x) - mean_x**2 + mean(y * y) - mean_y**2
    covariance = mean(x * y) - mean_x * mean_y
    similarity = (2 * mean_x * mean_y + C1) * (2 * covariance + C2)
    similarity /= (mean_x**2 + mean_y**2 + C1) * (variances + C2)
    assert 0.2 < similarity.mean() < 0.9
    assert 1 - loss_of(x, y, share=1) == pytest.approx(similarity.mean(), abs=1e-5)


def test_gradient_equals_finite_differences():
    image, target = pair(6, 8)
    loss = ImageLoss(target)
    gradient = np.array(loss(from_numpy(mi.Float, image.ravel())).gradient)
    for k in (0, 5, 40, 71, 143):
        ends = []
        for sign in (1, -1):
            moved = image.astype(np.float32).ravel().copy()
            moved[k] += sign * 3e-3
            ends.append(float(loss(from_numpy(mi.Float, moved)).loss[0]))
        assert (ends[0] - ends[1]) / 6e-3 == pytest.approx(gradient[k], rel=0.02)
