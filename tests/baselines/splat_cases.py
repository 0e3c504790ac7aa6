"""Gaussians, cameras and pictures that the tests of splatting share."""

import numpy as np
import torch

from gpf.baselines.pinhole import Pinhole, make_pinhole
from gpf.views import View

SIZE = (20, 12)


def place_camera(size: tuple[int, int] = SIZE) -> Pinhole:
    """A camera before the origin, tilted."""
    view = View(name="a", origin=(0.3, 0.4, 4), target=(0.1, 0, 0), up=(0.1, 1, 0), fov=30)
    return make_pinhole(view, size)


def random_splats(count: int, degree: int, seed: int = 0) -> dict[str, torch.nn.Parameter]:
    """Gaussians around the origin, of all shapes."""
    rng = np.random.default_rng(seed)
    arrays = {
        "means": rng.uniform(-1, 1, (count, 3)) * (1, 0.6, 1),
        "scales": np.log(0.12) + 0.5 * rng.normal(size=(count, 3)),
        "quats": rng.normal(size=(count, 4)),
        "opacities": rng.normal(size=count),
        "sh0": rng.normal(size=(count, 1, 3)),
        "shN": 0.3 * rng.normal(size=(count, (degree + 1) ** 2 - 1, 3)),
    }
    return {
        name: torch.nn.Parameter(torch.tensor(value, dtype=torch.float32))
        for name, value in arrays.items()
    }
