"""Images with more samples than fit into memory, rendered in batches."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np

from gpf.core.random import Stream, pass_seed
from gpf.rendering.adaptive import MIN_SPP

LARGEST_WAVEFRONT = 1 << 26
"""Largest number of samples in one batch: about 2 GB of state."""


def render_in_batches(
    scene: mi.Scene,
    integrator: mi.Integrator,
    sensor: mi.Sensor,
    spp: int,
    seed: int,
    largest: int = LARGEST_WAVEFRONT,
) -> np.ndarray:
    """An image with ``spp`` samples per pixel and all channels, (H, W, C) float32.

    Batches have independent samples: at most ``largest``, but at least one per pixel. The
    integrator ``gpf`` limits its memory itself if it samples adaptively; it then gets one batch.
    """
    width, height = (int(n) for n in sensor.film().crop_size())
    if getattr(integrator, "adaptive", False) and spp >= MIN_SPP:
        largest = spp * width * height
    total: Any = 0
    for batch, share in enumerate(split_samples(spp, width * height, largest)):
        image: Any = mi.render(
            scene,
            integrator=integrator,
            sensor=sensor,
            spp=share,
            seed=pass_seed(seed, batch, Stream.BATCHES),
        )
        total = total + np.asarray(image.numpy(), dtype=np.float64) * (share / spp)
    return np.asarray(total, dtype=np.float32)


def split_samples(spp: int, pixels: int, largest: int) -> list[int]:
    """Samples per pixel of each batch; they differ by at most one."""
    most = max(largest // pixels, 1)
    batches = -(-spp // most)
    return [(spp * (k + 1)) // batches - (spp * k) // batches for k in range(batches)]
