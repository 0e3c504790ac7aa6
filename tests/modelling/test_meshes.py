"""Meshes: closed, outwards, with the normals and the bytes that they should have."""

import mitsuba as mi
import numpy as np
import pytest

from gpf.modelling.meshes import Mesh, box, grid, join, lathe, quad, write_ply


def volume(mesh: Mesh) -> float:
    """Signed: positive where faces are counter-clockwise from outside."""
    a, b, c = (mesh.points[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def is_closed(mesh: Mesh) -> bool:
    """Every edge is there once in each direction, whichever points meet in a place."""
    _, place = np.unique(np.round(mesh.points, 6), axis=0, return_inverse=True)
    f = place.reshape(-1)[mesh.faces]
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    forth = sorted(map(tuple, edges.tolist()))
    back = sorted(map(tuple, edges[:, ::-1].tolist()))
    return forth == back


def ball(segments: int = 64) -> Mesh:
    turn = np.linspace(0, np.pi, segments // 2)
    profile = np.stack([np.sin(turn), -np.cos(turn)], axis=1)
    profile[[0, -1], 0] = 0
    return lathe(profile, segments)


def test_a_box_is_closed_and_outwards():
    made = box((1, 2, 3), (2, 4, 6))
    assert is_closed(made) and volume(made) == pytest.approx(6)
    assert made.uv is not None and made.uv.min() == 0 and made.uv.max() == 1


def test_a_turned_profile_is_closed_and_outwards():
    made = ball()
    assert is_closed(made)
    assert volume(made) == pytest.approx(4 / 3 * np.pi, rel=0.01)
    normals = made.smooth().normals
    assert normals is not None and np.abs(normals - made.points).max() < 0.05


def test_a_quad_faces_right_cross_up():
    made = quad((0, 0, 0), (2, 0, 0), (0, 3, 0))
    a, b, c = (made.points[made.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


def test_transformed_normals_stay_normal():
    turned = ball(256).smooth().transformed(np.diag([1, 3, 0.5, 1]) + np.eye(4, k=3) * 2)
    p = (turned.points - [2, 0, 0]) / [1, 3, 0.5]
    expected = p / [1, 3, 0.5]
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    off = np.abs(turned.normals - expected)
    assert np.median(off) < 2e-4 and off.max() < 0.03  # the worst is beside the poles


def test_joined_meshes_have_all_or_none():
    both = join([box((0, 0, 0), (1, 1, 1)), box((2, 0, 0), (3, 1, 1))])
    assert is_closed(both) and volume(both) == pytest.approx(2)
    with pytest.raises(ValueError, match="some of the meshes have uv, others do not"):
        join([box((0, 0, 0), (1, 1, 1)), ball()])


def test_mitsuba_reads_what_is_written(tmp_path):
    rows = np.array([[[0, 0, 0], [1, 0, 0]], [[0, 2, 0], [1, 2, 0.1234567]]], dtype=float)
    uv = np.array([[[0, 0], [1, 0]], [[0, 1], [1, 1]]], dtype=float)
    path = write_ply(tmp_path / "deep/skin.ply", grid(rows, uv=uv).smooth())
    again = path.read_bytes()
    assert write_ply(path, grid(rows, uv=uv).smooth()).read_bytes() == again
    loaded = mi.load_dict({"type": "ply", "filename": str(path)})
    assert (loaded.vertex_count(), loaded.face_count()) == (4, 2)
    assert loaded.has_vertex_normals() and loaded.has_vertex_texcoords()
    values = mi.traverse(loaded)
    positions = np.array(values["vertex_positions"]).reshape(-1, 3)
    np.testing.assert_allclose(positions, np.round(rows.reshape(-1, 3), 6), atol=1e-7)
    np.testing.assert_allclose(
        np.array(values["vertex_texcoords"]).reshape(-1, 2), uv.reshape(-1, 2)
    )
