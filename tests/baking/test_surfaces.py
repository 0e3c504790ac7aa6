"""Which surfaces are baked, and which side of them."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.surfaces import read_surfaces
from gpf.core.structs import from_numpy, to_numpy
from tests.baking.known_light import DIFFUSE, on_triangles

KINDS = ("rectangle", "cube", "sphere", "cylinder", "disk")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_points_lie_on_the_shape_and_normals_are_those_of_its_lit_side(kind, flipped, mirrored):
    turned = mi.ScalarTransform4f().translate([3, 1, 2]).rotate([1 / 3, 2 / 3, 2 / 3], 50)
    scale = [-0.5, 0.5, 0.5] if mirrored else 0.5
    to_world = turned @ mi.ScalarTransform4f().scale(scale)
    shape = {"type": kind, "flip_normals": flipped, "to_world": to_world, "bsdf": DIFFUSE}
    scene = mi.load_dict({"type": "scene", "shape": shape})
    (surface,), left_out = read_surfaces(scene)
    assert not left_out
    p, n = surface.at(*on_triangles(surface, 200, np.random.default_rng(0)))
    ray = mi.Ray3f(from_numpy(mi.Point3f, p + 0.01 * n), from_numpy(mi.Vector3f, -n))
    si = scene.ray_intersect(ray)
    assert np.abs(to_numpy(si.p) - p).max() < 1e-4
    assert (to_numpy(mi.Vector3f(si.sh_frame.n)) * n).sum(axis=1).min() > 0.999
    # The triangles are counter-clockwise as seen from there.
    faces = np.arange(len(surface.faces))
    _, middle = surface.at(faces, np.full((len(faces), 3), 1 / 3))
    assert (surface.face_normals * middle).sum(axis=1).min() > 0.99
    if surface.normals is not None:
        assert (surface.normals[surface.faces[:, 0]] * middle).sum(axis=1).min() > 0.9


def test_what_has_no_diffuse_light_or_no_triangles_is_left_out(tmp_path):
    (tmp_path / "line.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    inner = {"type": "shapegroup", "inner": {"type": "cube", "bsdf": DIFFUSE}}
    scene = mi.load_dict(
        {
            "type": "scene",
            "pane": {"type": "rectangle", "bsdf": {"type": "dielectric"}},
            "group": inner,
            "copy": {"type": "instance", "group": {"type": "ref", "id": "group"}},
            "wall": {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": DIFFUSE}},
            "line": {"type": "obj", "filename": f"{tmp_path}/line.obj", "bsdf": DIFFUSE},
            "plastic": {"type": "sphere", "bsdf": {"type": "plastic"}},
        }
    )
    surfaces, left_out = read_surfaces(scene)
    assert {s.name: s.two_sided for s in surfaces} == {"wall": True, "plastic": False}
    assert left_out == {
        "copy": "shapes of type Instance are not supported",
        "line": "it has no area",
        "pane": "it has no diffuse component",
    }


def test_names_are_unique():
    scene = mi.load_dict({"type": "scene", "a": {"type": "sphere"}, "b": {"type": "sphere"}})
    for shape in scene.shapes():
        shape.set_id("ball")
    assert [surface.name for surface in read_surfaces(scene)[0]] == ["ball", "ball (2)"]
