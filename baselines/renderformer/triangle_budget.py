"""Fitting a scene to a budget of triangles: fine meshes get fewer, large facets get more.

The package fast-simplification simplifies meshes by edge collapse with quadric errors (Garland and
Heckbert 1997). Facets are halved at their longest edges.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baselines.optional import import_optional
from baselines.protocol import CannotServe
from baselines.renderformer.triangle_scene import Surface, Triangles
from baselines.translation.meshes import facet_normals
from gpf.modelling.meshes import Mesh

# Meshes of at most this many triangles, such as boxes, are not simplified.
SMALL = 32
# Facets that meet at a larger angle are shaded with a crease, as in the authors' code.
CREASE = np.cos(np.radians(30))


def fit_budget(surfaces: list[Surface], budget: int, where: str) -> list[Surface]:
    """Simplify all meshes except lamps and small ones, by a common factor, to fit the budget.

    Raises
    ------
    CannotServe: they do not fit, or the package for simplification is missing.
    """
    counts = np.array([len(s.mesh.faces) for s in surfaces])
    fixed = np.array([s.glows for s in surfaces]) | (counts <= SMALL)
    fitted = list(surfaces)
    left = counts.copy()
    while left.sum() > budget and not fixed.all():
        spare = budget - left[fixed].sum() - SMALL * (~fixed).sum()
        share = max(spare / counts[~fixed].sum(), 0)
        wanted = SMALL + (share * counts).astype(int)
        for k in np.flatnonzero(~fixed):
            fitted[k] = replace(surfaces[k], mesh=simplify(surfaces[k].mesh, int(wanted[k])))
            left[k] = len(fitted[k].mesh.faces)
        stuck = ~fixed & (left > wanted)
        if not stuck.any():
            break
        fixed |= stuck  # cannot be simplified further, as at borders: the others must be smaller
    if left.sum() > budget:
        raise CannotServe(
            where,
            f"has {counts.sum()} triangles, of which {left.sum()} remain after simplification; "
            f"{budget} are allowed",
            "Raise the option `triangles`, or simplify the scene.",
        )
    return fitted


def simplify(mesh: Mesh, count: int) -> Mesh:
    """A mesh of about ``count`` triangles, or more if it cannot be simplified that far.

    A mesh without normals remains without them.
    """
    library = import_optional("fast_simplification", "'fast-simplification>=0.2'")
    # Join points that were split for normals or textures, so that each edge has two facets.
    points, number = np.unique(mesh.points, axis=0, return_inverse=True)
    faces = number.reshape(-1)[mesh.faces]
    if count < len(faces):
        # Borders are preserved: holes in walls would let light through.
        points, faces = library.simplify(
            points, faces.astype(np.int32), target_count=count, preserve_border=True
        )
    simple = Mesh(np.asarray(points, dtype=float), np.asarray(faces, dtype=int))
    return simple if mesh.normals is None else shade(simple)


def shade(mesh: Mesh) -> Mesh:
    """The mesh with normals at the corners of each facet, and separate points for each facet.

    A normal is the area-weighted mean over the facets at that point within 30° of the facet itself.
    """
    corners = mesh.points[mesh.faces]
    normals = facet_normals(mesh)
    edges = corners[:, 1:] - corners[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    # All pairs of corners (a, b) that share a point, from the corners sorted by point.
    owner = mesh.faces.ravel()
    order = np.argsort(owner, kind="stable")
    start = np.searchsorted(owner[order], np.arange(len(mesh.points) + 1))
    sizes = np.diff(start)[owner]
    a = np.repeat(np.arange(len(owner)), sizes)
    within = np.arange(len(a)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    b = order[np.repeat(start[owner], sizes) + within]
    near = (normals[a // 3] * normals[b // 3]).sum(axis=1) >= CREASE
    total = normals[np.arange(len(owner)) // 3] * 1e-12
    np.add.at(total, a[near], (area[:, None] * normals)[b[near] // 3])
    length = np.linalg.norm(total, axis=1, keepdims=True)
    faces = np.arange(len(owner)).reshape(-1, 3)
    return Mesh(corners.reshape(-1, 3), faces, total / np.where(length > 0, length, 1))


def subdivide(triangles: Triangles, edge: float, budget: int) -> Triangles:
    """Halve the triangles with the longest edges until none is longer than ``edge``.

    Stops at ``budget`` triangles. Lamps are not halved. Normals are interpolated.
    """
    while len(triangles) < budget:
        edges = np.roll(triangles.corners, -1, axis=1) - triangles.corners
        lengths = np.where(triangles.glow[:, None], 0, np.linalg.norm(edges, axis=2))
        longest = lengths.max(axis=1)
        # Halving shortens edges by up to √2: triangles within this factor are halved together.
        due = np.flatnonzero(longest > max(edge, longest.max() / np.sqrt(2)))
        due = due[np.argsort(-longest[due], kind="stable")][: budget - len(triangles)]
        if len(due) == 0:
            break
        triangles = _halve(triangles, due, lengths[due].argmax(axis=1))
    return triangles


def _halve(triangles: Triangles, which: np.ndarray, corner: np.ndarray) -> Triangles:
    """Halve triangles at the middle of the edges that begin at the given corners."""
    whole = triangles.take(np.concatenate([np.arange(len(triangles)), which]))
    first, second = which, len(triangles) + np.arange(len(which))
    after = (corner + 1) % 3
    corners, normals = whole.corners.copy(), whole.normals.copy()
    for values in (corners, normals):
        middle = (values[first, corner] + values[first, after]) / 2
        if values is normals:
            length = np.linalg.norm(middle, axis=1, keepdims=True)
            middle /= np.where(length > 0, length, 1)
        values[first, after] = values[second, corner] = middle
    return replace(whole, corners=corners, normals=normals)
