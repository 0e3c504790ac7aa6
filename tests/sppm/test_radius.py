"""The radius of each pass."""

from __future__ import annotations

import math

import pytest

from gpf.sppm.passes import radius_at


def next_radius(radius: float, t: int, alpha: float) -> float:
    """The recurrence of Knaus and Zwicker 2011."""
    return radius * math.sqrt((t + alpha) / (t + 1))


def test_three_passes_by_hand():
    """α = 0.7: r₂² = r₁² 1.7/2 and r₃² = r₂² 2.7/3."""
    assert next_radius(0.02, 1, 0.7) == pytest.approx(0.02 * math.sqrt(0.85), rel=1e-12)
    second = 0.02 * 0.92195444573  # √0.85
    third = second * 0.94868329805  # √0.9
    assert radius_at(1, 0.02, 0.7) == pytest.approx(0.02, rel=1e-9)
    assert radius_at(2, 0.02, 0.7) == pytest.approx(second, rel=1e-9)
    assert radius_at(3, 0.02, 0.7) == pytest.approx(third, rel=1e-9)
    assert radius_at(3, 0.02, 0.7) == pytest.approx(0.0174928557, rel=1e-8)


@pytest.mark.parametrize("alpha", [0.05, 0.5, 0.7, 0.95])
def test_closed_form_follows_the_recurrence(alpha):
    radius = 0.3
    for t in range(1, 1001):
        assert radius_at(t, 0.3, alpha) == pytest.approx(radius, rel=1e-9), t
        radius = next_radius(radius, t, alpha)


def test_radii_shrink_without_end_but_slowly():
    """r_t ∝ t^((α-1)/2): bias goes, and the noise of the mean goes as well."""
    ratio = radius_at(4_000_000, 1, 0.7) / radius_at(1_000_000, 1, 0.7)
    assert ratio == pytest.approx(4 ** ((0.7 - 1) / 2), rel=1e-5)
