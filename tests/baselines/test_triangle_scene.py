"""Scenes as triangles: shapes, materials, and how many triangles there are."""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from baselines.protocol import CannotServe
from baselines.renderformer.triangle_budget import fit_budget, shade, simplify, subdivide
from baselines.renderformer.triangle_materials import read_material
from baselines.renderformer.triangle_scene import (
    Surface,
    Triangles,
    join_triangles,
    read_surfaces,
)
from baselines.translation.meshes import facet_normals, read_mesh
from gpf.core.structs import from_numpy
from gpf.modelling.meshes import Mesh
from tests.furnace import diffuse, floor, lamp, rgb

needs_simplification = pytest.mark.skipif(
    importlib.util.find_spec("fast_simplification") is None,
    reason="fast-simplification is not installed",
)


def load(**objects: Any) -> list[Surface]:
    return read_surfaces(mi.load_dict({"type": "scene"} | objects, optimize=False), "scene.xml")


def areas(corners: np.ndarray) -> np.ndarray:
    a, b, c = corners.transpose(1, 0, 2)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize(
    ("shape", "count", "area"),
    [
        ({"type": "rectangle"}, 2, 4),
        ({"type": "cube"}, 12, 24),
        ({"type": "disk"}, 24, np.pi),
        ({"type": "cylinder"}, 48, 2 * np.pi),
        ({"type": "sphere"}, 528, 4 * np.pi),
    ],
)
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("scale", [(0.5, 0.5, 0.5), (-0.5, 0.5, 0.5)])
def test_shapes_become_triangles_that_face_where_the_shape_does(
    shape: dict[str, Any], count: int, area: float, flipped: bool, scale: tuple[float, ...]
) -> None:
    if shape["type"] == "cylinder":  # of mirrored ones, Mitsuba itself says this and that
        scale = (0.5, 0.5, 0.5)
    to_world = mi.ScalarTransform4f().translate([3, 1, -2]) @ mi.ScalarTransform4f().scale(scale)
    loaded = mi.load_dict(shape | {"to_world": to_world, "flip_normals": flipped})
    mesh = read_mesh(loaded, "scene.xml")
    assert len(mesh.faces) == count
    np.testing.assert_allclose(areas(mesh.points[mesh.faces]).sum(), area / 4, rtol=0.02)
    facets = facet_normals(mesh)
    if mesh.normals is not None:
        assert ((mesh.normals[mesh.faces] * facets[:, None]).sum(axis=2) > 0.9).all()
    # Seen from where a facet looks, Mitsuba's own normal looks the same way.
    eyes = mesh.points[mesh.faces].mean(axis=1) + 0.1 * facets
    scene = mi.load_dict({"type": "scene", "shape": loaded})
    si = scene.ray_intersect(
        mi.Ray3f(from_numpy(mi.Point3f, eyes), from_numpy(mi.Vector3f, -facets))
    )
    assert ((np.array(si.sh_frame.n).T * facets).sum(axis=1) > 0.9).all()
    np.testing.assert_allclose(np.array(si.t), 0.1, atol=0.02)


def test_what_triangles_cannot_be_made_of_is_refused() -> None:
    group = {"type": "shapegroup", "id": "group", "cube": {"type": "cube"}}
    with pytest.raises(CannotServe, match="shapes of type Instance.*Replace it"):
        load(group=group, copy={"type": "instance", "group": {"type": "ref", "id": "group"}})


