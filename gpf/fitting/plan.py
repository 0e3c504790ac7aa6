"""What a fit does next: how many passes of photons, and how long the field from them trains.

The first field is a draft from few passes and points. It shows what a field costs, and gives the
light of diffuse surfaces that is gathered for the next field. A draft never is the last field, even
if time is short: photons alone leak through thin walls. Each further field has three times
as many photons, as long as it takes a small part of the time. The last field uses all the photons
for which there is time; if time is short, it trains for fewer steps, or learns from fewer points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

GROWTH = 3
"""The factor by which the number of passes grows from field to field."""

FIRST_PASSES, DRAFT_STRIDE, DRAFT_STEPS = 9, 4, 32
"""Passes of a draft, which of the points it learns from (every fourth), and its training steps. Its
errors average out over all directions from which light is gathered, except those that are the same
everywhere: after six passes, the light gathered in a kitchen was too bright."""

LARGEST_STRIDE = 3
"""A last field with little time learns from at least every third point."""

SMALL_PART = 0.15
"""A field that is not the last takes at most this part of the time left."""

LEAST_GROWTH, WORTH_WAITING = 1.1, 2
"""The next field has at least ``LEAST_GROWTH`` times the photons of the one before. One that
is not the last is made only if the last will have ``WORTH_WAITING`` times its photons."""

GATHERED = 4
"""A field whose diffuse light is gathered is at least as good as one from this many times its
photons."""

STEPS_PER_PASS, MOST_STEPS, LEAST_STEPS = 16, 300, 100
"""Optimiser steps of a field: for each pass, up to a limit, and the fewest for a last field that
has little time."""

STEPS_PER_EVALUATION = 100
"""The training is evaluated each time after this many steps, and after the last one."""

_SLOWER = 1.15
"""A field takes this many times as long as the one before: it has more photons."""

_LATE = 3
"""The last field may begin this many passes late, because a shorter training would cost more. Only
some passes include samples, so the time of the next one is not known."""


@dataclass(frozen=True)
class FieldCost:
    """What a field costs, in seconds.

    Attributes
    ----------
    points: targets and start, for all points.
    evaluation: an evaluation, every :data:`STEPS_PER_EVALUATION` training steps, at all points.
    step: a training step.
    judgement: the estimate of its quality.
    ending: all that follows the training.
    """

    points: float = 0.0
    evaluation: float = 0.0
    step: float = 0.0
    judgement: float = 0.0
    ending: float = 0.0

    def seconds(self, steps: int, stride: int = 1) -> float:
        """Seconds for the next field with this many steps, from every ``stride``-th point."""
        evaluations = -(-steps // STEPS_PER_EVALUATION)
        of_points = (self.points + evaluations * self.evaluation) / stride
        return _SLOWER * of_points + steps * self.step + self.judgement


@dataclass(frozen=True)
class Plan:
    """The next field: photon passes in all, training steps, the points it learns from (every
    ``stride``-th), and whether its diffuse light is gathered."""

    passes: int
    steps: int
    stride: int = 1
    gathered: bool = False

    @property
    def is_draft(self) -> bool:
        """Whether the field only serves to make the next one."""
        return self.stride == DRAFT_STRIDE

    @property
    def worth(self) -> float:
        """Passes with all points that would make as good a field. With 24 passes and every third
        point, the Cornell Box loses .5 dB, as with 1.2 times fewer passes; a living room loses
        1.6 dB, as with fewer than a third of them."""
        return (GATHERED if self.gathered else 1) * self.passes / self.stride**0.5


def usual_steps(passes: int, gathered: bool = False) -> int:
    """Steps of a field from so many passes."""
    return min(MOST_STEPS, STEPS_PER_PASS * passes * (GATHERED if gathered else 1))


def plan_next(
    done: int,
    last: Plan | None,
    most: float,
    left: float,
    pass_seconds: float,
    cost: FieldCost,
    gathers: bool = False,
) -> Plan | None:
    """The next field; None if it would be no better than the last, or if there is no time for it.

    Parameters
    ----------
    done: passes of photons so far.
    last: the last complete field, or None.
    most: passes of the goal; may be infinite.
    left: seconds left; may be infinite.
    pass_seconds: seconds per pass, including its share of the quality estimate.
    cost: cost of the last complete field.
    gathers: whether diffuse light is gathered by now.
    """
    if last is None:
        return Plan(int(max(min(FIRST_PASSES, most), done)), DRAFT_STEPS, DRAFT_STRIDE)
    if last.passes >= most and not (last.is_draft or (gathers and not last.gathered)):
        return None

    def passes_before(seconds: float) -> float:
        """Passes in all, if ``seconds`` are reserved for fields."""
        return min(most, done + max(left - seconds, 0) / max(pass_seconds, 1e-6))

    count = max(round(GROWTH * last.passes), done)
    steps = usual_steps(count, gathers)
    another = passes_before(cost.seconds(steps) + cost.seconds(MOST_STEPS))
    if another >= WORTH_WAITING * count and cost.seconds(steps) < SMALL_PART * left:
        return Plan(count, steps, gathered=gathers)
    # No other field could follow: this one uses all the photons for which there is time.
    possible = []
    for stride in range(1, LARGEST_STRIDE + 1):
        for steps in (MOST_STEPS, (MOST_STEPS + LEAST_STEPS) // 2, LEAST_STEPS):
            if cost.seconds(steps, stride) > left + _LATE * pass_seconds:
                continue
            passes = int(passes_before(cost.seconds(steps, stride)))
            if steps < MOST_STEPS:  # a shorter training would make less of more photons
                passes = min(passes, max(done, math.ceil(LEAST_GROWTH * last.passes)))
            plan = Plan(passes, min(steps, usual_steps(passes, gathers)), stride, gathers)
            growth, longer = plan.worth / last.worth, plan.steps / max(last.steps, 1)
            # Many more photons make up for a shorter training, and a longer one for few more.
            enough = growth >= LEAST_GROWTH or passes == most
            if (longer > 0.6 and enough) or growth >= 1.5 or (longer > 1.5 and growth >= 1):
                possible.append(plan)
                break
    if not possible and last.is_draft:
        return Plan(done, min(LEAST_STEPS, usual_steps(done, gathers)), LARGEST_STRIDE, gathers)
    return max(possible, key=lambda plan: plan.worth) if possible else None
