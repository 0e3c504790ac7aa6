"""How far a fit is, for its callback."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from gpf.field.field import GaussianPhotonField


@dataclass(frozen=True)
class FitProgress:
    """Progress of a fit.

    Attributes
    ----------
    passes, all_passes: photon passes so far, and planned in all.
    steps, all_steps: optimiser steps of the field in training, so far and in all.
    held_out_error: error at points that the training does not use, in units of the mean target;
        None before the first evaluation.
    psnr: estimated PSNR of the field's images against an SPPM reference with 1000 passes, dB; None
        before the second complete field, because the first is a draft.
    seconds: seconds since the start.
    field: the field so far, after each evaluation; otherwise None.
    """

    passes: int = 0
    all_passes: int = 0
    steps: int = 0
    all_steps: int = 0
    held_out_error: float | None = None
    psnr: float | None = None
    seconds: float = 0.0
    field: GaussianPhotonField | None = None


class Reporter:
    """Tells a callback how far a fit is."""

    def __init__(self, callback: Callable[[FitProgress], None]) -> None:
        self._callback, self._known = callback, FitProgress()

    def note(self, **changes: Any) -> None:
        """Note attributes of :class:`FitProgress`, without telling."""
        self._known = replace(self._known, **changes)

    def tell(self, seconds: float, field: GaussianPhotonField | None = None) -> None:
        """Tell what is known."""
        self._callback(replace(self._known, seconds=seconds, field=field))
