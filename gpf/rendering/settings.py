"""Settings of rendering from a field."""

from __future__ import annotations

from typing import Literal

from gpf.core.settings import Count, Seed, Settings

Gather = Literal["never", "always"]
"""Whether the light at visible points is gathered (:mod:`gpf.field.gathering`)."""


class RenderSettings(Settings):
    """How views are rendered from a field; see the parameters of the plugin ``gpf``."""

    spp: Count = 64
    adaptive: bool = True
    suppress_fireflies: bool = True
    denoise: bool = False
    gather: Gather = "never"
    sampler: Literal["independent", "stratified", "multijitter", "ldsampler"] = "multijitter"
    rr_depth: Count = 5
    seed: Seed = 4