@pytest.mark.parametrize(
    ("bsdf", "expected_diffuse", "specular", "roughness"),
    [
        (diffuse(0.1, 0.2, 0.3), (0.1, 0.2, 0.3), 0, 0.99),
        ({"type": "twosided", "b": diffuse(0.4)}, (0.4, 0.4, 0.4), 0, 0.99),
        (
            {"type": "plastic", "int_ior": 1.5, "diffuse_reflectance": rgb(0.1, 0.2, 1)},
            (0.1, 0.2, 0.96),
            0.04,
            0.01,
        ),
        (
            {"type": "roughplastic", "int_ior": 1.5, "alpha": 0.25, "specular_reflectance": 0.5},
            (0.5, 0.5, 0.5),
            0.02,
            0.5,
        ),
        ({"type": "conductor", "material": "none"}, (0, 0, 0), 1, 0.01),
        (
            {"type": "roughconductor", "eta": 2, "k": 1, "alpha_u": 0.2, "alpha_v": 0.3},
            (0, 0, 0),
            0.2,
            0.5,
        ),
    ],
)
def test_materials_become_a_colour_a_gloss_and_a_roughness(
    bsdf: dict[str, Any], expected_diffuse: tuple[float, ...], specular: float, roughness: float
) -> None:
    material = read_material(mi.load_dict(bsdf), "scene.xml")
    np.testing.assert_allclose(material.diffuse, expected_diffuse, atol=1e-4)
    np.testing.assert_allclose(material.specular, np.full(3, specular), atol=1e-4)
    assert material.roughness == pytest.approx(roughness, abs=1e-4)


def test_two_different_sides_are_refused() -> None:
    sides = {"type": "twosided", "front": diffuse(0.1), "back": diffuse(0.9)}
    with pytest.raises(CannotServe, match="type TwoSidedBRDF with two"):
        read_material(mi.load_dict(sides), "scene.xml")


def test_lamps_keep_their_radiance_and_everything_stays_in_order() -> None:
    surfaces = load(
        ground=floor(diffuse(0.5)),
        light=lamp((0, 0, 2), (0, 0, 0), 0.5, 3, 2, 1),
        box={"type": "cube"},
    )
    surfaces.sort(key=lambda surface: surface.name)
    triangles = join_triangles(surfaces)
    assert [surface.name for surface in surfaces] == ["box", "ground", "light"]
    assert len(triangles) == 16
    np.testing.assert_array_equal(np.flatnonzero(triangles.glow), [14, 15])
    np.testing.assert_allclose(triangles.radiance[14], [3, 2, 1], rtol=1e-6)
    np.testing.assert_allclose(triangles.normals[12:14, :, 2], 1)
    np.testing.assert_allclose(np.linalg.norm(triangles.normals, axis=2), 1, rtol=1e-5)


def test_large_facets_are_halved_until_they_are_small_or_too_many() -> None:
    surfaces = load(ground=floor(diffuse(0.5), size=2), light=lamp((0, 0, 2), (0, 0, 0), 1, 5))
    whole = join_triangles(surfaces)
    # A bent normal, to be interpolated.
    tilted = whole.normals.copy()
    ground = int(np.flatnonzero(~whole.glow)[0])
    tilted[ground, 1] = [0.6, 0, 0.8]
    whole = replace(whole, normals=tilted)
    fine = subdivide(whole, 0.8, 1000)
    lengths = np.linalg.norm(np.roll(fine.corners, -1, axis=1) - fine.corners, axis=2).max(axis=1)
    assert lengths[~fine.glow].max() <= 0.8 and fine.glow.sum() == 2
    assert len(fine) == 2 + 32  # legs of ½: each half of the square becomes 16
    np.testing.assert_allclose(areas(fine.corners).sum(), 4 + 1, rtol=1e-6)
    np.testing.assert_allclose(facet_normals_of(fine)[~fine.glow], [[0, 0, 1]] * 32, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(fine.normals, axis=2), 1, rtol=1e-6)
    assert len(np.unique(fine.normals[~fine.glow].reshape(-1, 3)[:, 0].round(3))) > 3
    few = subdivide(whole, 0.8, 9)
    assert len(few) == 9
    np.testing.assert_allclose(areas(few.corners).sum(), 5, rtol=1e-6)


