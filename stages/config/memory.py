"""Refuse settings that need more memory than there is, before anything starts."""

from __future__ import annotations

from gpf.core.machine import require_memory
from stages.config.params import Params

BYTES = {
    "reference.photons_per_pass": 64,
    "reference.view_points": 64,
    "reference.surface_points": 64,
    "visible_region.rays": 48,
    "visible_region.pilot_paths": 48,
    "field.gaussians": 64,
    "train.batch": 64,
    "stream.view_points": 64,
    "stream.surface_points": 64,
}
"""Key of params.yaml -> bytes per unit. Arrays of this size exist at once; the total is larger."""


def refuse_too_large(params: Params) -> None:
    """Raise a :class:`UserError` if a single setting needs more memory than there is."""
    asked = {}
    for key, each in BYTES.items():
        section, _, leaf = key.partition(".")
        asked[key] = getattr(getattr(params, section), leaf), each
    for name, row in params.baselines.items():
        # A photon, a sample or a component takes as much as a Gaussian of the field.
        for leaf in ("photons_per_pass", "components", "samples", "gaussians", "batch"):
            asked[f"baselines.{name}.{leaf}"] = getattr(row, leaf, None), 64
    for key, (value, each) in asked.items():
        if isinstance(value, int):  # neither `auto` nor left out
            require_memory(f"params.yaml: {key}", f"{value:,}", value * each)
