"""The optimiser's arithmetic, by hand and against torch's."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import torch

from gpf.core.structs import from_numpy
from gpf.training.adam import Adam


def run_adam(gradients: np.ndarray, start: np.ndarray, rate: float) -> np.ndarray:
    """Values after each step; ``gradients`` are (steps, parameters, N)."""
    count = len(start)
    adam = Adam(*([dr.zeros(mi.Float, start.shape[1]) for _ in range(count)] for _ in range(2)))
    values = [from_numpy(mi.Float, row) for row in start]
    rates = [mi.Float(rate)] * count
    history = []
    for t, rows in enumerate(gradients, start=1):
        values = adam.step(values, [from_numpy(mi.Float, row) for row in rows], rates, t)
        dr.eval(values, adam.first, adam.second)
        history.append([np.array(v) for v in values])
    return np.array(history)


def test_adam_by_hand():
    # First moments .2, .28, -.048; second .004, .004996, .008991; corrected by 1 - .9^t and
    # 1 - .999^t.
    found = run_adam(np.array([[[2.0]], [[1.0]], [[-3.0]]]), np.array([[5.0]]), 0.1)
    steps = [
        0.2 / 0.1 / np.sqrt(0.004 / 0.001),
        0.28 / 0.19 / np.sqrt(0.004996 / 0.001999),
        -0.048 / 0.271 / np.sqrt(0.013991004 / 0.002997001),
    ]
    assert steps == pytest.approx([1, 0.932175, -0.0819764], rel=1e-5)
    np.testing.assert_allclose(found.ravel(), 5 - 0.1 * np.cumsum(steps), rtol=1e-6)


def test_adam_is_torchs():
    rng = np.random.default_rng(1)
    start, gradients = (
        rng.normal(size=(3, 8)),
        rng.normal(size=(20, 3, 8)) * 10.0 ** rng.integers(-6, 3, (1, 3, 8)),
    )
    found = run_adam(gradients, start, 0.02)
    tensor = torch.tensor(start, requires_grad=True)
    optimiser = torch.optim.Adam([tensor], lr=0.02, eps=1e-15)
    for step, rows in enumerate(gradients):
        tensor.grad = torch.tensor(rows)
        optimiser.step()
        np.testing.assert_allclose(found[step], tensor.detach().numpy(), atol=2e-5)