def facet_normals_of(triangles: Triangles) -> np.ndarray:
    count = len(triangles)
    return facet_normals(
        Mesh(triangles.corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    )


def test_simplified_meshes_are_smooth_but_for_their_edges() -> None:
    # A roof of 90°, and a plane that meets its left side at 18°.
    points = np.array([[0, -1, 0], [0, 1, 0], [1, -1, -1], [1, 1, -1], [-1, -1, -1], [-1, 1, -1]])
    points = np.concatenate([points, [[-2, -1, -1.5], [-2, 1, -1.5]]]).astype(float)
    faces = np.array([[0, 2, 3], [0, 3, 1], [0, 1, 5], [0, 5, 4], [4, 5, 7], [4, 7, 6]])
    mesh = shade(Mesh(points, faces))
    normals = mesh.normals[mesh.faces]
    right, left = np.array([1, 0, 1]) / np.sqrt(2), np.array([-1, 0, 1]) / np.sqrt(2)
    np.testing.assert_allclose(normals[0], [right] * 3, atol=1e-6)
    far = facet_normals(mesh)[5]
    # Where the planes meet, between the two; at the ridge and at the end, each its own.
    at_joint = normals[3][faces[3].tolist().index(4)]
    assert at_joint @ left > far @ left and at_joint @ far > far @ left
    np.testing.assert_allclose(normals[3][faces[3].tolist().index(0)], left, atol=1e-6)
    np.testing.assert_allclose(normals[5][faces[5].tolist().index(6)], far, atol=1e-6)


@needs_simplification
def test_fine_meshes_are_simplified_by_a_common_factor_and_stay_what_they_were() -> None:
    surfaces = load(
        ball={"type": "sphere", "bsdf": diffuse(0.5)},
        small={"type": "sphere", "radius": 0.5, "center": [3, 0, 0], "bsdf": diffuse(0.2)},
        box={"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, 4, 0])},
        light=lamp((0, 0, 5), (0, 0, 0), 1, 5),
    )
    fitted = {s.name: s.mesh for s in fit_budget(surfaces, 300, "scene.xml")}
    counts = {name: len(mesh.faces) for name, mesh in fitted.items()}
    assert 250 < sum(counts.values()) <= 300
    assert counts["box"] == 12 and counts["light"] == 2
    assert counts["ball"] == pytest.approx(counts["small"], abs=2)
    ball = fitted["ball"]
    assert np.abs(np.linalg.norm(ball.points, axis=1) - 1).max() < 0.15
    assert areas(ball.points[ball.faces]).sum() == pytest.approx(4 * np.pi, rel=0.1)
    assert ball.normals is not None
    away = ball.points / np.linalg.norm(ball.points, axis=1, keepdims=True)
    assert (ball.normals * away).sum(axis=1).min() > 0.8
    assert fit_budget(surfaces, 5000, "scene.xml") == surfaces
    with pytest.raises(CannotServe, match=r"triangles, of which \d+ remain .*; 50 are allowed"):
        fit_budget(surfaces, 50, "scene.xml")


@needs_simplification
def test_facetted_meshes_stay_facetted_and_keep_their_borders() -> None:
    u, v = np.mgrid[0:11, 0:11]
    points = np.stack([u.ravel(), v.ravel(), 0 * u.ravel()], 1) / 10
    corner = (11 * np.arange(10)[:, None] + np.arange(10)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + 11, corner + 12], 1),
            np.stack([corner, corner + 12, corner + 1], 1),
        ]
    )
    # Each face with points of its own, as files often have them.
    split = Mesh(points[faces].reshape(-1, 3), np.arange(600).reshape(-1, 3))
    simple = simplify(split, 60)
    assert simple.normals is None and 2 <= len(simple.faces) <= 60
    assert areas(simple.points[simple.faces]).sum() == pytest.approx(1, rel=1e-6)
    np.testing.assert_allclose(facet_normals(simple)[:, 2], 1, atol=1e-5)


def test_the_command_that_brings_the_missing_package_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "fast_simplification", None)
    surfaces = load(ball={"type": "sphere"}, light=lamp((0, 0, 5), (0, 0, 0), 1, 5))
    with pytest.raises(CannotServe, match="pip install 'fast-simplification"):
        fit_budget(surfaces, 100, "scene.xml")
