"""A generated landscape seen from a hill: fields and woods around a lake, and a wide sky.

The land is a height field in kilometres, x to the right and z away from the viewer. Each column of
the picture follows it from near to far, and each pixel takes the colour of the first point that is
at least as high in the picture. Noise has fixed seeds.
"""

from __future__ import annotations

import numpy as np

from gpf.modelling.textures import fractal_noise, ramp

EYE = 1.25  # height of the viewer above the lake
CROPS = [(0, (0.1, 0.2, 0.01)), (0.4, (0.19, 0.3, 0.015)), (0.7, (0.26, 0.32, 0.02))]
CROPS += [(0.85, (0.36, 0.34, 0.05)), (1, (0.12, 0.22, 0.01))]
WOODS = [(0, (0.008, 0.016, 0.002)), (0.5, (0.04, 0.06, 0.006)), (1, (0.16, 0.15, 0.015))]
TILE = 24.0  # period of the land's noise, kilometres


def lookup(tile: np.ndarray, x: np.ndarray, z: np.ndarray, period: float) -> np.ndarray:
    """Bilinear values at x and z of a square periodic ``tile``, ``period`` kilometres wide."""
    size = len(tile)
    u, v = x / period * size % size, z / period * size % size
    i, j = u.astype(int) % size, v.astype(int) % size
    s, t = u - np.floor(u), v - np.floor(v)
    i1, j1 = (i + 1) % size, (j + 1) % size
    near = tile[j, i] * (1 - s) + tile[j, i1] * s
    return near * (1 - t) + (tile[j1, i] * (1 - s) + tile[j1, i1] * s) * t


def land(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Height of the ground, height of the trees on it, and whether there is water; at x and z."""
    hills = fractal_noise((512, 512), (6, 6), 6, seed=11)
    woods = fractal_noise((512, 512), (20, 20), 4, seed=23)
    crowns = fractal_noise((512, 512), (64, 64), 2, seed=31)
    height = 1.3 * (lookup(hills, x, z, TILE) - 0.5)
    # The lake lies in a valley that winds away from the viewer, with an arm to the right.
    bend = 0.25 * z - 1.9 + 0.75 * np.sin(0.9 * z + 0.4)
    valley = np.exp(-(((x - bend) / (0.35 + 0.1 * z)) ** 2) - ((z - 6.2) / 2.5) ** 4)
    arm = np.exp(-(((x - 2.2 - 0.1 * z) / 2.2) ** 4) - ((z - 8.2 + 0.12 * x) / 0.7) ** 2)
    height += 0.16 - 0.6 * np.maximum(valley, arm) + 0.55 * np.clip((z - 12) / 25, 0, 1) ** 2
    height += 0.5 * np.exp(-(((z - 2.6 + 0.25 * x) / 0.95) ** 4))  # meadows in front
    height += 0.9 * np.exp(-(((x - 3.2) / 2.2) ** 2) - ((z - 16) / 2.5) ** 2)
    water = height < 0
    height = np.where(water, 0, 0.55 * height)
    bare = lookup(woods, x, z, 9.0) + 0.5 * np.clip(height - 0.01, 0, 0.1) + 0.004 * z
    shore = np.exp(-(((height - 0.008) / 0.008) ** 2)) * 0.1
    trees = np.clip((bare + shore - 0.61) / 0.03, 0, 1) * ~water
    trees = trees * (0.018 + 0.03 * lookup(crowns, x, z, 1.6))
    return height, trees, water


def paint(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height including trees, and linear colour, of the land at x and z."""
    height, trees, water = land(x, z)
    step = 0.02
    lit_side = sum(land(x - step, z)[:2])
    slope = (height + trees - lit_side) / step  # the sun stands on the left
    light = np.clip(1 - 1.1 * slope, 0.25, 1.7)[..., None]
    grain = fractal_noise((512, 512), (48, 48), 4, seed=53)
    warp = fractal_noise((512, 512), (12, 12), 2, seed=47)
    bent = lookup(warp, x, z, 12.0)
    column, row = np.floor(1.1 * x + 0.5 * z + 2 * bent), np.floor(0.9 * z - 0.4 * x + 3 * bent)
    crop = (0.618 * column + 0.414 * row + 0.27 * column * row) % 1
    fine = lookup(grain, x, z, 1.1)[..., None]
    field = ramp(crop, CROPS) * (0.75 + 0.5 * fine)
    wood = ramp(fine[..., 0], WOODS)
    colour = np.where((trees > 0.004)[..., None], wood, field) * light
    ripples = lookup(grain, x * 0.5, z * 2.5, 3.0)[..., None]
    lake = np.array([0.05, 0.1, 0.2]) + np.clip(z[..., None] / 11, 0, 1) * [0.3, 0.34, 0.38]
    colour = np.where(water[..., None], lake * (0.9 + 0.2 * ripples), colour)
    haze = 1 - np.exp(-((z[..., None] / 30) ** 1.4))
    return height + trees, colour + haze * (np.array([0.38, 0.44, 0.47]) - colour)


def sky(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Linear colours of the sky, (H, W, 3): ``rows`` (H,) are 0 at the horizon and 1 at the top."""
    clouds = fractal_noise((512, 512), (8, 8), 6, seed=71)
    away = 1 / (rows[:, None] + 0.35)  # clouds are in one layer: smaller towards the horizon
    cover = lookup(clouds, columns * away * 0.9, away + 0 * columns, 4.0)
    cover = np.clip((cover - 0.42) / 0.25, 0, 1)[..., None] * np.clip(rows * 6, 0, 1)[:, None, None]
    clear = ramp(
        rows, [(0, (0.62, 0.68, 0.74)), (0.5, (0.38, 0.52, 0.76)), (1, (0.26, 0.42, 0.72))]
    )
    return clear[:, None] + cover * (np.array([0.82, 0.78, 0.76]) - clear[:, None])


def landscape(width: int, height: int, horizon: float = 0.17, fov: float = 62) -> np.ndarray:
    """The picture as linear colours, (H, W, 3), first row on top.

    ``horizon`` is the share of the picture that is sky, ``fov`` the horizontal angle in degrees.
    """
    columns, rows = 2 * width, 2 * height  # 2 × 2 samples per pixel
    focal = 0.5 / np.tan(np.radians(fov / 2))
    tangent = ((np.arange(columns) + 0.5) / columns - 0.5) / focal
    z = np.geomspace(1.0, 90, 800)[:, None]
    x = tangent * z
    z = np.broadcast_to(z, x.shape)
    top, colour = paint(x, z)
    middle = horizon * rows
    # The topmost projected row so far, from near to far.
    skyline = np.minimum.accumulate(middle + columns * focal * (EYE - top) / z, axis=0)
    row = np.arange(rows) + 0.5
    up = np.clip((middle - row) / middle, 0, 1)
    picture = sky(up, tangent)
    for i in range(columns):
        first = np.searchsorted(-skyline[:, i], -row)
        seen = first < len(z)
        picture[seen, i] = colour[first[seen], i]
    return picture.reshape(height, 2, width, 2, 3).mean(axis=(1, 3))
