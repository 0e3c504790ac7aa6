"""Random numbers: independent streams from one seed, and samples on the device."""

from __future__ import annotations

import zlib
from enum import IntEnum, unique

import drjit as dr
import mitsuba as mi
import numpy as np


@unique
class Stream(IntEnum):
    """The independent streams of random numbers derived from one seed."""

    PHOTONS = 0
    CAMERA = 1
    RADIUS_PHOTONS = 2
    RADIUS_POINTS = 3
    SURFACE_POINTS = 5
    VISIBLE_REGION = 6
    PHOTON_MAP = 7
    PILOT = 8
    EDGES = 9
    DENSITY_CONTROL = 10
    EM_PHOTONS = 11
    ADAPTIVE_SAMPLES = 12
    ARRIVALS = 13
    BATCHES = 14
    DENOISING_GUIDES = 15
    TIMED_SAMPLES = 16
    EM_CAMERA = 17
    NOISE_POINTS = 18
    NOISE_PHOTONS = 19
    VOLUME_VIEWS = 20
    VOLUME_PHOTONS = 21
    SPLAT_VIEWS = 31
    SPLAT_GROWTH = 32
    SPLAT_SIGHT = 33
    SPLAT_SEEDS = 34
    NGP_CAMERA = 35
    QUALITY_PHOTONS = 41
    QUALITY_PIXELS = 42
    QUALITY_CAMERA = 43
    QUALITY_DIRECT = 44
    TRAIN_GROUP = 100
    NOVEL_GROUP = 101
    SECOND_REFERENCE_GROUP = 102
    MORE_GROUP = 103
    STREAM_EMITTERS = 1000
    STREAM_JUDGES = 1001
    GROUP_EMITTERS = 1002
    LAMP_PILOT = 1003
    GATHER_RAYS = 1004
    GATHER_LAMPS = 1005
    FURTHER = 1006
    GATHERED_HALVES = 1007
    VIEW_POINTS = 1008


def pass_seed(seed: int, t: int, stream: int, *more: int) -> int:
    """A 32-bit seed for pass ``t`` of a stream; equal arguments give equal seeds.

    Parameters
    ----------
    stream: a :class:`Stream`, or the result of :func:`stream_of`.
    more: further numbers that distinguish streams of the same name.
    """
    return int(np.random.SeedSequence([seed, t, stream, *more]).generate_state(1)[0])


def stream_of(name: str) -> int:
    """The stream of a named view or set of points.

    The probability that it equals a member of :class:`Stream` is below one in a million.
    """
    return zlib.crc32(name.encode())


# 1 / g and 1 / g², where g is the real solution of g³ = g + 1: the steps of a low-discrepancy
# sequence in the plane (Roberts 2018). In units of 2⁻³², so that 32-bit overflow is modulo 1.
_SPREAD = tuple(round(step * 2**32) for step in (0.7548776662466927, 0.5698402909980532))


def random_start(seed: int, lanes: int) -> mi.Point2f:
    """The first element u_0 of each lane's sequence, in [0, 1)², (N, 2)."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, lanes)
    start = sampler.next_2d()
    dr.eval(start)
    return start


def spread_sample(start: mi.Point2f, t: int | mi.UInt32) -> mi.Point2f:
    """Element ``t`` of each lane's sequence in [0, 1)², (N, 2): u_t = u_0 + t (1/g, 1/g²) mod 1.

    Each element is uniformly random; over all t, the elements of a lane are evenly spread.

    Parameters
    ----------
    start: u_0 of each lane, from :func:`random_start`, (N, 2).
    """
    number = dr.opaque(mi.UInt32, t) if isinstance(t, int) else t
    # A float holds only the first 24 bits of the fractions.
    offset = mi.Point2f(*(mi.Float((number * step) >> 8) * 2**-24 for step in _SPREAD))
    place = start + offset
    return place - dr.floor(place)


def step_random(lanes: int, seed: mi.UInt32, step: mi.UInt32) -> mi.PCG32:
    """Random numbers for one step: different for each seed, step and lane.

    ``PCG32(lanes, seed, step)`` is not enough: a lane in one step has the same stream as a
    neighbouring lane in the next step, so all steps together repeat a few thousand numbers.

    Parameters
    ----------
    seed, step: (1,), opaque if they change from call to call.
    """
    lane = dr.arange(mi.UInt32, lanes)
    state, sequence = mi.sample_tea_32(mi.sample_tea_32(seed, step)[0], lane)
    return mi.PCG32(lanes, mi.UInt64(state), mi.UInt64(sequence))


def stratified_batch(count: int, size: int, seed: mi.UInt32, step: mi.UInt32) -> mi.UInt32:
    """A stratified sample of the indices below ``count``, ascending: (min(size, count),).

    The indices are divided into equal intervals, and one is drawn from each. If the indexed points
    are sorted in space, a batch covers the space evenly and the lanes of a packet lie together.

    Parameters
    ----------
    count: number of indices.
    size: number of samples.
    seed, step: (1,), opaque if they change from call to call.
    """
    size = min(size, count)
    rng = step_random(size, seed, step)
    stride = dr.opaque(mi.Float, count / size)
    place = (mi.Float(dr.arange(mi.UInt32, size)) + rng.next_float32()) * stride
    return dr.minimum(mi.UInt32(place), dr.opaque(mi.UInt32, count - 1))


def next_1d(sampler: mi.Sampler, active: mi.Bool) -> mi.Float:
    """The next number of a sampler in [0, 1), (N,).

    About one in ten million from ``multijitter`` is 1, which may make a BSDF sample something of
    zero probability.
    """
    return dr.minimum(sampler.next_1d(active), dr.one_minus_epsilon(mi.Float))


def next_2d(sampler: mi.Sampler, active: mi.Bool) -> mi.Point2f:
    """The next point of a sampler in [0, 1)², (N, 2); see :func:`next_1d`."""
    return dr.minimum(sampler.next_2d(active), dr.one_minus_epsilon(mi.Float))
