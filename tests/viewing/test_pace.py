"""The size of pictures, and the values that are shown."""

from __future__ import annotations

import numpy as np

from gpf.core.images import tone_map
from gpf.viewing.pace import HEIGHTS, Pace
from gpf.viewing.screen import to_display


def test_the_pace_follows_the_machine():
    pace = Pace()
    assert pace.height(1.0, 1000) == HEIGHTS[0]
    pace.note(0.01, 256 * 256)
    assert HEIGHTS[0] < pace.height(1.0, 1000) < HEIGHTS[-1]
    assert pace.height(1.0, 200) == 200
    for _ in range(20):
        pace.note(0.5, 256 * 256)
    assert pace.height(1.0, 1000) == HEIGHTS[0]


def test_display_values_are_those_of_the_tone_map():
    linear = np.linspace(0, 2, 5001)[:, None, None].repeat(3, 2)
    expected = 255 * tone_map(linear, 0.7)
    assert np.abs(to_display(linear, 0.7) - expected).max() < 1.2
    soft = to_display(linear * 100, 1.0, "soft")
    assert soft.max() < 255 and (np.diff(soft[:, 0, 0].astype(int)) >= 0).all()
    assert to_display(np.full((1, 1, 3), np.nan), 1.0).max() == 255
