"""Small sizes for the programs of `benchmarks/`, so that a test of one takes seconds."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

import pytest
import typer
from typer.testing import CliRunner

import benchmarks.__main__ as bench
import benchmarks.training
from benchmarks import truth
from gpf.guiding.emission_plan import VisibleRegionSettings
from tests.small_fit import make_small
from tests.stages.conftest import built, finished, unused

__all__ = ["built", "finished", "unused"]


@pytest.fixture
def small_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of 32 rows, one radius, few passes, and no dark places."""
    monkeypatch.setattr(bench, "SIZES", (32,))
    monkeypatch.setattr(bench, "RADII", (0.05,))
    monkeypatch.setattr(bench, "ENERGY", (32, 64, 12))
    monkeypatch.setattr(benchmarks.training, "PASSES", 24)
    monkeypatch.setattr(benchmarks.training, "ROWS", 32)
    monkeypatch.setattr(bench, "dark_rows", lambda rows: ())


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """Run a program with small fits, wide enough for its tables; returns what it prints."""
    make_small(monkeypatch, passes=2, steps=4, paths=2000)
    few = partial(VisibleRegionSettings, rays=20_000, pilot_paths=20_000)
    monkeypatch.setattr(truth, "VisibleRegionSettings", few)

    def run_app(app: typer.Typer, *words: object) -> str:
        outcome = CliRunner().invoke(app, [str(word) for word in words], catch_exceptions=False)
        assert outcome.exit_code == 0, outcome.output
        return outcome.stdout

    return run_app


def cells(table: str, name: str) -> list[str]:
    """The cells of the last line of a printed table that begins with a name."""
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in table.splitlines()]
    return next(line for line in reversed(lines) if line and line[0] == name)[1:]


def numbers(texts: list[str]) -> list[float]:
    """All numbers in some texts."""
    return [float(text) for cell in texts for text in re.findall(r"-?\d*\.?\d+", cell)]
