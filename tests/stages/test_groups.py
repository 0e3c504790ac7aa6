"""Groups of reference views: their random numbers, and when they have enough passes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from stages.references.group_passes import GroupPasses
from stages.references.groups import GROUPS, Group


def test_no_two_groups_share_a_random_number():
    """Otherwise the noise of the novel views would be in the targets of the training."""
    section = SimpleNamespace(seed=1)
    job = SimpleNamespace(work=SimpleNamespace(params=SimpleNamespace(reference=section)))
    assert len({Group(job, name).seed for name in GROUPS}) == len(GROUPS) == 4


@pytest.mark.parametrize(("worst", "enough"), [(39.9, False), (40.1, True)])
def test_the_noisiest_view_decides_whether_passes_are_enough(worst, enough):
    passes = GroupPasses.__new__(GroupPasses)
    section = SimpleNamespace(target_psnr=40.0, passes=200)
    passes.work = SimpleNamespace(
        params=SimpleNamespace(reference=section), views=SimpleNamespace(exposure=1.0)
    )

    def view(psnr):
        return SimpleNamespace(expected_psnr=lambda passes, exposure: psnr)

    sums = SimpleNamespace(views={"a": view(45.0), "b": view(worst)}, passes=50)
    assert passes.is_good_enough(sums) == enough
