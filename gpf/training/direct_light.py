"""Direct light: whether a field stores it, and samples of it at supervised points."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.core.structs import to_numpy
from gpf.field.settings import Direct
from gpf.guiding.lamp_guide import LampGuide, count_bins, find_cells
from gpf.scene.lamps import Lamps, small_lamps
from gpf.scene.light_groups import LightGroups
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings, suit_scene
from gpf.training.sampled_light import SampledLight

PILOT = 8
"""Samples per point from which a guide learns."""

GROUP_SAMPLES = 16
"""Samples per point of each group of emitters."""

WORTH = 0.95
"""Samples are guided if that reduces their variance to less than this fraction."""


def choose_direct(
    scene: mi.Scene, passes: PassSettings, asked: Literal["auto"] | Direct = "auto"
) -> Direct:
    """The source of direct light in a scene: ``auto`` becomes the list of the small lamps.

    Lamps below the kernel radius of the first pass are small. If photons bring direct light, the
    field stores all of it; or, with ``emitters``, all but what samples of the emitters add when a
    view is rendered.
    """
    by_photons = suit_scene(passes, scene).direct == "photons"
    if asked == "auto":
        small = [] if by_photons else small_lamps(scene, passes.initial_radius)
        return tuple(small) or "field"
    if asked == "emitters" and by_photons:
        return tuple(range(len(scene.emitters())))
    return asked


class DirectLight(SampledLight):
    """Direct light at points.

    Most samples of a sky outside the window hit the wall instead. They are guided to the window
    (:mod:`gpf.guiding.lamp_guide`) if that pays off.

    Parameters
    ----------
    lamps: the emitters that are sampled.
    sign: -1 if their light is subtracted from that of the photons.
    """

    LEAST, MOST_PER_PASS, COST = 4, 24.0, 8.0

    def __init__(self, points: FixedPoints, lamps: Lamps, sign: int, seed: int) -> None:
        super().__init__(points, seed)
        self.lamps, self.sign = lamps, sign

    def sample(self, passes: int) -> None:
        """Add the samples that go with this many passes; none without lamps."""
        if self.lamps:
            super().sample(passes)

    def _light(self, half: int, first: int, count: int) -> mi.Color3f:
        seed = pass_seed(self.seed, half, Stream.STREAM_EMITTERS)
        start = random_start(seed, dr.width(self.points.points.p))
        warp = self._guide.warp if self._guide else None
        return self.sign * self.points.direct_sums(start, first, count, self.lamps, warp)[0]

    def by_group(self, groups: LightGroups) -> np.ndarray:
        """The light of each group of emitters, from samples of its own, W/m², (G, N, 3)."""
        found, sampled = [], self.lamps.indices
        for number, members in enumerate(groups.members):
            kept = members
            if sampled is not None:
                kept = tuple(k for k in members if k in sampled)
            seed = pass_seed(self.seed, number, Stream.GROUP_EMITTERS)
            lamps = Lamps(self.points.scene, kept)
            found.append(self.sign * self.points.mean_direct(lamps, GROUP_SAMPLES, seed))
        return np.stack(found)

    @cached_property
    def _guide(self) -> LampGuide | None:
        """The guide that a pilot has learned, or None if it does not pay off."""
        p, n = (to_numpy(values) for values in (self.points.points.p, self.points.points.n))
        cell = find_cells(p, n)
        seed = pass_seed(self.seed, 0, Stream.LAMP_PILOT)
        start, found = random_start(seed, len(p)), []
        for number in range(PILOT):
            sample = spread_sample(start, number)
            light = dr.sum(self.points.direct_irradiance(sample, self.lamps)) / 3
            found.append(count_bins(cell, to_numpy(sample), light.numpy()))
        square, count = (np.sum(part, axis=0) for part in zip(*found, strict=True))
        guide = LampGuide(cell, square, count)
        return guide if guide.remaining < WORTH else None
