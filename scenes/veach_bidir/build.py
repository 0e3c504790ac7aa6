"""Builds the objects in the room: the glass egg, the floor lamp, the spot tube, the table's legs.

The dimensions are those of Benedikt Bitterli's scene after Eric Veach; the README says how they
were measured. The room, the table top and the two lights are rectangles and a cube in
``scene.xml``. There are no random numbers: the builder writes the same bytes every time.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from gpf.modelling.meshes import Mesh, join, lathe, write_ply

# Profiles, (radius, y) from the bottom up.
EGG = (
    (0.0, 1.9072),  # the table top is at 1.8997
    (0.1073, 1.9106),
    (0.1979, 1.9268),
    (0.2757, 1.9550),
    (0.3415, 1.9940),
    (0.4399, 2.0993),
    (0.4992, 2.2333),
    (0.5275, 2.4265),
    (0.5246, 2.5489),
    (0.5027, 2.7112),
    (0.4435, 2.9336),
    (0.3646, 3.1158),
    (0.2731, 3.2559),
    (0.1756, 3.3531),
    (0.1106, 3.3936),
    (0.0477, 3.4144),
    (0.0, 3.4174),
)
EGG_AXIS = (-2.3767, -0.7882)  # x, z
BASE = (
    (0.9952, 0.0),
    (0.9856, 0.0291),
    (0.9714, 0.0581),
    (0.9150, 0.1143),
    (0.8235, 0.1662),
    (0.7003, 0.2111),
    (0.5502, 0.2482),
    (0.3790, 0.2761),
    (0.1993, 0.2932),
    (0.0, 0.2997),
)
POLE = ((0.0994, 0.2), (0.0994, 5.8))
SHADE = ((0.0, 5.736), (1.1716, 6.4389))
LAMP_AXIS = (-2.4816, 2.5894)

# The tube's y is the distance from the light's centre along the axis.
TUBE = ((0.0, -0.0454), (0.2982, -0.0454), (0.2982, 0.9407))
TUBE_ORIGIN = (-2.6908, 5.1042, -3.7706)
TUBE_AXIS = (0.0704, -0.4316, 0.8993)

LEG = ((0.112, -0.0966), (0.112, 1.8161))  # from below the floor into the table top
LEGS = tuple((x, z) for x in (-3.3624, -1.4214) for z in (-3.4150, 0.8886))


def turned(profile: tuple[tuple[float, float], ...], rows: int, segments: int) -> Mesh:
    """A smooth surface of revolution through ``profile``, with the normals of its curve.

    The curve is the cubic spline of (radius, y) over the length of the polygon. It meets the axis
    at a right angle and symmetrically, so the surface is smooth there too.
    """
    points = np.array(profile)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    straight = (2, 0.0)  # no curvature
    ends = [(1, 0.0) if radius == 0 else straight for radius in points[[0, -1], 0]]
    radius = CubicSpline(length, points[:, 0], bc_type=(straight, straight))
    height = CubicSpline(length, points[:, 1], bc_type=tuple(ends))
    t = np.linspace(0, length[-1], rows)
    r, y = radius(t), height(t)
    r[[0, -1]] = points[[0, -1], 0]  # exactly 0 on the axis
    mesh = lathe(np.stack([r, y], axis=1), segments)
    # y grows along the profile, so it determines the place of a vertex on the curve.
    normal = np.stack([height(t, 1), -radius(t, 1)]) / np.hypot(radius(t, 1), height(t, 1))
    outward, up = (np.interp(mesh.points[:, 1], y, component) for component in normal)
    x, _, z = mesh.points.T / np.maximum(np.hypot(mesh.points[:, 0], mesh.points[:, 2]), 1e-9)
    return replace(mesh, normals=np.stack([outward * x, up, outward * z], axis=1))


def on_axis(mesh: Mesh, axis: tuple[float, float]) -> Mesh:
    """The mesh moved along x and z."""
    matrix = np.eye(4)
    matrix[[0, 2], 3] = axis
    return mesh.transformed(matrix)


def spot_tube() -> Mesh:
    """The tube of the spot light, open at its mouth, with a cap behind the light."""
    axis = np.array(TUBE_AXIS) / np.linalg.norm(TUBE_AXIS)
    side = np.cross(axis, [0, 1, 0])
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3] = np.stack([side, axis, np.cross(side, axis), TUBE_ORIGIN], axis=1)
    return lathe(np.array(TUBE), 64).transformed(matrix)


def build(folder: Path) -> list[Path]:
    """Write the meshes below ``folder / "meshes"``; return their paths."""
    meshes = {
        "egg": on_axis(turned(EGG, rows=97, segments=96), EGG_AXIS),
        "lamp-base": on_axis(turned(BASE, rows=33, segments=96), LAMP_AXIS),
        "lamp-pole": on_axis(lathe(np.array(POLE), 128).smooth(), LAMP_AXIS),
        "lamp-shade": on_axis(lathe(np.array(SHADE), 128), LAMP_AXIS),
        "spot-tube": spot_tube(),
        "table-legs": join([on_axis(lathe(np.array(LEG), 32).smooth(), place) for place in LEGS]),
    }
    return [write_ply(folder / "meshes" / f"{name}.ply", mesh) for name, mesh in meshes.items()]
