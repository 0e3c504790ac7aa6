"""Projection of Gaussians to their footprints in an image (Zwicker and others 2001)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.scene.pinhole import Pinhole

# Added to the variance of every footprint, pixels², so that none falls between pixels.
BLUR = 0.3
# Gaussians nearer to the camera than this, world units, are not rendered.
NEAR = 0.01
# A footprint ends where its opacity falls below this.
FAINTEST = 1 / 255
# The slope in the projection is clamped to this multiple of the slope at the image's edge.
SLOPE_LIMIT = 1.3


@dataclass
class SplatArrays:
    """Gaussians as flat arrays, with one row per Gaussian.

    Attributes
    ----------
    means: (3 N,), world units.
    log_scales: (3 N,), logarithms of the standard deviations along the Gaussian's axes.
    quats: (4 N,) as w, x, y, z, of any length.
    opacities: (N,), logits.
    colours: (3 N,), coefficients of the constant spherical harmonic of the colour.
    harmonics: (3 K N,), coefficients of the other harmonics, by harmonic, then channel; K = 0, 3, 8
        or 15.
    """

    means: mi.Float
    log_scales: mi.Float
    quats: mi.Float
    opacities: mi.Float
    colours: mi.Float
    harmonics: mi.Float

    def arrays(self) -> list[mi.Float]:
        """All of them, in the order of the attributes."""
        return [getattr(self, field.name) for field in fields(self)]


@dataclass
class Footprints:
    """Gaussians in an image, (N,).

    Attributes
    ----------
    centres: pixels.
    conics: a, b, c of the exponent -(a x² + 2 b x y + c y²) / 2; pixels⁻².
    opacities: opacities at the centres, in (0, 1).
    colours: colours as seen from the camera.
    depths: depths along the camera's axis, world units.
    extents: half of the width and height of the footprint, pixels; 0 if it is not in the image.
    """

    centres: mi.Vector2f
    conics: mi.Vector3f
    opacities: mi.Float
    colours: mi.Color3f
    depths: mi.Float
    extents: mi.Vector2f


@dataclass
class Projector:
    """A pinhole camera as arrays: kernels read its numbers, so that they work for all cameras."""

    origin: mi.Point3f
    axes: list[mi.Vector3f]
    focal: mi.Float
    centre: mi.Vector2f
    limit: mi.Vector2f

    @classmethod
    def of(cls, camera: Pinhole) -> Projector:
        """The projector of a camera."""

        def opaque(values: np.ndarray) -> list[mi.Float]:
            return [dr.opaque(mi.Float, float(v)) for v in values]

        half = np.array(camera.size) / 2
        return cls(
            origin=mi.Point3f(*opaque(camera.origin)),
            axes=[mi.Vector3f(*opaque(row)) for row in camera.rotation.T],
            focal=dr.opaque(mi.Float, camera.focal),
            centre=mi.Vector2f(*opaque(half)),
            limit=mi.Vector2f(*opaque(SLOPE_LIMIT * half / camera.focal)),
        )


def project(splats: SplatArrays, camera: Projector, degree: int) -> Footprints:
    """Footprints of all Gaussians; differentiable except for depths and extents.

    With t = R (μ - o), the camera's projection is linearised around the mean,

        J = f [[1/t_z, 0, -t_x/t_z²], [0, 1/t_z, -t_y/t_z²]],    Σ' = J R Σ Rᵀ Jᵀ + BLUR,

    where Σ = Q S² Qᵀ. ``degree`` is the highest degree of the harmonics that are used.
    """
    count = dr.width(splats.opacities)
    index = dr.arange(mi.UInt32, count)
    mean = mi.Point3f(*_rows(splats.means, index, 3))
    scale = mi.Vector3f(*(dr.exp(s) for s in _rows(splats.log_scales, index, 3)))
    away = mean - camera.origin
    t = mi.Vector3f(*(dr.dot(axis, away) for axis in camera.axes))
    ahead = dr.detach(t.z) > NEAR
    depth = dr.select(ahead, t.z, 1)
    centre = camera.focal * mi.Vector2f(t.x, t.y) / depth + camera.centre

    slope = dr.clip(mi.Vector2f(t.x, t.y) / depth, -camera.limit, camera.limit)
    # Rows of J R, and of that times Q S.
    per_depth = camera.focal / depth
    right, down, forward = camera.axes
    across = [per_depth * (right - slope.x * forward), per_depth * (down - slope.y * forward)]
    columns = _columns(_rows(splats.quats, index, 4))
    x, y = (mi.Vector3f(*(dr.dot(row, columns[k]) * scale[k] for k in range(3))) for row in across)
    xx, yy, xy = dr.squared_norm(x) + BLUR, dr.squared_norm(y) + BLUR, dr.dot(x, y)
    inverse = dr.rcp(xx * yy - dr.square(xy))
    conic = mi.Vector3f(yy * inverse, -xy * inverse, xx * inverse)

    opacity = dr.rcp(1 + dr.exp(-dr.gather(mi.Float, splats.opacities, index)))
    widest = dr.sqrt(dr.maximum(2 * dr.log(dr.detach(opacity) / FAINTEST), 0))
    extent = widest * mi.Vector2f(dr.sqrt(dr.detach(xx)), dr.sqrt(dr.detach(yy)))
    beyond = dr.abs(dr.detach(centre) - camera.centre) - extent
    seen = ahead & dr.all(beyond < camera.centre)
    return Footprints(
        centres=centre,
        conics=conic,
        opacities=opacity,
        colours=_colour(splats, index, dr.normalize(away), degree),
        depths=dr.detach(t.z),
        extents=dr.select(seen, extent, 0),
    )


def _rows(flat: mi.Float, index: mi.UInt32, width: int) -> list[mi.Float]:
    """The columns of a flat array with rows of ``width``, (N,) each.

    Each element is read once, so the gather's adjoint needs no atomic operations.
    """
    mode = dr.ReduceMode.Permute
    return [dr.gather(mi.Float, flat, width * index + k, mode=mode) for k in range(width)]


def _columns(quat: list[mi.Float]) -> list[mi.Vector3f]:
    """The columns of the rotation matrix of a quaternion w, x, y, z of any length."""
    length = dr.rsqrt(sum((dr.square(q) for q in quat), mi.Float(0)))
    w, x, y, z = (q * length for q in quat)
    return [
        mi.Vector3f(1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        mi.Vector3f(2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        mi.Vector3f(2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    ]


def _colour(splats: SplatArrays, index: mi.UInt32, d: mi.Vector3f, degree: int) -> mi.Color3f:
    """The colour in the direction ``d``: max(1/2 + Σ_k Y_k(d) h_k, 0)."""
    first, *others = harmonics(d, degree)
    colour = 0.5 + first * mi.Color3f(*_rows(splats.colours, index, 3))
    if others:
        width = dr.width(splats.harmonics) // dr.width(index)
        values = _rows(splats.harmonics, index, width)
        for k, other in enumerate(others):
            colour += other * mi.Color3f(*values[3 * k : 3 * k + 3])
    return dr.maximum(colour, 0)


def harmonics(d: mi.Vector3f, degree: int) -> list[mi.Float]:
    """Real spherical harmonics of unit vectors up to a degree of at most 3, in 3DGS's order."""
    x, y, z = d
    values = [mi.Float(0.28209479177387814)]
    if degree > 0:
        values += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    if degree > 1:
        values += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * z * z - 1),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * (x * x - y * y),
        ]
    if degree > 2:
        values += [
            -0.5900435899266435 * y * (3 * x * x - y * y),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (5 * z * z - 1),
            0.3731763325901154 * z * (5 * z * z - 3),
            -0.4570457994644658 * x * (5 * z * z - 1),
            1.445305721320277 * z * (x * x - y * y),
            -0.5900435899266435 * x * (x * x - 3 * y * y),
        ]
    return values
