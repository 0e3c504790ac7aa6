"""What `gpf fit` is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FitOptions:
    """What one field is asked for, or each of an animation.

    Attributes
    ----------
    seconds, passes, target_psnr, seed: as for :func:`gpf.fitting.fit.fit` or, without a target, for
        :func:`gpf.fitting.frames.fit_frames`.
    views: a ``views.yaml`` or ``transforms.json`` with the views that fields are for; by default
        the ``views.yaml`` beside the scene; without one, cameras are placed around the scene's own.
    groups: groups of emitters whose light is kept apart (:meth:`LightGroups.parse`).
    """

    seconds: float | None = None
    passes: int | None = None
    target_psnr: float | None = None
    views: Path | None = None
    seed: int = 0
    groups: str = ""
