"""Seeds: independent streams of random numbers that all follow from one."""

from __future__ import annotations

import zlib
from enum import IntEnum, unique

import drjit as dr
import mitsuba as mi
import numpy as np


@unique
class Stream(IntEnum):
    """Names of independent streams of random numbers that all follow from one seed."""

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
    SPLAT_VIEWS = 31
    SPLAT_GROWTH = 32
    SPLAT_SIGHT = 33
    SPLAT_SEEDS = 34
    NGP_CAMERA = 35
    TRAIN_GROUP = 100
    NOVEL_GROUP = 101
    SECOND_REFERENCE_GROUP = 102
    MORE_GROUP = 103
    STREAM_EMITTERS = 1000
    STREAM_JUDGES = 1001


def pass_seed(seed: int, t: int, stream: int, *more: int) -> int:
    """A 32-bit seed for pass ``t`` of a stream: a function of its arguments alone.

    Parameters
    ----------
    stream: a :class:`Stream`, or :func:`stream_of`.
    more: tell further streams of one name apart.
    """
    return int(np.random.SeedSequence([seed, t, stream, *more]).generate_state(1)[0])


def stream_of(name: str) -> int:
    """The stream of a view or a set of points: a number far above those of :class:`Stream`, unless
    by a chance of one in a million."""
    return zlib.crc32(name.encode())


# 1 / g and 1 / g² for the real solution g of g³ = g + 1: a sequence of low discrepancy in the
# plane (Roberts 2018).
_SPREAD = (0.7548776662466927, 0.5698402909980532)


def random_start(seed: int, lanes: int) -> mi.Point2f:
    """Where each lane's own sequence begins: u_0 in [0, 1)², (N, 2)."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, lanes)
    start = sampler.next_2d()
    dr.eval(start)
    return start


def spread_sample(start: mi.Point2f, t: int) -> mi.Point2f:
    """Element ``t`` of each lane's own sequence in [0, 1)², (N, 2).

    Each is random; those of one lane, over all t, lie evenly: u_t = u_0 + t (1/g, 1/g²) mod 1.
    """
    place = start + mi.Point2f(*(dr.opaque(mi.Float, (t * step) % 1) for step in _SPREAD))
    return place - dr.floor(place)


def step_random(lanes: int, seed: mi.UInt32, step: mi.UInt32) -> mi.PCG32:
    """Random numbers of a step: other ones for each seed, step and lane.

    ``PCG32(lanes, seed, step)`` alone will not do: the streams of neighbouring lanes in one step
    are those of others in the next, and over all steps the same few thousand numbers come back.

    Parameters
    ----------
    seed, step: (1), opaque where they change from call to call.
    """
    lane = dr.arange(mi.UInt32, lanes)
    state, sequence = mi.sample_tea_32(mi.sample_tea_32(seed, step)[0], lane)
    return mi.PCG32(lanes, mi.UInt64(state), mi.UInt64(sequence))


def stratified_batch(count: int, size: int, seed: mi.UInt32, step: mi.UInt32) -> mi.UInt32:
    """One index of each of ``size`` equal runs of ``count`` consecutive ones, (size); at most all.

    Where what they count comes in the order of space, a batch is even over it, and lanes of a
    packet stay close to each other.

    Parameters
    ----------
    seed, step: (1), opaque where they change from call to call.
    """
    size = min(size, count)
    rng = step_random(size, seed, step)
    stride = dr.opaque(mi.Float, count / size)
    place = (mi.Float(dr.arange(mi.UInt32, size)) + rng.next_float32()) * stride
    return dr.minimum(mi.UInt32(place), count - 1)
