"""Where targets are gathered with narrow kernels instead of a wide one.

A wide kernel has less noise, but blurs what is sharp. Each kernel gathers two independent halves of
the photons, so that noise can be told from light.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from gpf.guiding.density_control import cell_keys

WIDTHS = (1.0, 0.5, 0.25)
"""Radii of the kernels, in units of the widest."""

Halves = tuple[np.ndarray, np.ndarray]
"""Irradiance from each half of the photons, (N, 3) each."""

# A narrow kernel is used where the squared bias of a wide one is more than this many times the
# narrow one's variance, both with half of the photons. With 0.5, much noise would pass for light.
SHARP, A_LITTLE = 6.0, 2.0

# Edge of the squares in which two kernels are compared, in radii of the wide one.
COMPARED = 2.0


def choose_kernels(
    position: np.ndarray, normal: np.ndarray, gathered: Sequence[Halves], radius: float
) -> np.ndarray:
    """Which kernel each point takes, (N,) uint8: indices into :data:`WIDTHS`.

    A point takes the second or third kernel instead of the widest if either :func:`is_sharp`
    compared with it; the second alone is not enough, because beside a bright surface it may be as
    wrong as the first. It takes the third rather than the second if it is a little sharp compared
    with the second.

    Parameters
    ----------
    position, normal: positions and normals of the points, (N, 3).
    gathered: irradiance gathered with each kernel.
    radius: radius of the widest kernel, world units.
    """
    wide, narrow, narrowest = gathered
    second = is_sharp(position, normal, wide, narrow, radius)
    third = is_sharp(position, normal, wide, narrowest, radius)
    third &= ~second | is_sharp(position, normal, narrow, narrowest, radius, A_LITTLE)
    chosen: np.ndarray = np.where(third, 2, np.where(second, 1, 0)).astype(np.uint8)
    return chosen


def pick(chosen: np.ndarray, gathered: Sequence[Halves]) -> Halves:
    """What the chosen kernels have gathered."""
    rows = np.arange(len(chosen))
    first, second = (np.stack(part)[chosen, rows] for part in zip(*gathered, strict=True))
    return first, second


def kernel_blur(chosen: np.ndarray, gathered: Sequence[Halves]) -> np.ndarray:
    """Squared change of the targets if their kernels had half the radius, mean over the channels,
    (N,).

    The product over independent halves, (w_a - n_a) (w_b - n_b), is the squared difference between
    a kernel and the next narrower one, and its mean is free of noise; it may be negative. Bias is
    proportional to the square of the radius, so for the narrowest kernel the change is ν⁴ times
    that of the one before, where ν is the ratio of their radii.

    Parameters
    ----------
    chosen: the kernels from :func:`choose_kernels`, (N,).
    gathered: irradiance gathered with each kernel.
    """
    changes = [
        ((wide[0] - narrow[0]) * (wide[1] - narrow[1])).mean(axis=1)
        for wide, narrow in itertools.pairwise(gathered)
    ]
    changes.append(changes[-1] * (WIDTHS[-1] / WIDTHS[-2]) ** 4)
    blur: np.ndarray = np.stack(changes)[chosen, np.arange(len(chosen))]
    return blur.astype(np.float32)


def is_sharp(
    position: np.ndarray,
    normal: np.ndarray,
    wide: Halves,
    narrow: Halves,
    radius: float,
    least: float = SHARP,
) -> np.ndarray:
    """Where a narrow kernel should replace a wide one, (N,) bool.

    Both kernels gather two independent halves of the photons, a and b. In each cell of a grid, the
    squared bias B² of the wide kernel w against the narrow one n, and the variance V of each, are

        V_n = mean((n_a - n_b)²) / 2,    V_w likewise,
        B² = mean((w_a - n_b)² + (w_b - n_a)²) / 2 - V_n - V_w,

    and the cell is sharp if B² > ``least`` V_n.

    Parameters
    ----------
    position, normal: positions and normals of the points, (N, 3).
    wide, narrow: irradiance gathered with each kernel.
    radius: radius of the wide kernel, world units.
    """
    _, cell = np.unique(cell_keys(position, normal, COMPARED * radius), return_inverse=True)
    count = np.bincount(cell)

    def difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Mean squared difference in each cell."""
        return np.bincount(cell, ((x - y) ** 2).sum(axis=1)) / count

    variance = difference(*narrow) / 2
    bias = (difference(wide[0], narrow[1]) + difference(wide[1], narrow[0])) / 2
    bias -= variance + difference(*wide) / 2
    sharp: np.ndarray = (bias > least * variance)[cell]
    return sharp
