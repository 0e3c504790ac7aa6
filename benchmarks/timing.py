"""Timing of alternatives in turn, so that other load on the machine affects all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import numpy as np


class Row(NamedTuple):
    """A line of `make bench`: what is measured, and what it is compared with."""

    what: str
    measured: str
    compared: str
    ratio: str
    goal: str

    def __str__(self) -> str:
        return (
            f"{self.what:92} {self.measured:>9} {self.compared:>14} {self.ratio:>6} {self.goal:>6}"
        )


@dataclass(frozen=True)
class Timings:
    """Seconds of every round, by name."""

    rounds: Mapping[str, np.ndarray]

    def milliseconds(self, name: str) -> float:
        """Median over rounds."""
        return 1e3 * float(np.median(self.rounds[name]))

    def ratio(self, name: str, *floor: str) -> float:
        """Median over rounds of a time divided by the sum of others in the same round."""
        total = sum(self.rounds[f] for f in floor)
        return float(np.median(self.rounds[name] / total))


def time_in_turn(
    work: Mapping[str, Callable[[int], None]], rounds: int = 15, warm_up: int = 3
) -> Timings:
    """Call each function once per round with the number of the round.

    A sync after each call includes its kernels in its time.
    """
    seconds: dict[str, list[float]] = {name: [] for name in work}
    for number in range(warm_up + rounds):
        for name, call in work.items():
            start = time.perf_counter()
            call(number)
            dr.sync_thread()
            if number >= warm_up:
                seconds[name].append(time.perf_counter() - start)
    return Timings({name: np.array(values) for name, values in seconds.items()})
