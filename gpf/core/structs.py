"""The data that the packages exchange: Dr.Jit PyTrees with shapes and units.

``N`` is the width of the wavefront; every attribute has one entry per lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

Struct = TypeVar("Struct")

# Bytes in the widest packet of any processor; also more than the number of values in one.
_PACKET = 64


@dataclass
class Photons:
    """Photons where they hit surfaces with a diffuse component, or where they fly in a medium.

    Attributes
    ----------
    p: position, world units, (N, 3).
    n: unit geometric normal on the side that the photon came from, or, in a medium, the direction
        of its flight, (N, 3).
    power: flux Φ in watts, already divided by the number of traced paths, (N, 3). It includes the
        factor g of the diffuse lobe for the direction of incidence
        (:func:`gpf.scene.materials.diffuse_transfer`): the powers on an area, divided by the area,
        are the irradiance E for which the reflected radiance is ``f_d(n, wo) E``. In a medium it is
        in W m: the powers in a volume, divided by the volume, are the fluence, W/m².
    depth: number of surface interactions before this one, (N,); 0 is direct light.
    """

    p: mi.Point3f
    n: mi.Normal3f
    power: mi.Color3f
    depth: mi.UInt32


@dataclass
class OrientedPoints:
    """Points on surfaces.

    Attributes
    ----------
    p: position, world units, (N, 3).
    n: unit normal, (N, 3).
    """

    p: mi.Point3f
    n: mi.Normal3f


@dataclass
class VisiblePoints:
    """First diffuse hits of camera rays, after any glossy and specular bounces.

    Attributes
    ----------
    p: position, world units, (N, 3).
    n: unit geometric normal on the viewer's side, (N, 3). Where there is no such hit, one of a
        surface that turned the ray, or 0.
    reflectance: diffuse reflectance π f_d(n, wo) at the hit, dimensionless, (N, 3).
    throughput: β, the weight of radiance at the hit in that of the ray, (N, 3).
    emission: L_e, radiance from the emitters along the path and at the hit, W/(m² sr), (N, 3). It
        includes the direct light on glossy surfaces along the path and, on request, at the hit.
    depth: number of bounces before the hit, (N,).
    valid: whether the ray ended on a diffuse surface, (N,).
    """

    p: mi.Point3f
    n: mi.Normal3f
    reflectance: mi.Color3f
    throughput: mi.Color3f
    emission: mi.Color3f
    depth: mi.UInt32
    valid: mi.Bool

    @classmethod
    def seen_directly(cls, p: np.ndarray, n: np.ndarray) -> VisiblePoints:
        """White points with positions and normals, (N, 3), without light on the way."""
        where = from_numpy(mi.Point3f, p), from_numpy(mi.Normal3f, n)
        white = mi.Color3f(1), mi.Color3f(1)
        return cls(*where, *white, mi.Color3f(0), mi.UInt32(0), dr.full(mi.Bool, True, len(p)))

    def opaque(self) -> mi.Bool:
        """Whether surfaces ended or turned the ray, (N,), as for an alpha channel."""
        return dr.any(self.n != 0)

    def radiance(self, irradiance: mi.Color3f) -> mi.Color3f:
        """L = L_e + β ρ/π E, W/(m² sr), (N, 3), for the irradiance E at the points, W/m²."""
        reflected = self.throughput * self.reflectance * irradiance * dr.inv_pi
        return self.emission + dr.select(self.valid, reflected, 0)


@dataclass
class Haze:
    """Places in media, one for each camera ray, from which scattered light comes.

    Attributes
    ----------
    p: position, world units, (N, 3).
    d: unit direction of the ray, (N, 3); the light goes in the opposite one.
    medium: the medium there, (N,).
    weight: of the light scattered there, ∫ f(ω, ω') L(ω') dω', in the radiance of the ray, m/m,
        (N, 3).
    depth: number of bounces before, (N,).
    valid: whether there is such a place, (N,).
    """

    p: mi.Point3f
    d: mi.Vector3f
    medium: mi.MediumPtr
    weight: mi.Color3f
    depth: mi.UInt32
    valid: mi.Bool

    def radiance(self, scattered: mi.Color3f) -> mi.Color3f:
        """The part of the ray's radiance, W/(m² sr), (N, 3), given the light scattered there."""
        return dr.select(self.valid, self.weight * scattered, 0)


@dataclass
class Way:
    """One of two paths that camera rays can take at their first surface.

    Attributes
    ----------
    weight: weight of this path in a mean over both, (N,); 1 if there is no other.
    chance: for the first path, the probability that the other one should be taken as well,
        (N,); 0 if there is none.
    """

    weight: mi.Float
    chance: mi.Float


