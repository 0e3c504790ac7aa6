"""Seeds: independent streams of random numbers that all follow from one."""

from __future__ import annotations

import numpy as np


def pass_seed(seed: int, t: int, stream: int) -> int:
    """A 32-bit seed for stream ``stream`` of pass ``t``: a function of its arguments alone."""
    return int(np.random.SeedSequence([seed, t, stream]).generate_state(1)[0])
