"""Camera samples of some pixels, whose radiance follows from the light at fixed points."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.haze import lit_by
from gpf.camera.rays import sample_rays_at
from gpf.camera.visible_points import find_visible_points
from gpf.core.images import check_finite
from gpf.core.random import Stream, pass_seed, random_start
from gpf.core.structs import Haze, concatenate, from_numpy, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.scene.lamps import Lamps
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PhotonPass

SAMPLES = 4
"""Camera samples of each pixel."""

# Samples of each lamp whose direct light is not stored in the field, and of all lamps for the
# variance of a single sample.
DIRECT_SAMPLES = 16


class CameraSamples:
    """Camera samples of pixels at random places, :data:`SAMPLES` each.

    Light is asked for at M places: first the diffuse surfaces that camera rays meet, then places in
    media, where it is the light scattered towards the camera.

    Parameters
    ----------
    pixels: number of pixels in all; the views share them evenly.
    sampled: the emitters whose direct light on surfaces is added to any irradiance.
    scattered: the same in media.

    Attributes
    ----------
    share: weight of the light at a place in the radiance of its sample, (M, 3).
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor],
        pixels: int,
        sampled: Lamps,
        scattered: Lamps,
        seed: int,
    ) -> None:
        sampler = mi.load_dict({"type": "independent", "sample_count": SAMPLES})
        rays = _rays(sensors, sampler, max(1, pixels // len(sensors)), seed)
        points, haze = find_visible_points(scene, sampler, rays)
        self._emission = to_numpy(points.emission)
        check_finite(self._emission, "light that reaches the cameras")
        lanes = [dr.compress(points.valid), dr.compress(haze.valid)]
        self._lanes = [np.asarray(each.numpy()) for each in lanes]
        points, self._haze = take(points, lanes[0]), take(haze, lanes[1])
        on_surfaces = to_numpy(points.throughput * points.reflectance) / np.pi
        self.share = np.concatenate([on_surfaces, to_numpy(self._haze.weight)])
        self._points = FixedPoints(scene, points)
        direct_seed = pass_seed(seed, 3, Stream.QUALITY_DIRECT)
        on_surfaces = self._points.mean_direct(sampled, DIRECT_SAMPLES, direct_seed)
        in_media = _mean_scattered(scattered, self._haze, direct_seed)
        self._direct = np.concatenate([on_surfaces, in_media])

    def __len__(self) -> int:
        """Number of places M."""
        return len(self.share)

    @property
    def surfaces(self) -> int:
        """Number of places on surfaces."""
        return len(self._lanes[0])

    def light(
        self, photons: PhotonPass, start: mi.Point2f, number: int, stored: Lamps
    ) -> np.ndarray:
        """The light at the places by a pass of photons, (M, 3); the other arguments are those of
        :meth:`PhotonPass.all_irradiance`."""
        irradiance, _ = photons.all_irradiance(self._points, start, number, stored)
        return self._both(irradiance, photons.scattered)

    def ask(self, field: GaussianPhotonField) -> np.ndarray:
        """The light at the places by a field, (M, 3)."""
        at = self._points.points
        value, _ = field.query(at.p, at.n, self._every)
        return np.maximum(self._both(value, field.volume and field.volume.scattered), 0)

    def ask_error(self, field: GaussianPhotonField) -> np.ndarray:
        """The errors that a field expects of :meth:`ask`, (M, 3)."""
        at = self._points.points
        value, _ = field.part("error").query(at.p, at.n, self._every)
        return self._both(value, field.volume and field.volume.error)

    def _both(
        self, irradiance: mi.Color3f, scattered: Callable[[Haze], mi.Color3f] | None
    ) -> np.ndarray:
        """Values on surfaces, and of a function in media; 0 there without a function."""
        found = np.zeros((len(self._lanes[1]), 3))
        if len(found) and scattered is not None:
            found = to_numpy(scattered(self._haze))
        return np.concatenate([to_numpy(irradiance), found])

    @property
    def _every(self) -> mi.Bool:
        return dr.full(mi.Bool, True, self.surfaces)

    def radiance(self, light: np.ndarray) -> np.ndarray:
        """Radiance of all samples, (P, SAMPLES, 3), from the light at the places, (M, 3)."""
        radiance = self._emission + self._at_samples(self.share * (light + self._direct))
        return radiance.reshape(-1, SAMPLES, 3)

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over the samples of each pixel, (P, 3), of values at the places, (M, 3); the other
        samples count as 0."""
        return self._at_samples(values).reshape(-1, SAMPLES, 3).mean(axis=1)

    def _at_samples(self, values: np.ndarray) -> np.ndarray:
        found = np.zeros(self._emission.shape)
        for lanes, part in zip(self._lanes, np.split(values, [self.surfaces]), strict=True):
            found[lanes] += part
        return found

    def lamp_noise(self, seed: int) -> np.ndarray:
        """Variance of the radiance from a single sample of the lamps on surfaces, mean over each
        pixel's camera samples, (P, 3)."""
        start = random_start(pass_seed(seed, 2, Stream.QUALITY_DIRECT), self.surfaces)
        sums = self._points.direct_sums(start, 1, DIRECT_SAMPLES)
        total, squares = (to_numpy(values) for values in sums)
        found = (squares - total**2 / DIRECT_SAMPLES) / (DIRECT_SAMPLES - 1)
        noise = self.share[: self.surfaces] ** 2 * np.maximum(found, 0)
        return self.mean(np.concatenate([noise, np.zeros((len(self) - self.surfaces, 3))]))


def _mean_scattered(lamps: Lamps, haze: Haze, seed: int) -> np.ndarray:
    """The direct light of lamps that is scattered towards the camera, (N, 3), the mean of
    :data:`DIRECT_SAMPLES` samples."""
    total = np.zeros((dr.width(haze.p), 3))
    if not lamps or not len(total):
        return total
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(total))
    for _ in range(DIRECT_SAMPLES):
        total += to_numpy(lit_by(lamps, haze, sampler)) / DIRECT_SAMPLES
    return total


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
