"""Generated textures: smooth noise, colour ramps and PNG files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image


def smooth_noise(shape: tuple[int, int], cells: tuple[int, int], seed: int) -> np.ndarray:
    """Value noise in [0, 1], (H, W): random values on a grid of (rows, columns) ``cells``,
    interpolated with the weights 3t² - 2t³. It repeats without a seam in both directions.
    """
    # numpy guarantees that the generator's stream of raw integers does not change.
    raw = np.random.PCG64(seed).random_raw(cells[0] * cells[1])
    lattice = (raw >> np.uint64(11)).astype(float).reshape(cells) / 2.0**53
    axes = []
    for size, count in zip(shape, cells, strict=True):
        position = (np.arange(size) + 0.5) * count / size
        low = np.floor(position).astype(int)
        t = position - low
        axes.append((low % count, (low + 1) % count, t * t * (3 - 2 * t)))
    (y0, y1, ty), (x0, x1, tx) = axes
    ty = ty[:, None]
    below = lattice[y0][:, x0] * (1 - tx) + lattice[y0][:, x1] * tx
    above = lattice[y1][:, x0] * (1 - tx) + lattice[y1][:, x1] * tx
    return below * (1 - ty) + above * ty


def fractal_noise(
    shape: tuple[int, int], cells: tuple[int, int], octaves: int, seed: int
) -> np.ndarray:
    """Octaves of :func:`smooth_noise`, each twice as fine and half as strong, in [0, 1], (H, W)."""
    total = np.zeros(shape)
    for i in range(octaves):
        finer = (cells[0] * 2**i, cells[1] * 2**i)
        total += smooth_noise(shape, finer, seed + i) / 2**i
    return total / (2 - 2.0 ** (1 - octaves))


def ramp(value: np.ndarray, stops: list[tuple[float, tuple[float, float, float]]]) -> np.ndarray:
    """Colours (…, 3) by linear interpolation between ``stops``: pairs (position, colour)."""
    positions = [position for position, _ in stops]
    colours = np.array([colour for _, colour in stops])
    return np.stack([np.interp(value, positions, colours[:, i]) for i in range(3)], axis=-1)


def write_png(path: Path, colours: np.ndarray) -> Path:
    """Write display-referred (sRGB) colours in [0, 1], (H, W, 3), first row on top."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.clip(np.rint(colours * 255), 0, 255).astype(np.uint8)
    Image.fromarray(pixels).save(path, format="PNG", optimize=False)
    return path
