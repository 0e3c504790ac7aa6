"""A plain twin of the field, in numpy and double precision: one loop per query, no grid."""

from __future__ import annotations

from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial.transform import Rotation

from gpf.core.structs import SurfacePoints, from_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.settings import FieldSettings

# The field's constants, written down a second time.
SURFACE_HEIGHT, LARGEST_REACH, WEIGHT_FLOOR = 0.35, 4.0, 1e-6
SUPPLEMENT_SLACK, SUPPLEMENT_REACH = 1.0002, 1.5

# Neither a cube nor centred: swapped axes show.
LOWER, UPPER = np.array([-1.0, 0.0, -0.5]), np.array([2.0, 2.0, 0.7])
# Normals in the tests are these, slightly tilted: none near the 45 degrees of the normal test.
AXES = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0]], dtype=float)


@dataclass(frozen=True)
class PlainGaussians:
    """The arrays of :class:`gpf.field.gaussians.Gaussians`, (N, .) each, in double precision."""

    means: np.ndarray
    log_scales: np.ndarray
    quats: np.ndarray
    irradiance: np.ndarray
    normals: np.ndarray

    def flat(self) -> np.ndarray:
        """The trained parameters, as in :func:`gpf.training.kernels.parameters`, (13, N)."""
        return np.concatenate(
            [self.means, self.log_scales, self.quats, self.irradiance], axis=1
        ).T.copy()

    def with_flat(self, p: np.ndarray) -> PlainGaussians:
        """The inverse of :meth:`flat`."""
        return replace(
            self, means=p[0:3].T, log_scales=p[3:6].T, quats=p[6:10].T, irradiance=p[10:13].T
        )

    def rows(self) -> np.ndarray:
        """M = diag(1/s) R^T, (N, 3, 3); scipy's rotations take (x, y, z, w) of any length, too."""
        rotation = Rotation.from_quat(self.quats).as_matrix()
        return np.exp(-self.log_scales)[:, :, None] * rotation.transpose(0, 2, 1)


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def single(v: np.ndarray) -> np.ndarray:
    """Values that single precision holds exactly, so that both twins start from the same."""
    return np.asarray(v, dtype=np.float32).astype(float)


def random_normals(rng: np.random.Generator, count: int) -> np.ndarray:
    tilt = rng.uniform(-0.15, 0.15, (count, 3))
    return single(unit(AXES[rng.integers(0, len(AXES), count)] + tilt))


def random_gaussians(
    rng: np.random.Generator, count: int, sizes: tuple[float, float] = (0.05, 0.4)
) -> PlainGaussians:
    return PlainGaussians(
        means=single(rng.uniform(LOWER, UPPER, (count, 3))),
        log_scales=single(np.log(rng.uniform(*sizes, (count, 3)))),
        quats=single(rng.normal(size=(count, 4)) * rng.uniform(0.5, 2, (count, 1))),
        irradiance=single(rng.uniform(0.1, 3, (count, 3))),
        normals=random_normals(rng, count),
    )


def flat_gaussians(means: np.ndarray, irradiance: np.ndarray, size: float = 0.1) -> PlainGaussians:
    """Round Gaussians whose normal is +z."""
    count = len(means)
    return PlainGaussians(
        means=single(np.asarray(means, dtype=float)),
        log_scales=single(np.full((count, 3), np.log(size))),
        quats=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        irradiance=single(np.asarray(irradiance, dtype=float)),
        normals=np.tile([0.0, 0.0, 1.0], (count, 1)),
    )


def to_device(g: PlainGaussians) -> Gaussians:
    return Gaussians(
        means=from_numpy(mi.Point3f, g.means),
        log_scales=from_numpy(mi.Vector3f, g.log_scales),
        quats=from_numpy(mi.Quaternion4f, g.quats),
        irradiance=from_numpy(mi.Color3f, g.irradiance),
        normals=from_numpy(mi.Normal3f, g.normals),
    )


def bounds() -> tuple:
    return mi.ScalarPoint3f(LOWER), mi.ScalarPoint3f(UPPER)


def make_field(g: PlainGaussians, settings: FieldSettings, **more) -> GaussianPhotonField:
    return GaussianPhotonField(to_device(g), settings, bounds(), **more)


def surface_points(x, n, target=None) -> SurfacePoints:
    count = len(x)
    return SurfacePoints(
        p=from_numpy(mi.Point3f, x),
        n=from_numpy(mi.Normal3f, n),
        target=from_numpy(mi.Color3f, np.zeros((count, 3)) if target is None else target),
    )


def ask(field: GaussianPhotonField, x: np.ndarray, n: np.ndarray, active=True):
    """The field's value, (P, 3), and reach, (P,)."""
    value, reach = field.query(
        from_numpy(mi.Point3f, x),
        from_numpy(mi.Normal3f, n),
        dr.full(mi.Bool, True, len(x)) & active,
    )
    return np.array(value).T, np.array(reach)


def neighbours_of(
    g: PlainGaussians, settings: FieldSettings, x: np.ndarray, n: np.ndarray, margin: float = 1
) -> tuple[np.ndarray, float]:
    """The Gaussians that are blended at one point, and the support R of the falloff.

    The ball is wider by ``margin`` than what is blended.
    """
    distance = np.linalg.norm(g.means - x, axis=1)
    if settings.normal_test:
        radius2 = settings.search_radius**2
        limit2 = SURFACE_HEIGHT**2 * radius2 + 0.25 * np.maximum(distance**2 - radius2, 0)
        flat = ((g.means - x) @ n) ** 2 <= limit2
        distance = np.where(flat & (g.normals @ n > np.sqrt(0.5)), distance, np.inf)
    ball = np.flatnonzero(distance <= margin * settings.search_radius)
    enough = settings.neighbours == "both" and len(ball) > settings.k
    if settings.neighbours == "radius" or enough:
        return ball, settings.search_radius
    nearest = np.argsort(distance, kind="stable")[: settings.k + 1]
    nearest = nearest[distance[nearest] <= LARGEST_REACH * settings.search_radius]
    if len(nearest) > settings.k:
        return nearest[:-1], np.sqrt(SUPPLEMENT_SLACK) * distance[nearest[-1]]
    return nearest, SUPPLEMENT_REACH * distance[nearest].max(initial=0)


def weights_of(g: PlainGaussians, indices: np.ndarray, support: float, x: np.ndarray) -> np.ndarray:
    d = x - g.means[indices]
    u = np.einsum("nij,nj->ni", g.rows()[indices], d)
    falloff = np.maximum(1 - (d**2).sum(1) / support**2, 0) ** 2
    return falloff * (np.exp(-0.5 * (u**2).sum(1)) + WEIGHT_FLOOR)


def plain_query(
    g: PlainGaussians, settings: FieldSettings, x: np.ndarray, n: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What ``ask`` has to answer."""
    values, reaches = np.zeros((len(x), 3)), np.full(len(x), np.inf)
    for i, (point, normal) in enumerate(zip(x, n, strict=True)):
        indices, support = neighbours_of(g, settings, point, normal)
        if len(indices) == 0:
            continue
        w = weights_of(g, indices, support, point)
        values[i] = w @ g.irradiance[indices]
        if settings.blend == "divided":
            values[i] /= w.sum()
        in_ball = support == settings.search_radius
        farthest = np.linalg.norm(g.means[indices] - point, axis=1).max()
        reaches[i] = 1 if in_ball else max(1, farthest / settings.search_radius)
    return values, reaches
