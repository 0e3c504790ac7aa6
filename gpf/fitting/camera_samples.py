"""Camera samples of some pixels, whose radiance follows from the irradiance at fixed points."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import sample_rays_at
from gpf.camera.visible_points import find_visible_points
from gpf.core.images import check_finite
from gpf.core.random import Stream, pass_seed, random_start
from gpf.core.structs import concatenate, from_numpy, take, to_numpy
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints

SAMPLES = 4
"""Camera samples of each pixel."""

# Samples of each lamp whose direct light is not stored in the field, and of all lamps for the
# variance of a single sample.
DIRECT_SAMPLES = 16


class CameraSamples:
    """Camera samples of pixels at random places, :data:`SAMPLES` each.

    Parameters
    ----------
    pixels: number of pixels in all; the views share them evenly.
    sampled: the emitters whose direct light is added to any irradiance.

    Attributes
    ----------
    points: the diffuse surfaces that camera rays meet, (M).
    share: weight of the irradiance there in the radiance of its sample, (M, 3).
    """

    def __init__(
        self, scene: mi.Scene, sensors: Sequence[mi.Sensor], pixels: int, sampled: Lamps, seed: int
    ) -> None:
        sampler = mi.load_dict({"type": "independent", "sample_count": SAMPLES})
        rays = _rays(sensors, sampler, max(1, pixels // len(sensors)), seed)
        points = find_visible_points(scene, sampler, rays)
        self._emission = to_numpy(points.emission)
        check_finite(self._emission, "light that reaches the cameras")
        valid = dr.compress(points.valid)
        self._lanes = np.asarray(valid.numpy())
        points = take(points, valid)
        self.share = to_numpy(points.throughput * points.reflectance) / np.pi
        self.points = FixedPoints(scene, points)
        direct_seed = pass_seed(seed, 3, Stream.QUALITY_DIRECT)
        self._direct = self.points.mean_direct(sampled, DIRECT_SAMPLES, direct_seed)

    def __len__(self) -> int:
        """Number of points."""
        return len(self._lanes)

    def radiance(self, irradiance: np.ndarray) -> np.ndarray:
        """Radiance of all samples, (P, SAMPLES, 3), from the irradiance at the points, (M, 3)."""
        radiance = self._emission.copy()
        radiance[self._lanes] += self.share * (irradiance + self._direct)
        return radiance.reshape(-1, SAMPLES, 3)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over the samples of each pixel, (P, 3), of values at the points, (M, 3); the other
        samples count as 0."""
        found = np.zeros(self._emission.shape)
        found[self._lanes] = values
        return found.reshape(-1, SAMPLES, 3).mean(axis=1)

    def lamp_noise(self, seed: int) -> np.ndarray:
        """Variance of the radiance from a single sample of the lamps, mean over each pixel's camera
        samples, (P, 3)."""
        start = random_start(pass_seed(seed, 2, Stream.QUALITY_DIRECT), len(self))
        sums = self.points.direct_sums(start, 1, DIRECT_SAMPLES)
        total, squares = (to_numpy(values) for values in sums)
        found = (squares - total**2 / DIRECT_SAMPLES) / (DIRECT_SAMPLES - 1)
        return self.mean(self.share**2 * np.maximum(found, 0))


def _rays(sensors: Sequence[mi.Sensor], sampler: mi.Sampler, each: int, seed: int) -> mi.Ray3f:
    """Camera rays through ``each`` random pixels of each view, :data:`SAMPLES` for each pixel;
    afterwards the sampler is ready for their walks."""
    rng, rays = np.random.default_rng(pass_seed(seed, 0, Stream.QUALITY_PIXELS)), []
    for k, sensor in enumerate(sensors):
        pixels = rng.integers(0, [int(n) for n in sensor.film().crop_size()], (each, 2))
        place = from_numpy(mi.Point2f, np.repeat(pixels, SAMPLES, axis=0))
        sampler.seed(pass_seed(seed, 0, Stream.QUALITY_CAMERA, k), SAMPLES * each)
        rays.append(mi.Ray3f(sample_rays_at(sensor, sampler, place + sampler.next_2d())[0]))
    sampler.seed(pass_seed(seed, 0, Stream.QUALITY_CAMERA), SAMPLES * each * len(sensors))
    return mi.Ray3f(concatenate([r.o for r in rays]), concatenate([r.d for r in rays]))
