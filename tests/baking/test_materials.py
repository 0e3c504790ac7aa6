"""Materials in glTF: their reflectances, roughness and glass are those of Mitsuba's."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from gpf.baking.albedo import read_albedo
from gpf.baking.atlas import unwrap
from gpf.baking.finish import read_finish, read_gloss
from gpf.baking.gltf import Stage, write_glb, write_unlit_glb
from gpf.baking.surfaces import read_specular_surfaces, read_surfaces
from gpf.core.images import undo_tone_map
from tests.baking.glb_file import Read
from tests.baking.known_light import DIFFUSE
from tests.baking.showroom import GOLD


def single(**shape) -> mi.Scene:
    return mi.load_dict({"type": "scene", "it": {"type": "rectangle", **shape}})


@pytest.mark.parametrize("wrap", ["repeat", "mirror", "clamp"])
def test_an_image_keeps_its_own_resolution(wrap):
    pixels = np.random.default_rng(0).uniform(0, 1, (7, 9, 3)).astype(np.float32)
    image = {"type": "bitmap", "data": mi.TensorXf(pixels), "raw": True, "wrap_mode": wrap}
    image["to_uv"] = mi.ScalarTransform4f().rotate([0, 0, 1], 20).scale([3, 2, 1])
    (surface,), _ = read_surfaces(single(bsdf={"type": "diffuse", "reflectance": image}))
    albedo = read_albedo(surface)
    assert albedo.wrap == wrap and albedo.image.shape == pixels.shape
    np.testing.assert_allclose(albedo.factor, 1, atol=1e-3)
    assert np.abs(undo_tone_map(albedo.image / 255) - pixels).max() < 0.006


def test_what_is_no_single_image_is_baked():
    squares = {"type": "diffuse", "reflectance": {"type": "checkerboard"}}
    (surface,), _ = read_surfaces(single(bsdf=squares))
    assert read_albedo(surface) is None
    (surface,), _ = read_surfaces(single(bsdf=DIFFUSE))
    albedo = read_albedo(surface)
    assert albedo.image is None
    np.testing.assert_allclose(albedo.factor, [0.5, 0.4, 0.3], rtol=1e-5)


def finish(**bsdf):
    (surface,) = read_specular_surfaces(single(bsdf=bsdf))
    return read_finish(surface)


def test_finishes():
    mirror = finish(type="conductor", material="none")
    assert (mirror.colour > 0.99).all() and mirror.roughness == 0 and not mirror.transmits
    pane = finish(type="thindielectric", int_ior=1.5, ext_ior=1.0)
    assert pane.transmits and not pane.bends
    tinted = finish(
        type="roughdielectric", alpha=0.04, specular_transmittance=0.5, int_ior=1.3, ext_ior=1.0
    )
    assert tinted.bends and tinted.roughness == pytest.approx(0.2)
    np.testing.assert_allclose(tinted.colour, 0.5, atol=0.03)
    inside = finish(type="dielectric", int_ior=1.0, ext_ior=1.5)
    assert inside.ior == pytest.approx(1.5, abs=1e-4)
    squares = {"type": "checkerboard", "color0": 0.2, "color1": 0.9}
    floor = finish(type="conductor", material="none", specular_reflectance=squares)
    assert floor.colour.ndim == 3
    np.testing.assert_allclose(
        floor.colour[[100, 100, 400], [100, 400, 400], 0], [0.2, 0.9, 0.2], atol=0.01
    )


def test_water_is_darker_than_what_is_in_it():
    """Radiance falls by the square of the index of refraction where light leaves the water."""
    over = mi.ScalarTransform4f().translate([0, 0, 0.4])
    water = {
        "type": "rectangle",
        "to_world": over,
        "bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    }
    scene = mi.load_dict(
        {"type": "scene", "water": water, "floor": {"type": "rectangle", "bsdf": DIFFUSE}}
    )
    baked_floor = read_surfaces(scene)[0]
    stage = Stage(scene, unwrap(baked_floor, 32), read_specular_surfaces(scene), [], 1)
    file = Read(write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1))
    _, _, material = file.part("water")
    assert material["pbrMetallicRoughness"]["baseColorFactor"][0] == pytest.approx(
        1 / 2.25, abs=0.01
    )
    assert material["extensions"]["KHR_materials_volume"]["thicknessFactor"] == pytest.approx(
        0.4, abs=1e-3
    )


def test_a_metal_that_is_principled_is_no_black_surface():
    metal = {"type": "separable_principled", "metallic": 1.0, "roughness": 0.25}
    metal["base_color"] = {"type": "rgb", "value": [0.9, 0.6, 0.3]}
    scene = single(bsdf=metal)
    (surface,), _ = read_surfaces(scene)
    assert read_gloss(surface) == 0.25
    stage = Stage(scene, unwrap([surface], 32), [], [], 1)
    _, _, material = Read(write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1)).part("it")
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 1
    np.testing.assert_allclose(
        material["pbrMetallicRoughness"]["baseColorFactor"][:3], [0.9, 0.6, 0.3], atol=0.1
    )


def test_a_luminous_metal():
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [4.0, 2.0, 1.0]}}
    hot = {"type": "rectangle", "bsdf": GOLD, "emitter": glow}
    scene = mi.load_dict({"type": "scene", "hot": hot, "floor": {"type": "disk", "bsdf": DIFFUSE}})
    stage = Stage(scene, unwrap(read_surfaces(scene)[0], 32), read_specular_surfaces(scene), [], 1)
    _, _, material = Read(write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1.5)).part("hot")
    strength = material["extensions"]["KHR_materials_emissive_strength"]["emissiveStrength"]
    assert max(material["emissiveFactor"]) <= 1
    np.testing.assert_allclose(strength * np.array(material["emissiveFactor"]), [6, 3, 1.5])


@pytest.mark.parametrize("alpha", [0, 0.04])
def test_plastic_is_as_smooth_as_it_is(alpha):
    kind = {"type": "roughplastic", "alpha": alpha} if alpha else {"type": "plastic"}
    scene = single(bsdf=kind)
    surfaces, _ = read_surfaces(scene)
    stage = Stage(scene, unwrap(surfaces, 32), [], [], 1)
    for data in (
        write_glb(stage, np.zeros((32, 32, 3), np.uint8), 1),
        write_unlit_glb(stage, {}, 1),
    ):
        _, _, material = Read(data).part("it")
        assert "extensions" not in material
        assert material["pbrMetallicRoughness"]["roughnessFactor"] == pytest.approx(alpha**0.5)
