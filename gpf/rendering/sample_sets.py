"""Sets of samples: some for each pixel of an image, added up pixel by pixel.

The samples of a set lie on a grid in their pixel, and consecutive sets in pixels next to each
other, so that the lanes of a packet look at the same part of the scene. A set is added up in small
blocks, which tell fireflies from really bright pixels (:mod:`gpf.rendering.fireflies`). All of this
stays in kernels, and each pixel is added up in the same order: the same seed gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import TILE
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import from_numpy
from gpf.rendering.fireflies import BrightestBlocks, choose_block_size


def largest_launch() -> int:
    """Most samples in one launch. All of them are in memory at once, but a GPU takes a few million
    of them in the time that Python needs to trace a launch."""
    return 1 << (23 if "cuda" in str(mi.variant()) else 21)


SampleFunction = Callable[["mi.Sampler", "mi.Vector2u"], "list[mi.Float]"]
"""Maps a seeded sampler and the pixel of each lane to the channels of each lane's sample; the first
three channels are the radiance."""


@dataclass(frozen=True)
class SampleSets:
    """Takes sets of samples of an image with N pixels.

    Attributes
    ----------
    sampler: draws the samples.
    size: width and height of the image, pixels.
    set_size: samples per set; the sampler can arrange them in a grid.
    brightest: gets the blocks of all sets, if given.
    """

    sample: SampleFunction
    sampler: mi.Sampler
    size: tuple[int, int]
    set_size: int
    brightest: BrightestBlocks | None

    def take(self, counts: mi.UInt32, seed: int) -> list[mi.Float64]:
        """Take ``counts`` sets of each pixel, (N,).

        Returns, (N,) each: the sums of the channels; the sums of the samples' squared radiance; and
        the sums of the sets' squared sums of radiance. A square is the mean over three channels.
        """
        sums: list[mi.Float64] = []
        for number, part in enumerate(self._parts(counts)):
            launch = self._launch(part, pass_seed(seed, number, Stream.ADAPTIVE_SAMPLES))
            if not sums:
                sums = [dr.zeros(mi.Float64, self.size[0] * self.size[1]) for _ in launch]
            for whole, more in zip(sums, launch, strict=True):
                before = dr.gather(mi.Float64, whole, part.pixel)
                dr.scatter(whole, before + more, part.pixel)
            dr.eval(sums)
        return sums

    def _parts(self, counts: mi.UInt32) -> Iterator[_Part]:
        """The sets of each launch."""
        pixels = tile_order(*self.size)
        ends = dr.prefix_reduce(
            dr.ReduceOp.Add, dr.gather(mi.UInt32, counts, pixels), exclusive=False
        )
        largest = max(largest_launch() // self.set_size, 1)
        total = int(ends[dr.width(ends) - 1])
        starts = np.arange(0, total, largest)
        stops = np.minimum(starts + largest, total)
        places = [_places(from_numpy(mi.UInt32, sets), ends) for sets in (starts, stops - 1)]
        for start, stop, first, last in zip(
            starts, stops, *(place.numpy() for place in places), strict=True
        ):
            begin, end = (dr.opaque(mi.UInt32, int(n)) for n in (start, stop))
            place = dr.arange(mi.UInt32, int(last - first) + 1) + dr.opaque(mi.UInt32, int(first))
            after = dr.gather(mi.UInt32, ends, place)
            before = dr.gather(mi.UInt32, ends, place - 1, place > 0)
            owner = _places(dr.arange(mi.UInt32, int(stop - start)) + begin, ends)
            part = _Part(
                pixel=dr.gather(mi.UInt32, pixels, place),
                first=dr.maximum(before, begin) - begin,
                end=dr.minimum(after, end) - begin,
                owner=dr.gather(mi.UInt32, pixels, owner),
            )
            dr.eval(part)
            yield part

    def _launch(self, part: _Part, seed: int) -> list[mi.Float64]:
        """One launch: what :meth:`take` returns, for the pixels of a part."""
        lanes = dr.width(part.owner) * self.set_size
        sampler = self.sampler.fork()
        sampler.set_sample_count(self.set_size)
        sampler.set_samples_per_wavefront(self.set_size)
        sampler.seed(seed, lanes)
        place = dr.arange(mi.UInt32, lanes) // dr.opaque(mi.UInt32, self.set_size)
        number = dr.gather(mi.UInt32, part.owner, place)
        width = dr.opaque(mi.UInt32, self.size[0])
        row = number // width
        channels = self.sample(sampler, mi.Vector2u(number - row * width, row))
        square = sum((c * c for c in channels[:3]), mi.Float(0)) / 3
        each = dr.zeros(mi.Float, lanes)  # a channel may hold a single value for all lanes
        values = [value + each for value in (*channels, square)]
        dr.eval(values)  # otherwise the kernel of each sum would trace them again
        block_size = choose_block_size(self.set_size)
        blocks = [dr.block_sum(value, block_size) for value in values]
        dr.eval(blocks)
        in_set = dr.opaque(mi.UInt32, self.set_size // block_size)
        first, end = part.first * in_set, part.end * in_set
        if self.brightest is not None:
            self.brightest.add(part.pixel, mi.Color3f(blocks[:3]), first, end)
        # Double-precision sums of these same blocks, because `excess` subtracts some of them later.
        sums = [mi.Float64(0) for _ in blocks]
        return _add_up(sums, [mi.Float64(0)] * 3, mi.Float64(0), blocks, first, end, in_set)


@dataclass
class _Part:
    """The sets of one launch.

    Attributes
    ----------
    pixel: the pixels that have sets in it, (M,), each once.
    first, end: numbers of the first set of each, and of the one after its last, (M,).
    owner: the pixel of each set.
    """

    pixel: mi.UInt32
    first: mi.UInt32
    end: mi.UInt32
    owner: mi.UInt32


def tile_order(width: int, height: int) -> mi.UInt32:
    """Numbers of all pixels, (H W,), sorted so that the pixels of a small square stay together."""
    # Kernels also run for the lanes that fill the last packet: there, too, nothing may be divided
    # by zero, which would end the process.
    place = dr.minimum(dr.arange(mi.UInt32, width * height), width * height - 1)
    across, down = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)
    top = place // (TILE * across) * TILE
    rows = dr.minimum(TILE, down - top)
    place -= top * across
    left = place // (TILE * rows) * TILE
    columns = dr.minimum(TILE, across - left)
    place -= left * rows
    row = place // columns
    return (top + row) * across + left + place - row * columns


def _places(sets: mi.UInt32, ends: mi.UInt32) -> mi.UInt32:
    """The place of each set; ``ends`` has the number of the set after those of each place."""
    return dr.binary_search(
        0, dr.width(ends) - 1, lambda place: dr.gather(mi.UInt32, ends, place) <= sets
    )


@dr.syntax
def _add_up(sums, of_set, of_sets, blocks, at, end, in_set):  # type: ignore[no-untyped-def]
    """The sums of the blocks from ``at`` to ``end``, and the squared sums of the sets' radiance."""
    at, left = mi.UInt32(at), mi.UInt32(in_set)
    while at < end:
        values = [mi.Float64(dr.gather(mi.Float, block, at)) for block in blocks]
        sums, of_set = _added(sums, values), _added(of_set, values)
        at += 1
        left -= 1
        if left == 0:
            of_sets += (of_set[0] ** 2 + of_set[1] ** 2 + of_set[2] ** 2) / 3
            of_set = [mi.Float64(0), mi.Float64(0), mi.Float64(0)]
            left = mi.UInt32(in_set)
    return [*sums, of_sets]


def _added(sums: list[mi.Float64], values: list[mi.Float64]) -> list[mi.Float64]:
    return [one + another for one, another in zip(sums, values, strict=False)]
