"""Costs: counted for each part, across interruptions, with the compilation apart."""

from __future__ import annotations

import json
import time
from types import SimpleNamespace

import drjit as dr
import mitsuba as mi
import pytest

from baselines.programs.conversation import peak_megabytes
from gpf.core.errors import UserError
from stages.common.costs import KINDS, CostMeter, peak_memory


class Clock:
    """Wall-clock and CPU time that only the test lets go by."""

    def __init__(self) -> None:
        self.wall, self.cpu = 100.0, 50.0

    def perf_counter(self) -> float:
        return self.wall

    def process_time(self) -> float:
        return self.cpu

    def sleep(self, seconds: float) -> None:
        self.wall += seconds

    def work(self, seconds: float) -> None:
        self.wall += seconds
        self.cpu += seconds


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("stages.common.costs.time", clock)
    return clock


def test_wall_and_cpu_time_of_a_part(clock):
    costs = CostMeter()
    with costs.measure("asleep"):
        clock.sleep(0.5)
    with costs.measure("busy"):
        clock.work(0.25)
    none = {"compile_seconds": 0.0}
    assert costs.parts == {
        "asleep": {"wall_seconds": 0.5, "cpu_seconds": 0.0} | none,
        "busy": {"wall_seconds": 0.25, "cpu_seconds": 0.25} | none,
    }
    assert costs.parts["busy"].keys() == set(KINDS)


def test_a_part_measured_twice_adds_up(clock):
    costs = CostMeter()
    for _ in range(2):
        with costs.measure("part"):
            clock.sleep(0.5)
    assert costs.parts["part"]["wall_seconds"] == 1


def test_a_part_that_fails_is_counted_too(clock):
    costs = CostMeter()
    with pytest.raises(KeyboardInterrupt), costs.measure("part"):
        clock.sleep(0.5)
        raise KeyboardInterrupt
    assert costs.parts["part"]["wall_seconds"] == 0.5


def test_what_is_asked_for_in_between_is_not_counted_twice(clock):
    costs = CostMeter()
    with costs.measure("part"):
        clock.sleep(0.5)
        half = costs.so_far("part")
        clock.sleep(0.25)
    assert costs.parts["part"]["wall_seconds"] == 0.75
    # What was asked for is a record of its moment, not a view of the running total.
    assert half["wall_seconds"] == 0.5


def test_compilation_is_counted_apart():
    costs = CostMeter()
    x = dr.arange(mi.Float, 1000)
    dr.eval(x)
    # A constant that no kernel on this machine has had: nothing is found in the cache.
    odd = 1 + (time.time_ns() % 1_000_003) / 1e7

    def work() -> None:
        dr.eval(dr.sin(x * odd) + dr.exp(x / odd) * dr.tan(odd + x))

    with costs.measure("first"):
        work()
    with costs.measure("second"):
        work()
    assert costs.parts["first"]["compile_seconds"] > 0
    assert costs.parts["second"]["compile_seconds"] == 0
    assert costs.parts["first"]["wall_seconds"] < 0.5


def test_device_work_is_waited_for():
    x = dr.arange(mi.Float, 2_000_000) + 1
    dr.eval(x)
    dr.sync_thread()
    one, other = CostMeter(), CostMeter()
    for meter, rounds in ((one, 1), (other, 40)):
        for _ in range(2):  # the second time without compilation
            meter.parts.clear()
            with meter.measure("work"):
                value = mi.Float(x)
                for _ in range(rounds):
                    value = dr.sin(value) + 1
                    dr.eval(value)  # runs beside this thread
    assert other.parts["work"]["wall_seconds"] > 5 * one.parts["work"]["wall_seconds"]


def test_a_part_is_shared_among_names():
    costs = CostMeter({"group": {"wall_seconds": 6.0, "cpu_seconds": 12.0, "compile_seconds": 3.0}})
    costs.share("group", ["a", "b", "c"])
    expected = {"wall_seconds": 2.0, "cpu_seconds": 4.0, "compile_seconds": 1.0}
    assert costs.parts == {f"group/{name}": expected for name in "abc"}


def test_costs_go_on_from_their_file(tmp_path):
    path = tmp_path / "costs" / "reference.json"
    assert CostMeter.load(path).parts == {}
    first = CostMeter()
    with first.measure("old"):
        time.sleep(0.05)
    first.facts["views"] = 3
    first.write(path)
    written = json.loads(path.read_text())
    assert written["facts"] == {"views": 3} and "cpu" in str(written["machine"]).lower()
    again = CostMeter.load(path)
    assert again.parts == first.parts and again.facts == first.facts


def test_a_damaged_file_is_said_in_words(tmp_path):
    path = tmp_path / "reference.json"
    path.write_text('{"parts": {"old": {"wall')
    with pytest.raises(UserError, match=r"reference\.json: is not JSON"):
        CostMeter.load(path)


@pytest.mark.parametrize(("system", "size"), [("linux", 2_048_000), ("darwin", 2000)])
def test_peak_memory_in_the_units_of_the_system(monkeypatch, system, size):
    monkeypatch.setattr("sys.platform", system)
    monkeypatch.setattr("resource.getrusage", lambda who: SimpleNamespace(ru_maxrss=2000))
    assert (peak_memory(), peak_megabytes()) == (size, size / 1e6)
