"""`make bench` prints each of its lines, here with small pictures."""

import re

import pytest

import benchmarks.__main__ as bench
from benchmarks import dark_places
from tests.small_fit import make_small


@pytest.mark.slow
def test_it_prints_a_line_for_each_measurement(small_bench, capsys):
    bench.bench()
    lines = capsys.readouterr().out.splitlines()
    rows = [line for line in lines if re.search(r"[\d.]+ m?s ", line)]
    assert float(lines[-1].split()[-3]) == pytest.approx(1, abs=0.05)  # … ratio, "1 ±.01"
    pass_, *between, recorded, training = rows
    (sample,) = (row for row in between if row.startswith("one sample"))
    assert any("fog" in row for row in between)
    assert pass_.startswith("SPPM pass, 32²") and "(gpf, recorded)" in recorded
    assert sample and training.startswith("training to within")
    ratios = [float(line.split()[-2]) for line in rows[:-1]]
    assert all(0.1 < ratio < 100 for ratio in ratios)
    assert float(re.search(r"([\d.]+) M points/s", rows[-1])[1]) > 0


@pytest.mark.slow
def test_dark_places(monkeypatch):
    make_small(monkeypatch, passes=2, steps=4, paths=2000)
    monkeypatch.setattr(dark_places, "PASSES", 2)
    rows = list(dark_places.dark_rows(16))
    assert len(rows) == 5 and "tumbler, filled by glass" in rows[-1].what
    assert all(0.1 < float(row.ratio) < 10 for row in rows)