@dataclass
class SurfacePoints:
    """Points on surfaces with training targets.

    Attributes
    ----------
    p: position, world units, (P, 3).
    n: unit normal, (P, 3).
    target: what the field should return there, irradiance or radiance, (P, 3).
    """

    p: mi.Point3f
    n: mi.Normal3f
    target: mi.Color3f


@dataclass
class Arrival:
    """How camera rays arrive at their visible points.

    Attributes
    ----------
    ray: the last ray of the walk, (N,).
    medium: the medium that it goes through, (N,).
    """

    ray: mi.Ray3f
    medium: mi.MediumPtr


def take(points: Struct, lanes: mi.UInt32) -> Struct:
    """The given lanes of a structure; attributes with a single lane stay as they are."""
    dr.eval(points)  # all at once: one by one, each would run the whole loop that it comes from
    width, taken = dr.width(points), {}
    for f in fields(points):  # type: ignore[arg-type]
        value = getattr(points, f.name)
        whole = dr.width(value) == width
        taken[f.name] = dr.gather(type(value), value, lanes) if whole else value
    selected = type(points)(**taken)
    dr.eval(selected)
    return selected


def concatenate(parts: Sequence[Any]) -> Any:
    """Join structures or arrays in order; attributes with a single lane are repeated."""
    dr.eval(parts)  # as in `take`
    if is_dataclass(parts[0]):
        widths = [dr.width(part) for part in parts]
        joined = {}
        for f in fields(parts[0]):
            values = [getattr(part, f.name) for part in parts]
            joined[f.name] = _concatenate(values, widths)
        kind: Any = type(parts[0])
        return kind(**joined)
    return _concatenate(parts, [dr.width(part) for part in parts])


def _concatenate(values: Sequence[Any], widths: Sequence[int]) -> Any:
    kind = type(values[0])
    if dr.depth_v(kind) > 1:
        columns = zip(*values, strict=True)
        return kind(*(_concatenate(column, widths) for column in columns))
    if len(values) == 1 and dr.width(values[0]) == widths[0]:
        return kind(values[0])
    joined, begin = dr.empty(kind, sum(widths)), 0
    for value, width in zip(values, widths, strict=True):
        if width == 0:
            continue
        # Opaque: else each number of values has a kernel of its own.
        places = dr.opaque(mi.UInt32, begin) + dr.arange(mi.UInt32, width)
        dr.scatter(joined, value, places)
        begin += width
    return joined


def from_numpy(kind: Any, values: ArrayLike) -> Any:
    """Convert values of any number type to a Dr.Jit array, vector or tensor.

    Dr.Jit does not copy numpy's memory, and its kernels read whole packets of values, even beyond
    the last one. If that memory is not mapped, the process dies. So this makes a copy with room
    after it. The copy is aligned to packets: unaligned data is read by different kernels, which
    would have to be compiled as well.

    Parameters
    ----------
    kind: ``mi.Float``, ``mi.UInt32``, ``mi.UInt64``, ``mi.Bool``, ``mi.TensorXf``, or a vector such
        as ``mi.Point3f``.
    values: (N,); for vectors one row per lane, (N, D), as from :func:`to_numpy`; any shape
        for tensors.
    """
    values = np.asarray(values)
    if dr.depth_v(kind) > 1:
        return kind(*(from_numpy(dr.value_t(kind), column) for column in values.T))
    types = {
        dr.VarType.Bool: np.bool_,
        dr.VarType.Int32: np.int32,
        dr.VarType.UInt32: np.uint32,
        dr.VarType.UInt64: np.uint64,
        dr.VarType.Float32: np.float32,
        dr.VarType.Float64: np.float64,
    }
    dtype: np.dtype = np.dtype(types[dr.type_v(kind)])
    size = (values.size + _PACKET) * dtype.itemsize
    room = np.empty(size + _PACKET, np.uint8)
    begin = -room.ctypes.data % _PACKET
    copy = room[begin : begin + size].view(dtype)[: values.size].reshape(values.shape)
    copy[...] = values
    return kind(copy)


def to_numpy(value: Any) -> np.ndarray:
    """Convert a Dr.Jit array (…, N) to a numpy array with one row per lane, (N, …).

    (Dr.Jit would do so for a vector by a kernel that has N in it, one for each N.)
    """
    if dr.depth_v(value) != 2:
        return np.asarray(value.numpy())
    dr.eval(value)
    columns = [np.asarray(column.numpy()) for column in value]
    return np.stack(np.broadcast_arrays(*columns), axis=1)  # some may be constants
