"""An estimate of the PSNR of a field's images, from passes that the field did not learn from."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import sample_rays_at
from gpf.camera.visible_points import find_visible_points
from gpf.core.images import propose_exposure, tone_slope
from gpf.core.random import Stream, pass_seed, random_start
from gpf.core.structs import VisiblePoints, concatenate, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.photons.emission import Source, emit_light
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, PhotonPasses

REFERENCE_PASSES = 1000
"""The estimate is the PSNR against an SPPM reference with this many passes."""

LEAST_PASSES = 8
"""With fewer passes, the estimate is too uncertain."""

# Camera samples of each pixel.
SAMPLES = 4

# Samples per pixel of the field's images, F: as many as an image usually has.
FIELD_SAMPLES = 64


class QualityEstimate:
    """Irradiance by SPPM at visible points of some pixels, with which fields are compared.

    With the field's image f, the slope s of the tone curve there, and two images A and B by SPPM
    with n/2 independent passes each, the mean squared error against a reference with N passes is
    estimated as

        mean(s² (f - A) (f - B)) + mean(s² ((A - B)² n/4 + v)) / N + mean'(s² v) / F,

    plus the standard error of the first term. The noise of A and B has no influence on the expected
    value of that term, because all three images have the same camera samples and only the
    irradiance differs. The second term is the noise of the reference, from its photons and from its
    camera samples, whose variance in a pixel is v. The third term is the noise of F camera samples
    in the field's image; it counts pixels that look through glass or into mirrors, since samples
    are spread too evenly for noise at others. The passes have the kernel radii of passes 1 to N in
    equal parts, so that A and B are as blurred as the reference.

    Parameters
    ----------
    sensors: the views.
    settings: of the passes.
    pixels: number of pixels in all, at random places.
    exposure: of the tone mapping; by default :func:`gpf.core.images.propose_exposure`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor],
        settings: PassSettings,
        seed: int,
        source: Source = emit_light,
        pixels: int = 8192,
        exposure: float | None = None,
    ) -> None:
        self.seed, self.exposure, self.passes = seed, exposure, 0
        self._photons = PhotonPasses(scene, settings, seed, source)
        self._pixels = max(1, pixels // len(sensors)) * len(sensors)
        points = self._find_points(scene, sensors)
        self._emission = to_numpy(points.emission)
        self._through = np.asarray((points.depth > 0).numpy()).reshape(-1, SAMPLES, 1).any(axis=1)
        valid = dr.compress(points.valid)
        self._lanes = np.asarray(valid.numpy())
        points = take(points, valid)
        self._share = to_numpy(points.throughput * points.reflectance) / np.pi
        self._points = FixedPoints(scene, points)
        self._starts = [
            random_start(pass_seed(seed, half, Stream.QUALITY_DIRECT), len(self._lanes))
            for half in range(2)
        ]
        self._sums = np.zeros((2, len(self._lanes), 3))

    def add_pass(self) -> None:
        """Trace one more pass; passes add to A and B in turn."""
        half, pair = self.passes % 2, self.passes // 2
        # Multiples of the golden ratio modulo 1: evenly spread, for any number of passes.
        place = (pair + 0.5) * (5**0.5 - 1) / 2 % 1
        # The radius is that of this pass of a reference. Passes of A and B share no random number.
        number = 1 + half + int(place * REFERENCE_PASSES)
        traced = self._photons.trace(
            number, pass_seed(self.seed, self.passes, Stream.QUALITY_PHOTONS)
        )
        irradiance, _ = traced.all_irradiance(self._points, self._starts[half], pair + 1)
        self._sums[half] += to_numpy(irradiance)
        self.passes += 1

    def psnr(self, field: GaussianPhotonField) -> float:
        """The estimated PSNR of the field's images, dB; needs :data:`LEAST_PASSES` passes."""
        assert self.passes >= LEAST_PASSES
        counts = (self.passes + 1) // 2, self.passes // 2
        a, b = (self._samples(s / n).mean(axis=1) for s, n in zip(self._sums, counts, strict=True))
        if self.exposure is None:
            self.exposure = propose_exposure((a + b) / 2)
        points = self._points.points
        value, _ = field.query(points.p, points.n, dr.full(mi.Bool, True, len(self._lanes)))
        samples = self._samples(np.maximum(to_numpy(value), 0))
        f, variance = samples.mean(axis=1), samples.var(axis=1, ddof=1)
        slope2 = tone_slope(f, self.exposure) ** 2
        reference = (a - b) ** 2 * self.passes / 4 + variance
        noise = reference / REFERENCE_PASSES + self._through * variance / FIELD_SAMPLES
        error = (slope2 * (f - a) * (f - b)).mean(axis=1)
        # With few passes the estimate is uncertain; then it is rather too low.
        uncertain = error.std() / np.sqrt(len(error))
        least = float(np.mean(slope2 * noise))
        total = max(float(error.mean()), 0.0) + float(uncertain) + least
        return float(-10 * np.log10(max(total, 1e-10)))

    def _samples(self, irradiance: np.ndarray) -> np.ndarray:
        """Radiance of all camera samples, (P, SAMPLES, 3), from the irradiance at the points."""
        radiance = self._emission.copy()
        radiance[self._lanes] += self._share * irradiance
        return radiance.reshape(-1, SAMPLES, 3)

    def _find_points(self, scene: mi.Scene, sensors: Sequence[mi.Sensor]) -> VisiblePoints:
        """Visible points of :data:`SAMPLES` camera rays for each pixel, (SAMPLES P,)."""
        each = self._pixels // len(sensors)
        rng = np.random.default_rng(pass_seed(self.seed, 0, Stream.QUALITY_PIXELS))
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        rays = []
        for k, sensor in enumerate(sensors):
            pixels = rng.integers(0, [int(n) for n in sensor.film().crop_size()], (each, 2))
            sampler.seed(pass_seed(self.seed, 0, Stream.QUALITY_CAMERA, k), SAMPLES * each)
            place = mi.Point2f(np.repeat(pixels, SAMPLES, axis=0).T.astype(np.float32))
            rays.append(mi.Ray3f(sample_rays_at(sensor, sampler, place + sampler.next_2d())[0]))
        ray = mi.Ray3f(concatenate([r.o for r in rays]), concatenate([r.d for r in rays]))
        sampler.seed(pass_seed(self.seed, 0, Stream.QUALITY_CAMERA), SAMPLES * self._pixels)
        points = find_visible_points(scene, sampler, ray)
        dr.eval(points)
        return points
