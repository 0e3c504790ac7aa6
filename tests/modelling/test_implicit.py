"""Meshes of level sets: closed, on the surface, facing outwards; roundings where solids meet."""

from collections import Counter

import numpy as np
import pytest

from scenes.modelling.implicit import intersection, polygonize, spaced, union

CENTRE = np.array([0.11, -0.23, 0.37])


def ball(x, y, z, radius=0.5):
    return np.sqrt((x - CENTRE[0]) ** 2 + (y - CENTRE[1]) ** 2 + (z - CENTRE[2]) ** 2) - radius


def axes(cell=0.06):
    # As long as the ball needs along each axis; finer along the last one.
    return spaced(-0.6, (0.8, cell)), spaced(-0.95, (0.5, cell)), spaced(-0.3, (1.1, 0.7 * cell))


def volume(mesh):
    a, b, c = (mesh.points[mesh.faces[:, i]] for i in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def test_ball_is_closed_and_lies_on_the_surface():
    mesh = polygonize(ball, axes())
    edges = Counter((int(f[i]), int(f[(i + 1) % 3])) for f in mesh.faces for i in range(3))
    assert max(edges.values()) == 1
    assert all(edge[::-1] in edges for edge in edges)
    assert len(mesh.points) - len(edges) // 2 + len(mesh.faces) == 2
    assert np.abs(ball(*mesh.points.T)).max() < 1e-6
    radial = (mesh.points - CENTRE) / 0.5
    assert np.abs(mesh.normals - radial).max() < 1e-4
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi * 0.5**3, rel=0.01)


def test_hollow_ball_has_the_volume_of_its_wall():
    def wall(x, y, z):
        return np.maximum(ball(x, y, z), -ball(x, y, z, radius=0.3))

    expected = 4 / 3 * np.pi * (0.5**3 - 0.3**3)
    assert volume(polygonize(wall, axes())) == pytest.approx(expected, rel=0.01)


def test_spaced_planes_keep_their_distances():
    assert spaced(0, (0.5, 0.2), (1, 0.25)) == pytest.approx([0, 0.2, 0.4, 0.65, 0.9])


def test_roundings_are_a_quarter_of_the_fillet_deep_and_end():
    assert union(np.array(0.0), np.array(0.0), fillet=0.4) == pytest.approx(-0.1)
    assert intersection(np.array(0.0), np.array(0.0), fillet=0.4) == pytest.approx(0.1)
    assert union(np.array(1.0), np.array(0.5), fillet=0.4) == 0.5
    assert intersection(np.array(1.0), np.array(0.5), fillet=0.4) == 1.0
