"""Fireflies: single samples of very high radiance that no nearby sample confirms.

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

from collections.abc import Iterator

import drjit as dr
import mitsuba as mi
import numpy as np

MIN_BLOCK_SIZE = 4
"""Samples per block, if sets are large enough. Noise in smaller blocks looks like fireflies."""

RIVALS = 3
"""A block counts in full if at least this many blocks, itself included, are about as bright."""

TOLERANCE = 2.0
"""κ: a block may be this many times as bright as the rival."""


def choose_block_size(set_size: int) -> int:
    """The number of samples in a block; it divides ``set_size``.

    A set has at least :data:`RIVALS` blocks, so that a pixel that is bright in all its samples
    confirms itself; unless it has fewer samples.
    """
    sizes = [n for n in range(1, max(set_size // RIVALS, 1) + 1) if set_size % n == 0]
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

    def add(self, pixels: mi.UInt32, blocks: mi.Color3f, first: mi.UInt32, end: mi.UInt32) -> None:
        """Add the blocks from ``first`` to ``end`` of some pixels, (M,) each; no pixel twice.

        A block is the sum of the radiance of its samples.
        """
        before = [dr.gather(mi.Color3f, values, pixels) for values in self.kept]
        kept = _brightest(before, blocks, mi.UInt32(first), end)
        for values, better in zip(self.kept, kept, strict=True):
            dr.scatter(values, better, pixels)
        dr.eval(self.kept)

    def excess(self) -> list[mi.Float64]:
        """Sum of L_b - L_b' over the blocks of each pixel, in the unit of the blocks: one array,
        (H W,), for each channel."""
        rivals = [dr.full(mi.Color3f, -dr.inf) for _ in range(RIVALS)]
        for there, inside in neighbours(self.size, 1):
            for values in self.kept:
                block = dr.gather(mi.Color3f, values, there, inside)
                _insert(rivals, dr.select(inside, block, -dr.inf))
        # In double precision, because the difference is much smaller than its terms.
        limit = TOLERANCE * (sum(mi.Float64(c) for c in rivals[-1]) / 3)
        total = [mi.Float64(0)] * 3
        for values in self.kept:
            block = [mi.Float64(c) for c in values]
            level = sum(block) / 3
            over = dr.isfinite(limit) & (level > limit) & (limit >= 0)
            lost = dr.select(over, 1 - limit / level, 0)
            total = [t + dr.select(over, c * lost, 0) for t, c in zip(total, block, strict=True)]
        dr.eval(total)
        return total


def neighbours(size: tuple[int, int], reach: int) -> Iterator[tuple[mi.UInt32, mi.Bool]]:
    """For each place in a square of 2 ``reach`` + 1 pixels around each pixel of an image: the
    number of the pixel there, (H W,), and whether it is in the image."""
    width, height = (dr.opaque(mi.Int32, n) for n in size)
    pixel = dr.arange(mi.Int32, size[0] * size[1])
    x, y = pixel % width, pixel // width
    for dx, dy in np.ndindex(2 * reach + 1, 2 * reach + 1):
        u, v = x + dx - reach, y + dy - reach
        yield mi.UInt32(v * width + u), (u >= 0) & (u < width) & (v >= 0) & (v < height)


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
