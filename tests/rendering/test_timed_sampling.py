"""Samples against the clock, with a clock of the test's own."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from gpf.rendering.timed_sampling import sample_for, time_of


@dataclass
class Tracer:
    """Takes ``start`` + ``each`` seconds per sample; the image is the mean of 1, 2, 3, …"""

    start: float
    each: float
    now: float = 0.0
    shares: list[int] = field(default_factory=list)

    def trace(self, spp: int, part: int) -> np.ndarray:
        assert part == len(self.shares)
        first = sum(self.shares) + 1
        self.shares.append(spp)
        self.now += self.start + self.each * spp
        return np.full((2, 3, 3), np.mean(np.arange(first, first + spp)))


@pytest.mark.parametrize(
    ("seconds", "start", "each", "shares"),
    [
        (8.05, 0.0, 0.5, [1, 1, 2, 4, 8]),
        (13.3, 0.0, 0.5, [1, 1, 2, 4, 8, 10]),
        (0.2, 0.0, 0.5, [1]),
        (-1.0, 0.0, 0.5, [1]),
        # 20 s: 2 + 2 + 3 + 5 leave 8, in which five of 1.25 s would fit; they take 7 in the end.
        (20.0, 1.0, 1.0, [1, 1, 2, 4, 6]),
    ],
)
def test_parts_grow_and_the_last_is_what_fits(seconds, start, each, shares):
    tracer = Tracer(start, each)
    image, spp = sample_for(seconds, tracer.trace, lambda: tracer.now)
    assert tracer.shares == shares
    assert spp == sum(shares)
    assert tracer.now <= max(seconds, start + each)
    # Each sample counts once: a part weighs what it has.
    np.testing.assert_allclose(image, np.full((2, 3, 3), (spp + 1) / 2))
    assert image.dtype == np.float32


@pytest.mark.parametrize(("seconds", "count"), [(5.05, 10), (0.2, 2)])
def test_parts_that_are_alike_do_not_count_what_the_first_compiled(seconds, count):
    tracer = Tracer(0.0, 0.5, now=0.0)

    def trace(spp, part):
        tracer.now += 0 if part else 30
        return tracer.trace(spp, part)

    image, spp = sample_for(seconds, trace, lambda: tracer.now, alike=True)
    assert tracer.shares == [1] * count and spp == count
    assert tracer.now == 30 + 0.5 * count
    np.testing.assert_allclose(image, np.full((2, 3, 3), (spp + 1) / 2))


def test_the_first_time_is_not_counted():
    naps = [0.5, 0.2, 0.02]
    assert 0.02 <= time_of(lambda: time.sleep(naps.pop(0))) < 0.2
    assert not naps
