"""Light-map coordinates: every triangle has a place of its own."""

from __future__ import annotations

import sys

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking import atlas
from gpf.baking.atlas import unwrap
from gpf.baking.surfaces import read_surfaces
from gpf.baking.texels import REACH, nearest_points
from gpf.baking.xatlas_process import Mesh, flatten
from gpf.core.errors import UserError
from tests.baking.known_light import DIFFUSE, solid_scene


@pytest.fixture(scope="module")
def scene():
    return solid_scene()


@pytest.fixture(params=[atlas.AT_ONCE, 300])
def in_pieces(request, monkeypatch):
    """Surfaces in one piece, and in several."""
    monkeypatch.setattr(atlas, "AT_ONCE", request.param)


@pytest.mark.usefixtures("in_pieces")
@pytest.mark.parametrize(("size", "density"), [(256, None), (None, 41.5)])
def test_the_triangles_are_those_of_the_surfaces(scene, size, density):
    surfaces, _ = read_surfaces(scene)
    page = unwrap(surfaces, size, density)
    if size:
        assert page.size == (size, size)
    for chart in page.charts:
        surface = chart.surface
        corners = surface.points[chart.vertices][chart.faces]
        np.testing.assert_array_equal(corners, surface.corners)
        assert chart.uv.min() >= 0 and chart.uv.max() <= 1
        # Charts are stretched to whole texels.
        texels = chart.uv[chart.faces] * page.size
        ratio = areas(texels).sum() / areas(corners).sum() / page.texels_per_unit**2
        assert ratio == pytest.approx(1, abs=0.15)


def areas(corners: np.ndarray) -> np.ndarray:
    sides = np.pad(corners[:, 1:] - corners[:, :1], ((0, 0), (0, 0), (0, 3 - corners.shape[2])))
    return np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2


@pytest.mark.usefixtures("in_pieces")
def test_charts_are_apart(scene):
    """Points on a triangle are not on another, nor near one of another chart."""
    surfaces, _ = read_surfaces(scene)
    page = unwrap(surfaces, 192)
    triangles = page.triangles
    rng = np.random.default_rng(0)
    owner = rng.integers(0, len(triangles), 300)
    inside = 0.9 * rng.dirichlet([1, 1, 1], 300) + 0.1 / 3
    q = np.einsum("pk,pki->pi", inside, triangles[owner])
    label = parts(triangles)
    for point, own in zip(q, owner, strict=True):
        _, distance = nearest_points(triangles, np.tile(point, (len(triangles), 1)))
        assert distance[np.arange(len(triangles)) != own].min() > 0
        assert distance[label != label[own]].min() > 2 * REACH


def parts(triangles: np.ndarray) -> np.ndarray:
    """The chart of each triangle: triangles with common corners."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corner = np.unique(triangles.reshape(-1, 2).round(3), axis=0, return_inverse=True)[1].ravel()
    owner = np.repeat(np.arange(len(triangles)), 3)
    shape = (len(triangles), corner.max() + 1)
    touches = coo_array((np.ones(len(owner)), (owner, corner)), shape).tocsr()
    return connected_components(touches @ touches.T)[1]


@pytest.mark.parametrize("scale", [1e-5, 1e5])
def test_units_do_not_matter(scale):
    parts = []
    for size in (1, scale):
        ball = {"type": "sphere", "radius": size, "bsdf": DIFFUSE}
        surfaces, _ = read_surfaces(mi.load_dict({"type": "scene", "ball": ball}))
        parts.append(unwrap(surfaces, 256))
    usual, other = parts
    assert other.texels_per_unit * scale == pytest.approx(usual.texels_per_unit, rel=0.1)
    ratio = areas(other.triangles) / areas(usual.triangles)
    assert ratio.min() > 0.5 and ratio.max() < 2


def test_triangles_without_area_stay(tmp_path):
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nv 0.5 0 0\n"
    (tmp_path / "a.obj").write_text(f"{corners}f 1 2 3\nf 1 5 2\nf 2 2 4\nf 2 4 3\n")
    shape = {"type": "obj", "filename": str(tmp_path / "a.obj"), "bsdf": DIFFUSE}
    surfaces, _ = read_surfaces(mi.load_dict({"type": "scene", "shape": shape}))
    page = unwrap(surfaces, 64)
    (chart,) = page.charts
    np.testing.assert_array_equal(
        chart.surface.points[chart.vertices][chart.faces], chart.surface.corners
    )
    assert (areas(page.triangles) > 1).tolist() == [True, False, False, True]


def test_a_ball_is_not_cut_at_its_poles():
    ball = {"type": "sphere", "radius": 0.4, "bsdf": DIFFUSE}
    surfaces, _ = read_surfaces(mi.load_dict({"type": "scene", "ball": ball}))
    assert parts(unwrap(surfaces, 256).triangles).max() + 1 < 15


def test_a_page_that_is_too_small_or_too_large(scene):
    surfaces, _ = read_surfaces(scene)
    with pytest.raises(UserError, match=r"--size 16: is too small for the \d+ parts"):
        unwrap(surfaces, 16)
    for density in (1e5, 1e30):
        with pytest.raises(UserError, match="the largest map has 16384x16384"):
            unwrap(surfaces, None, density)


def test_without_xatlas(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "xatlas", None)
    with pytest.raises(UserError, match="pip install xatlas"):
        unwrap(read_surfaces(scene)[0], 64)


def test_what_xatlas_refuses():
    mesh = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 3]], np.uint32))
    with pytest.raises(UserError, match=r"xatlas: failed: .*[Ii]ndex out of range"):
        flatten([mesh], 64)
