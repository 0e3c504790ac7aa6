"""Generated textures of tiles and planks, for floors, basins and decks.

Colours are display-referred (sRGB) in [0, 1], first row on top. All textures repeat without a seam.
"""

from __future__ import annotations

import numpy as np

from gpf.modelling.textures import fractal_noise, ramp

Colour = tuple[float, float, float]
Stops = list[tuple[float, Colour]]


def shades(count: int, seed: int) -> np.ndarray:
    """Numbers in [0, 1), (count,), from raw integers of a generator with a fixed stream."""
    raw = np.random.PCG64(seed).random_raw(count)
    return np.asarray(raw >> np.uint64(11), dtype=float) / 2.0**53


def tiles(
    rows: int, columns: int, pixels: int, colours: Stops, grout: Colour, seed: int
) -> np.ndarray:
    """Square tiles of ``pixels²`` with round corners, (rows · pixels, columns · pixels, 3).

    Each tile has its own shade of ``colours`` (:func:`gpf.modelling.textures.ramp`). The grout
    lines are 7% of a tile wide, half in each of two neighbours.
    """
    shade = shades(rows * columns, seed).reshape(rows, columns)
    flat = ramp(shade, colours).repeat(pixels, axis=0).repeat(pixels, axis=1)
    corner = 0.09 * pixels
    offset = np.abs(np.arange(pixels) + 0.5 - pixels / 2)
    over = np.maximum(offset - (pixels / 2 - 0.035 * pixels - corner), 0)
    # Distance to the tile's edge, positive outside; the edge is one pixel soft.
    distance = np.hypot(over[:, None], over[None, :]) - corner
    cover = np.tile(np.clip(0.5 - distance, 0, 1), (rows, columns))[..., None]
    return cover * flat + (1 - cover) * np.array(grout)


def planks(
    rows: int, pixels: int, length: int, colours: Stops, joint: Colour, seed: int
) -> np.ndarray:
    """Planks along the rows, each ``pixels`` wide and ``length`` long, (rows · pixels, length, 3).

    A plank's shade varies along its grain. The planks' ends are staggered by the golden ratio.
    """
    golden = (5**0.5 - 1) / 2
    noise = fractal_noise((rows * pixels, length), (rows * 4, 2), 3, seed)
    shade = 0.6 * shades(rows, seed).repeat(pixels)[:, None] + 0.4 * noise
    offset = np.abs(np.arange(pixels) + 0.5 - pixels / 2)
    across = np.tile(np.clip(offset - (pixels / 2 - 0.04 * pixels - 0.5), 0, 1), rows)
    ends = (np.arange(rows) * golden % 1 * length).repeat(pixels)[:, None]
    from_end = np.abs((np.arange(length)[None, :] - ends + length / 2) % length - length / 2)
    along = np.clip(0.02 * pixels + 1 - from_end, 0, 1)
    gap = np.maximum(across[:, None], along)[..., None]
    return (1 - gap) * ramp(shade, colours) + gap * np.array(joint)
