"""As many samples as fit into a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import drjit as dr
import numpy as np

from gpf.baselines.protocol import CannotServe, Task
from gpf.core.random import Stream, pass_seed


@dataclass
class Samples:
    """How many samples per pixel a view gets.

    Attributes
    ----------
    number: of them; None for as many as fit into ``seconds``. The clock decides then, so that there
        are not as many each time.
    seconds: of a view, in all.
    alike: whether parts have one sample each (:func:`sample_for`).
    taken: what the views so far got.
    """

    number: int | None
    seconds: float = 0.0
    alike: bool = False
    taken: list[int] = field(default_factory=list)

    @classmethod
    def plan(cls, spp: int | Literal["equal_time"], task: Task) -> Samples:
        """What options ask for.

        Raises
        ------
        CannotServe: the time of a view from the field is asked for, and not known.
        """
        if spp != "equal_time":
            return cls(int(spp))
        if task.seconds_per_view is None:
            raise CannotServe(
                f"scene {task.name}",
                "what a view from the field costs is not known, so there is no equal time",
                f"Run `gpf stage render --scene {task.name}` first, or give a number of samples.",
            )
        return cls(None, task.seconds_per_view)

    @property
    def spp(self) -> float:
        """Their number; where the clock decides, the mean over the views so far."""
        return self.number if self.number is not None else float(np.mean(self.taken or [0]))

    def trace(
        self, trace: Callable[[int, int], np.ndarray], seed: int, spent: float = 0.0
    ) -> np.ndarray:
        """An image.

        Parameters
        ----------
        trace: called as ``trace(spp, seed)``.
        spent: seconds of the view that other things take.
        """
        if self.number is not None:
            return trace(self.number, seed)
        image, spp = sample_for(
            self.seconds - spent,
            lambda spp, part: trace(spp, pass_seed(seed, part, Stream.TIMED_SAMPLES)),
            alike=self.alike,
        )
        self.taken.append(spp)
        return image


def sample_for(
    seconds: float,
    trace: Callable[[int, int], np.ndarray],
    clock: Callable[[], float] = time.perf_counter,
    alike: bool = False,
) -> tuple[np.ndarray, int]:
    """An image of as many samples per pixel as fit into a time, and their number: one at least.

    Parts have 1, 1, 2, 4, … samples, and the last what fits, going by what a sample of the part
    before took: nothing is thrown away to find that out.

    Parameters
    ----------
    trace: called as ``trace(spp, part)``; gives an image of so many samples per pixel, which are
        independent of those of the other parts.
    alike: whether all parts have one sample, two of them at least. This is for kernels that are
        compiled anew for each view and number of samples: the first part counts as much as the
        second, and its compilation does not count.
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
