"""Where the Gaussians of 3DGS start: the visible points of training views, where they seem to be.

3DGS starts from points that structure from motion found where pictures agree. Here the points are
known; but through water and glass a point is not seen where it is, and what has been refracted only
fits together at its apparent place. So each point is moved along the ray that saw it to where the
other pictures agree best with its surroundings: no nearer than the first thing that the ray meets,
and hardly further than the way that the light went. Without a visible point, that is the sky.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np
from scipy.ndimage import gaussian_filter

from gpf.baselines.pinhole import Pinhole
from gpf.baselines.splatting.model import Seeds
from gpf.baselines.splatting.training import Picture
from gpf.camera.visible_points import find_visible_points
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import to_numpy
from gpf.scene.bounds import bounding_box

# Distances that are tried for each point, evenly spaced in their inverses.
DISTANCES = 96
# How much further than the light's way a point may seem to be.
BEYOND = 1.1
# The sky is a sphere around each camera with this radius, in diagonals of the scene.
SKY = 5
# There is nothing to see in pixels whose channels are no brighter than this.
DARKEST = 1 / 255
# What surrounds a pixel: means with these standard deviations, in heights of the image.
SURROUNDINGS = (1 / 60, 1 / 20)
# Only what is further from a camera than this can be compared with what it saw.
NEAREST = 0.05


@dataclass(frozen=True)
class Sight:
    """What the rays through a picture's pixels meet, (M,) each.

    Attributes
    ----------
    directions: unit vectors, (M, 3).
    near: the way to the first thing, world units.
    far: the way of the light from the first diffuse surface; where there is none, to the sky.
    rows, columns: of the pixels.
    """

    directions: np.ndarray
    near: np.ndarray
    far: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def take(self, index: np.ndarray) -> Sight:
        """Some of the rays."""
        return Sight(*(values[index] for values in vars(self).values()))


def find_seeds(
    scene: mi.Scene, pictures: Sequence[Picture], count: int, seed: int, rr_depth: int = 5
) -> Seeds:
    """At most ``count`` seeds, from the pixels of all pictures that are not black."""
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
    """Follow a ray through the centre of each pixel, row by row."""
    width, height = camera.size
    rows, columns = (index.ravel() for index in np.indices((height, width)))
    x, y = columns + 0.5 - width / 2, rows + 0.5 - height / 2
    directions = np.stack([x, y, np.full(len(x), camera.focal)], axis=1) @ camera.rotation.T
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ray = mi.Ray3f(mi.Point3f(*camera.origin.tolist()), mi.Vector3f(*directions.T))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, len(rows))
    found = find_visible_points(scene, sampler, ray, rr_depth=rr_depth)
    first = scene.ray_intersect(ray)
    outside = SKY * float(np.linalg.norm(np.diff(bounding_box(scene), axis=0)))
    way = np.linalg.norm(to_numpy(found.p) - camera.origin, axis=1)
    far = np.where(np.array(found.valid), way, outside)
    near = np.minimum(np.array(first.t), far)
    return Sight(directions, near, far, rows, columns)


def describe(image: np.ndarray) -> np.ndarray:
    """What is compared: colours of pixels and of their surroundings, (H, W, 3 (1 + S))."""
    height = image.shape[0]
    blurred = [gaussian_filter(image, (s * height, s * height, 0)) for s in SURROUNDINGS]
    return np.concatenate([image, *blurred], axis=-1).astype(np.float32)


def find_distances(
    k: int, sight: Sight, cameras: Sequence[Pinhole], features: Sequence[np.ndarray]
) -> np.ndarray:
    """Where on the rays of picture ``k`` the others agree with it best, (M,).

    A distance costs the mean absolute difference of features, over that half of the other pictures
    which agree best: in the rest something may be in the way.
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
    """How much features (M, F) differ from those where a camera sees points (M, 3), (M,).

    Infinity where it does not see them.
    """
    pixels, depth = camera.project(points)
    inside = (depth > NEAREST) & np.all((pixels > 0) & (pixels < camera.size), axis=1)
    result = np.full(len(points), np.inf)
    x, y = pixels[inside].T - 0.5
    there = interpolate(features, x, y)
    result[inside] = np.abs(there - own[inside]).mean(axis=1)
    return result


def interpolate(features: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Bilinear interpolation between the centres of pixels, which have whole coordinates."""
    height, width, _ = features.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    left, above = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
    u, v = (x - left)[:, None], (y - above)[:, None]
    upper = (1 - u) * features[above, left] + u * features[above, left + 1]
    lower = (1 - u) * features[above + 1, left] + u * features[above + 1, left + 1]
    return (1 - v) * upper + v * lower
