"""Images with as many samples as fit into a given time."""

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
    alike: bool = False,
) -> tuple[np.ndarray, int]:
    """An image with as many samples per pixel as fit into a time, and their number, at least one.

    The samples come in parts of 1, 1, 2, 4, … The last part has as many as still fit, judging by
    the time per sample of the part before it. All parts count, so measuring costs no samples.

    Parameters
    ----------
    trace: called as ``trace(spp, part)``; returns an image of ``spp`` samples per pixel that are
        independent of those of other parts.
    alike: whether all parts have one sample; there are at least two parts. For kernels that are
        compiled again for each view and number of samples: the first part includes the compilation,
        so the time of the second part is counted for it instead.
    """
    total: Any = 0
    done, part, share = 0, 0, 1
    if alike:
        total, done, part = np.asarray(trace(1, 0), dtype=np.float64), 1, 1
    end = clock() + seconds
    while share > 0:
        start = clock()
        total = total + np.asarray(trace(share, part), dtype=np.float64) * share
        done, part = done + share, part + 1
        now = clock()
        per_sample = max(now - start, 1e-9) / share
        if alike and part == 2:
            end -= per_sample
        share = min(int((end - now) / per_sample), 1 if alike else done)
    return np.asarray(total / done, dtype=np.float32), done


def time_of(action: Callable[[], object]) -> float:
    """Seconds for an action: the shorter of two runs, after one that may compile kernels."""
    action()
    times = []
    for _ in range(2):
        dr.sync_thread()
        start = time.perf_counter()
        action()
        dr.sync_thread()
        times.append(time.perf_counter() - start)
    return min(times)
