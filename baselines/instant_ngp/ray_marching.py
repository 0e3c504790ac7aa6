"""Volume rendering along rays: steps through occupied cells, compositing, and its adjoint.

Lengths are in units of the cube's edge, places in [0, 1]³.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from baselines.instant_ngp.occupancy_grid import OccupancyGrid

# A ray ends below this transmittance.
LEAST_TRANSMITTANCE = 1e-4


@dataclass
class Rays:
    """Rays through the cube, (R).

    Attributes
    ----------
    o, d: origin and unit direction.
    near, far: distances at which rays enter and leave the rendered box; near ≥ far for rays that
        miss it.
    """

    o: mi.Point3f
    d: mi.Vector3f
    near: mi.Float
    far: mi.Float

    def at(self, distance: mi.Float, ray: mi.UInt32) -> tuple[mi.Point3f, mi.Vector3f]:
        """Places at distances along the rays with the given indices, and the rays' directions."""
        d = dr.gather(mi.Vector3f, self.d, ray)
        p = mi.Point3f(dr.gather(mi.Point3f, self.o, ray) + distance * d)
        dr.eval(p, d)
        return p, d


def clip_rays(o: mi.Point3f, d: mi.Vector3f, lower: mi.Point3f, upper: mi.Point3f) -> Rays:
    """Clip rays to a box and to the half in front of their origin."""
    a, b = (lower - o) / d, (upper - o) / d
    near = dr.max(dr.minimum(a, b))
    far = dr.min(dr.maximum(a, b))
    return Rays(o, d, dr.maximum(near, 0), far)


@dataclass
class Samples:
    """Samples along rays, grouped by ray and ordered by distance.

    Attributes
    ----------
    distance: distance along the ray, (N,).
    ray: index of the ray, (N,).
    begin, count: index of each ray's first sample, and number of its samples, (R,).
    total: number of samples; the rest of the arrays is padding.
    """

    distance: mi.Float
    ray: mi.UInt32
    begin: mi.UInt32
    count: mi.UInt32
    total: int


def next_distance(
    grid: OccupancyGrid, rays: Rays, t: mi.Float, active: mi.Bool
) -> tuple[mi.Float, mi.Bool]:
    """The distance after the next step of rays at ``t``, and whether the cell at ``t`` is occupied.

    All steps have the grid's length; steps that stay in one empty cell are taken at once.
    """
    place = rays.o + t * rays.d
    occupied = dr.gather(mi.Bool, grid.occupied, grid.cell(place), active)
    scaled = place * grid.resolution
    # Distance to the cell's far sides; infinite for sides that are nearly parallel to the ray.
    ahead = dr.floor(scaled) + dr.select(rays.d > 0, 1, 0) - scaled
    leave = dr.min(dr.select(dr.abs(rays.d) > 1e-9, ahead / rays.d, dr.inf)) / grid.resolution
    steps = dr.select(occupied, 1, dr.maximum(dr.ceil(leave / grid.step), 1))
    return t + steps * grid.step, occupied


@dr.syntax
def count_samples(grid: OccupancyGrid, rays: Rays, first: mi.Float) -> mi.UInt32:
    """The number of samples of rays whose first sample is at distance ``first``, (R,)."""
    t = mi.Float(first)
    count = mi.UInt32(0)
    while t < rays.far:
        after, occupied = next_distance(grid, rays, t, t < rays.far)
        count += dr.select(occupied, mi.UInt32(1), 0)
        t = after
    return count


@dr.syntax
def _write_samples(
    grid: OccupancyGrid, rays: Rays, first: mi.Float, samples: Samples, ray: mi.UInt32
) -> mi.UInt32:
    """Write the samples of rays into the arrays of ``samples``."""
    t = mi.Float(first)
    slot = mi.UInt32(samples.begin)
    end = samples.begin + samples.count
    while (t < rays.far) & (slot < end):
        active = (t < rays.far) & (slot < end)
        after, occupied = next_distance(grid, rays, t, active)
        dr.scatter(samples.distance, t, slot, active & occupied)
        dr.scatter(samples.ray, ray, slot, active & occupied)
        slot += dr.select(occupied, mi.UInt32(1), 0)
        t = after
    return slot


