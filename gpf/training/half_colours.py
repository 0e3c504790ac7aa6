"""What a field would be if it had been fitted to only one half of the photons or the other.

What both have in common is light; where they differ is noise. They give an estimate of the field's
error (:mod:`gpf.training.field_error`), and detail that they do not share is removed from the field
(:mod:`gpf.training.shared_detail`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import SurfacePoints, take, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.training.blend_matrix import RowParts, blend_matrix
from gpf.training.light_split import fit_colours
from gpf.training.loss import relative_weight

if TYPE_CHECKING:
    from scipy.sparse import csr_array

STEPS = 10
"""Steps of the fit to a half."""

POINTS = 16
"""Points per Gaussian. If there are at least twice as many, every second or third is enough, since
neighbours share the noise of the same photons."""

_TINY = 1e-20


@dataclass(frozen=True)
class HalfColours:
    """The colours of a field's Gaussians from all photons and from each half of them.

    All light is in units of the mean target, where single precision is enough.

    Attributes
    ----------
    stride: every ``stride``-th supervised point is used.
    matrix: the weights W of the Gaussians at these points, (P, N).
    targets: targets of the halves, (2, P, 3).
    halves: colours fitted to these targets, (2, N, 3).
    caustics: colours fitted to the caustics of the halves, (2, N, 3), or None.
    unit: the mean target, W/m².
    """

    stride: int
    matrix: csr_array
    targets: np.ndarray
    halves: np.ndarray
    caustics: np.ndarray | None
    unit: float

    @classmethod
    def fit(
        cls,
        field: GaussianPhotonField,
        halves: tuple[SurfacePoints, SurfacePoints],
        caustics: np.ndarray | None = None,
    ) -> HalfColours:
        """Fit a field's colours.

        Parameters
        ----------
        halves: supervised points, (P), with the targets of each half.
        caustics: the part of the targets that is caustics, (2, P, 3), if known.
        """
        gaussians = dr.width(field.gaussians.means)
        stride = max(1, dr.width(halves[0].p) // (POINTS * gaussians))
        targets = np.stack([to_numpy(half.target)[::stride] for half in halves])
        every = dr.arange(mi.UInt32, len(targets[0])) * stride
        matrix = blend_matrix(field, take(halves[0], every))
        unit = max(float(targets[0].mean()), _TINY)
        level = (matrix @ to_numpy(field.gaussians.irradiance)).mean(axis=1) / unit
        weight = relative_weight(np.maximum(level, 0))
        targets /= unit
        each = targets if caustics is None else np.vstack([targets, caustics[:, ::stride] / unit])
        fitted = fit_colours(matrix, weight, each.astype(np.float32), STEPS)
        further = None if caustics is None else fitted[2:]
        return cls(stride, matrix, targets, fitted[:2], further, unit)

    def spread(self, values: np.ndarray, rounds: int) -> np.ndarray:
        """Means of the Gaussians' values, (N, K), over their neighbours, (N, K): more rounds reach
        farther."""
        for _ in range(rounds):
            values = self.around(self._forth @ values)
        return values

    def total(self, colours: np.ndarray) -> np.ndarray:
        """The sum of the light of all points, (3,), for these colours, (N, 3)."""
        found: np.ndarray = self._sums.astype(np.float32) @ colours
        return found

    def around(self, values: np.ndarray) -> np.ndarray:
        """Means of values at points, (P, K), around each Gaussian, (N, K)."""
        found: np.ndarray = self._back @ values.astype(np.float32)
        return found

    @cached_property
    def _forth(self) -> RowParts:
        return RowParts(self.matrix)

    @cached_property
    def _back(self) -> RowParts:
        """The weights of the points for the mean around each Gaussian, (N, P)."""
        from scipy.sparse import diags_array  # slow to import

        sums = np.maximum(self._sums, _TINY)
        return RowParts(diags_array((1 / sums).astype(np.float32)) @ self.matrix.T.tocsr())

    @property
    def unseen(self) -> np.ndarray:
        """Whether no point sees a Gaussian, (N,): then the halves know nothing of its colour."""
        return self._sums == 0

    @cached_property
    def _sums(self) -> np.ndarray:
        return np.asarray(self.matrix.sum(axis=0))
