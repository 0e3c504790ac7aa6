"""The Gaussians of 3DGS during the fit: tensors with one optimiser each."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

# Adam's learning rates, as in 3DGS. The rate of the means is in units of the scene's size; it
# decays exponentially to FINAL_SHARE of itself.
RATES = {
    "means": 1.6e-4,
    "scales": 5e-3,
    "quats": 1e-3,
    "opacities": 5e-2,
    "sh0": 2.5e-3,
    "shN": 2.5e-3 / 20,
}
FINAL_SHARE = 0.01

# The constant spherical harmonic.
HARMONIC = 0.28209479177387814
# Initial opacity of the Gaussians.
OPACITY = 0.1


@dataclass(frozen=True)
class Seeds:
    """Initial Gaussians: points (N, 3) in world units, and colours (N, 3) in [0, 1]."""

    points: np.ndarray
    colours: np.ndarray


class SplatModel:
    """Parameters and their optimisers, with the names and layout of gsplat's strategies.

    Attributes
    ----------
    params: ``means`` (N, 3); ``scales`` (N, 3), logarithms; ``quats`` (N, 4) as w, x, y, z;
        ``opacities`` (N,), logits; ``sh0`` (N, 1, 3) and ``shN`` (N, K - 1, 3), harmonics.
    optimizers: one Adam for each.
    size: the scene's size, world units.
    """

    def __init__(self, tensors: Mapping[str, torch.Tensor], size: float) -> None:
        self.size = size
        self.params = {name: torch.nn.Parameter(tensor) for name, tensor in tensors.items()}
        self.optimizers = {
            name: torch.optim.Adam([value], lr=RATES[name], eps=1e-15, fused=True)
            for name, value in self.params.items()
        }

    @property
    def count(self) -> int:
        """The number of Gaussians."""
        return len(self.params["means"])

    def update(self, progress: float) -> None:
        """Step all optimisers; ``progress`` through the training is from 0 to 1."""
        rate = RATES["means"] * self.size * FINAL_SHARE**progress
        self.optimizers["means"].param_groups[0]["lr"] = rate
        for optimizer in self.optimizers.values():
            optimizer.step()

    def save(self) -> dict[str, np.ndarray]:
        """The state for :meth:`restore`: name -> array."""
        arrays = {}
        for name, value in self.params.items():
            arrays[name] = value.detach().cpu().numpy()
            for key, moment in self.optimizers[name].state[value].items():
                arrays[f"{name}.{key}"] = moment.cpu().numpy()
        return arrays

    @classmethod
    def restore(cls, arrays: Mapping[str, np.ndarray], size: float, device: str) -> SplatModel:
        """The model that was saved; ``arrays`` may contain others too."""
        model = cls({name: torch.from_numpy(arrays[name]).to(device) for name in RATES}, size)
        for name, value in model.params.items():
            state = {
                key.partition(".")[2]: torch.from_numpy(array).to(device)
                for key, array in arrays.items()
                if key.startswith(f"{name}.")
            }
            model.optimizers[name].state[value] = state
        return model


def grow_from(seeds: Seeds, degree: int, device: str) -> dict[str, torch.Tensor]:
    """Tensors of round Gaussians at the seeds.

    Their standard deviation is the root mean square distance to the three nearest seeds, within a
    factor of 10 of the median.

    Parameters
    ----------
    degree: highest degree of the spherical harmonics.
    """
    count = len(seeds.points)
    if count > 1:
        distances, _ = cKDTree(seeds.points).query(seeds.points, k=min(4, count))
        spread = np.sqrt(np.mean(distances[:, 1:] ** 2, axis=1))
    else:
        spread = np.ones(count)
    widest = max(float(np.median(spread)), 1e-6)
    scales = np.log(np.clip(spread, widest / 10, widest * 10))
    arrays = {
        "means": seeds.points,
        "scales": np.repeat(scales[:, None], 3, axis=1),
        "quats": np.tile([1.0, 0, 0, 0], (count, 1)),
        "opacities": np.full(count, math.log(OPACITY / (1 - OPACITY))),
        "sh0": (seeds.colours[:, None] - 0.5) / HARMONIC,
        "shN": np.zeros((count, (degree + 1) ** 2 - 1, 3)),
    }
    return {
        name: torch.tensor(value, dtype=torch.float32, device=device)
        for name, value in arrays.items()
    }
