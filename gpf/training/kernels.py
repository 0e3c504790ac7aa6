"""The kernels of training: the field's blend over neighbour lists, and its adjoint."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from gpf.core.structs import SurfacePoints
from gpf.field.field import WEIGHT_FLOOR
from gpf.field.gaussians import Gaussians, whitening_adjoint, whitening_rows
from gpf.training.loss import Loss, relative_weight
from gpf.training.neighbours import NeighbourLists

# Gradients are multiples of this step. A typical gradient is 1e-6.
STEP = 2.0**-50

MOST = 4096.0
"""What sums of gradients may reach."""


def parameters(g: Gaussians) -> list[mi.Float]:
    """The trained arrays, one per scalar parameter, (N,) each."""
    q = g.quats
    return [*g.means, *g.log_scales, q.x, q.y, q.z, q.w, *g.irradiance]


def with_parameters(g: Gaussians, p: list[mi.Float]) -> Gaussians:
    """The inverse of :func:`parameters`; normals are taken from ``g``."""
    return Gaussians(
        means=mi.Point3f(*p[0:3]),
        log_scales=mi.Vector3f(*p[3:6]),
        quats=mi.Quaternion4f(*p[6:10]),
        irradiance=mi.Color3f(*p[10:13]),
        normals=g.normals,
    )


@dataclass
class Packets:
    """The Gaussians as the batch kernel reads them, or their gradients: groups of 4, (4 N,).

    ``means`` holds μ; ``rows[k]`` holds the row M_k and the colour channel k. Gradients have the
    same layout; they are whole numbers of :data:`STEP`, so that the order of the points does not
    change the sums.
    """

    means: mi.Float | mi.Int64
    rows: list[mi.Float] | list[mi.Int64]


def pack(g: Gaussians) -> Packets:
    """Packets of the Gaussians, in the same order."""
    rows = whitening_rows(g.log_scales, g.quats)
    return Packets(
        means=dr.ravel(mi.Vector4f(g.means.x, g.means.y, g.means.z, 0)),
        rows=[
            dr.ravel(mi.Vector4f(rows[k].x, rows[k].y, rows[k].z, g.irradiance[k]))
            for k in range(3)
        ],
    )


def unpack_gradients(g: Gaussians, gradients: Packets, anisotropic: bool) -> list[mi.Float]:
    """Gradients with respect to :func:`parameters`, from those with respect to the packets."""
    index = dr.arange(mi.UInt32, dr.width(g.means))
    means, *rows = (_read(sums, index) for sums in (gradients.means, *gradients.rows))
    scales, quats = whitening_adjoint(
        g.log_scales,
        g.quats,
        tuple(mi.Vector3f(r.x, r.y, r.z) for r in rows),  # type: ignore[arg-type]
    )
    if not anisotropic:
        scales = mi.Vector3f(dr.sum(scales) / 3)
    return [means.x, means.y, means.z, *scales, *quats, rows[0].w, rows[1].w, rows[2].w]


@dr.syntax
def blend_neighbours(
    points: SurfacePoints, lists: NeighbourLists, chosen: mi.UInt32, packets: Packets, divided: bool
) -> tuple[mi.Color3f, mi.Float]:
    """The field's value at the chosen points, (B, 3), and 1 / Z, (B,)."""
    x = dr.gather(mi.Point3f, points.p, chosen)
    support2 = dr.gather(mi.Float, lists.support2, chosen)
    i = dr.gather(mi.UInt32, lists.starts, chosen)
    end = dr.gather(mi.UInt32, lists.starts, chosen + 1)
    total = mi.Float(0)
    blend = mi.Color3f(0)
    while i < end:
        index = dr.gather(mi.UInt32, lists.indices, i)
        term = _Term(x, packets, index, support2)
        total += term.weight
        blend += term.weight * term.colour
        i += 1
    inverse = dr.select(total > 0, dr.rcp(total), 0) if divided else mi.Float(1)
    return blend * inverse, inverse


@dr.syntax
def accumulate_gradients(
    points: SurfacePoints,
    lists: NeighbourLists,
    chosen: mi.UInt32,
    packets: Packets,
    gradients: Packets,
    scale: mi.Float,
    divided: bool,
    loss: Loss = "relative",
) -> mi.Float:
    """Weighted squared errors of a batch, (B,); adds their gradients to ``gradients``.

    The loss is ``scale`` times the sum of the result; with ``scale`` = 1 / (3 B) it is the mean
    squared error. Its weights (:mod:`gpf.training.loss`) are those of the blend, held fixed.
    """
    blend, inverse = blend_neighbours(points, lists, chosen, packets, divided)
    importance = mi.Float(1)
    if dr.hint(loss == "relative", mode="scalar"):
        importance = relative_weight(dr.sum(blend) / 3)
    error = blend - dr.gather(mi.Color3f, points.target, chosen)
    adjoint = 2 * scale * importance * inverse * error

    scatter_adjoint(points, lists, chosen, packets, gradients, adjoint, blend, divided)
    return importance * dr.squared_norm(error)


