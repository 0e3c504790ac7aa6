"""Where targets are gathered with a narrow kernel instead of a wide one.

A wide kernel has less noise, and blurs what is sharp. Both gather two independent halves of the
photons, which tell noise from light.
"""

from __future__ import annotations

import numpy as np

from gpf.guiding.density_control import cell_keys

# Radius of the narrow kernel, in units of the wide one.
NARROW = 0.5

# The narrow kernel is used where the squared bias of the wide one is more than this many times the
# narrow one's variance, both of half of the photons. With 0.5, much noise passes for light.
SHARP = 6.0

# Edge of the squares in which the two kernels are compared, in radii of the wide one.
COMPARED = 2.0


def kernel_blur(
    sharp: np.ndarray,
    wide: tuple[np.ndarray, np.ndarray],
    narrow: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Squared change of the targets if their kernels had half the radius, mean over the channels,
    (N,).

    The product over independent halves, (w_a - n_a) (w_b - n_b), is the square of the difference
    between the wide and the narrow kernel without noise in its mean; it may be negative. Bias is
    proportional to the square of the radius, so for a narrow kernel the change is ν² as much.

    Parameters
    ----------
    sharp: whether the narrow kernel is used, (N,).
    wide, narrow: irradiance from each half, (N, 3) each.
    """
    square = ((wide[0] - narrow[0]) * (wide[1] - narrow[1])).mean(axis=1)
    blur: np.ndarray = square * np.where(sharp, NARROW**4, 1)
    return blur.astype(np.float32)


def is_sharp(
    position: np.ndarray,
    normal: np.ndarray,
    wide: tuple[np.ndarray, np.ndarray],
    narrow: tuple[np.ndarray, np.ndarray],
    radius: float,
) -> np.ndarray:
    """Where a narrow kernel should replace a wide one, (N,) bool.

    Both kernels gather two independent halves of the photons, a and b. In each cell of a grid, the
    squared bias B² of the wide kernel w against the narrow one n, and the variance V of each, are

        V_n = mean((n_a - n_b)²) / 2,    V_w likewise,
        B² = mean((w_a - n_b)² + (w_b - n_a)²) / 2 - V_n - V_w,

    and the cell is sharp if B² > :data:`SHARP` V_n.

    Parameters
    ----------
    position, normal: of the points, (N, 3).
    wide, narrow: irradiance from each half, (N, 3) each.
    radius: of the wide kernel, world units.
    """
    _, cell = np.unique(cell_keys(position, normal, COMPARED * radius), return_inverse=True)
    count = np.bincount(cell)

    def difference(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Mean squared difference in each cell."""
        return np.bincount(cell, ((x - y) ** 2).sum(axis=1)) / count

    variance = difference(*narrow) / 2
    bias = (difference(wide[0], narrow[1]) + difference(wide[1], narrow[0])) / 2
    bias -= variance + difference(*wide) / 2
    sharp: np.ndarray = (bias > SHARP * variance)[cell]
    return sharp
