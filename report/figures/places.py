"""Find the parts of a view where methods differ most: pure functions of arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def window_sums(score: np.ndarray, size: int) -> np.ndarray:
    """Sums over all squares of s = ``size`` pixels, by upper left corner, (H-s+1, W-s+1)."""
    total = np.zeros((score.shape[0] + 1, score.shape[1] + 1))
    total[1:, 1:] = score.cumsum(axis=0).cumsum(axis=1)
    return total[size:, size:] - total[:-size, size:] - total[size:, :-size] + total[:-size, :-size]


def find_place(
    score: np.ndarray, size: int, taken: Sequence[tuple[int, int]] = ()
) -> tuple[int, int]:
    """Upper left corner (x, y) of the square with the highest score.

    Pixels of the squares in ``taken`` have score 0. The result does not overlap them, if there is
    room.
    """
    left = np.array(score, dtype=float)
    for x, y in taken:
        left[y : y + size, x : x + size] = 0
    sums = window_sums(left, size)
    for x, y in taken:
        top, start = max(y - size + 1, 0), max(x - size + 1, 0)
        sums[top : y + size, start : x + size] = -1
    if sums.max() < 0:
        sums = window_sums(left, size)
    best = divmod(int(sums.argmax()), sums.shape[1])
    return best[1], best[0]


def arriving_light(radiance: np.ndarray, reflectance: np.ndarray) -> np.ndarray:
    """Radiance without the texture, ``radiance / max(reflectance, 0.05)``, (H, W, 3)."""
    return radiance / np.maximum(reflectance, 0.05)


def focused_light(
    light: np.ndarray, position: np.ndarray, normal: np.ndarray, valid: np.ndarray
) -> np.ndarray:
    """How much light changes along surfaces, (H, W): high in caustics and at hard shadows.

    The absolute differences of neighbouring pixels of ``light`` (H, W, 3). Only pixels that are on
    the same smooth surface, by their positions and normals, count: edges of objects do not. The
    unit is the 99th percentile of the light.
    """
    level = light.mean(axis=-1)
    seen = level[valid > 0]
    unit = float(np.percentile(seen, 99)) if seen.size else 0.0
    strength = np.zeros(level.shape)
    if unit <= 0:
        return strength
    level = np.clip(level / unit, 0, 1)
    for before, after in (
        ((slice(None), slice(0, -1)), (slice(None), slice(1, None))),
        ((slice(0, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        same = (valid[before] > 0) & (valid[after] > 0)
        same &= (normal[before] * normal[after]).sum(axis=-1) > 0.95
        step = position[after] - position[before]
        off = np.abs((step * normal[before]).sum(axis=-1))
        same &= off <= 0.2 * np.linalg.norm(step, axis=-1)
        strength[before] += np.where(same, np.abs(level[after] - level[before]), 0)
    return strength


def typical_error(errors: Sequence[np.ndarray]) -> np.ndarray:
    """The median of error maps, (H, W); one bad method does not change it much."""
    return np.asarray(np.median(np.stack(errors), axis=0))
