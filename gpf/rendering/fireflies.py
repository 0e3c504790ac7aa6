"""Fireflies: single samples of great radiance that no nearby sample confirms.

Behind glass or on brushed metal, about one camera walk in ten thousand finds radiance a thousand
times that of its pixel. The mean over many images is right, but each single image is wrong: it has
white dots. A really bright pixel is bright in several of its samples, or in those of its
neighbours. Samples are therefore summed in small blocks. A block b counts at most :data:`TOLERANCE`
times the :data:`RIVALS`-th brightest block of the 3 × 3 pixels around it:

    L_b' = L_b min(1, κ l / l_b)

l_b is the mean over the channels of its radiance L_b, l that of the rival, and κ the tolerance,
which is large enough for ordinary noise. This is a simple form of the reweighting of Zirr, Hanika
and Dachsbacher, "Reweighting Firefly Samples for Improved Finite-Sample Monte Carlo Estimates"
(2018). The image loses some energy; the loss falls with the number of samples.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import from_numpy

MIN_BLOCK_SIZE = 4
"""Samples of a block, if sets are large enough. Noise in smaller blocks looks like fireflies."""

RIVALS = 3
"""A block counts in full if at least this many blocks, itself included, are about as bright."""

TOLERANCE = 2.0
"""κ: a block may be this many times as bright as the rival."""


def choose_block_size(set_size: int) -> int:
    """The number of samples in a block; it divides ``set_size``.

    A set has at least :data:`RIVALS` blocks, so that a pixel that is bright in all its samples
    confirms itself.
    """
    sizes = [n for n in range(1, set_size // RIVALS + 1) if set_size % n == 0]
    return next((n for n in sizes if n >= MIN_BLOCK_SIZE), sizes[-1])


class BrightestBlocks:
    """The :data:`RIVALS` brightest blocks of each pixel; only these can exceed the limit.

    Attributes
    ----------
    size: width and height of the image, pixels.
    kept: the blocks, brightest first, (H W,) each; -inf for pixels with fewer blocks.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.kept = [dr.full(mi.Color3f, -dr.inf, size[0] * size[1]) for _ in range(RIVALS)]

    def add(self, pixels: np.ndarray, blocks: mi.Color3f) -> None:
        """Add blocks; ``pixels`` (N,) is grouped, and each entry adds the same number of blocks.

        A block is the sum of the radiance of its samples.
        """
        each = dr.width(blocks) // len(pixels)
        starts = np.flatnonzero(np.r_[True, pixels[1:] != pixels[:-1]])
        ends = np.r_[starts[1:], len(pixels)]
        at, end = (from_numpy(mi.UInt32, n * each) for n in (starts, ends))
        pixel = from_numpy(mi.UInt32, pixels[starts])
        kept = _brightest(
            [dr.gather(mi.Color3f, values, pixel) for values in self.kept], blocks, at, end
        )
        for values, better in zip(self.kept, kept, strict=True):
            dr.scatter(values, better, pixel)
        dr.eval(self.kept)

    def excess(self) -> np.ndarray:
        """Sum of L_b - L_b' over the blocks of each pixel, in the unit of the blocks, (H W, 3)."""
        width, height = (dr.opaque(mi.Int32, n) for n in self.size)
        pixel = dr.arange(mi.Int32, self.size[0] * self.size[1])
        x, y = pixel % width, pixel // width
        rivals = [dr.full(mi.Color3f, -dr.inf) for _ in range(RIVALS)]
        for dx, dy in np.ndindex(3, 3):
            there = mi.Point2i(x + dx - 1, y + dy - 1)
            inside = (there.x >= 0) & (there.x < width) & (there.y >= 0) & (there.y < height)
            for values in self.kept:
                block = dr.gather(mi.Color3f, values, there.y * width + there.x, inside)
                _insert(rivals, dr.select(inside, block, -dr.inf))
        # In double precision, because the difference is much smaller than its terms.
        limit = TOLERANCE * (dr.sum(rivals[-1]) / 3).numpy().astype(np.float64)
        total = np.zeros((len(limit), 3))
        for values in self.kept:
            block = values.numpy().T.astype(np.float64)
            level = block.mean(axis=1)
            over = np.isfinite(limit) & (level > limit) & (limit >= 0)
            total[over] += block[over] * (1 - limit[over] / level[over])[:, None]
        return total


@dr.syntax
def _brightest(kept, blocks, at, end):  # type: ignore[no-untyped-def]
    """The brightest blocks among ``kept`` and the blocks from ``at`` to ``end``."""
    while at < end:
        block = dr.gather(mi.Color3f, blocks, at)
        # Blocks that are not finite are left out here; they still show in the image.
        _insert(kept, dr.select(dr.all(dr.isfinite(block)), block, -dr.inf))
        at += 1
    return kept


def _insert(kept: list[mi.Color3f], new: mi.Color3f) -> None:
    """Insert a block into the sorted list ``kept`` and drop the darkest."""
    for k, old in enumerate(kept):
        brighter = dr.sum(new) > dr.sum(old)
        kept[k], new = dr.select(brighter, new, old), dr.select(brighter, old, new)