def take_samples(grid: OccupancyGrid, rays: Rays, first: mi.Float, room: int) -> Samples:
    """The samples of rays in occupied cells; rays that do not fit into ``room`` get none."""
    count = count_samples(grid, rays, first)
    dr.eval(count)
    begin = dr.prefix_reduce(dr.ReduceOp.Add, count, exclusive=True)
    fits = begin + count <= dr.opaque(mi.UInt32, room)
    count = dr.select(fits, count, 0)
    total = int(dr.sum(count)[0])
    samples = Samples(dr.zeros(mi.Float, room), dr.zeros(mi.UInt32, room), begin, count, total)
    dr.eval(samples)
    dr.eval(_write_samples(grid, rays, first, samples, dr.arange(mi.UInt32, dr.width(count))))
    return samples


@dataclass
class Composite:
    """Colours of rays, (R).

    Attributes
    ----------
    colour: C = Σ w_i c_i with w_i = T_i α_i, α_i = 1 - exp(-σ_i δ) and T_i = Π_{j<i} (1 - α_j).
    used: number of samples until T_i fell below LEAST_TRANSMITTANCE.
    """

    colour: mi.Color3f
    used: mi.UInt32


@dr.syntax
def composite(samples: Samples, density: mi.Float, colour: mi.Color3f, step: mi.Float) -> Composite:
    """Composite densities σ and colours c of samples, (N,), front to back, over black."""
    total = mi.Color3f(0)
    through = mi.Float(1)
    i = mi.UInt32(samples.begin)
    end = samples.begin + samples.count
    while (i < end) & (through > LEAST_TRANSMITTANCE):
        kept = dr.exp(-dr.gather(mi.Float, density, i) * step)
        total += through * (1 - kept) * dr.gather(mi.Color3f, colour, i)
        through *= kept
        i += 1
    return Composite(total, i - samples.begin)


@dataclass
class _Gradients:
    """Derivatives, and the indices of their samples."""

    sample: mi.UInt32
    density: mi.Float
    colour: mi.Color3f


@dr.syntax
def _write_gradients(
    samples: Samples,
    density: mi.Float,
    colour: mi.Color3f,
    step: mi.Float,
    seen: Composite,
    adjoint: mi.Color3f,
    place: mi.UInt32,
    into: _Gradients,
) -> mi.UInt32:
    """Write the derivatives of the rays' used samples one after the other."""
    through = mi.Float(1)
    # The colour behind the sample, which the sample's opacity reduces.
    behind = mi.Color3f(seen.colour)
    i = mi.UInt32(0)
    while i < seen.used:
        index = samples.begin + i
        kept = dr.exp(-dr.gather(mi.Float, density, index) * step)
        c = dr.gather(mi.Color3f, colour, index)
        weight = through * (1 - kept)
        behind -= weight * c
        through *= kept
        dr.scatter(into.sample, index, place + i)
        dr.scatter(into.density, step * dr.dot(adjoint, through * c - behind), place + i)
        dr.scatter(into.colour, weight * adjoint, place + i)
        i += 1
    return i


def composite_adjoint(
    samples: Samples,
    density: mi.Float,
    colour: mi.Color3f,
    step: mi.Float,
    seen: Composite,
    adjoint: mi.Color3f,
) -> tuple[mi.UInt32, mi.Float, mi.Color3f]:
    """Derivatives of a loss for σ and c, from its derivative ``adjoint`` = ∂loss/∂C, (R, 3):

        ∂c_i = w_i ∂C,    ∂σ_i = δ ∂C · (T_{i+1} c_i - Σ_{j>i} w_j c_j).

    Returns the indices of the used samples, and both derivatives, (M) each.
    """
    place = dr.prefix_reduce(dr.ReduceOp.Add, seen.used, exclusive=True)
    # As large as the samples: with other sizes, Dr.Jit would recompile the kernel.
    room = dr.width(samples.distance)
    into = _Gradients(
        dr.zeros(mi.UInt32, room), dr.zeros(mi.Float, room), dr.zeros(mi.Color3f, room)
    )
    dr.eval(into)
    dr.eval(_write_gradients(samples, density, colour, step, seen, adjoint, place, into))
    lanes = dr.arange(mi.UInt32, max(int(dr.sum(seen.used)[0]), 1))
    result = (
        dr.gather(mi.UInt32, into.sample, lanes),
        dr.gather(mi.Float, into.density, lanes),
        dr.gather(mi.Color3f, into.colour, lanes),
    )
    dr.eval(result)
    return result
