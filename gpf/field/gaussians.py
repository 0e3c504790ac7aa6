"""Geometry of the Gaussians: from quaternion and scales to the matrix of a query, and its adjoint.

At the offset d = x - μ a Gaussian is exp(-m/2), ``m = |M d|²``. The rows of M are the columns of
the rotation R(q), divided by the scales: M = diag(1/s) Rᵀ, so that MᵀM = Σ⁻¹.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


@dataclass
class Gaussians:
    """Anisotropic 3D Gaussians on surfaces, as a structure of arrays (N).

    Attributes
    ----------
    means: centres μ, world units, (N, 3).
    log_scales: logarithms of the standard deviations along the local axes, (N, 3).
    quats: rotations (x, y, z, w), of any non-zero length, (N, 4).
    irradiance: the stored quantity: irradiance E in W/m², or radiance, depending on the field's
        settings, (N, 3).
    normals: unit normal of the surface on which the Gaussian lies, (N, 3); not trained.
    """

    means: mi.Point3f
    log_scales: mi.Vector3f
    quats: mi.Quaternion4f
    irradiance: mi.Color3f
    normals: mi.Normal3f


def rotation_columns(q: mi.Quaternion4f) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
    """Columns of R(q) for a quaternion of any length."""
    q = q * dr.rcp(dr.norm(q))
    x, y, z, w = q.x, q.y, q.z, q.w
    return (
        mi.Vector3f(1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)),
        mi.Vector3f(2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)),
        mi.Vector3f(2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)),
    )


def whitening_rows(
    log_scales: mi.Vector3f, quats: mi.Quaternion4f
) -> tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f]:
    """Rows of M = diag(1/s) Rᵀ."""
    inv = dr.exp(-log_scales)
    a, b, c = rotation_columns(quats)
    return a * inv.x, b * inv.y, c * inv.z


def whitening_adjoint(
    log_scales: mi.Vector3f,
    quats: mi.Quaternion4f,
    grad_rows: tuple[mi.Vector3f, mi.Vector3f, mi.Vector3f],
) -> tuple[mi.Vector3f, mi.Vector4f]:
    """Gradients of a loss with respect to log scales, (N, 3), and quaternion, (N, 4), from those
    with respect to M's rows.

    With M_k = R_k / s_k (R_k a column of R):

        ∂L/∂log s_k = -M_k · ∂L/∂M_k
        ∂L/∂q = 2/|q|² q ⊗ (τ, 0),   τ = Σ_k e_k × Rᵀ ∂L/∂R_k

    since a rotation by the small vector θ in the local frame changes q by q ⊗ (θ, 0) / 2 and the
    column R_k by R (θ × e_k).
    """
    columns = rotation_columns(quats)
    inv = dr.exp(-log_scales)
    grad_scales = mi.Vector3f(*(-dr.dot(columns[k], grad_rows[k]) * inv[k] for k in range(3)))
    # local[k] = Rᵀ ∂L/∂R_k
    local = [
        mi.Vector3f(*(dr.dot(columns[j], grad_rows[k]) * inv[k] for j in range(3)))
        for k in range(3)
    ]
    tau = mi.Vector3f(
        local[1].z - local[2].y,
        local[2].x - local[0].z,
        local[0].y - local[1].x,
    )
    product = quats * mi.Quaternion4f(tau.x, tau.y, tau.z, 0)
    scale = 2 / dr.squared_norm(mi.Vector4f(quats.x, quats.y, quats.z, quats.w))
    return grad_scales, mi.Vector4f(product.x, product.y, product.z, product.w) * scale
