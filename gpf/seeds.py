"""Seeds: independent streams of random numbers that all follow from one."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np


def pass_seed(seed: int, t: int, stream: int) -> int:
    """A 32-bit seed for stream ``stream`` of pass ``t``: a function of its arguments alone."""
    return int(np.random.SeedSequence([seed, t, stream]).generate_state(1)[0])


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
