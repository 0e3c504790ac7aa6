"""A teapot: a hollow body with spout and handle, and a lid with a knob.

The axis is y, the spout points to +z, and the pot stands on y = 0.033. With its lid it is 6.2 high
and 9.4 long. Body and lid are closed solids with walls of about 0.2, so they can be made of glass.
The tables below give radii and half-widths by height.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from gpf.modelling.meshes import Mesh, lathe
from scenes.modelling.implicit import intersection, polygonize, spaced, union

Table = Sequence[tuple[float, ...]]

FOOT, FLOOR, RIM = 0.033, 0.25, 4.74  # heights: underside, inside bottom, edge of the mouth

# (y, radius) of the outside, of the inside, and of the lid from its underside to its top.
OUTSIDE = [(0, 2.3), (0.1, 2.31), (0.25, 2.345), (0.5, 2.52), (0.75, 2.753), (1, 2.927)]
OUTSIDE += [(1.25, 3.033), (1.6, 3.083), (2, 3.047), (2.5, 2.93), (3, 2.775), (3.5, 2.601)]
OUTSIDE += [(4, 2.408), (4.4, 2.231), (4.7, 2.06), (5, 1.87)]
INSIDE = [(0.22, 1.1), (0.28, 1.42), (0.35, 1.75), (0.5, 2.172), (0.75, 2.526), (1, 2.703)]
INSIDE += [(1.3, 2.805), (1.7, 2.847), (2, 2.833), (2.5, 2.752), (3, 2.62), (3.5, 2.444)]
INSIDE += [(4, 2.228), (4.4, 2)]
MOUTH = [(4.4, 1.99), (4.5, 1.84), (4.54, 1.76), (4.58, 1.77)]
MOUTH += [(4.63, 1.86), (4.68, 1.93), (5, 1.94)]
LID = [(4.71, 0), (4.706, 0.2), (4.69, 0.6), (4.66, 1.3)]
LID += [(4.64, 1.57), (4.605, 1.69), (4.59, 1.715)]
LID += [(4.6, 1.74), (4.63, 1.77), (4.655, 1.83), (4.67, 1.9), (4.69, 1.92), (4.715, 1.915)]
LID += [(4.755, 1.8), (4.8, 1.57), (4.85, 1.308), (4.9, 1.062)]
LID += [(4.95, 0.84), (5, 0.658), (5.05, 0.51)]
LID += [(5.11, 0.4), (5.2, 0.322), (5.3, 0.307), (5.45, 0.331), (5.65, 0.385), (5.85, 0.44)]
LID += [(5.97, 0.464), (6.05, 0.447), (6.1, 0.396), (6.14, 0.282), (6.16, 0.12), (6.165, 0)]

# (y, back, front, half width, wall) of the spout's horizontal sections, which are ellipses.
SPOUT = [(0, 1.2, 1.8, 0.4, 0.3), (0.6, 1.5, 2.3, 0.7, 0.3)]
SPOUT += [(1, 1.5, 2.9, 1, 0.3), (1.5, 1.6, 3.3, 1.12, 0.3)]
SPOUT += [(2, 1.75, 3.471, 1.15, 0.28), (2.5, 1.9, 3.608, 1.05, 0.23), (3, 2.18, 3.743, 0.84, 0.19)]
SPOUT += [(3.4, 2.66, 3.856, 0.58, 0.16), (3.6, 2.87, 3.917, 0.505, 0.15)]
SPOUT += [(3.8, 3.029, 3.984, 0.45, 0.14)]
SPOUT += [(4, 3.182, 4.066, 0.405, 0.13), (4.2, 3.338, 4.181, 0.375, 0.125)]
SPOUT += [(4.4, 3.494, 4.37, 0.385, 0.13)]
SPOUT += [(4.5, 3.569, 4.47, 0.42, 0.14), (4.7, 3.71, 4.67, 0.5, 0.15)]
LIP = 4.64  # height of the spout's edge at its back; the edge falls a little towards the front

# (z, y, half width in x, half thickness) along the handle's centre line, from the mouth down.
HANDLE = [(-1.9, 4.12, 0.42, 0.22), (-2.3, 4.17, 0.4, 0.24), (-2.7, 4.25, 0.375, 0.23)]
HANDLE += [(-3.2, 4.305, 0.32, 0.2), (-3.8, 4.305, 0.33, 0.18), (-4.25, 4.2, 0.37, 0.19)]
HANDLE += [(-4.54, 4.02, 0.365, 0.2), (-4.635, 3.7, 0.335, 0.18), (-4.55, 3.3, 0.3, 0.175)]
HANDLE += [(-4.32, 2.83, 0.275, 0.165), (-3.96, 2.33, 0.27, 0.16), (-3.5, 1.82, 0.315, 0.155)]
HANDLE += [(-3.1, 1.47, 0.36, 0.16), (-2.7, 1.2, 0.4, 0.17)]


def curve(x: np.ndarray, table: Table) -> list[np.ndarray]:
    """Smooth curves through the columns of ``table`` as functions of its first column, at ``x``.

    Cubic between knots, constant beyond the ends; the slope at a knot is that of the chord of its
    two neighbours.
    """
    knots, *columns = np.array(table).T
    x = np.clip(x, knots[0], knots[-1])
    i = np.clip(np.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
    width = knots[i + 1] - knots[i]
    t = (x - knots[i]) / width
    found = []
    for value in columns:
        slope = np.empty_like(value)
        slope[1:-1] = (value[2:] - value[:-2]) / (knots[2:] - knots[:-2])
        slope[[0, -1]] = (value[[1, -1]] - value[[0, -2]]) / (knots[[1, -1]] - knots[[0, -2]])
        left, right = value[i], value[i + 1]
        bend = t * (1 - t) * width
        found.append(
            left
            + (right - left) * t * t * (3 - 2 * t)
            + bend * ((1 - t) * slope[i] - t * slope[i + 1])
        )
    return found


def revolved(r: np.ndarray, y: np.ndarray, table: Table) -> np.ndarray:
    """Roughly the signed distance to the surface of revolution with the radii of ``table``."""
    radius, above = curve(y, table)[0], curve(y + 1e-3, table)[0]
    return (r - radius) / np.sqrt(1 + ((above - radius) / 1e-3) ** 2)


def spout(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The spout without its bore, and the bore."""
    back, front, half, wall = curve(y, SPOUT)
    a, middle = (front - back) / 2, (front + back) / 2

    def section(thinner: np.ndarray | float) -> np.ndarray:
        long, short = a - thinner, half - thinner
        across, along = x / short, (z - middle) / long
        size = np.sqrt(across**2 + along**2)
        # Divided by the length of the gradient; 0.85 because the walls are slanted.
        steep = np.sqrt((across / short) ** 2 + (along / long) ** 2)
        return 0.85 * (size - 1) * np.maximum(size, 0.05) / np.maximum(steep, 0.05)

    return section(0.0), section(1.1 * wall)


