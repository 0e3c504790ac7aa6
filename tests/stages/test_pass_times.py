"""What a pass takes, by a clock that passes of known length move."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from stages.common.costs import CostMeter
from stages.references import pass_times
from stages.references.pass_times import compile_passes, time_kinds_of_passes, time_passes


class Clock:
    """Seconds that only passes let go by."""

    def __init__(self) -> None:
        self.now, self.calls = 0.0, []

    def perf_counter(self) -> float:
        return self.now


class Renderer:
    """A pass takes ``scale`` t^-0.3 seconds."""

    def __init__(self, clock: Clock, name: str, scale: float) -> None:
        self.clock, self.name, self.scale = clock, name, scale

    def empty_sums(self) -> None:
        pass

    def run_pass(self, t: int, sums: None) -> None:
        self.clock.calls.append((self.name, t))
        self.clock.now += self.scale * t**-0.3


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr("stages.references.pass_times.time", clock)
    return clock


@pytest.mark.parametrize("passes", [range(1, 1001), range(1, 251), range(501, 1001)])
def test_few_passes_tell_the_mean_of_all(clock, passes):
    renderers = [Renderer(clock, "a", 1.0), Renderer(clock, "b", 3.0)]
    found = time_passes(renderers, passes, samples=8)
    expected = np.mean(np.array(passes) ** -0.3)
    np.testing.assert_allclose(found, [expected, 3 * expected], rtol=0.04)
    numbers = [t for _, t in clock.calls]
    assert min(numbers) >= passes.start and max(numbers) < passes.stop


def test_renderers_take_turns(clock):
    renderers = [Renderer(clock, name, 1.0) for name in "abc"]
    compile_passes(renderers)
    assert clock.calls == [(name, 1) for name in "aabbcc"]
    clock.calls.clear()
    time_passes(renderers, range(1, 3), samples=5)
    assert [name for name, _ in clock.calls] == list("abc" * 5)
    assert {t for _, t in clock.calls} == {1, 2}


def test_each_kind_of_pass_for_one_view(clock, monkeypatch):
    """Two novel views on their own, both in a pass, and the training's points."""
    singles = [Renderer(clock, name, scale) for name, scale in (("a", 2.0), ("b", 4.0))]
    for single in singles:
        single.sensors = {single.name: None}
    monkeypatch.setattr(pass_times, "single_views", lambda job: singles)

    def together(scene, sensors, points, *rest):
        return Renderer(clock, "shared", 5.0) if sensors else Renderer(clock, "targets", 7.0)

    monkeypatch.setattr(pass_times, "ReferenceRenderer", together)
    section = SimpleNamespace(seed=1, surface_points=10)
    job = SimpleNamespace(
        work=SimpleNamespace(
            params=SimpleNamespace(reference=section), views=SimpleNamespace(train=())
        ),
        plan=SimpleNamespace(source=None),
        costs=CostMeter(),
        target_points=lambda views, surfaces: {"surfaces": surfaces},
        scene=None,
        settings=None,
    )
    found = time_kinds_of_passes(job, passes=1)
    assert found == {
        "seconds_per_single_view_pass": 3.0,
        "seconds_per_shared_view_pass": 2.5,
        "seconds_per_target_pass": 7.0,
    }
