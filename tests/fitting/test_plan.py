"""What a fit does next: a table of cases, and whole fits by the plan alone."""

from __future__ import annotations

import time
from itertools import pairwise
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.fitting import goals
from gpf.fitting.plan import FieldCost, Plan, plan_next

# With 300 steps 11.2 s, with 100 steps 5.6 s; from every second point 6.6 and 3.3 s.
COST = FieldCost(points=2.0, evaluation=2.0, step=0.005, judgement=0.5)
INFINITE = float("inf")


@pytest.mark.parametrize(
    ("done", "last", "most", "left", "plan"),
    [
        # First a draft: early, after what is asked for, or from what is there. Whatever the time.
        (0, None, INFINITE, 90, Plan(9, 32, 4)),
        (0, None, 7, 90, Plan(7, 32, 4)),
        (0, None, 2, INFINITE, Plan(2, 32, 4)),
        (30, None, INFINITE, 90, Plan(30, 32, 4)),
        (2, None, INFINITE, 1, Plan(9, 32, 4)),
        # After a draft there is another field, also without more photons.
        (6, Plan(6, 32, 4), 6, INFINITE, Plan(6, 96)),
        (6, Plan(6, 32, 4), INFINITE, 60, Plan(103, 300)),
        (6, Plan(6, 32, 4), INFINITE, 4, Plan(6, 96, 2)),
        # Late rather than with a draft.
        (6, Plan(6, 32, 4), INFINITE, 1, Plan(6, 96, 3)),
        # Three times as many, if that takes a small part of the time and the last has many more.
        (24, Plan(24, 300, 2), INFINITE, 100, Plan(72, 300)),
        (24, Plan(24, 300, 2), 144, INFINITE, Plan(72, 300)),
        (24, Plan(24, 300, 2), 143, INFINITE, Plan(143, 300)),
        # Else a last one with all photons for which there is time, or up to the goal.
        (24, Plan(24, 300, 2), INFINITE, 40, Plan(81, 300)),
        (24, Plan(24, 300, 2), 50, INFINITE, Plan(50, 300)),
        (72, Plan(72, 300), INFINITE, 20.4, Plan(90, 300)),
        # With little time it trains shorter, or from fewer points.
        (72, Plan(72, 300), INFINITE, 12.4, Plan(80, 200)),
        (24, Plan(24, 300, 2), INFINITE, 8, Plan(24, 200)),
        (24, Plan(24, 300, 2), INFINITE, 5.5, None),
        # The photons of an interrupted field.
        (60, Plan(24, 300, 2), INFINITE, 6.3, Plan(60, 100)),
        # Too little time, or nothing to gain.
        (72, Plan(72, 300), INFINITE, 3, None),
        (72, Plan(72, 300), INFINITE, 12, None),
        (72, Plan(72, 300), 72, INFINITE, None),
    ],
)
def test_the_next_field(done, last, most, left, plan):
    found = plan_next(done, last, most, left=left, pass_seconds=0.5, cost=COST)
    assert found == plan


def test_once_light_is_gathered_a_field_of_the_same_photons_is_worth_it():
    first = Plan(24, 300, 2)

    def following(last, most, left):
        return plan_next(24, last, most, left, pass_seconds=1.0, cost=COST, gathers=True)

    assert following(first, 24, INFINITE) == Plan(24, 300, 1, gathered=True)
    assert following(Plan(24, 300, 1, gathered=True), 24, INFINITE) is None
    assert following(first, INFINITE, 7.0) == Plan(24, 200, 1, gathered=True)
    assert following(first, INFINITE, 300).gathered
    assert plan_next(24, first, 24, INFINITE, 1.0, COST) is None


def test_a_slow_first_pass_is_no_measure(monkeypatch):
    """It compiles kernels, also where a fit goes on that has known for long what a pass costs."""
    monkeypatch.setattr(
        goals, "time", SimpleNamespace(perf_counter=iter((0.0, 0.0, 8.0, 8.3)).__next__)
    )
    budget = goals.TimeBudget(60)
    budget.pass_seconds = 0.2
    budget.start_pass()
    budget.note_pass()
    assert budget.pass_seconds == 0.2
    budget.start_pass()
    budget.note_pass()
    assert budget.pass_seconds == pytest.approx(0.3)


def test_the_clock_of_work_stands_still_while_kernels_are_compiled():
    value = dr.opaque(mi.Float, 0.5)
    with goals.TimeBudget(None) as clock:
        assert dr.flag(dr.JitFlag.KernelHistory)
        begin, work = time.perf_counter(), clock.work
        for _ in range(20):  # a literal of its own makes a kernel that no cache has
            value = dr.sin(value * float(np.random.default_rng().uniform(1, 2)))
        dr.eval(value)
        dr.sync_thread()
        compiling = time.perf_counter() - begin
        assert clock.work - work < 0.5 * compiling
        begin, work = time.perf_counter(), clock.work
        time.sleep(0.05)
        assert clock.work - work == pytest.approx(time.perf_counter() - begin, abs=0.01)
    assert not dr.flag(dr.JitFlag.KernelHistory)


def simulate(seconds, pass_seconds, cost):
    """The fields that a fit makes, and the time that it takes."""
    spent, fields, done = 0.0, [], 0
    last = None
    while plan := plan_next(done, last, INFINITE, seconds - spent, pass_seconds, cost):
        spent += (plan.passes - done) * pass_seconds + cost.seconds(plan.steps, plan.stride)
        assert plan.passes >= done and plan.steps <= 300
        last, done = plan, plan.passes
        fields.append(plan)
    return fields, spent


@pytest.mark.parametrize("seconds", [20, 40, 60, 61, 75, 120, 600])
@pytest.mark.parametrize("pass_seconds", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("cost", [FieldCost(1, 0.5, 0.003, 0.5), FieldCost(6, 2, 0.004, 2)])
def test_a_fit_uses_its_time(seconds, pass_seconds, cost):
    """All of it but what the next pass or a shorter training would take."""
    fields, spent = simulate(seconds, pass_seconds, cost)
    assert len(fields) <= 8
    if 24 * pass_seconds + cost.seconds(300, 2) < 0.5 * seconds:
        assert seconds - cost.seconds(100, 2) - pass_seconds < spent <= seconds
        assert spent > 0.9 * seconds or seconds - spent < 1.1 * cost.seconds(100, 2)


def test_more_time_is_more_photons():
    found = [simulate(seconds, 0.3, COST)[0][-1].passes for seconds in range(15, 200, 5)]
    assert all(after >= 0.8 * before for before, after in pairwise(found))
    assert found[-1] > 10 * found[0]
