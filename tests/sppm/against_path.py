"""SPPM images against those of ``path``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

from tests.furnace import Scene, block_means, diffuse, interior, render, sppm, z_scores
from tests.tiers import Tier, tiers

PATH = {"type": "path", "max_depth": -1}
TIERS = tiers(quick=1 / 10)
DIRECT = pytest.mark.parametrize("direct", ["photons", "emitters"])
WHITE = diffuse(0.6, 0.5, 0.4)


def compare(
    tier: Tier,
    scene: Scene,
    passes: int = 12,
    spp: int = 1024,
    mean: float = 5e-3,
    block: int = 4,
    bias: float = 0.01,
    truth: Scene = PATH,
    **options: Any,
) -> None:
    """Compare away from edges, where the kernel is biased by design: it finds less than a disc.

    The mean over all such pixels has to agree within ``mean``, blocks of pixels within noise; of
    ``bias``, relative, we take no notice there, for the kernel blurs shadows.

    ``passes``, ``spp`` and ``mean`` are those of the precise tier. The standard error of the ratio
    of means is at most 0.6 ``mean``, a quarter to a half of it in most tests.
    """
    depth = {"max_depth": truth["max_depth"]}
    ours = render(scene, sppm(**options) | depth, tier.samples(passes), 8)
    theirs = render(scene, truth, tier.samples(spp), 8, first=100)
    mask = interior(scene)
    a, b = ours[:, mask].mean(1), theirs[:, mask].mean(1)
    error = np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / 8) / b.mean(0)
    ratio = a.mean(0) / b.mean(0)
    # `pytest -s tests/sppm` prints them all.
    name = os.environ["PYTEST_CURRENT_TEST"].partition("::")[2].removesuffix(" (call)")
    print(f"\n{name}: {ratio.round(4)} ± {error.round(4)}", end=" ")
    z = z_scores(block_means(ours, block, mask), block_means(theirs, block, mask), bias)
    mean = tier.noise(mean)
    assert (error < 0.6 * mean).all(), f"too noisy to tell: {error}"
    np.testing.assert_allclose(ratio, 1, atol=mean)
    assert np.sqrt(np.mean(z**2)) < 1.4 and z.max() < 6
