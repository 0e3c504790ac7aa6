"""Points from which a field does not learn, and by which its training is judged."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import SurfacePoints
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.training.kernels import blend_neighbours, pack
from gpf.training.loss import relative_weight
from gpf.training.neighbours import list_neighbours


class HeldOut:
    """Supervised points, maybe none."""

    def __init__(self, field: GaussianPhotonField, points: SurfacePoints) -> None:
        self.field, self.points = field, points
        self._weight = mi.Float(1)

    def __bool__(self) -> bool:
        return dr.width(self.points.p) > 0

    def rebuild(self) -> None:
        """Look for the neighbours of all points again."""
        if self:
            self._lists = list_neighbours(self.field, self.points)

    def weigh(self, gaussians: Gaussians) -> None:
        """From now on, weight the points as in the relative loss of this state. With the weights of
        each state, bright states would seem better."""
        if self:
            self._weight = relative_weight(dr.sum(self._blend(gaussians)) / 3)
            dr.eval(self._weight)

    def error(self, gaussians: Gaussians) -> float:
        """Weighted root mean square error, in units of the mean target; 0 without points."""
        if not self:
            return 0.0
        difference = self._blend(gaussians) - self.points.target
        error = self._weight * dr.squared_norm(difference)
        return float(np.sqrt(dr.mean(error)[0] / 3))

    def _blend(self, gaussians: Gaussians) -> mi.Color3f:
        """The field's answers with these Gaussians, (H, 3)."""
        every = dr.arange(mi.UInt32, dr.width(self.points.p))
        divided = self.field.settings.blend == "divided"
        packets = pack(gaussians)
        dr.eval(packets)
        return blend_neighbours(self.points, self._lists, every, packets, divided)[0]
