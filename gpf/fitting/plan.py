"""What a fit does next: how many passes of photons, and how long the field from them trains.

The first field comes early, from few passes; each further one has three times as many photons, as
long as there is time for that and for a last one. The last field takes all the photons for which
there is time, and trains shorter if its time is short.
"""

from __future__ import annotations

from dataclasses import dataclass

FIRST_PASSES, GROWTH = 24, 3
"""Passes until the first complete field, and the factor by which their number then grows."""

LEAST_GROWTH = 1.1
"""The next field has at least so many times the photons of the one before."""

STEPS_PER_PASS, MOST_STEPS, LEAST_STEPS = 3, 300, 100
"""Optimiser steps of a field: so many for each pass, up to a limit; and the fewest of a last field
that has little time."""

_SLOWER = 1.1
"""A field takes so many times as long as the one before: it has more photons."""


@dataclass(frozen=True)
class FieldCost:
    """What a field costs, seconds: in any case (targets, start, judgement), and for each step of
    its training."""

    fixed: float = 0.0
    step: float = 0.0

    def seconds(self, steps: int) -> float:
        """Of the next field with so many steps."""
        return _SLOWER * self.fixed + steps * self.step


@dataclass(frozen=True)
class Plan:
    """The next field: passes of photons in all, and steps of its training."""

    passes: int
    steps: int


@dataclass(frozen=True)
class Done:
    """How far a fit is: passes of photons so far, and passes and steps of its last field."""

    passes: int = 0
    fitted: int = 0
    steps: int = 0


def usual_steps(passes: int) -> int:
    """Steps of a field from so many passes."""
    return min(MOST_STEPS, STEPS_PER_PASS * passes)


def plan_next(
    done: Done, most: float, left: float, pass_seconds: float, cost: FieldCost
) -> Plan | None:
    """The next field; None if it would be no better than the last, or if there is no time for it.

    Parameters
    ----------
    most: passes of the goal; may be infinite.
    left: seconds; may be infinite.
    pass_seconds: of a pass, with its share for the estimate of the quality.
    cost: of the last field.
    """
    if not done.fitted:
        passes = min(FIRST_PASSES, most)
        passes = int(max(passes, done.passes))
        return Plan(passes, usual_steps(passes))
    if done.fitted >= most:
        return None

    def passes_before(seconds: float) -> float:
        """Passes in all, if so many seconds are kept for fields."""
        return min(most, done.passes + max(left - seconds, 0) / max(pass_seconds, 1e-6))

    count = max(round(GROWTH * done.fitted), done.passes)
    steps = usual_steps(count)
    another = passes_before(cost.seconds(steps) + cost.seconds(MOST_STEPS))
    if another >= LEAST_GROWTH * count:
        return Plan(count, steps)
    # No other field could follow: this one takes all the photons that are left.
    for steps in (MOST_STEPS, (MOST_STEPS + LEAST_STEPS) // 2, LEAST_STEPS):
        if cost.seconds(steps) > left:
            continue
        passes = int(passes_before(cost.seconds(steps)))
        steps = min(steps, usual_steps(passes))
        growth, longer = passes / done.fitted, steps / max(done.steps, 1)
        # Many more photons make up for a shorter training, and a longer one for few more.
        enough = growth >= LEAST_GROWTH or passes == most
        if (longer > 0.6 and enough) or growth >= 2 or (longer > 1.5 and growth >= 1):
            return Plan(passes, steps)
    return None
