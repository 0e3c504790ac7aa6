"""Settings of rendering from a field."""

from __future__ import annotations

from typing import Literal

from gpf.core.settings import Count, Seed, Settings

Gather = Literal["auto", "never", "always"]
"""Whether the light at visible points is gathered (:mod:`gpf.field.gathering`); ``auto``: to
correct denoised pictures (:mod:`gpf.rendering.correction`)."""


class RenderSettings(Settings):
    """How views are rendered from a field; see the parameters of the plugin ``gpf``."""

    spp: Count = 64
    adaptive: bool = True
    suppress_fireflies: bool = True
    denoise: bool = False
    gather: Gather = "auto"
    sampler: Literal["independent", "stratified", "multijitter", "ldsampler"] = "multijitter"
    rr_depth: Count = 5
    seed: Seed = 4
