"""Two independent images of gathered light, by which the picture of a field is corrected."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.rays import sample_pixel_rays
from gpf.core.random import Stream, pass_seed
from gpf.rendering.correction import is_wrong
from gpf.rendering.sample_sets import SampleSets
from gpf.rendering.timed_sampling import sample_for

FIRST, LEAST = 2, 8
"""Samples with gathered light in each half that show whether a picture needs correction, and the
smallest number of the picture's own samples for which it is tried."""


def sample_halves(
    look: Callable[[mi.Sampler, mi.Ray3f], mi.Color3f], sensor: mi.Sensor, seed: int, spp: int
) -> np.ndarray:
    """Two images with independent noise, (2, H, W, 3), with about ``spp`` samples per pixel each.

    ``look``: the radiance that camera rays find, with gathered light.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    rows = dr.opaque(mi.UInt32, height)

    def sample(sampler: mi.Sampler, pixel: mi.Vector2u) -> list[mi.Float]:
        # One image lies below the other.
        place = mi.Vector2u(pixel.x, dr.select(pixel.y < rows, pixel.y, pixel.y - rows))
        ray, weight = sample_pixel_rays(sensor, sampler, place)
        return [*(weight * look(sampler, ray))]

    with dr.suspend_grad():
        sampler = sensor.sampler().fork()
        sampler.set_sample_count(spp)
        spp = int(sampler.sample_count())  # it may have rounded it
        sets = SampleSets(sample, sampler, (width, 2 * height), spp, None)
        one = dr.full(mi.UInt32, 1, 2 * height * width)
        sums = sets.take(one, pass_seed(seed, 0, Stream.GATHERED_HALVES))
    found = np.stack([c.numpy() for c in sums[:3]], axis=1) / spp
    return found.reshape(2, height, width, 3).astype(np.float32)


def halves_to_correct(
    picture: np.ndarray,
    spp: int,
    gather: Callable[[int, int], np.ndarray],
    seconds: float | None = None,
) -> np.ndarray | None:
    """Two images that correct a picture from the field, (H, W, 3), which has ``spp`` samples per
    pixel: with as many in all, or as many as fit into ``seconds``. None if the picture has few
    samples, or if :data:`FIRST` show nothing to correct.

    ``gather(spp, part)`` returns :func:`sample_halves`, independent of those of other parts.
    """
    if seconds is None and spp < LEAST:
        return None
    halves, count = gather(FIRST, 0), spp // 2
    if not is_wrong(picture, halves):
        return None
    if seconds is None:
        more = gather(count, 1)
    else:
        more, count = sample_for(seconds, lambda spp, part: gather(spp, part + 1))
    halves += (more - halves) * np.float32(count / (count + FIRST))
    return halves
