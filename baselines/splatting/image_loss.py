"""The image loss of 3DGS, and its gradient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy

# Width and standard deviation of the window of SSIM (Wang and others 2004), pixels, and the
# constants of its two factors.
WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2


@dataclass
class Difference:
    """A loss, (1,), and its derivative with respect to the flat image."""

    loss: mi.Float
    gradient: mi.Float


class ImageLoss:
    """The loss of 3DGS for one target: ``(1 - λ) mean |x - y| + λ (1 - mean SSIM(x, y))``.

    μ and the moments E[x²], E[xy] are means under a Gaussian window around each pixel; images are
    black beyond their edges.

        SSIM = (2 μ_x μ_y + C1) (2 σ_xy + C2) / ((μ_x² + μ_y² + C1) (σ_x² + σ_y² + C2)),
        σ_x² = E[x²] - μ_x²,    σ_xy = E[xy] - μ_x μ_y.

    The window is symmetric, so the adjoint of a mean under it is again a mean under it.

    Parameters
    ----------
    target: y, (H, W, 3) in [0, 1].
    share: λ.
    """

    def __init__(self, target: np.ndarray, share: float = 0.2) -> None:
        height, width, _ = target.shape
        self.size, self.share = (width, height), share
        self.target = from_numpy(mi.Float, target.ravel())
        self._mean, square = self._means([self.target, dr.square(self.target)])
        self._variance = square - dr.square(self._mean)
        dr.eval(self._mean, self._variance)

    def __call__(self, image: mi.Float) -> Difference:
        """Compare an image, a flat array (3 W H,) by row, column, channel."""
        y, mean_y = self.target, self._mean
        mean, square, product = self._means([image, dr.square(image), image * y])
        first = 2 * mean * mean_y + C1
        second = 2 * (product - mean * mean_y) + C2
        below1 = dr.square(mean) + dr.square(mean_y) + C1
        below2 = square - dr.square(mean) + self._variance + C2
        scale = dr.rcp(below1 * below2)
        ssim = first * second * scale
        by_mean, by_square, by_product = self._means(
            [
                2 * (mean_y * (second - first) * scale - mean * ssim * (below2 - below1) * scale),
                -ssim / below2,
                2 * first * scale,
            ]
        )
        count = dr.width(image)
        of_ssim = by_mean + 2 * image * by_square + y * by_product
        gradient = (1 - self.share) * dr.sign(image - y) * (image != y) - self.share * of_ssim
        loss = (1 - self.share) * dr.abs(image - y) + self.share * (1 - ssim)
        result = Difference(dr.sum(loss) / count, gradient / count)
        dr.eval(result)
        return result

    def _means(self, images: Sequence[mi.Float]) -> list[mi.Float]:
        """Means of flat images under the window."""
        width, height = self.size
        index = dr.arange(mi.UInt32, 3 * width * height)
        column = index // 3 % dr.opaque(mi.UInt32, width)
        row = index // dr.opaque(mi.UInt32, 3 * width)
        dr.eval(images)
        across = [_mean_along(image, index, column, width, 3) for image in images]
        dr.eval(across)
        return [_mean_along(image, index, row, height, 3 * width) for image in across]


def _mean_along(
    image: mi.Float, index: mi.UInt32, place: mi.UInt32, length: int, stride: int
) -> mi.Float:
    """Mean along one axis; ``place``, from 0 to ``length``, is each element's position on it."""
    half = WINDOW // 2
    weights = np.exp(-((np.arange(WINDOW) - half) ** 2) / (2 * SIGMA**2))
    weights /= weights.sum()
    ends, step = dr.opaque(mi.Int32, length), dr.opaque(mi.Int32, stride)
    result = mi.Float(0)
    for k, weight in enumerate(weights.tolist()):
        shift = k - half
        there = mi.Int32(place) + shift
        at = mi.UInt32(mi.Int32(index) + shift * step)
        result += weight * dr.gather(mi.Float, image, at, (there >= 0) & (there < ends))
    return result
