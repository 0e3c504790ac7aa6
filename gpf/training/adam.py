"""The Adam optimiser on lists of Dr.Jit arrays, as part of the caller's kernel."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Adam:
    """Adam's moments, one array per parameter, (N,) each."""

    first: list[mi.Float]
    second: list[mi.Float]

    def step(
        self, values: list[mi.Float], gradients: list[mi.Float], rates: list[mi.Float], t: int
    ) -> list[mi.Float]:
        """New parameters after step ``t`` (counted from 1); Kingma and Ba 2015, β = (.9, .999)."""
        correct1 = dr.opaque(mi.Float, 1 / (1 - 0.9**t))
        correct2 = dr.opaque(mi.Float, 1 / (1 - 0.999**t))
        result = []
        for k, (value, gradient) in enumerate(zip(values, gradients, strict=True)):
            self.first[k] = dr.lerp(gradient, self.first[k], 0.9)
            self.second[k] = dr.lerp(dr.square(gradient), self.second[k], 0.999)
            change = self.first[k] * correct1 / (dr.sqrt(self.second[k] * correct2) + 1e-15)
            result.append(value - rates[k] * change)
        return result
