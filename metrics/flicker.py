"""Flicker of an animation in which only the camera moves.

A diffuse point in constant light has the same radiance in all directions. So two pixels of
successive frames that see the same point should have the same value; their difference is flicker.
:func:`link_frames` matches pixels by the points that they see, even through clear water; a
point that the earlier frame does not see has no match. Images are compared as displayed
(:func:`metrics.image.expose`), in levels of 255.

A match lies between four pixels, and their bilinear mean has less noise than one pixel. Each
difference is scaled up for this, as if the noise of all pixels were independent. Then noise with
the standard deviation s gives a mean difference of ``2 s / √π`` wherever matches lie. For noise
that is correlated between neighbours, as after a denoiser, this scaling makes the result up to 1.4
times too high. Some differences are not noise, and a perfect renderer has them too: aliasing of
sharp edges, and reflections on the water above a point.

A reference that has not converged flickers with its own noise; :func:`change_of_noise` computes
this from its standard error. A method with less flicker than that is better than the reference can
measure.

Low flicker does not mean a correct image: an image without caustics has no flickering caustics.
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
"""Limit for smooth surfaces: how far the middle one of three neighbouring points may lie from the
mean of the other two, in units of the distance between neighbours."""

REACH = 0.75
"""Largest distance of a match from the pixel with the nearest point, pixels."""

LEVELS = 255


@dataclass(frozen=True)
class FramePoints:
    """The surface points that a frame sees at its pixel centres.

    Attributes
    ----------
    points: positions, world units, (H, W, 3).
    usable: whether the point lies on a diffuse surface, (H, W), bool. Others are not matched.
    """

    points: Array
    usable: Array


@dataclass(frozen=True)
class Link:
    """Matches between a frame and the frame before it; indices are of flat images, (H·W, 3).

    Attributes
    ----------
    later: pixels of the later frame, (M,).
    earlier: for each, the four pixels of the earlier frame around its match, (M, 4).
    weights: their bilinear weights, (M, 4).
    pixels: number of pixels of a frame.
    """

    later: Array
    earlier: Array
    weights: Array
    pixels: int


@dataclass(frozen=True)
class Flicker:
    """Differences between successive frames.

    Attributes
    ----------
    change: mean absolute difference of matched pixels, levels of 255.
    share: fraction of pixels that have a match.
    """

    change: float
    share: float

    @property
    def noise(self) -> float:
        """Standard deviation of independent Gaussian noise with the same ``change``, levels."""
        return self.change * math.sqrt(math.pi) / 2


def link_frames(earlier: FramePoints, later: FramePoints) -> Link:
    """Find the points of the later frame in the earlier frame.

    The nearest point gives a pixel, and the differences of its neighbours' points give the offset
    from its centre. Pixels at edges, where neighbours see another surface or the surface bends,
    are left out.
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
    # `smooth_pixels` has not tested the diagonal neighbour.
    sound = _on_surface(earlier, row[found], column[found], around) | (weights == 0)
    kept = sound.all(axis=1)
    return Link(wanted[found][kept], around[kept], weights[kept], height * width)


def measure_flicker(images: Sequence[Array], links: Sequence[Link], exposure: float) -> Flicker:
    """Flicker of linear images (H, W, 3); ``links[k]`` links image k + 1 to image k.

    In a closed path there are as many links as images, and the last links the first image to the
    last one.

    Raises
    ------
    ValueError: images and links do not match, or no pixel has a match.
    """
    if len(links) not in (len(images) - 1, len(images)):
        raise ValueError(f"{len(images)} images cannot have {len(links)} links")
    shown = [expose(image, exposure).reshape(-1, 3) for image in images]
    total, matched = 0.0, 0
    for k, link in enumerate(links):
        before, after = shown[k], shown[(k + 1) % len(shown)]
        if len(before) != link.pixels or len(after) != link.pixels:
            raise ValueError(f"images have {len(after)} pixels, their links {link.pixels}")
        mean = np.einsum("mk,mkc->mc", link.weights, before[link.earlier])
        # For noise of variance 1, the difference of two pixels has variance 2; the difference from
        # a bilinear mean has less.
        scale = np.sqrt(2 / (1 + (link.weights**2).sum(axis=1)))
        total += float((np.abs(after[link.later] - mean).mean(axis=1) * scale).sum())
        matched += len(link.later)
    if matched == 0:
        raise ValueError("no pixel of any frame has a match in the frame before")
    share = matched / sum(link.pixels for link in links)
    return Flicker(LEVELS * total / matched, share)


def change_of_noise(radiance: Array, standard_error: Array, exposure: float) -> float:
    """The :attr:`Flicker.change` that noise alone would give, levels of 255.

    Parameters
    ----------
    radiance, standard_error: values of linear pixels, (..., 3). The noise must be small compared
        with the radiance.
    """
    radiance, standard_error = (np.reshape(x, (1, -1, 3)) for x in (radiance, standard_error))
    above = expose(radiance + standard_error, exposure)
    below = expose(np.maximum(radiance - standard_error, 0), exposure)
    return LEVELS * float(np.mean(above - below)) / math.sqrt(math.pi)


def smooth_pixels(frame: FramePoints) -> Array:
    """Pixels whose four neighbours see the same smooth surface, (H, W), bool.

    The other pixels are at edges and are not matched.
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
    """Whether the pixels ``around`` (M, 4) are usable and on the surface of the centres (M,)."""
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
    """Offsets (M, 2) in pixels to the target, by least squares, and their residuals (M,)."""
    a, b, c = (across**2).sum(1), (across * down).sum(1), (down**2).sum(1)
    u, v = (across * target).sum(1), (down * target).sum(1)
    determinant = a * c - b * b
    # A surface seen edge-on gives no solution.
    sound = determinant > 1e-6 * a * c
    determinant = np.where(sound, determinant, 1)
    offset = np.stack([c * u - b * v, a * v - b * u], axis=1) / determinant[:, None]
    offset[~sound] = np.inf
    with np.errstate(invalid="ignore"):
        rest = target - offset[:, :1] * across - offset[:, 1:] * down
    return offset, np.where(sound, np.linalg.norm(rest, axis=1), np.inf)
