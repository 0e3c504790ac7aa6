"""Cost lines, compared with the paper's numbers and with a naive search."""

import itertools

import pytest

from metrics.cost import CostLine, break_even, cumulative

HOUR = 3600.0
FIELD = CostLine("GPF", 12.3 * HOUR, 15.0)
SPPM = CostLine("SPPM-1000", 0.0, 2.3 * HOUR)


def test_total_counts_the_preparation_once():
    assert CostLine("x", 100.0, 3.0).total(7) == 121.0
    assert CostLine("x", 100.0, 3.0).total(0) == 100.0


def test_the_papers_numbers():
    assert break_even(FIELD, SPPM) == 6
    assert SPPM.total(10) / FIELD.total(10) == pytest.approx(1.9, abs=0.05)
    assert SPPM.total(100) / FIELD.total(100) == pytest.approx(18, abs=0.1)


def test_equal_cost_is_not_yet_cheaper():
    # 10 + 2n against 4n: equal at 5 views.
    assert break_even(CostLine("a", 10.0, 2.0), CostLine("b", 0.0, 4.0)) == 6


def test_no_break_even_if_the_cheaper_start_costs_more_per_view():
    cheap_start = CostLine("a", 0.0, 4.0)
    assert cheap_start.total(1) < CostLine("b", 10.0, 2.0).total(1)
    assert break_even(cheap_start, CostLine("b", 10.0, 2.0)) is None


def test_parallel_lines():
    a, b = CostLine("a", 1.0, 2.0), CostLine("b", 2.0, 2.0)
    assert break_even(a, b) == 1
    assert break_even(b, a) is None
    assert break_even(a, a) is None


def test_a_late_break_even_is_found():
    late = break_even(CostLine("a", 500.0, 1.0), CostLine("b", 0.0, 1.0 + 2**-20))
    assert late == 500 * 2**20 + 1


def test_break_even_agrees_with_counting_back_from_the_end():
    values = (0.0, 1.0, 2.5, 7.0)
    for p, v, q, w in itertools.product(values, repeat=4):
        a, b = CostLine("a", p, v), CostLine("b", q, w)
        first = 61
        while first > 1 and a.total(first - 1) < b.total(first - 1):
            first -= 1
        # `a` may be cheaper for 60 views, but with more per view it is not cheaper for ever.
        expected = first if first <= 60 and v <= w else None
        assert break_even(a, b) == expected, (a, b)


def test_cumulative_has_a_column_per_line():
    table = cumulative([FIELD, SPPM])
    assert list(table.columns) == ["views", "GPF", "SPPM-1000"]
    assert list(table["views"]) == list(range(1, 101))
    assert table["GPF"].iloc[0] == 12.3 * HOUR + 15
    assert table["SPPM-1000"].iloc[-1] == pytest.approx(230 * HOUR)
    assert list(cumulative([SPPM], views=(2, 5))["SPPM-1000"]) == [4.6 * HOUR, 11.5 * HOUR]


def test_negative_and_infinite_times_are_errors():
    with pytest.raises(ValueError, match=r"per_view_seconds of x is -1\.0; give a finite time"):
        CostLine("x", 0.0, -1.0)
    with pytest.raises(ValueError, match="preparation_seconds of x is nan"):
        CostLine("x", float("nan"), 1.0)


def test_equal_names_and_negative_views_are_errors():
    with pytest.raises(ValueError, match="use different names"):
        cumulative([SPPM, SPPM])
    with pytest.raises(ValueError, match="not 'views'"):
        cumulative([CostLine("views", 0.0, 1.0)])
    with pytest.raises(ValueError, match="smallest number of views is -3"):
        cumulative([SPPM], views=(1, -3))
