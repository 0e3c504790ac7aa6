"""How much an animation flickers: what changes where only the camera has moved.

A diffuse point in still light looks the same from everywhere. So the pixel that sees a point in one
frame and the one that saw it in the frame before should show the same; what they differ by is
flicker. Pixels are matched by the points that they see, :func:`link_frames`: this follows the light
through clear water as well as through air, and a point that the earlier frame does not see has no
match. Images are compared as they are shown (:func:`metrics.image.expose`), in levels of 255.

A match falls between pixels, and a bilinear mean of four has less noise than one pixel has. Its
share of the difference is made up for, as if noise were independent from pixel to pixel: then noise
of standard deviation s changes pixels by ``2 s / √π`` on average, wherever matches fall. Noise in
blotches wider than a pixel, as denoisers leave it, comes out up to 1.4 times too high for the same
reason. What is no noise stays in the number, too, and a perfect renderer has it as well: sharp
edges that fall on pixels differently from frame to frame, and reflections on water over the points.

Noise counts whoever made it. A reference that is not converged flickers by its own noise
(:func:`change_of_noise` tells by how much from its standard error); a method with less flicker than
that is steadier than the reference, and no better number can be asked of it.

Steady is not right: an image that lacks a caustic altogether has nothing there that could flicker.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from metrics.image import expose

Array = NDArray[Any]

BEND = 0.25
"""Points of three pixels in a row that are so far from a line, in steps between them, are no
surface that a match can be found on."""

REACH = 0.75
"""A match is at most so many pixels from the pixel whose point is nearest."""

LEVELS = 255


@dataclass(frozen=True)
class FramePoints:
    """What a frame's pixels see at their centres.

    Attributes
    ----------
    points: positions, world units, (H, W, 3).
    usable: where a pixel sees a diffuse surface that may be matched, (H, W), bool.
    """

    points: Array
    usable: Array


@dataclass(frozen=True)
class Link:
    """Pixels of a frame and where the frame before saw the same points; images are flat, (H·W, 3).

    Attributes
    ----------
    later: pixels, (M,).
    earlier: the four pixels around each match, (M, 4).
    weights: their shares in the bilinear mean, (M, 4).
    pixels: how many pixels a frame has.
    """

    later: Array
    earlier: Array
    weights: Array
    pixels: int


@dataclass(frozen=True)
class Flicker:
    """What changes from one frame to the next.

    Attributes
    ----------
    change: mean absolute difference of matched pixels, levels of 255.
    share: share of all pixels that have a match.
    """

    change: float
    share: float

    @property
    def noise(self) -> float:
        """Standard deviation of independent Gaussian noise that changes as much, levels."""
        return self.change * math.sqrt(math.pi) / 2


def link_frames(earlier: FramePoints, later: FramePoints) -> Link:
    """Find where the earlier frame saw what the later one sees.

    The pixel with the nearest point is refined with the first differences of the points around it.
    Pixels at edges, where neighbours see other surfaces or a surface bends, take no part.
    """
    height, width = earlier.usable.shape
    smooth = smooth_pixels(earlier)
    rows, columns = np.nonzero(smooth)
    wanted = np.flatnonzero(smooth_pixels(later))
    if not len(rows) or not len(wanted):
        none = np.zeros((0, 4))
        return Link(wanted[:0], none.astype(int), none, later.usable.size)
    p = np.asarray(earlier.points, dtype=np.float64)
    x = np.asarray(later.points, dtype=np.float64).reshape(-1, 3)[wanted]
    nearest = cKDTree(p[rows, columns]).query(x)[1]
    row, column = rows[nearest], columns[nearest]

    across = (p[row, column + 1] - p[row, column - 1]) / 2
    down = (p[row + 1, column] - p[row - 1, column]) / 2
    offset, residual = _solve(across, down, x - p[row, column])
    step = np.sqrt(np.minimum((across**2).sum(1), (down**2).sum(1)))
    found = (np.abs(offset).max(axis=1) <= REACH) & (residual <= BEND * step)

    place = np.stack([column, row], axis=1)[found] + offset[found]
    first = np.floor(place).astype(int)
    s, t = (place - first).T
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), (1 - s) * t, s * t], axis=1)
    corner = first[:, 1] * width + first[:, 0]
    around = corner[:, None] + np.array([0, 1, width, width + 1])
    # The cross around the nearest pixel says nothing of the one that lies diagonally from it.
    sound = _on_surface(earlier, row[found], column[found], around) | (weights == 0)
    kept = sound.all(axis=1)
    return Link(wanted[found][kept], around[kept], weights[kept], height * width)


def measure_flicker(images: Sequence[Array], links: Sequence[Link], exposure: float) -> Flicker:
    """Flicker of linear images (H, W, 3); ``links[k]`` leads from image k + 1 back to image k.

    With as many links as images, the last one leads from the first image back to the last.

    Raises
    ------
    ValueError: images and links do not fit, or no pixel has a match.
    """
    if len(links) not in (len(images) - 1, len(images)):
        raise ValueError(f"{len(images)} images have {len(links)} links")
    shown = [expose(image, exposure).reshape(-1, 3) for image in images]
    total, matched = 0.0, 0
    for k, link in enumerate(links):
        before, after = shown[k], shown[(k + 1) % len(shown)]
        if len(before) != link.pixels or len(after) != link.pixels:
            raise ValueError(f"images have {len(after)} pixels, their links {link.pixels}")
        mean = np.einsum("mk,mkc->mc", link.weights, before[link.earlier])
        # Of two pixels with noise of variance 1 the difference has 2; here it has less.
        scale = np.sqrt(2 / (1 + (link.weights**2).sum(axis=1)))
        total += float((np.abs(after[link.later] - mean).mean(axis=1) * scale).sum())
        matched += len(link.later)
    if matched == 0:
        raise ValueError("no pixel of any frame has a match in the frame before")
    share = matched / sum(link.pixels for link in links)
    return Flicker(LEVELS * total / matched, share)


def change_of_noise(radiance: Array, standard_error: Array, exposure: float) -> float:
    """The :attr:`Flicker.change` that the noise of an image alone would bring, levels of 255.

    Parameters
    ----------
    radiance, standard_error: of linear pixels, (..., 3); noise is small against the radiance.
    """
    radiance, standard_error = (np.reshape(x, (1, -1, 3)) for x in (radiance, standard_error))
    above = expose(radiance + standard_error, exposure)
    below = expose(np.maximum(radiance - standard_error, 0), exposure)
    return LEVELS * float(np.mean(above - below)) / math.sqrt(math.pi)


def smooth_pixels(frame: FramePoints) -> Array:
    """Pixels in the middle of a cross of pixels that see the same smooth surface, (H, W), bool.

    Others are at edges, and never have a match.
    """
    p, usable = np.asarray(frame.points, dtype=np.float64), np.asarray(frame.usable, dtype=bool)
    kept = np.zeros_like(usable)
    if min(usable.shape) < 3:
        return kept
    middle, inside = p[1:-1, 1:-1], usable[1:-1, 1:-1].copy()
    for before, after in (
        ((slice(0, -2), slice(1, -1)), (slice(2, None), slice(1, -1))),
        ((slice(1, -1), slice(0, -2)), (slice(1, -1), slice(2, None))),
    ):
        step = np.linalg.norm(p[after] - p[before], axis=-1) / 2
        bend = np.linalg.norm(p[after] + p[before] - 2 * middle, axis=-1) / 2
        inside &= usable[before] & usable[after] & (bend <= BEND * step) & (step > 0)
    kept[1:-1, 1:-1] = inside
    return kept


def _on_surface(frame: FramePoints, row: Array, column: Array, around: Array) -> Array:
    """Whether pixels (M, 4) are usable and continue the surface that crosses (M,) are on."""
    p = np.asarray(frame.points, dtype=np.float64)
    width = p.shape[1]
    across = (p[row, column + 1] - p[row, column - 1]) / 2
    down = (p[row + 1, column] - p[row - 1, column]) / 2
    x, y = around % width - column[:, None], around // width - row[:, None]
    middle = p[row, column][:, None]
    expected = middle + x[..., None] * across[:, None] + y[..., None] * down[:, None]
    step = np.sqrt(np.minimum((across**2).sum(1), (down**2).sum(1)))[:, None]
    off = np.linalg.norm(p.reshape(-1, 3)[around] - expected, axis=-1)
    return np.asarray(frame.usable, dtype=bool).reshape(-1)[around] & (off <= 2 * BEND * step)


def _solve(across: Array, down: Array, target: Array) -> tuple[Array, Array]:
    """Offsets (M, 2) in pixels that lead to the target, and what is left of the way, (M,)."""
    a, b, c = (across**2).sum(1), (across * down).sum(1), (down**2).sum(1)
    u, v = (across * target).sum(1), (down * target).sum(1)
    determinant = a * c - b * b
    # Where a surface is seen edge on, there is no telling.
    sound = determinant > 1e-6 * a * c
    determinant = np.where(sound, determinant, 1)
    offset = np.stack([c * u - b * v, a * v - b * u], axis=1) / determinant[:, None]
    offset[~sound] = np.inf
    with np.errstate(invalid="ignore"):
        rest = target - offset[:, :1] * across - offset[:, 1:] * down
    return offset, np.where(sound, np.linalg.norm(rest, axis=1), np.inf)
