"""How a field's irradiance divides among groups of emitters.

Light adds up, and a field's answer is linear in the colours of its Gaussians. With their places and
sizes fixed, and W the matrix of their normalised weights at the supervised points, the colours c_g
of group g make W c_g agree with the irradiance t_g of that group,

    min Σ_p v_p (W c_g - t_g)²,    c_g ≥ 0,

by multiplicative steps c_g ← c_g (Wᵀ V t_g) / (Wᵀ V W c_g) (Lee and Seung 2001), which keep colours
positive. Then all groups of a Gaussian are scaled so that they add up to its trained colour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gpf.core.structs import SurfacePoints, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.training.blend_matrix import RowParts, blend_matrix
from gpf.training.loss import relative_weight

if TYPE_CHECKING:
    from scipy.sparse import csr_array

STEPS = 30

_TINY = 1e-20


def split_light(
    field: GaussianPhotonField, points: SurfacePoints, by_group: np.ndarray
) -> np.ndarray:
    """The irradiance of the Gaussians from each group, (G, N, 3) float32; their sum is the field's.

    Parameters
    ----------
    points: supervised points, (P).
    by_group: irradiance of the points from each group, (G, P, 3).
    """
    matrix, total = blend_matrix(field, points), to_numpy(field.gaussians.irradiance)
    level = (matrix @ total).mean(axis=1)
    importance = relative_weight(level / max(float(level.mean()), _TINY))
    return split_colours(matrix, total, importance, by_group)


def split_colours(
    matrix: csr_array,
    total: np.ndarray,
    importance: np.ndarray,
    by_group: np.ndarray,
    steps: int = STEPS,
) -> np.ndarray:
    """The colours of the Gaussians from each group, (G, N, 3) float32.

    Parameters
    ----------
    matrix: W, (P, N).
    total: the colours that the groups add up to, (N, 3).
    importance: v, (P,).
    by_group: irradiance of the points from each group, (G, P, 3).
    """
    # The scale does not matter in the end; near 1, single precision is enough.
    unit = max(float(by_group.mean()), _TINY)
    split = fit_colours(matrix, importance, by_group / unit, steps).transpose(1, 0, 2)
    whole = split.sum(axis=1, keepdims=True)
    # Where no group brings light to the points, those that do elsewhere share the field's equally.
    shines = by_group.any(axis=(1, 2)) if by_group.any() else np.ones(len(by_group), bool)
    equal = (shines / shines.sum())[:, None]
    share = np.where(whole > _TINY, split / np.maximum(whole, _TINY), equal)
    return np.ascontiguousarray((share * total[:, None]).transpose(1, 0, 2), dtype=np.float32)


def fit_colours(
    matrix: csr_array, importance: np.ndarray, by_group: np.ndarray, steps: int
) -> np.ndarray:
    """Colours of the Gaussians for the irradiance of each group, (G, N, 3) float32; the arguments
    are those of :func:`split_colours`."""
    from scipy.sparse import diags_array  # slow to import

    groups, count, _ = by_group.shape
    back = (diags_array(importance) @ matrix).T.tocsr().astype(np.float32)
    target = np.maximum(by_group, 0).transpose(1, 0, 2).reshape(count, 3 * groups)
    wanted = back @ np.ascontiguousarray(target, dtype=np.float32)
    colour = wanted / np.maximum(back.sum(axis=1), _TINY)[:, None]
    forth, back = RowParts(matrix), RowParts(back)
    for _ in range(steps):
        colour *= wanted / np.maximum(back @ (forth @ colour), _TINY)
    return np.ascontiguousarray(colour.reshape(-1, groups, 3).transpose(1, 0, 2))
