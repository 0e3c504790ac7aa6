"""Light between diffuse surfaces, gathered at points by rays that end in a field.

Photons need a kernel, which blurs their light and leaks it through thin walls. A ray needs none:
what the surface that it meets sends follows from what arrives there, and a field gives that (final
gathering). The surface is usually far away, so small errors of the field average out. Caustics are
left to the photons, direct light to samples of the emitters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.recorded_steps import RecordedSteps, traced_step
from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.field.field import GaussianPhotonField
from gpf.field.gathering import gathered_radiance
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.sampled_light import SampledLight


class GatheredLight(SampledLight):
    """Light from diffuse surfaces at points.

    Parameters
    ----------
    field: gives the irradiance of the surfaces that the rays meet.
    since: photon passes before the first that has samples.
    """

    LEAST, MOST_PER_PASS, COST = 4, 1.0, 0.6

    def __init__(
        self, points: FixedPoints, field: GaussianPhotonField, seed: int, since: int = 0
    ) -> None:
        super().__init__(points, seed)
        self.field, self.since = field, since
        self._steps = RecordedSteps()

    def sample(self, passes: int) -> None:
        """Add the samples that go with this many passes."""
        super().sample(passes - self.since)

    def tensors(self) -> dict[str, np.ndarray]:
        """The samples so far, and the passes before them, for a file."""
        return super().tensors() | {"lit": np.array([self.since])}

    def _light(self, half: int, first: int, count: int) -> mi.Color3f:
        seed = pass_seed(self.seed, half, Stream.GATHER_RAYS)
        start = random_start(seed, dr.width(self.points.points.p))
        total = mi.Color3f(0)
        for number in range(first, first + count):
            others = pass_seed(self.seed, half, Stream.GATHER_LAMPS, number)
            sample = spread_sample(start, number)
            total += gather(self.points, self.field, sample, others, self._steps.run)
            dr.eval(total)
        return total


def gather(
    points: FixedPoints,
    field: GaussianPhotonField,
    sample: mi.Point2f,
    seed: int,
    run: Callable[..., Any] = traced_step,
) -> mi.Color3f:
    """Irradiance from diffuse surfaces, along one ray from each point, W/m², (N, 3).

        E = π / cos θ · L · |cos θ| g(ω),

    with directions distributed in proportion to cos θ, and L the radiance that the surface sends
    which the ray meets (:func:`gpf.field.gathering.gathered_radiance`).

    Parameters
    ----------
    sample: random numbers in [0, 1)², (N, 2).
    seed: for the random numbers beyond the first surface.
    run: :meth:`gpf.camera.recorded_steps.RecordedSteps.run`, if rays are recorded.
    """
    ray, cosine = points.cosine_rays(sample)
    weight = dr.select(cosine > 0, dr.pi / cosine, 0) * points.share(ray.d)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(ray.d))
    found = gathered_radiance(points.scene, field, sampler, ray, cosine > 0, run=run)
    dr.eval(weight)
    return weight * found
