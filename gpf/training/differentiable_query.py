"""A field's answer as an operation with derivatives: with respect to the arrays of its Gaussians,
and to the points of the query."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.structs import SurfacePoints
from gpf.field.field import GaussianPhotonField
from gpf.field.gaussians import Gaussians
from gpf.field.neighbour_search import LARGEST_REACH
from gpf.training.kernels import (
    MOST,
    Packets,
    blend_neighbours,
    pack,
    parameters,
    scatter_adjoint,
    unpack_gradients,
    with_parameters,
    zero_gradients,
)
from gpf.training.neighbours import NeighbourLists, list_neighbours

AT_ONCE = 1 << 18
"""Most points whose neighbours are listed at a time."""


def query(
    field: GaussianPhotonField,
    gaussians: Gaussians,
    x: mi.Point3f,
    n: mi.Normal3f,
    active: mi.Bool,
) -> mi.Color3f:
    """The stored quantity at surface points, (N, 3), as from :meth:`GaussianPhotonField.query`.

    The derivatives are those of the blend: which Gaussians it holds, and the support of their
    falloff, count as fixed.

    Parameters
    ----------
    gaussians: those of the field, whose arrays may be attached.
    x: positions, which may be attached, (N, 3).
    n: viewer-side normals, (N, 3).
    """
    found: mi.Color3f = dr.custom(_Query, field, parameters(gaussians), x, n, active)
    return found


@dataclass
class _Part:
    """Some of the points of a query.

    Attributes
    ----------
    lanes: their numbers, (P,).
    points: the points, in the space of the Gaussians' centres.
    scale: how far they move there, relative to x, (P,).
    """

    lanes: mi.UInt32
    points: SurfacePoints
    scale: mi.Float
    lists: NeighbourLists


class _Query(dr.CustomOp):
    def eval(
        self,
        field: GaussianPhotonField,
        values: list[mi.Float],
        x: mi.Point3f,
        n: mi.Normal3f,
        active: mi.Bool,
    ) -> mi.Color3f:
        self.field, self.x, self.n, self.active = field, x, n, active
        self.gaussians = with_parameters(field.gaussians, values)
        return field.query(x, n, active)[0]

    def forward(self) -> None:
        found = dr.zeros(mi.Color3f, dr.width(self.active))
        with dr.isolate_grad():
            moving = _move(self.gaussians, self.grad_in("values"))
            for part in self._parts():
                shift = mi.Vector3f(self.grad_in("x"))
                part.points.p = _with_grad(
                    part.points.p, part.scale * dr.gather(mi.Vector3f, shift, part.lanes)
                )
                every = dr.arange(mi.UInt32, dr.width(part.lanes))
                packets = Packets(*(_with_grad(*pair) for pair in zip(*moving, strict=True)))
                blend, _ = blend_neighbours(
                    part.points, part.lists, every, packets, self._is_divided
                )
                dr.scatter(found, dr.forward_to(blend), part.lanes)
                dr.eval(found)
        self.set_grad_out(found)

    def backward(self) -> None:
        adjoint = self.grad_out()
        packets = pack(self.gaussians)
        gradients = zero_gradients(dr.width(self.gaussians.means))
        to_x = dr.zeros(mi.Vector3f, dr.width(self.active))
        unit = self._unit(adjoint)
        for part in self._parts():
            every = dr.arange(mi.UInt32, dr.width(part.lanes))
            place = part.points, part.lists, every, packets
            blend, inverse = blend_neighbours(*place, self._is_divided)
            own = dr.gather(mi.Color3f, adjoint, part.lanes) * inverse / unit
            moved = scatter_adjoint(*place, gradients, own, blend, self._is_divided)
            dr.scatter(to_x, part.scale * unit * moved, part.lanes)
            dr.eval(to_x, gradients)
        found = unpack_gradients(self.gaussians, gradients, anisotropic=True)
        self.set_grad_in("values", [unit * value for value in found])
        self.set_grad_in("x", mi.Point3f(to_x))

    def _unit(self, adjoint: mi.Color3f) -> float:
        """A unit for gradients: the sums are of whole numbers, which have a range, and all lanes
        may add to the same one."""
        size = float(np.abs(np.array(adjoint)).max(initial=0))
        colour = float(np.abs(np.array(self.gaussians.irradiance)).max())
        sharpest = float(np.exp(-float(np.array(self.gaussians.log_scales).min())))
        radius = self.field.settings.search_radius
        largest = max(1.0, 2 * colour * max(LARGEST_REACH * radius, 2 * sharpest + 4 / radius))
        unit = max(size, 1e-30) * largest * dr.width(self.active) / MOST
        return unit if np.isfinite(unit) else 1.0

    @property
    def _is_divided(self) -> bool:
        return self.field.settings.blend == "divided"

    def _parts(self) -> Iterator[_Part]:
        lanes = dr.compress(self.active)
        for first in range(0, dr.width(lanes), AT_ONCE):
            count = min(AT_ONCE, dr.width(lanes) - first)
            some = dr.gather(mi.UInt32, lanes, dr.arange(mi.UInt32, count) + first)
            x, n = dr.gather(mi.Point3f, self.x, some), dr.gather(mi.Normal3f, self.n, some)
            p, scale = self.field.unfold(x), mi.Float(1)
            if self.field.detail is not None:
                scale = self.field.detail.scale(x)
            points = SurfacePoints(p=p, n=n, target=dr.zeros(mi.Color3f, count))
            dr.eval(points, some, scale)
            yield _Part(some, points, scale, list_neighbours(self.field, points))


def _move(gaussians: Gaussians, moved: list[mi.Float]) -> tuple[list[Any], list[Any]]:
    """The packets of Gaussians, and how they change when the parameters do: ``means`` and ``rows``
    of :class:`gpf.training.kernels.Packets` each."""
    values = [_with_grad(*pair) for pair in zip(parameters(gaussians), moved, strict=True)]
    packets = pack(with_parameters(gaussians, values))
    change = dr.forward_to([packets.means, packets.rows])
    return [dr.detach(packets.means), dr.detach(packets.rows)], list(change)


def _with_grad(value: Any, gradient: Any) -> Any:
    value = dr.copy(dr.detach(value))
    dr.enable_grad(value)
    dr.set_grad(value, gradient)
    return value
