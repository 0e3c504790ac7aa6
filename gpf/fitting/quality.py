"""An estimate of the PSNR of a field's images, from passes that the field did not learn from."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property

import mitsuba as mi
import numpy as np

from gpf.core.errors import uninterrupted
from gpf.core.images import propose_exposure, tone_secant
from gpf.core.random import Stream, pass_seed, random_start
from gpf.field.field import GaussianPhotonField
from gpf.fitting.camera_samples import SAMPLES, CameraSamples
from gpf.photons.emission import Source, emit_light
from gpf.scene.lamps import Lamps
from gpf.sppm.passes import PassSettings, PhotonPasses

REFERENCE_PASSES = 1000
"""The estimate is the PSNR against an SPPM reference with this many passes."""

LEAST_PASSES, ENOUGH_PASSES = 4, 16
"""With fewer passes there is no estimate, or a rather uncertain one."""

# The estimate is certain enough if its standard error is this small, dB.
SURE = 0.3

# Largest factor for the error that a field predicts.
MOST_SCALE = 3.0

# Pixels in all, and the most views that share them: with few pixels, the PSNR of a view is biased.
PIXELS, MOST_VIEWS = 8192, 16


class QualityEstimate:
    """Irradiance by SPPM at visible points of some pixels, with which fields are compared.

    With the field's radiance f_i at sample i of a pixel, the radiances a_i and b_i by SPPM with n/2
    independent passes each, and the slope s of the tone curve between the means of f_i and of
    (a_i + b_i)/2, the mean squared error against a reference with N passes is estimated as

        mean(s² (f_i - a_i) (f_j - b_j)) + mean(s² ((a_i - b_i)² n/4 + v + d)) / N,    i ≠ j,

    in each view. The estimate is the mean of the views' PSNR, less its standard error. Neither the
    noise of a and b nor light that changes within the pixel affects the first term's expected
    value, except slightly through s: an image has many samples per pixel, which average out. The
    second term is the noise of the reference: from its photons, from its camera samples, whose
    variance in a pixel is v, and from its single samples of the lamps, with the variance d; those
    of a and b are evenly spread. The noise of camera samples in the field's images is left out: it
    depends on their number, and on the denoiser. The passes have the kernel radii of passes 1 to N
    in equal parts, so that a and b are as blurred as the reference.

    Parameters
    ----------
    sensors: the views; if there are more than :data:`MOST_VIEWS`, an even selection is used.
    settings: settings of the passes.
    sampled: the emitters whose direct light the fields do not store.
    pixels: number of pixels in all, at random places.
    exposure: exposure of the tone mapping; by default :func:`gpf.core.images.propose_exposure`.
    """

    def __init__(
        self,
        scene: mi.Scene,
        sensors: Sequence[mi.Sensor],
        settings: PassSettings,
        sampled: Lamps,
        seed: int,
        source: Source = emit_light,
        pixels: int = PIXELS,
        exposure: float | None = None,
    ) -> None:
        self.seed, self.exposure, self.passes = seed, exposure, 0
        self._measured = exposure is None
        chosen = np.unique(np.linspace(0, len(sensors) - 1, MOST_VIEWS).round().astype(int))
        self._sensors = [sensors[k] for k in chosen]
        self._photons = PhotonPasses(scene, settings, seed, source)
        scattered = Lamps(scene, None if self._photons.paths.indirect else ())
        self._samples = CameraSamples(scene, self._sensors, pixels, sampled, scattered, seed)
        self._stored = sampled.others()
        seeds = [pass_seed(seed, half, Stream.QUALITY_DIRECT) for half in range(2)]
        self._starts = [random_start(each, self._samples.surfaces) for each in seeds]
        self._sums = np.zeros((2, len(self._samples), 3))

    def tensors(self) -> dict[str, np.ndarray]:
        """The passes so far, for a file."""
        facts = np.array([self.passes, self.exposure or np.nan, self._measured])
        return {"quality/sums": self._sums, "quality/facts": facts}

    def restore(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Continue from :meth:`tensors` of an estimate with the same arguments."""
        self._sums = tensors["quality/sums"].copy()
        passes, exposure, measured = tensors["quality/facts"]
        self.passes = int(passes)
        if self._measured and measured and not np.isnan(exposure):
            self.exposure = float(exposure)

    def add_pass(self) -> None:
        """Trace one more pass; passes add to A and B in turn."""
        half, pair = self.passes % 2, self.passes // 2
        # Multiples of the golden ratio modulo 1: evenly spread, for any number of passes.
        place = (pair + 0.5) * (5**0.5 - 1) / 2 % 1
        # The radius is that of this pass of a reference. Passes of A and B share no random numbers.
        number = 1 + half + int(place * REFERENCE_PASSES)
        traced = self._photons.trace(
            number, pass_seed(self.seed, self.passes, Stream.QUALITY_PHOTONS)
        )
        found = self._samples.light(traced, self._starts[half], pair + 1, self._stored)
        with uninterrupted():
            self._sums[half] += found
            self.passes += 1

    def psnr(self, field: GaussianPhotonField) -> float:
        """The estimated PSNR of the field's images, mean over the views, dB; needs
        :data:`LEAST_PASSES` passes."""
        estimate, uncertain = self._estimate(field)
        # With few passes the estimate is uncertain; then it should rather be too low.
        return estimate - uncertain

    def sppm_psnr(self, field: GaussianPhotonField, passes: int) -> float:
        """The PSNR that SPPM images with this many passes would have by the same measure, dB,
        without the error from the width of their kernels. The slopes of the tone curve are the
        field's."""
        _, reference, _ = self._compare(field)
        noise = reference.reshape(len(self._sensors), -1).mean(axis=1)
        each = np.maximum(noise * (1 / passes + 1 / REFERENCE_PASSES), 1e-10)
        return float(np.mean(-10 * np.log10(each)))

    def needed_passes(self, field: GaussianPhotonField) -> int:
        """The number of passes with which the estimate would be certain enough.

        More passes reduce the noise of both factors, and with it the standard error, except for the
        part that comes from the choice of pixels.
        """
        _, uncertain = self._estimate(field)
        return math.ceil(self.passes * uncertain / SURE)

    def error_scale(self, field: GaussianPhotonField) -> float:
        """Factor that makes the errors that the field predicts agree with these passes.

        Mean squares in tone-mapped images are compared: the first term of the estimate, m, and what
        the field predicts, p. With the standard error e of m, the factor for squares is (m / p) to
        the power of m² / (m² + e²): 1 if these passes cannot tell.
        """
        error, _, slope2 = self._compare(field)
        wrong = self._samples.mean(self._samples.share * self._samples.ask_error(field))
        predicted = float((slope2 * wrong**2).mean())
        measured = max(float(error.mean()), 1e-12)
        certain = measured**2 / (measured**2 + standard_error(error) ** 2)
        scale = (measured / max(predicted, 1e-12)) ** (0.5 * certain)
        return float(np.clip(scale, 1 / MOST_SCALE, MOST_SCALE))

    def _estimate(self, field: GaussianPhotonField) -> tuple[float, float]:
        """The mean of the views' PSNR, and its standard error, dB."""
        error, reference, _ = self._compare(field)
        views = len(self._sensors)
        error = error.reshape(views, -1)
        least = reference.reshape(views, -1).mean(axis=1) / REFERENCE_PASSES
        each = np.maximum(np.maximum(error.mean(axis=1), 0) + least, 1e-10)
        # The standard error of a logarithm is the relative one.
        relative = np.array([standard_error(view) for view in error]) / each
        uncertain = 10 / math.log(10) * np.linalg.norm(relative) / views
        return float(np.mean(-10 * np.log10(each))), float(uncertain)

    def _compare(self, field: GaussianPhotonField) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """At each pixel: the first term of the estimate, (P,), the second times N, (P, 3), and the
        square of the slope, (P, 3)."""
        assert self.passes >= LEAST_PASSES
        counts = (self.passes + 1) // 2, self.passes // 2
        a, b = (self._samples.radiance(s / n) for s, n in zip(self._sums, counts, strict=True))
        if self.exposure is None:
            self.exposure = propose_exposure((a + b).mean(axis=1) / 2)
        f = self._samples.radiance(self._samples.ask(field))
        slope2 = tone_secant(f.mean(axis=1), (a + b).mean(axis=1) / 2, self.exposure) ** 2
        of_a, of_b = f - a, f - b
        crossed = of_a.sum(axis=1) * of_b.sum(axis=1) - (of_a * of_b).sum(axis=1)
        error = (slope2 * crossed).mean(axis=1) / (SAMPLES * (SAMPLES - 1))
        noise = ((a - b) ** 2).mean(axis=1) * self.passes / 4
        noise += f.var(axis=1, ddof=1) + self._lamp_noise
        return error, slope2 * noise, slope2

    @cached_property
    def _lamp_noise(self) -> np.ndarray:
        """Variance from the reference's single samples of the lamps, (P, 3), or 0."""
        samples = self._photons.settings.direct == "emitters"
        return self._samples.lamp_noise(self.seed) if samples else np.zeros(3)


def standard_error(values: np.ndarray) -> float:
    """Standard error of the mean of independent values."""
    return float(values.std()) / math.sqrt(len(values))
