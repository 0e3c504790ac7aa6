"""How wrong a field may be: an expected relative error for each Gaussian.

Two halves of the photons give targets a and b at the supervised points, with independent noise. Let
f be the field's answer there, f_a and f_b those of fields whose colours were fitted to one half
each. The field has three kinds of error: noise, with the variance D; misfit, light that its
Gaussians cannot follow, with the square M; and the blur of the targets' kernels, with the square
B (:func:`gpf.training.kernel_width.kernel_blur`):

    D = ⟨(f_a - f_b)²⟩ / 4,
    M = ⟨(f - a) (f - b)⟩ + (s - s²/2) S,      S = ⟨(a - b)²⟩ / 2,  s = √(2 D / S).

S is the variance of a half. The field picks up the share s of the targets' noise, and the second
term of M makes up for this. ⟨⟩ are means over the points around a Gaussian, weighted by the inverse
square of their light, so that bright places do not outweigh their dim neighbours. D is divided by
their light and multiplied by that of the Gaussian, because the variance of a sum of photons is
proportional to their light; M + B is divided by the square of the light.

This only compares places with each other. The overall size of the error comes from photons from
which the field did not learn (:meth:`gpf.fitting.quality.QualityEstimate.error_scale`).
"""

from __future__ import annotations

import numpy as np

from gpf.core.structs import to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.training.half_colours import HalfColours

ROUNDS = 4
"""How often means over points are spread to neighbours, because means of few points are noisy."""

MOST = 10.0
"""Largest relative error."""

DIM = 0.1
"""Points with less light than this share of the mean count as if they had as much."""

_TINY = 1e-20

# Gaussians with less light than this, in units of the mean target, count as if they had as much.
_DARK = 1e-6


def estimate_error(field: GaussianPhotonField, fitted: HalfColours, blur: np.ndarray) -> np.ndarray:
    """The expected error of the field around each Gaussian, relative to its irradiance, (N,).

    ``blur``: B at the supervised points, (P,).
    """
    a, b = fitted.targets
    matrix, colour = fitted.matrix, to_numpy(field.gaussians.irradiance) / fitted.unit
    f = matrix @ colour
    level = np.maximum(f.mean(axis=1), 0)
    square = (f**2).mean(axis=1)
    counts = 1 / (level**2 + DIM**2)
    values = (
        ((matrix @ (fitted.halves[0] - fitted.halves[1])) ** 2).mean(axis=1) / 4,
        ((f - a) * (f - b)).mean(axis=1),
        ((a - b) ** 2).mean(axis=1) / 2,
        square / np.maximum(level, _TINY),
        square,
        blur[:: fitted.stride] / fitted.unit**2,
    )
    around = fitted.around(counts[:, None] * np.stack(values, axis=1))
    noise, cross, variance, per_level, square, blur = fitted.spread(around, ROUNDS).T
    share = np.sqrt(np.clip(2 * noise / np.maximum(variance, _TINY), 0, 1))
    misfit = np.maximum(cross + (share - share**2 / 2) * variance, 0) + np.maximum(blur, 0)
    own = np.maximum(colour.mean(axis=1), _DARK)
    relative = noise / np.maximum(per_level, _TINY) / own + misfit / np.maximum(square, _TINY)
    return np.sqrt(np.clip(relative, 0, MOST**2)).astype(np.float32)
