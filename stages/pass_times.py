"""What a pass of SPPM takes, on average over a long run of them."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from gpf.reference import ReferenceRenderer


def compile_passes(renderers: Sequence[ReferenceRenderer]) -> None:
    """Run what a first pass needs and a later one finds made."""
    for renderer in renderers:
        for _ in range(2):
            renderer.run_pass(1)


def time_passes(renderers: Sequence[ReferenceRenderer], passes: range, samples: int) -> np.ndarray:
    """Seconds that a pass takes, mean over a range of passes, (R,).

    Passes get cheaper as radii shrink, as t^-0.3, so samples are the middles of equal parts: the
    mean with both ends is a quarter too large for 1000 passes. The renderers take turns, so that
    other load on the machine meets all of them.
    """
    seconds = np.empty((samples, len(renderers)))
    for i in range(samples):
        t = passes[int(len(passes) * (i + 0.5) / samples)]
        for j, renderer in enumerate(renderers):
            start = time.perf_counter()
            renderer.run_pass(t)
            seconds[i, j] = time.perf_counter() - start
    return seconds.mean(axis=0)
