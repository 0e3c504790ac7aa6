"""Similarity transforms of space, and the one that aligns one set of cameras with another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpf.scene.pinhole import Pinhole


@dataclass(frozen=True)
class Similarity:
    """x → s R x + t.

    Attributes
    ----------
    scale: s > 0.
    rotation: R, (3, 3).
    translation: t, (3,).
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3)."""
        return self.scale * points @ self.rotation.T + self.translation

    def inverse(self) -> Similarity:
        """The inverse similarity."""
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -(back @ self.translation) / self.scale)

    def apply_camera(self, camera: Pinhole) -> Pinhole:
        """The camera that sees the transformed scene as ``camera`` sees the scene."""
        return Pinhole(
            self.apply(camera.origin),
            self.rotation @ camera.rotation,
            camera.focal,
            camera.size,
            camera.centre,
        )


def align_points(source: np.ndarray, target: np.ndarray) -> Similarity:
    """The least-squares similarity from points ``source`` (N, 3) to points ``target``.

    Umeyama 1991: R from the singular value decomposition of Σ = 1/N Σ_i y_i x_iᵀ, with x and y
    relative to their means; s = tr(Rᵀ Σ) / var x. For points on a line, R is not unique.

    Raises
    ------
    ValueError: all points of ``source`` or of ``target`` are equal.
    """
    return _complete(_best_rotation(_cross_covariance(source, target)), source, target)


def align_cameras(source: np.ndarray, target: np.ndarray) -> Similarity:
    """The similarity that aligns the cameras ``source`` with the cameras ``target``.

    Like :func:`align_points` for their positions, but R also fits their directions: it is computed
    from Σ / (σ_x σ_y) + 1/N Σ_i C_i B_iᵀ, where B and C are the axes of the cameras. The positions
    alone do not determine R for a few cameras on a line or far from the scene.

    Parameters
    ----------
    source, target: camera to world, (N, 4, 4).

    Raises
    ------
    ValueError: all cameras of ``source`` or of ``target`` are in one place, or no positive scale
        fits.
    """
    x, y = source[:, :3, 3], target[:, :3, 3]
    spread = np.sqrt(_variance(x) * _variance(y))
    turned = np.einsum("nij,nkj->ik", target[:, :3, :3], source[:, :3, :3]) / len(x)
    return _complete(_best_rotation(_cross_covariance(x, y) / spread + turned), x, y)


def _cross_covariance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    covariance: np.ndarray = (y - y.mean(axis=0)).T @ (x - x.mean(axis=0)) / len(x)
    return covariance


def _variance(points: np.ndarray) -> float:
    variance = float(((points - points.mean(axis=0)) ** 2).sum() / len(points))
    # Rounding gives equal points about this variance.
    if not variance > 1e-12 * float((points**2).sum() / len(points)):
        raise ValueError("all are in one place, so the scale is unknown")
    return variance


def _best_rotation(matrix: np.ndarray) -> np.ndarray:
    """The rotation R with the largest tr(Rᵀ M)."""
    u, _, vt = np.linalg.svd(matrix)
    mirror = np.diag([1, 1, np.sign(np.linalg.det(u @ vt))])
    rotation: np.ndarray = u @ mirror @ vt
    return rotation


def _complete(rotation: np.ndarray, x: np.ndarray, y: np.ndarray) -> Similarity:
    """The similarity with this rotation and the scale and translation that fit best."""
    _variance(y)
    scale = float((rotation * _cross_covariance(x, y)).sum()) / _variance(x)
    if not scale > 0:
        raise ValueError("they are too different")
    return Similarity(scale, rotation, y.mean(axis=0) - scale * rotation @ x.mean(axis=0))
