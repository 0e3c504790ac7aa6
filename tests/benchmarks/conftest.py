"""Small sizes for `make bench`, so that a test of it takes seconds."""

import pytest

import benchmarks.__main__ as bench
import benchmarks.training


@pytest.fixture
def small_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures of 32 rows, one radius, and few passes."""
    monkeypatch.setattr(bench, "SIZES", (32,))
    monkeypatch.setattr(bench, "RADII", (0.05,))
    monkeypatch.setattr(bench, "ENERGY", (32, 64, 12))
    monkeypatch.setattr(benchmarks.training, "PASSES", 24)
    monkeypatch.setattr(benchmarks.training, "ROWS", 32)
