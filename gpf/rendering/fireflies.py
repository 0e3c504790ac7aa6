"""Fireflies: single samples of great radiance that no other sample around has found.

A walk behind glass or off brushed metal meets, once in some ten thousand samples, what is a
thousand times brighter than its pixel. Its share is right on average, and wrong in every image: a
white dot here, nothing elsewhere. What is really bright is bright in several samples of a pixel or
its neighbours. Samples are therefore taken in blocks of a few, and a block b counts no more than
:data:`TOLERANCE` times the :data:`RIVALS`-th brightest block of the 3 × 3 pixels around it,

    L_b' = L_b min(1, κ l / l_b),

l_b the mean over the channels of its radiance L_b, l that of the rival, and κ the tolerance, which
leaves ordinary noise as it is: a simple form of the reweighting of Zirr, Hanika and Dachsbacher,
"Reweighting Firefly Samples for Improved Finite-Sample Monte Carlo Estimates" (2018). The image
loses energy, the less the more samples it has.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

LEAST_IN_BLOCK = 4
"""Samples of a block, where sets are large enough: fewer, and noise would look like fireflies."""

RIVALS = 3
"""A block is believed where so many blocks, itself among them, are about as bright."""

TOLERANCE = 2.0
"""κ: how many times as bright as its rivals a block may be."""


def choose_block(in_set: int) -> int:
    """How many samples a block has where sets of ``in_set`` are to be divided evenly.

    A set has :data:`RIVALS` blocks at least: what a pixel sees in all its samples it has confirmed.
    """
    sizes = [n for n in range(1, in_set // RIVALS + 1) if in_set % n == 0]
    return next((n for n in sizes if n >= LEAST_IN_BLOCK), sizes[-1])


class BrightestBlocks:
    """The :data:`RIVALS` brightest blocks of each pixel: no other can be too bright.

    Attributes
    ----------
    size: width and height of the image, pixels.
    kept: the blocks, brightest first, -inf where a pixel had fewer; (H W,) each.
    """

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.kept = [dr.full(mi.Color3f, -dr.inf, size[0] * size[1]) for _ in range(RIVALS)]

    def add(self, pixels: np.ndarray, blocks: mi.Color3f) -> None:
        """Equally many blocks of each of ``pixels`` (N,), of which equal ones follow each other.

        A block is the radiance of its samples, all added up.
        """
        each = dr.width(blocks) // len(pixels)
        starts = np.flatnonzero(np.r_[True, pixels[1:] != pixels[:-1]])
        ends = np.r_[starts[1:], len(pixels)]
        at, end = (mi.UInt32((n * each).astype(np.uint32)) for n in (starts, ends))
        pixel = mi.UInt32(pixels[starts].astype(np.uint32))
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
        # In double precision: what is left is that much less than what is taken away.
        limit = TOLERANCE * dr.mean(rivals[-1]).numpy().astype(np.float64)
        total = np.zeros((len(limit), 3))
        for values in self.kept:
            block = values.numpy().T.astype(np.float64)
            level = block.mean(axis=1)
            over = np.isfinite(limit) & (level > limit) & (limit >= 0)
            total[over] += block[over] * (1 - limit[over] / level[over])[:, None]
        return total


@dr.syntax
def _brightest(kept, blocks, at, end):  # type: ignore[no-untyped-def]
    """The brightest of those that are kept and of the blocks from ``at`` to ``end``."""
    while at < end:
        block = dr.gather(mi.Color3f, blocks, at)
        # What is not finite is for others to complain of.
        _insert(kept, dr.select(dr.all(dr.isfinite(block)), block, -dr.inf))
        at += 1
    return kept


def _insert(kept: list[mi.Color3f], new: mi.Color3f) -> None:
    """Put a block where it belongs among the brightest; the last one goes."""
    for k, old in enumerate(kept):
        brighter = dr.mean(new) > dr.mean(old)
        kept[k], new = dr.select(brighter, new, old), dr.select(brighter, old, new)
