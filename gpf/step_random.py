"""Random numbers of the steps of an optimiser."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi


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
