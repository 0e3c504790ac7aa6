"""Samples against the clock, with a clock of the test's own."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from gpf.baselines import timed_sampling
from gpf.baselines.options import BaselineOptions
from gpf.baselines.timed_sampling import Samples, sample_for, time_of


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


def test_what_else_a_view_takes_is_off_its_time(monkeypatch):
    asked = []
    known = np.zeros((2, 3, 3)), 7
    monkeypatch.setattr(
        timed_sampling,
        "sample_for",
        lambda seconds, trace, alike: (asked.append(seconds), known)[1],
    )
    samples = Samples(None, 3.0)
    assert samples.spp == 0
    samples.trace(lambda spp, seed: known[0], 1, spent=0.5)
    assert asked == [2.5] and samples.spp == 7
    fixed = Samples(4)
    np.testing.assert_array_equal(fixed.trace(lambda spp, seed: np.array([spp, seed]), 9), [4, 9])
    assert fixed.spp == 4 and not fixed.taken


@pytest.mark.parametrize("system", ["path_tracer", "particle_tracer", "denoised"])
def test_rows_of_params_may_ask_for_equal_time(system):
    row = {"system": system, "spp": "equal_time"}
    options = TypeAdapter(BaselineOptions).validate_python(row)
    assert options.waits_for_field and options.title.endswith(", equal time")
    assert not options.model_copy(update={"spp": 8}).waits_for_field
    with pytest.raises(ValidationError, match="equal_time"):
        TypeAdapter(BaselineOptions).validate_python(row | {"spp": "as long"})
