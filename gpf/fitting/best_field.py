"""The best of a fit's complete fields."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gpf.field.field import GaussianPhotonField
from gpf.fitting.quality import QualityEstimate

# A new field replaces the one before it unless its estimated PSNR is lower by more than this, dB.
# The estimate is uncertain, and a field from more photons is better unless its training failed.
TOLERATED, OF_DRAFTS = 3.0, 10.0

# A PSNR is out of reach if tripling the passes gains less than LEAST_GAIN, dB, MOST_STALLS times in
# a row.
LEAST_GAIN, MOST_STALLS = 0.1, 2


class BestField:
    """The best field so far, judged by its estimated PSNR.

    Attributes
    ----------
    field: None before the first complete field.
    passes: photon passes of the field.
    psnr: its estimated PSNR, dB; None if it is a draft.
    history: passes and estimated PSNR of the fields that were the best, in order; a draft is judged
        when there is another field to compare it with.
    stalls: fields in a row that gained less than :data:`LEAST_GAIN`.
    """

    def __init__(self) -> None:
        self.field: GaussianPhotonField | None = None
        self.passes = 0
        self.psnr: float | None = None
        self.history: list[tuple[int, float]] = []
        self.stalls = 0

    def facts(self) -> dict[str, Any]:
        """What a file keeps besides the field, as JSON values."""
        return {"passes": self.passes, "stalls": self.stalls, "is_draft": self.psnr is None}

    def restore(
        self, field: GaussianPhotonField, facts: Mapping[str, Any], quality: QualityEstimate
    ) -> None:
        """Continue with the field and the :meth:`facts` of a file."""
        psnr = None if facts["is_draft"] else quality.psnr(field)
        self.take(field, facts["passes"], psnr)
        self.stalls = facts["stalls"]

    def judge_again(self, quality: QualityEstimate) -> float:
        """The estimated PSNR by all passes of the estimate so far; -inf without a field."""
        if self.field is None:
            return float("-inf")
        psnr = quality.psnr(self.field)
        if self.psnr is not None:
            self.history.pop()
        self.take(self.field, self.passes, psnr)
        return psnr

    def gives_way_to(self, psnr: float, quality: QualityEstimate, is_draft: bool) -> bool:
        """Whether a field with this estimated PSNR, from more photons, should replace it.

        ``is_draft``: whether it is one. SPPM, which judges, leaks through thin walls as drafts do.
        """
        before = self.judge_again(quality)
        self.stalls = self.stalls + 1 if psnr - before < LEAST_GAIN else 0
        return psnr >= before - (OF_DRAFTS if is_draft else TOLERATED)

    def take(self, field: GaussianPhotonField, passes: int, psnr: float | None) -> None:
        """Take a new field; without a PSNR, it is a draft."""
        self.field, self.passes, self.psnr = field, passes, psnr
        if psnr is not None:
            self.history.append((passes, psnr))
