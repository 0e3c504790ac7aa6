"""Gradient descent: Adam on batches of supervised points.

A step is two kernels. The first runs over Gaussians: it applies Adam to the last gradients and
writes the arrays that the second reads. The second runs over a batch of points: it blends each
point's neighbours, compares the blend with the target, visits the neighbours again and adds their
gradients.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import stratified_batch
from gpf.core.structs import SurfacePoints, from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.training.adam import Adam
from gpf.training.kernels import (
    accumulate_gradients,
    pack,
    parameters,
    unpack_gradients,
    with_parameters,
    zero_gradients,
)
from gpf.training.neighbours import list_neighbours
from gpf.training.settings import TrainingSettings, cosine_decay

# Smallest brightness, in units of the mean target, that scales the learning rate of a Gaussian's
# irradiance.
LEAST_LEVEL = 0.01


class GaussianDescent:
    """Steps of the Gaussians of a field towards the targets of its supervised points.

    The size of Adam's steps depends on the rate, not on the gradient. With one rate for all, steps
    suited to bright Gaussians would be too large for dark ones. So the rates of irradiance are
    scaled by the light around each Gaussian.

    Parameters
    ----------
    points: supervised points, sorted by position.
    level: light around each Gaussian, in units of the mean target, (N,).
    anisotropic: whether the three scales of a Gaussian may differ.

    Attributes
    ----------
    adam: Adam's moments of :func:`gpf.training.kernels.parameters`.
    """

    def __init__(
        self,
        field: GaussianPhotonField,
        points: SurfacePoints,
        settings: TrainingSettings,
        level: np.ndarray,
        anisotropic: bool,
    ) -> None:
        self.field, self.points, self.settings = field, points, settings
        self.anisotropic = anisotropic
        self.level = from_numpy(mi.Float, np.maximum(level, LEAST_LEVEL))
        first, second = (
            [dr.zeros(mi.Float, len(level)) for _ in parameters(field.gaussians)] for _ in range(2)
        )
        self.adam = Adam(first, second)

    def rebuild(self) -> None:
        """Look for the neighbours of all points again."""
        self.lists = list_neighbours(self.field, self.points)

    def rates(self, done: int) -> list[mi.Float]:
        """Learning rates after so many steps, one array per parameter, scaled by
        :func:`cosine_decay`."""
        s = self.settings
        decay = cosine_decay(done / max(s.steps, 1), s.final_rate)
        r = s.rates
        unit = self.field.settings.search_radius
        values = [r.means * unit] * 3 + [r.log_scales] * 3 + [r.quats] * 4
        common = [dr.opaque(mi.Float, v * decay) for v in values]
        irradiance = dr.opaque(mi.Float, r.irradiance * decay) * self.level
        return [*common, irradiance, irradiance, irradiance]

    def batch(self, done: int) -> mi.UInt32:
        """The points of the next step, (B,): spread evenly over the surfaces, because the points
        are sorted by position."""
        # Opaque: values that change with each step must not become constants of the kernel.
        seed, step = (dr.opaque(mi.UInt32, v) for v in (self.settings.seed, done))
        return stratified_batch(dr.width(self.points.p), self.settings.batch, seed, step)

    def step(self, gaussians: Gaussians, done: int) -> tuple[Gaussians, mi.Float]:
        """The Gaussians after one more step, and the squared errors of its batch, (B,)."""
        packets = pack(gaussians)
        gradients = zero_gradients(dr.width(gaussians.means))
        chosen = self.batch(done)
        scale = dr.opaque(mi.Float, 1 / (3 * dr.width(chosen)))
        divided = self.field.settings.blend == "divided"
        dr.eval(packets)
        errors = accumulate_gradients(
            self.points,
            self.lists,
            chosen,
            packets,
            gradients,
            scale,
            divided,
            self.settings.loss,
        )
        dr.eval(errors, gradients)
        values = self.adam.step(
            parameters(gaussians),
            unpack_gradients(gaussians, gradients, self.anisotropic),
            self.rates(done),
            done + 1,
        )
        before, gaussians = gaussians, with_parameters(gaussians, values)
        # Along its normal, a Gaussian would leave its surface, whose points then no longer see it.
        n = mi.Vector3f(gaussians.normals)
        moved = mi.Vector3f(gaussians.means - before.means)
        gaussians.means = mi.Point3f(before.means + moved - dr.dot(moved, n) * n)
        # Beside bright places, negative values would show as black spots.
        gaussians.irradiance = dr.maximum(gaussians.irradiance, 0)
        dr.eval(gaussians, self.adam.first, self.adam.second)
        return gaussians, errors
