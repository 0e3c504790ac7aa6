"""Errors against a truth that is known only with noise, in two independent halves.

For an image f and two images A and B with independent noise around the truth T, the mean of
(f - A) (f - B) is the squared error of f from T: the noise of A and B does not count, however
strong it is. The noise of f counts. For displayed values, this holds as long as noise does not
change their means.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrics.image import Image, expose


@dataclass(frozen=True)
class Halves:
    """Two images of the same view with independent noise, (H, W, 3) each, linear radiance."""

    first: Image
    second: Image

    def psnr(self, test: Image, exposure: float) -> float:
        """PSNR of the exposed image, dB."""
        f, a, b = (expose(image, exposure) for image in (test, self.first, self.second))
        return float(-10 * np.log10(np.mean((f - a) * (f - b))))

    def relmse(self, test: Image, level: Image, epsilon: float = 0.01) -> float:
        """Relative squared error: ``mean((f - A) (f - B) / (L^2 + epsilon))``.

        ``level``: L, an image whose noise is independent of A and B, (H, W, 3). With the mean
        of A and B instead, errors would count more where both are too dark by chance.
        """
        f, a, b, of = (np.float64(i) for i in (test, self.first, self.second, level))
        return float(np.mean((f - a) * (f - b) / (np.square(of) + epsilon)))
