"""Arrays of structures that travel between the rooms: Dr.Jit PyTrees with shapes and units.

``N`` is the width of the wavefront. Every field holds one entry per lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np


@dataclass
class Photons:
    """Photons where they met surfaces that have a diffuse component.

    Attributes
    ----------
    p: position, world units, (N, 3).
    n: geometric normal on the side from which the photon came, unit length, (N, 3).
    power: flux Φ in watts, already divided by the number of traced paths, (N, 3). It carries the
        dependence of the diffuse lobe on the direction of incidence (see
        :func:`gpf.scene.materials.diffuse_transfer`), so that a sum of powers over an area is the
        irradiance-like quantity E for which the reflected radiance is ``f_d(n, wo) E``.
    depth: number of surface interactions before this one, (N,); 0 is light straight from a lamp.
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
    """First diffuse hits of camera rays, followed through glossy and specular bounces.

    Attributes
    ----------
    p: position, world units, (N, 3).
    n: geometric normal on the viewer's side, unit length, (N, 3).
    reflectance: diffuse reflectance π f_d(n, wo) at the hit, dimensionless, (N, 3).
    throughput: β, what a unit of radiance at the hit contributes to the ray, (N, 3).
    emission: radiance that the ray gathered from emitters on the way, hit included, (N, 3); direct
        light on the glossy surfaces that it met is part of it, and that at the hit where it was
        asked for.
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

    def radiance(self, irradiance: mi.Color3f) -> mi.Color3f:
        """L = L_e + β ρ/π E, for the irradiance E at the points, W/m²."""
        reflected = self.throughput * self.reflectance * irradiance * dr.inv_pi
        return self.emission + dr.select(self.valid, reflected, 0)


@dataclass
class SurfacePoints:
    """Points on surfaces with a known target.

    Attributes
    ----------
    p: position, world units, (P, 3).
    n: unit normal, (P, 3).
    target: what the field should answer there (irradiance or radiance), (P, 3).
    weight: weight of the point in the loss, (P,).
    """

    p: mi.Point3f
    n: mi.Normal3f
    target: mi.Color3f
    weight: mi.Float


def take(points: Any, lanes: mi.UInt32) -> Any:
    """The given lanes of a structure; fields of a single lane stay as they are."""
    width, taken = dr.width(points), {}
    for f in fields(points):
        value = getattr(points, f.name)
        whole = dr.width(value) == width
        taken[f.name] = dr.gather(type(value), value, lanes) if whole else value
    selected = type(points)(**taken)
    dr.eval(selected)
    return selected


def concatenate(parts: Sequence[Any]) -> Any:
    """Join structures or arrays lane after lane; single-lane fields are spread out first."""
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
    spread = [
        dr.gather(
            kind,
            value,
            dr.arange(mi.UInt32, width) if dr.width(value) > 1 else dr.zeros(mi.UInt32, width),
        )
        for value, width in zip(values, widths, strict=True)
    ]
    return dr.concat(spread)


def to_numpy(value: Any) -> np.ndarray:
    """Dr.Jit array (…, N) to a numpy array with one row per lane, (N, …)."""
    array = np.asarray(value.numpy())
    return np.ascontiguousarray(array.T) if array.ndim == 2 else array
