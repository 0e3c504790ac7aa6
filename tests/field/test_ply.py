"""Splats: what a reader that knows nothing of this project finds in the file."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gpf.core.images import tone_map
from gpf.field.io import StoredField
from gpf.field.ply import (
    NARROWING,
    OPACITY,
    THICKNESS,
    flatten,
    propose_exposure,
    write_splats,
)
from gpf.field.settings import FieldSettings
from tests.plain_field import PlainGaussians, random_gaussians

# As the readers of PlayCanvas and three.js ask for them by name, in the order of the first program.
VIEWERS_EXPECT = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
]


def read_ply(path) -> np.ndarray:
    """A PLY reader after the format's description: any float32 vertex properties."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    lines = data[:end].decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    element, kind, count = lines[2].split()
    assert (element, kind) == ("element", "vertex")
    properties = [line.split() for line in lines[3:-1]]
    assert all(words[:2] == ["property", "float"] for words in properties)
    table = np.frombuffer(data[end:], np.dtype([(words[2], "<f4") for words in properties]))
    assert len(table) == int(count)
    return table


def stored(g: PlainGaussians, **settings) -> StoredField:
    names = ("means", "log_scales", "quats", "irradiance", "normals")
    tensors = {name: getattr(g, name).astype(np.float32) for name in names}
    return StoredField(
        tensors, FieldSettings(search_radius=0.2, **settings), [[0, 0, 0], [1, 1, 1]], {}
    )


def columns(table: np.ndarray, *names: str) -> np.ndarray:
    return np.stack([table[name] for name in names], axis=1).astype(float)


@pytest.fixture
def gaussians() -> PlainGaussians:
    return random_gaussians(np.random.default_rng(2), 13)


@pytest.mark.parametrize("stores", ["irradiance", "radiance"])
def test_a_viewer_shows_the_light_on_white_surfaces(tmp_path, gaussians, stores):
    field = stored(gaussians, stores=stores)
    write_splats(tmp_path / "deep" / "splats.ply", field, exposure=0.7)
    table = read_ply(tmp_path / "deep" / "splats.ply")
    assert list(table.dtype.names) == VIEWERS_EXPECT
    np.testing.assert_allclose(columns(table, *"xyz"), gaussians.means, rtol=1e-6)
    np.testing.assert_allclose(columns(table, "nx", "ny", "nz"), gaussians.normals, rtol=1e-6)
    # As viewers decode it.
    shown = 0.5 + np.sqrt(1 / (4 * np.pi)) * columns(table, "f_dc_0", "f_dc_1", "f_dc_2")
    radiance = gaussians.irradiance / (np.pi if stores == "irradiance" else 1)
    np.testing.assert_allclose(shown, tone_map(radiance, 0.7), atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-table["opacity"])), OPACITY, rtol=1e-5)


def test_splats_are_slices_of_the_gaussians(tmp_path, gaussians):
    """Σ⁻¹ is that of the Gaussian along the surface, widened by the narrowing."""
    write_splats(tmp_path / "splats.ply", stored(gaussians), exposure=1)
    table = read_ply(tmp_path / "splats.ply")
    wxyz = columns(table, "rot_0", "rot_1", "rot_2", "rot_3")
    np.testing.assert_allclose(np.linalg.norm(wxyz, axis=1), 1, rtol=1e-6)
    axes = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    extents = np.exp(columns(table, "scale_0", "scale_1", "scale_2"))
    np.testing.assert_allclose(axes[:, :, 2], gaussians.normals, atol=1e-5)
    np.testing.assert_allclose(extents[:, 2], THICKNESS * extents[:, :2].min(axis=1), rtol=1e-5)
    rng = np.random.default_rng(3)
    for i, rows in enumerate(gaussians.rows()):
        n = gaussians.normals[i]
        d = rng.normal(size=(20, 3))
        d -= np.outer(d @ n, n) / (n @ n)
        splat = (((d @ axes[i]) / extents[i]) ** 2).sum(axis=1)
        gaussian = ((d @ rows.T) ** 2).sum(axis=1)
        np.testing.assert_allclose(splat * NARROWING**2, gaussian, rtol=1e-3)


def test_a_needle_that_stands_on_the_surface_becomes_a_dot():
    """What it is above the surface, no query sees."""
    log_scales = np.log([[0.01, 0.02, 5.0], [0.01, 5.0, 0.02]])
    identity = np.array([[0.0, 0, 0, 1]] * 2)
    flat, wxyz = flatten(log_scales, identity, np.array([[0.0, 0, 1]] * 2))
    np.testing.assert_allclose(np.exp(flat[:, :2]), [[0.01, 0.02], [0.01, 5]], rtol=1e-9)
    axes = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(np.abs(axes), [np.eye(3)] * 2, atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(axes), 1)


def test_the_proposed_exposure_shows_the_median_as_middle_grey(gaussians):
    g = gaussians
    assert propose_exposure(stored(g)) * np.median(g.irradiance.mean(1)) / np.pi == pytest.approx(
        0.18, rel=1e-5
    )
    g.irradiance[:10] = 0  # what is in the dark does not count
    lit = np.median(g.irradiance[10:].mean(1))
    assert propose_exposure(stored(g)) * lit / np.pi == pytest.approx(0.18, rel=1e-5)
    g.irradiance[:] = 0
    assert propose_exposure(stored(g)) == 1
