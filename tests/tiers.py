"""Two tiers of a statistical test: a quick one, and a precise one that is marked long.

The quick tier draws a share s of the samples. Standard errors are then 1/√s times as large, and so
are the tolerances that stand for noise: each tier is as sure of its answer as the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import pytest


@dataclass(frozen=True)
class Tier:
    """The share of the samples that a test draws."""

    share: float

    def samples(self, number: int) -> int:
        """How many of so many samples, seeds or passes."""
        return max(2, round(self.share * number))

    def noise(self, tolerance: float) -> float:
        """A tolerance that stands for noise."""
        return tolerance / self.share**0.5


def tiers(quick: float) -> pytest.MarkDecorator:
    """Run a test with a share of its samples, and, if long tests run, with all of them."""
    precise = pytest.param(Tier(1), marks=pytest.mark.long, id="precise")
    return pytest.mark.parametrize("tier", [pytest.param(Tier(quick), id="quick"), precise])
