"""The baked light is that of the field and of the lamps that the field leaves out."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.atlas import unwrap
from gpf.baking.bake import bake_maps, bake_vertices, surfaces_to_bake
from gpf.baking.surfaces import Surface
from gpf.core.errors import UserError
from gpf.core.structs import to_numpy
from gpf.field.lights import FieldLights
from gpf.scene.light_groups import LightGroups
from tests.baking.known_light import (
    DIFFUSE,
    field_with,
    from_lamp,
    lamp_scene,
    lamp_scene_parts,
    looked_up,
    on_triangles,
    solid_scene,
)


def dark(p: np.ndarray) -> np.ndarray:
    return np.zeros((len(p), 3))


def on_edges(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Triangles and barycentric coordinates along all of their edges."""
    along = np.linspace(0, 1, 21)
    edge = np.stack([along, 1 - along, 0 * along], axis=1)
    weights = np.concatenate([np.roll(edge, k, axis=1) for k in range(3)])
    count = len(surface.faces)
    return np.repeat(np.arange(count), len(weights)), np.tile(weights, (count, 1))


def test_no_seams():
    """Under the same light everywhere, lookups on all edges of all triangles find it."""
    scene = solid_scene()
    field = field_with(scene, lambda p: np.full((len(p), 3), [1.0, 2.0, 3.0]))
    surfaces, _ = surfaces_to_bake(scene)
    baked = bake_maps(scene, field, unwrap(surfaces, 128))
    for surface in surfaces:
        found = looked_up(baked.atlas, baked.maps[""], surface.name, *on_edges(surface))
        np.testing.assert_allclose(found, np.tile([1.0, 2.0, 3.0], (len(found), 1)), rtol=1e-4)


def test_no_dark_corners_in_a_room():
    """Rays to a lamp start beside the walls, not in them."""
    turned = mi.ScalarTransform4f().rotate([1 / 3, 2 / 3, 2 / 3], 20).scale([3, 2, 4])
    room = {"type": "cube", "to_world": turned, "flip_normals": True, "bsdf": DIFFUSE}
    lamp = lamp_scene_parts()["lamp"]
    scene = mi.load_dict({"type": "scene", "room": room, "lamp": lamp})
    field = field_with(scene, dark, direct=(0,))
    (surface,), _ = surfaces_to_bake(scene)
    baked = bake_maps(scene, field, unwrap([surface], 200), samples=1)
    faces, weights = on_edges(surface)
    found = looked_up(baked.atlas, baked.maps[""], surface.name, faces, weights)
    expected = from_lamp(*surface.at(faces, weights))
    assert expected.min() > 0.001
    assert np.abs(found / expected - 1).max() < 0.02


def test_a_lamp_that_the_field_leaves_out():
    """E = I cos / r² on a floor and on a ball, whose triangles lie beneath its surface."""
    scene = lamp_scene()
    field = field_with(scene, dark, direct=(0,))
    surfaces, _ = surfaces_to_bake(scene)
    baked = bake_maps(scene, field, unwrap(surfaces, 256), samples=1)
    rng = np.random.default_rng(1)
    for surface in surfaces:
        faces, weights = on_triangles(surface, 2000, rng)
        found = looked_up(baked.atlas, baked.maps[""], surface.name, faces, weights)
        expected = from_lamp(*surface.at(faces, weights))
        assert np.abs(found - expected).max() < 0.02 * expected.max()
        assert np.abs(found - expected).mean() < 0.002 * expected.max()


def test_light_at_vertices():
    cube = {"type": "cube", "face_normals": True, "bsdf": DIFFUSE}
    cube["to_world"] = mi.ScalarTransform4f().translate([9, 0, -1]).scale(0.2)
    scene = lamp_scene(cube=cube)
    field = field_with(scene, lambda p: np.ones((len(p), 3)), direct=(0,))
    surfaces, _ = surfaces_to_bake(scene)
    lit = bake_vertices(scene, field, surfaces, samples=1)
    named = {part.surface.name: part for part in lit}
    assert set(named) == {"floor", "ball", "cube"}
    assert len(named["cube"].vertices) == 36 == len(np.unique(named["cube"].faces))
    for part in lit:
        surface = part.surface
        np.testing.assert_array_equal(surface.points[part.vertices][part.faces], surface.corners)
        normals = np.repeat(surface.face_normals, 3, axis=0)
        if surface.normals is not None:
            normals = surface.normals[part.vertices[part.faces.ravel()]]
        expected = 1 + from_lamp(surface.points[part.vertices[part.faces.ravel()]], normals)
        found = part.light[""][part.faces.ravel()]
        assert np.abs(found - expected).max() < 0.04 * expected.max()


def grouped(scene: mi.Scene):
    """A field with the light of a lamp and a sky apart; samples bring the lamp's direct light."""
    groups = LightGroups.each(scene)
    field = field_with(scene, lambda p: 2 + np.sin(3 * p), direct=(groups.names.index("lamp"),))
    total = to_numpy(field.gaussians.irradiance)
    share = np.random.default_rng(2).uniform(0, 1, total.shape).astype(np.float32)
    field.lights = FieldLights(groups, np.stack([share * total, (1 - share) * total]))
    return field


def test_groups_add_up_to_the_whole():
    scene = lamp_scene(sky={"type": "constant"})
    field = grouped(scene)
    surfaces, _ = surfaces_to_bake(scene)
    atlas = unwrap(surfaces, 96)
    apart = bake_maps(scene, field, atlas, samples=1).maps
    names = field.lights.groups.names
    assert set(apart) == {"", *names} and len(names) == 2
    field.lights = None
    (whole,) = bake_maps(scene, field, atlas, samples=1).maps.values()
    scale = whole.max()
    assert np.abs(apart[names[0]] + apart[names[1]] - whole).max() < 1e-5 * scale
    assert np.abs(apart[""] - whole).max() < 1e-5 * scale
    assert min(apart[name].mean() for name in names) > 0.1 * whole.mean()


def test_a_field_keeps_its_colours():
    scene = lamp_scene(sky={"type": "constant"})
    field = grouped(scene)
    before = to_numpy(field.gaussians.irradiance)
    surfaces, _ = surfaces_to_bake(scene)
    bake_vertices(scene, field, surfaces, samples=1)
    np.testing.assert_array_equal(to_numpy(field.gaussians.irradiance), before)


def test_what_cannot_be_baked():
    glass = {"type": "scene", "pane": {"type": "rectangle", "bsdf": {"type": "dielectric"}}}
    with pytest.raises(UserError, match="no diffuse surface"):
        surfaces_to_bake(mi.load_dict(glass))
    scene = lamp_scene()
    field = field_with(scene, dark)
    field.settings = field.settings.model_copy(update={"stores": "radiance"})
    surfaces, _ = surfaces_to_bake(scene)
    with pytest.raises(UserError, match="stores radiance"):
        bake_vertices(scene, field, surfaces)
    other = grouped(lamp_scene(sky={"type": "constant"}))
    with pytest.raises(UserError, match="belong to another scene"):
        bake_vertices(scene, other, surfaces)
