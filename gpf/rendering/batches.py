"""Images of more samples than memory holds at once."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.rendering.adaptive import LEAST_SPP

LARGEST_WAVEFRONT = 1 << 26
"""Samples that are in flight at once: some 2 GB of state."""


def render_in_batches(
    scene: mi.Scene,
    integrator: mi.Integrator,
    sensor: mi.Sensor,
    spp: int,
    seed: int,
    largest: int = LARGEST_WAVEFRONT,
) -> np.ndarray:
    """An image of ``spp`` samples per pixel, all its channels, (H, W, C) float32.

    It is made in as many parts of independent samples as it takes for none of them to have more
    than ``largest`` samples; a part has at least one per pixel. Adaptive samples of the integrator
    ``gpf`` see to that by themselves.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    if getattr(integrator, "adaptive", False) and spp >= LEAST_SPP:
        largest = spp * width * height
    total: Any = 0
    for part, share in enumerate(split_samples(spp, width * height, largest)):
        image: Any = mi.render(
            scene,
            integrator=integrator,
            sensor=sensor,
            spp=share,
            seed=pass_seed(seed, part, Stream.BATCHES),
        )
        total = total + np.asarray(image.numpy(), dtype=np.float64) * (share / spp)
    return np.asarray(total, dtype=np.float32)


def split_samples(spp: int, pixels: int, largest: int) -> list[int]:
    """Samples per pixel of each part, as equal as can be."""
    most = max(largest // pixels, 1)
    parts = -(-spp // most)
    return [(spp * (k + 1)) // parts - (spp * k) // parts for k in range(parts)]
