"""An estimate of the PSNR of a field's images, from passes that the field did not learn from."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import sample_rays_at
from gpf.camera.visible_points import find_visible_points
from gpf.core.images import propose_exposure, tone_slope
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import VisiblePoints, concatenate, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.photons.emission import Source, emit_light
from gpf.sppm.passes import PassSettings, PhotonPasses

REFERENCE_PASSES = 1000
"""The estimate is the PSNR against an SPPM reference with this many passes."""

# Radiance of an image of the estimate that counts at most, in units of display white.
BRIGHTEST = 4.0

# Samples of the field per pixel: as many as an image usually has.
FIELD_SAMPLES = 64


class QualityEstimate:
    """Images by SPPM at some random pixels of some views, with which fields are compared.

    With the field's image f, the slope s of the tone curve there, and two independent images A and
    B of n/2 passes each, the mean squared error against a reference with N passes is estimated as

        mean(s² (f - A) (f - B)) + mean(s² (A - B)²) n / 4N.

    The noise of A and B has no influence on the expected value of the first term; the second term
    is the noise of the reference. The passes have the kernel radii of passes 1 to N in equal parts,
    so that A and B are as blurred as the reference.

    Parameters
    ----------
    sensors: the views.
    settings: of the passes.
    pixels: number of pixels in all.
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
        self.scene, self.sensors, self.seed, self.exposure = scene, list(sensors), seed, exposure
        self._photons = PhotonPasses(scene, settings, seed, source)
        rng = np.random.default_rng(pass_seed(seed, 0, Stream.QUALITY_PIXELS))
        each = max(1, pixels // len(self.sensors))
        self._pixels = [
            rng.integers(0, [int(n) for n in sensor.film().crop_size()], (each, 2))
            for sensor in self.sensors
        ]
        self._sums = np.zeros((2, each * len(self.sensors), 3))
        self.passes = 0

    def add_pass(self) -> None:
        """Trace one more pass; passes add to A and B in turn."""
        # Multiples of the golden ratio modulo 1: evenly spread, for any number of passes.
        place = (self.passes // 2 + 0.5) * (5**0.5 - 1) / 2 % 1
        number = 1 + int(place * REFERENCE_PASSES)
        # The radius is that of pass `number`; twins for A and B have other photons.
        traced = self._photons.trace(
            number, pass_seed(self.seed, self.passes, Stream.QUALITY_PHOTONS)
        )
        direct = self._photons.settings.direct == "emitters"
        points = self._visible_points(1, self.passes, direct)
        self._sums[self.passes % 2] += to_numpy(points.radiance(traced.irradiance(points)))
        self.passes += 1

    def psnr(self, field: GaussianPhotonField) -> float:
        """The estimated PSNR of the field's images, dB. Needs at least two passes."""
        assert self.passes >= 2
        counts = np.array([(self.passes + 1) // 2, self.passes // 2])
        first, second = self._sums / counts[:, None, None]
        if self.exposure is None:
            self.exposure = propose_exposure((first + second) / 2)
        shown = self._render(field)
        slope2 = tone_slope(shown, self.exposure) ** 2
        # Single samples that are very bright would decide alone.
        a, b = (np.minimum(image, BRIGHTEST / self.exposure) for image in (first, second))
        noise = float(np.mean(slope2 * (a - b) ** 2)) * self.passes / 4 / REFERENCE_PASSES
        error = float(np.mean(slope2 * (shown - a) * (shown - b))) + noise
        return float(-10 * np.log10(max(error, noise, 1e-10)))

    def _render(self, field: GaussianPhotonField) -> np.ndarray:
        """The field's radiance at the pixels, (P, 3)."""
        number = 10**6 + self.passes  # no number of a pass
        direct = field.settings.direct == "emitters"
        points = self._visible_points(FIELD_SAMPLES, number, direct)
        radiance, _ = field.radiance(points)
        return to_numpy(radiance).reshape(-1, FIELD_SAMPLES, 3).mean(axis=1)

    def _visible_points(self, samples: int, number: int, direct: bool) -> VisiblePoints:
        """Visible points of ``samples`` camera rays for each pixel, (samples P,)."""
        count = samples * sum(map(len, self._pixels))
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        rays = []
        for k, (sensor, pixels) in enumerate(zip(self.sensors, self._pixels, strict=True)):
            sampler.seed(
                pass_seed(self.seed, number, Stream.QUALITY_CAMERA, k), samples * len(pixels)
            )
            place = mi.Point2f(np.repeat(pixels, samples, axis=0).T.astype(np.float32))
            rays.append(mi.Ray3f(sample_rays_at(sensor, sampler, place + sampler.next_2d())[0]))
        ray = mi.Ray3f(concatenate([r.o for r in rays]), concatenate([r.d for r in rays]))
        sampler.seed(pass_seed(self.seed, number, Stream.QUALITY_CAMERA), count)
        points = find_visible_points(self.scene, sampler, ray, direct=direct)
        dr.eval(points)
        return points
