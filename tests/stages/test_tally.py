"""Mean and standard error of a view's pixels, by hand."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from stages.references.pass_sums import ViewTally


def test_the_standard_error_of_few_passes_by_hand():
    """Of 1, 2, 6: the squares of the differences from the mean are 4, 1 and 9."""
    tally = ViewTally(1)
    for t, value in enumerate((1, 2, 6)):
        tally.add(mi.Color3f(value), t)
    np.testing.assert_array_equal(tally.mean(3), 3)
    np.testing.assert_allclose(tally.standard_error(3), np.sqrt(14 / 3 / 2), rtol=1e-6)


def test_one_pass_knows_no_error():
    tally = ViewTally(2)
    tally.add(mi.Color3f(1), 1)
    assert np.isinf(tally.standard_error(1)).all()
