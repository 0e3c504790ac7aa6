"""Spheres, cylinders and disks: their points and normals, and triangles that approximate them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mitsuba as mi
import numpy as np

from gpf.core.structs import to_numpy
from gpf.core.vectors import normalise

# Steps in u and v into which Mitsuba's analytic shapes are divided.
STEPS = {"Sphere": (48, 24), "Cylinder": (48, 1), "Disk": (1, 48)}


@dataclass(frozen=True)
class Curved:
    """A surface that is not made of triangles, in its own coordinates: radius 1 around the origin,
    a cylinder from z = 0 to 1.

    Attributes
    ----------
    kind: one of :data:`STEPS`.
    to_world: (4, 4) float64.
    sign: -1 if the front is inside.
    """

    kind: str
    to_world: np.ndarray
    sign: float

    @classmethod
    def read(cls, shape: mi.Shape) -> Curved:
        """The surface of an analytic shape."""
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        outside = cls(shape.class_name(), matrix, 1)
        si = shape.eval_parameterization(mi.Point2f(0.4, 0.4))
        seen = to_numpy(mi.Vector3f(si.n)).reshape(1, 3)
        normal = outside.nearest(to_numpy(si.p).reshape(1, 3))[1]
        return replace(outside, sign=float(np.sign(np.sum(seen * normal))))

    def place(self, uv: np.ndarray) -> np.ndarray:
        """World positions for Mitsuba's parameters of the shape, (P, 3)."""
        u, v = uv.T
        if self.kind == "Disk":
            local = u[:, None] * _circle(v)
        elif self.kind == "Cylinder":
            local = _circle(u) + v[:, None] * [0, 0, 1]
        else:
            up = np.cos(np.pi * v)[:, None] * [0, 0, 1]
            local = np.sin(np.pi * v)[:, None] * _circle(u) + up
        # Points of a pole or a seam are exactly the same: xatlas would cut between others.
        local = np.round(local, 6)
        return np.asarray(local @ self.to_world[:3, :3].T + self.to_world[:3, 3])

    def nearest(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The points and normals of the surface beside positions near it, (P, 3) float32 each."""
        linear, origin = self.to_world[:3, :3], self.to_world[:3, 3]
        local = (p - origin) @ np.linalg.inv(linear).T
        if self.kind == "Disk":
            normal = np.tile([0.0, 0.0, 1.0], (len(local), 1))
        else:
            normal = local * ([1, 1, 0] if self.kind == "Cylinder" else [1, 1, 1])
            local = local + normal * (1 / np.linalg.norm(normal, axis=1, keepdims=True) - 1)
        normal = normalise(self.sign * normal @ np.linalg.inv(linear))
        return (local @ linear.T + origin).astype(np.float32), normal.astype(np.float32)


def _circle(turns: np.ndarray) -> np.ndarray:
    angle = 2 * np.pi * turns
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