def handle(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The handle: elliptic sections across a plane curve."""
    knots = np.arange(len(HANDLE), dtype=float)
    table = [(k, *row) for k, row in zip(knots, HANDLE, strict=True)]
    path = np.stack(curve(np.linspace(0, knots[-1], 6 * len(HANDLE)), table), axis=1)
    y, z = np.broadcast_arrays(y, z)
    wide, thick, distance = np.ones(z.shape), np.ones(z.shape), np.full(z.shape, 9.0)
    close = z < -1.6  # elsewhere any large distance is good enough
    y, z, nearest = y[close], z[close], np.full(int(close.sum()), np.inf)
    widths = np.ones((2, len(nearest)))
    for a, b in pairwise(path):
        dz, dy = b[0] - a[0], b[1] - a[1]
        t = np.clip(((z - a[0]) * dz + (y - a[1]) * dy) / (dz * dz + dy * dy), 0, 1)
        reach = np.hypot(z - a[0] - t * dz, y - a[1] - t * dy)
        closer = reach < nearest
        nearest = np.where(closer, reach, nearest)
        widths = np.where(closer, a[2:, None] + t * (b - a)[2:, None], widths)
    distance[close], wide[close], thick[close] = nearest, *widths
    return (np.sqrt((x / wide) ** 2 + (distance / thick) ** 2) - 1) * thick


def body_field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Negative inside the material of the body."""
    r = np.sqrt(x * x + z * z)
    belly = intersection(revolved(r, y, OUTSIDE), y - RIM, fillet=0.1)
    outer, bore = spout(x, y, z)
    outer = intersection(outer, y - LIP + 0.1 * (z - 3.65), fillet=0.08)
    solid = intersection(union(belly, outer, fillet=0.25), FOOT - y, fillet=0.1)
    solid = union(solid, handle(x, y, z), fillet=0.16)
    room = intersection(revolved(r, y, INSIDE), FLOOR - y, fillet=0.1)
    room = intersection(room, y - 4.43, fillet=0.02)
    hollow = union(room, intersection(bore, 1.0 - y, fillet=0.1), fillet=0.25)
    mouth = intersection(revolved(r, y, MOUTH), 4.38 - y, fillet=0.02)
    return intersection(solid, -np.minimum(hollow, mouth), fillet=0.08)


def teapot_body(cell: float = 0.06) -> Mesh:
    """The body with spout and handle, as one closed surface with normals."""
    # Finer near rim and lip; no grid plane touches the underside, the rim or the lip.
    x = spaced(-3.301, (3.31, cell))
    y = spaced(-0.097, (4.3, cell), (4.9, cell / 2))
    z = spaced(-5.023, (3.4, cell), (4.8, 0.7 * cell))
    return polygonize(body_field, (x, y, z))


def teapot_lid(segments: int = 96) -> Mesh:
    """The lid with its knob, closed, with normals; it is 0.02 above its seat."""
    heights = np.array(LID)
    knots = np.arange(len(heights), dtype=float)
    fine = np.arange(0, len(heights) - 1 + 1e-9, 1 / 3)
    table = [(k, r, y) for k, (y, r) in zip(knots, heights, strict=True)]
    radius, y = curve(fine, table)
    radius[[0, -1]] = 0
    return lathe(np.stack([np.maximum(radius, 0), y], axis=1), segments).smooth()
