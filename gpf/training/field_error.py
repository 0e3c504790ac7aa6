"""How wrong a field may be: an expected relative error for each Gaussian.

Two halves of the photons give targets a and b at the supervised points, with independent noise. Let
f be the field's answer there, f_a and f_b those of fields whose colours were fitted to one half
each. The field has three kinds of error: noise, with the variance D; misfit, light that its
Gaussians cannot follow, with the square M; and the blur of the targets' kernels, with the square
B (:func:`gpf.training.streaming.kernel_blur`):

    D = ⟨(f_a - f_b)²⟩ / 4,
    M = ⟨(f - a) (f - b)⟩ + (s - s²/2) S,      S = ⟨(a - b)²⟩ / 2,  s = √(2 D / S).

S is the variance of a half. The field takes over the share s of the targets' noise, and the second
term of M makes up for this. ⟨⟩ are means over the points around a Gaussian; each counts by the
inverse square of its light, so that a bright place does not decide for its dim neighbours. D is
divided by their light and multiplied by that of the Gaussian, because the variance of a sum of
photons is proportional to their light; M + B is divided by the square of the light.

This tells places apart. How large the error is in all, photons tell from which the field did not
learn (:meth:`gpf.fitting.quality.QualityEstimate.error_scale`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gpf.core.structs import SurfacePoints, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.training.blend_matrix import blend_matrix
from gpf.training.light_split import split_colours
from gpf.training.loss import relative_weight

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ROUNDS = 4
"""Means over points are spread to neighbours so many times: few points have much noise."""

STEPS = 10
"""Steps that fit the colours of a half."""

MOST = 10.0
"""Largest relative error."""

DIM = 0.1
"""Points with less light than this share of the mean count as if they had as much."""

_TINY = 1e-20


def estimate_error(
    field: GaussianPhotonField, halves: tuple[SurfacePoints, SurfacePoints], blur: np.ndarray
) -> np.ndarray:
    """The expected error of the field around each Gaussian, relative to its irradiance, (N,).

    Parameters
    ----------
    halves: the supervised points, with targets from two independent halves of the photons.
    blur: B at the points, (P,).
    """
    a, b = (to_numpy(half.target) for half in halves)
    matrix = blend_matrix(field, halves[0])
    colour = to_numpy(field.gaussians.irradiance)
    unit = max(float(a.mean()), _TINY)  # near 1, single precision is enough
    a, b, colour = a / unit, b / unit, colour / unit
    f = matrix @ colour
    level = np.maximum(f.mean(axis=1), 0)
    parts = split_colours(matrix, colour, relative_weight(level), np.stack([a, b]) / 2, STEPS)
    square = (f**2).mean(axis=1)
    counts = 1 / (level**2 + DIM**2)
    values = (
        ((matrix @ (parts[0] - parts[1])) ** 2).mean(axis=1),
        ((f - a) * (f - b)).mean(axis=1),
        ((a - b) ** 2).mean(axis=1) / 2,
        square / np.maximum(level, _TINY),
        square,
        blur / unit**2,
    )
    noise, cross, variance, per_level, square, blur = _spread(
        matrix, counts[:, None] * np.stack(values, axis=1)
    ).T
    share = np.sqrt(np.clip(2 * noise / np.maximum(variance, _TINY), 0, 1))
    misfit = np.maximum(cross + (share - share**2 / 2) * variance, 0) + np.maximum(blur, 0)
    own = np.maximum(colour.mean(axis=1), _TINY)
    relative = noise / np.maximum(per_level, _TINY) / own + misfit / np.maximum(square, _TINY)
    return np.sqrt(np.clip(relative, 0, MOST**2)).astype(np.float32)


def _spread(matrix: csr_array, values: np.ndarray) -> np.ndarray:
    """Means of values at points, (P, K), around each Gaussian, (N, K)."""
    back, values = matrix.T.tocsr(), values.astype(np.float32)
    sums = np.maximum(np.asarray(back.sum(axis=1)), _TINY)[:, None]
    around: np.ndarray = (back @ values) / sums
    for _ in range(ROUNDS):
        around = (back @ (matrix @ around)) / sums
    return around
