"""A field's irradiance by groups of emitters, so that each can be dimmed and coloured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpf.scene.light_groups import Levels, LightGroups


@dataclass(frozen=True)
class FieldLights:
    """Each group's part of the Gaussians' irradiance.

    Attributes
    ----------
    irradiance: W/m², (G, N, 3) float32; the sum over the groups is the field's.
    """

    groups: LightGroups
    irradiance: np.ndarray

    def at(self, levels: Levels) -> np.ndarray:
        """Irradiance of the Gaussians at these levels, (N, 3): light is linear."""
        factors = np.ones((len(self.groups.names), 1, 3), np.float32)
        for name, level in levels.items():
            factors[self.groups.names.index(name)] = level
        total: np.ndarray = (factors * self.irradiance).sum(axis=0)
        return total