@dr.syntax
def scatter_adjoint(
    points: SurfacePoints,
    lists: NeighbourLists,
    chosen: mi.UInt32,
    packets: Packets,
    gradients: Packets,
    adjoint: mi.Color3f,
    blend: mi.Color3f,
    divided: bool,
) -> mi.Vector3f:
    """Add the gradients of a loss to ``gradients``; returns those with respect to the chosen
    points, (B, 3), in the space of the Gaussians' centres.

    The blend is E = Σ w_i c_i / Z with w_i = ψ_i (exp(-m_i/2) + ε) and Z = Σ w_i (Z = 1 for the
    plain sum). With G = ∂loss/∂E the adjoint is

        ∂c_i = w_i G / Z,   ∂w_i = G · (c_i - E) / Z,   ∂m_i = -ψ_i exp(-m_i/2) ∂w_i / 2,
        ∂M_k = 2 u_k ∂m_i d,   ∂μ = -∂x = -(2 Mᵀu ∂m_i + ∂ψ_i/∂d (exp(-m_i/2) + ε) ∂w_i).

    Parameters
    ----------
    adjoint: G / Z, (B, 3).
    blend: E, as from :func:`blend_neighbours`, (B, 3).
    """
    x = dr.gather(mi.Point3f, points.p, chosen)
    support2 = dr.gather(mi.Float, lists.support2, chosen)
    i = dr.gather(mi.UInt32, lists.starts, chosen)
    end = dr.gather(mi.UInt32, lists.starts, chosen + 1)
    middle = blend if divided else mi.Color3f(0)
    to_x = mi.Vector3f(0)
    while i < end:
        index = dr.gather(mi.UInt32, lists.indices, i)
        term = _Term(x, packets, index, support2)
        to_x += mi.Vector3f(term.scatter(gradients, index, adjoint, middle))
        i += 1
    return to_x


@dr.syntax
def pair_weights(points: SurfacePoints, lists: NeighbourLists, packets: Packets) -> mi.Float:
    """The weights w_i of all pairs of a point and a Gaussian in ``lists``, (pairs,)."""
    weights = dr.zeros(mi.Float, dr.width(lists.indices))
    lane = dr.arange(mi.UInt32, dr.width(points.p))
    i = dr.gather(mi.UInt32, lists.starts, lane)
    end = dr.gather(mi.UInt32, lists.starts, lane + 1)
    x, support2 = mi.Point3f(points.p), mi.Float(lists.support2)
    while i < end:
        index = dr.gather(mi.UInt32, lists.indices, i)
        dr.scatter(weights, _Term(x, packets, index, support2).weight, i)
        i += 1
    return weights


class _Term:
    """One neighbour's term of a blend (:func:`gpf.field.field.blend_weight`), and its adjoint."""

    def __init__(self, x, packets, index, support2):  # type: ignore[no-untyped-def]
        mean = dr.gather(mi.Vector4f, packets.means, index)
        rows = [dr.gather(mi.Vector4f, r, index) for r in packets.rows]
        self.d = x - mi.Point3f(mean.x, mean.y, mean.z)
        self.rows = [mi.Vector3f(r.x, r.y, r.z) for r in rows]
        self.colour = mi.Color3f(*(r.w for r in rows))
        self.u = mi.Vector3f(*(dr.dot(row, self.d) for row in self.rows))
        self.support2 = support2
        self.rest = dr.maximum(1 - dr.squared_norm(self.d) / support2, 0)
        self.falloff = dr.square(self.rest)
        self.bell = dr.exp(-0.5 * dr.squared_norm(self.u))
        self.weight = self.falloff * (self.bell + WEIGHT_FLOOR)

    def scatter(self, gradients, index, adjoint, blend):  # type: ignore[no-untyped-def]
        """Add this term's gradients; returns that with respect to the point. ``adjoint`` is
        ∂loss/∂E / Z."""
        to_weight = dr.dot(adjoint, self.colour - blend)
        to_u = (-to_weight * self.falloff * self.bell) * self.u
        to_d = sum((to_u[k] * self.rows[k] for k in range(3)), mi.Vector3f(0))
        slope = -4 * self.rest / self.support2
        to_d += (to_weight * (self.bell + WEIGHT_FLOOR) * slope) * self.d
        _add(gradients.means, (-to_d.x, -to_d.y, -to_d.z, mi.Float(0)), index)
        to_colour = adjoint * self.weight
        for k in range(3):
            row = to_u[k] * self.d
            _add(gradients.rows[k], (row.x, row.y, row.z, to_colour[k]), index)
        return to_d


def zero_gradients(size: int) -> Packets:
    """Zero gradients for ``size`` Gaussians."""
    means, *rows = (dr.zeros(mi.Int64, 4 * size) for _ in range(4))
    return Packets(means, rows)


def _add(sums, values, index):  # type: ignore[no-untyped-def]
    """Add four numbers per lane to the sums of a Gaussian, each as a whole number of steps.

    Values that are not finite are left out: as whole numbers they would pass for gradients. The
    error of their point is not finite either, which is reported
    (:meth:`gpf.training.trainer.Trainer.finish`).
    """
    steps = [mi.Int64(dr.select(dr.isfinite(v), v, 0) / STEP) for v in values]
    dr.scatter_add(sums, dr.int64_array_t(mi.Vector4f)(*steps), index)


def _read(sums: mi.Int64, index: mi.UInt32) -> mi.Vector4f:
    """The sums of Gaussians, (N, 4)."""
    return mi.Vector4f(dr.gather(dr.int64_array_t(mi.Vector4f), sums, index)) * STEP
