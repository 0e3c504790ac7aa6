"""What the denoiser is told, where it is known."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from baselines.denoised.guides import are_noisy, render_guides
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import bitmap, diffuse, floor, lamp, rectangle, rgb, room

# Straight down at the plane z = 0, of which it sees 2 x 1.5 around the origin.
DOWN = View(name="down", origin=(0, 0, 1), target=(0, 0, 0), up=(0, 1, 0), fov=90)
SPP = 64


def guides(spp: int = SPP, view: View = DOWN, **objects):
    scene = mi.load_dict({"type": "scene"} | objects)
    return render_guides(scene, make_sensor(view, 8, 6), spp, seed=1)


def test_colours_and_normals_are_in_the_places_of_their_surfaces():
    left = rectangle((-3, 0, 0), (-3, 0, 1), 6, 6, diffuse(0.8, 0.5, 0.2))
    right = rectangle((3, 0, 0), (3, 0, 1), 6, 6, diffuse(0.1, 0.3, 0.6))
    albedo, normal = guides(left=left, right=right)
    assert albedo.shape == normal.shape == (6, 8, 3)
    assert albedo.dtype == normal.dtype == np.float32
    # The camera looks down with +y up: its left is -x.
    np.testing.assert_allclose(albedo[:, :4], np.broadcast_to((0.8, 0.5, 0.2), (6, 4, 3)), 1e-4)
    np.testing.assert_allclose(albedo[:, 4:], np.broadcast_to((0.1, 0.3, 0.6), (6, 4, 3)), 1e-4)
    np.testing.assert_allclose(normal, np.broadcast_to((0, 0, 1), (6, 8, 3)), atol=1e-5)


def test_textures_are_box_filtered():
    texels = np.random.default_rng(2).random((6, 6, 3))
    texture = bitmap(texels, filter_type="nearest")
    image, _ = guides(spp=5000, floor=floor({"type": "diffuse", "reflectance": texture}, size=2))
    # Of a row of pixels: what the texture has between y = 0.75 and 0.5, from x = -1 to 1.
    mixed = (texels[-1] / 12 + texels[-2] / 6).mean(0)
    np.testing.assert_allclose(image[0].mean(0), 4 * mixed, atol=0.01)


def test_in_a_mirror_is_what_it_shows():
    mirror = {
        "type": "conductor", "material": "none", "specular_reflectance": rgb(0.5, 0.9, 0.7)
    }  # fmt: skip
    above = rectangle((0, 0, 2), (0, 0, 0), 20, 20, diffuse(0.8, 0.4, 0.2))
    albedo, normal = guides(mirror=floor(mirror), above=above)
    np.testing.assert_allclose(albedo[2, 3], (0.4, 0.36, 0.14), rtol=1e-3)
    np.testing.assert_allclose(normal[2, 3], (0, 0, -1), atol=1e-5)


def test_glass_shows_what_is_behind_it_and_what_it_reflects():
    to_world = mi.ScalarTransform4f().translate([0, 0, 0.5]).scale([4, 4, 0.01])
    pane = {"type": "cube", "to_world": to_world, "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    albedo, normal = guides(20_000, pane=pane, floor=floor(diffuse(0.5), size=40))
    reflected = 0.04
    through = (1 - reflected) / (1 + reflected)  # all that is reflected within included
    np.testing.assert_allclose(albedo[2:4, 3:5], 0.5 * through, atol=0.005)
    np.testing.assert_allclose(normal[2:4, 3:5, 2], through, atol=0.01)


def test_a_cage_of_mirrors_is_white_in_the_end():
    albedo, _ = guides(mirrors=room({"type": "conductor", "material": "none"}, (2, 2, 2)))
    np.testing.assert_allclose(albedo, 1, atol=1e-4)


@pytest.mark.parametrize(("radiance", "shown"), [(0.3, 0.3), (50, 1)])
def test_lamps_and_the_sky_have_a_colour_of_at_most_one(radiance, shown):
    albedo, normal = guides(lamp=lamp((0, 0, 0), (0, 0, 1), 9, radiance))
    np.testing.assert_allclose(albedo, shown, rtol=1e-4)
    np.testing.assert_allclose(normal[..., 2], 1, rtol=1e-4)
    sky = {"type": "constant", "radiance": rgb(radiance)}
    albedo, normal = guides(sky=sky, floor=floor(diffuse(0.5), z=-9, size=0.1))
    np.testing.assert_allclose(albedo[0, 0], shown, rtol=1e-4)
    assert not normal[0].any()


def test_a_ray_has_a_choice_at_glass_and_under_a_coat():
    for bsdf, noisy in (
        (diffuse(0.5), False),
        ({"type": "roughconductor", "alpha": 0.2}, False),
        ({"type": "twosided", "bsdf": diffuse(0.5)}, False),
        ({"type": "dielectric"}, True),
        ({"type": "plastic"}, True),
    ):
        assert are_noisy(mi.load_dict({"type": "scene", "floor": floor(bsdf)})) == noisy, bsdf
