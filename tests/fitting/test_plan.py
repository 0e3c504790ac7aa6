"""What a fit does next: a table of cases, and whole fits by the plan alone."""

from __future__ import annotations

from itertools import pairwise

import pytest

from gpf.fitting.plan import Done, FieldCost, Plan, plan_next

COST = FieldCost(fixed=4.0, step=0.02)  # with 300 steps 10.4 s, with 100 steps 6.4 s
INFINITE = float("inf")


@pytest.mark.parametrize(
    ("done", "most", "left", "plan"),
    [
        # The first field: early, or after what is asked for, or from what is there.
        (Done(), INFINITE, 60, Plan(24, 72)),
        (Done(), 2, INFINITE, Plan(2, 6)),
        (Done(30), INFINITE, 60, Plan(30, 90)),
        # Whatever the time: a field from fewer photons is speckled.
        (Done(2), INFINITE, 1, Plan(24, 72)),
        # Three times as many, if a last one can follow.
        (Done(24, 24, 72), INFINITE, 100, Plan(72, 216)),
        (Done(24, 24, 72), 1000, INFINITE, Plan(72, 216)),
        # Else a last one with all photons for which there is time, or up to the goal.
        (Done(24, 24, 72), INFINITE, 40, Plan(83, 249)),
        (Done(24, 24, 72), 50, INFINITE, Plan(50, 150)),
        (Done(72, 72, 216), INFINITE, 20.4, Plan(92, 276)),
        # With little time it trains shorter.
        (Done(72, 72, 216), INFINITE, 12.4, Plan(80, 200)),
        (Done(30, 30, 72), INFINITE, 8, Plan(33, 99)),
        # The photons of an interrupted field.
        (Done(60, 24, 72), INFINITE, 11, Plan(61, 183)),
        # Too little time, or nothing to gain.
        (Done(72, 72, 216), INFINITE, 6, None),
        (Done(72, 72, 300), INFINITE, 12, None),
        (Done(72, 72, 216), 72, INFINITE, None),
    ],
)
def test_the_next_field(done, most, left, plan):
    assert plan_next(done, most, left, pass_seconds=0.5, cost=COST) == plan


@pytest.mark.parametrize("seconds", [20, 40, 60, 61, 75, 120, 600])
@pytest.mark.parametrize("pass_seconds", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("cost", [FieldCost(2, 0.01), FieldCost(6, 0.03)])
def test_a_fit_uses_its_time(seconds, pass_seconds, cost):
    """All of it but what the next pass or a shorter training would take."""
    spent, done, fields = 0.0, Done(), 0
    while plan := plan_next(done, INFINITE, seconds - spent, pass_seconds, cost):
        spent += (plan.passes - done.passes) * pass_seconds
        spent += cost.fixed + plan.steps * cost.step
        assert plan.passes >= done.passes and plan.steps <= 300
        done, fields = Done(plan.passes, plan.passes, plan.steps), fields + 1
    first = 24 * pass_seconds + cost.fixed + 72 * cost.step
    assert fields <= 8
    if first < 0.5 * seconds:
        assert seconds - cost.seconds(100) - pass_seconds < spent <= seconds
        assert spent > 0.85 * seconds or seconds - spent < 1.1 * cost.seconds(100)


def test_more_time_is_more_photons():
    found = []
    for seconds in range(15, 200, 5):
        spent, done = 0.0, Done()
        while plan := plan_next(done, INFINITE, seconds - spent, 0.3, COST):
            spent += (plan.passes - done.passes) * 0.3 + COST.fixed + plan.steps * COST.step
            done = Done(plan.passes, plan.passes, plan.steps)
        found.append(done.passes)
    assert all(after >= 0.8 * before for before, after in pairwise(found))
    assert found[-1] > 10 * found[0]
