"""Initial Gaussians of 3DGS: visible points of the training views, at their apparent places.

3DGS starts from points that structure from motion finds where images agree. Here the visible points
are known, but through water and glass a point is seen at another, apparent place, and refracted
images agree only there. So each point is moved along its camera ray to the distance where the other
images agree best with its surroundings. This distance is at least that of the first surface on the
ray, and at most 1.1 times that of the visible point, or of the sky if there is no visible point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter

from baselines.splatting.model import Seeds
from baselines.splatting.training import Picture
from gpf.camera.visible_points import find_visible_points
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.bounds import bounding_box
from gpf.scene.pinhole import Pinhole

# Number of distances tried for each point, evenly spaced in their inverses.
DISTANCES = 96
# Largest distance tried, in units of the visible point's distance.
BEYOND = 1.1
# Radius of the sky, a sphere around each camera, in units of the scene's diagonal.
SKY = 5
# Pixels whose channels are all at most this count as black.
DARKEST = 1 / 255
# Standard deviations of the blurs that describe a pixel's surroundings, in image heights.
SURROUNDINGS = (1 / 60, 1 / 20)
# Points nearer to a camera than this, world units, are not compared with its image.
NEAREST = 0.05


@dataclass(frozen=True)
class Sight:
    """Rays through pixels of an image, (M,) each.

    Attributes
    ----------
    directions: unit vectors, (M, 3).
    near: distance to the first surface, world units.
    far: distance to the visible point; without one, to the sky.
    rows, columns: those of the pixels.
    """

    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def take(self, index: np.ndarray) -> Sight:
        """The rays with the given indices."""
        return Sight(*(values[index] for values in vars(self).values()))


def find_seeds(
    scene: mi.Scene, pictures: Sequence[Picture], count: int, seed: int, rr_depth: int = 5
) -> Seeds:
    """At most ``count`` seeds, from random non-black pixels of all images."""
    sights = []
    for k, picture in enumerate(pictures):
        sight = look(scene, picture.camera, pass_seed(seed, k, Stream.SPLAT_SIGHT), rr_depth)
        sights.append(sight.take(np.flatnonzero(picture.image.max(axis=-1) > DARKEST)))
    sizes = [len(sight.near) for sight in sights]
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.SPLAT_SEEDS))
    chosen = np.sort(rng.permutation(sum(sizes))[:count])
    features = [describe(picture.image) for picture in pictures]
    cameras = [picture.camera for picture in pictures]
    points, colours = [], []
    for k, own in enumerate(np.split(chosen, np.searchsorted(chosen, np.cumsum(sizes)[:-1]))):
        sight = sights[k].take(own - sum(sizes[:k]))
        away = find_distances(k, sight, cameras, features)
        points.append(cameras[k].origin + away[:, None] * sight.directions)
        colours.append(pictures[k].image[sight.rows, sight.columns])
    return Seeds(np.concatenate(points), np.concatenate(colours))


def look(scene: mi.Scene, camera: Pinhole, seed: int, rr_depth: int) -> Sight:
    """The rays through the centres of all pixels, row by row."""
    width, height = camera.size
    rows, columns = (index.ravel() for index in np.indices((height, width)))
    x, y = columns + 0.5 - width / 2, rows + 0.5 - height / 2
    directions = np.stack([x, y, np.full(len(x), camera.focal)], axis=1) @ camera.rotation.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(*camera.origin.tolist()), from_numpy(mi.Vector3f, directions))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(rows))
    found, _ = find_visible_points(scene, sampler, ray, rr_depth=rr_depth)
    first = scene.ray_intersect(ray)
    outside = SKY * float(np.linalg.norm(np.diff(bounding_box(scene), axis=0)))
    way = np.linalg.norm(to_numpy(found.p) - camera.origin, axis=1)
    far = np.where(np.array(found.valid), way, outside)
    near = np.minimum(np.array(first.t), far)
    return Sight(directions, near, far, rows, columns)


def describe(image: np.ndarray) -> np.ndarray:
    """Features for comparison: colours of pixels and of S surroundings, (H, W, 3 (1 + S))."""
    height = image.shape[0]
    blurred = [gaussian_filter(image, (s * height, s * height, 0)) for s in SURROUNDINGS]
    return np.concatenate([image, *blurred], axis=-1).astype(np.float32)


def find_distances(
    k: int, sight: Sight, cameras: Sequence[Pinhole], features: Sequence[np.ndarray]
) -> np.ndarray:
    """The distances on rays of image ``k`` where the other images agree with it best, (M,).

    The cost of a distance is the mean absolute difference of features, over the half of the other
    images that agrees best: in the rest, the point may be hidden.
    """
    own = features[k][sight.rows, sight.columns]
    best, result = np.full(len(own), np.inf), np.array(sight.far)
    others = [i for i in range(len(cameras)) if i != k]
    for share in np.linspace(0, 1, DISTANCES if others else 0):
        away = 1 / ((1 - share) / sight.near + share / (BEYOND * sight.far))
        points = cameras[k].origin + away[:, None] * sight.directions
        costs = np.sort([compare(points, own, cameras[i], features[i]) for i in others], axis=0)
        seen = np.isfinite(costs).sum(axis=0)
        half = np.maximum((seen + 1) // 2, 1)
        counts = np.arange(len(others))[:, None] < half
        cost = np.where(counts, costs, 0).sum(axis=0) / half
        better = cost < best
        best[better], result[better] = cost[better], away[better]
    return result


def compare(
    points: np.ndarray, own: np.ndarray, camera: Pinhole, features: np.ndarray
) -> np.ndarray:
    """Mean absolute difference, (M,), of ``own`` features (M, F) from a camera's at points (M, 3).

    Infinite for points outside the camera's image.
    """
    pixels, depth = camera.project(points)
    inside = (depth > NEAREST) & np.all((pixels > 0) & (pixels < camera.size), axis=1)
    result = np.full(len(points), np.inf)
    x, y = pixels[inside].T - 0.5
    there = interpolate(features, x, y)
    result[inside] = np.abs(there - own[inside]).mean(axis=1)
    return result


def interpolate(features: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear interpolation; the centres of pixels have integer coordinates."""
    height, width, _ = features.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, above = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    u, v = (x - left)[:, None], (y - above)[:, None]
    upper = (1 - u) * features[above, left] + u * features[above, left + 1]
    lower = (1 - u) * features[above + 1, left] + u * features[above + 1, left + 1]
    return (1 - v) * upper + v * lower
