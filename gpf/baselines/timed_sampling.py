"""As many samples as fit into a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np


def sample_for(
    seconds: float,
    trace: Callable[[int, int], np.ndarray],
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[np.ndarray, int]:
    """An image of as many samples per pixel as fit into a time, and their number: one at least.

    Parts have 1, 1, 2, 4, … samples, and the last what fits, going by what a sample of the part
    before took: nothing is thrown away to find that out.

    Parameters
    ----------
    trace: called as ``trace(spp, part)``; gives an image of so many samples per pixel, which are
        independent of those of the other parts.
    """
    end = clock() + seconds
    total: Any = 0
    done, part, share = 0, 0, 1
    while share > 0:
        start = clock()
        total = total + np.asarray(trace(share, part), dtype=np.float64) * share
        done, part = done + share, part + 1
        now = clock()
        per_sample = max(now - start, 1e-9) / share
        share = min(int((end - now) / per_sample), done)
    return np.asarray(total / done, dtype=np.float32), done


def time_of(action: Callable[[], object]) -> float:
    """Seconds that an action takes: the shorter of two, after one that may compile kernels."""
    action()
    times = []
    for _ in range(2):
        dr.sync_thread()
        start = time.perf_counter()
        action()
        dr.sync_thread()
        times.append(time.perf_counter() - start)
    return min(times)
