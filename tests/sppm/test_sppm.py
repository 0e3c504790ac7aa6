"""SPPM against ``path``, and what the length of a path means."""

from __future__ import annotations

import mitsuba as mi
import numpy as np
import pytest

from tests.furnace import (
    Scene,
    bitmap,
    camera,
    cornell_box,
    diffuse,
    facing,
    floor,
    furnace,
    lamp,
    point_light,
    rectangle,
    render,
    rgb,
    sppm,
    studio,
    two_sided,
)
from tests.sppm.against_path import DIRECT, TIERS, WHITE, compare
from tests.tiers import Tier


@pytest.mark.slow
@pytest.mark.parametrize("glass", [False, True], ids=["diffuse", "glass sphere"])
def test_the_cornell_box_is_that_of_path(glass):
    scene = cornell_box((48, 40), glass)
    compare(Tier(1), scene, passes=10, spp=256, block=8, photons=250_000, radius=0.02)


SKY = np.full((6, 12, 3), 0.2, dtype=np.float32)
SKY[1, 2:5] = [9, 6, 3]  # a bright patch some way up

LIGHTS = {
    "area": lamp((1.4, -0.2, 1.6), (0, 0, 0), 0.8, 10, 8, 6),
    "point": point_light((0.6, -0.4, 1.7), 3, 2, 1),
    "spot": {
        "type": "spot",
        "to_world": facing((0.6, -0.4, 2.5), (0, 0.2, 0)),
        "intensity": rgb(9, 6, 3),
        "cutoff_angle": 35,
        "beam_width": 20,
    },
    "directional": {"type": "directional", "direction": [1, 0.5, -2], "irradiance": rgb(3, 2, 1)},
    "constant": {"type": "constant", "radiance": rgb(1, 2, 3)},
    "envmap": {
        "type": "envmap",
        "bitmap": "sky",
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
    },
    "projector": {
        "type": "projector",
        "to_world": facing((0.6, -1.4, 2.5), (0, 0.2, 0)),
        "irradiance": bitmap(np.linspace(0.5, 3, 4 * 6 * 3).reshape(4, 6, 3)),
        "fov": 60,
    },
}


@TIERS
@DIRECT
@pytest.mark.parametrize("kind", LIGHTS)
def test_a_floor_lit_by_each_kind_of_emitter_is_that_of_path(tier, kind, direct):
    light = LIGHTS[kind]
    if kind == "envmap":
        light = light | {"bitmap": mi.Bitmap(SKY)}
    # Photons have nothing to do here where direct light does not come from them; as many samples
    # take less time in few passes of many pixels.
    if direct == "photons":
        compare(tier, lit_floor(light), 32, radius=0.07, direct=direct)
    else:
        fine = lit_floor(light, size=(48, 32))
        compare(tier, fine, 15, spp=64, block=16, radius=0.07, photons=1000, direct=direct)


def lit_floor(light: Scene, size: tuple[int, int] = (12, 8)) -> Scene:
    return {
        "type": "scene",
        "sensor": camera((0.2, -2.5, 2), (0, 0.1, 0), 26, size),
        "floor": floor(diffuse(0.6, 0.5, 0.4), size=2.6),
        "light": light,
    }


def test_a_floor_under_a_directional_area_light_is_evenly_lit():
    """Nothing for `path` to find, but known: L = ρ/π E, the same all over the beam."""
    light = rectangle((0, 0, 1.7), (0, 0, 0), 3, 3, diffuse(0))
    light["emitter"] = {"type": "directionalarea", "radiance": rgb(3, 2, 1)}
    image = render(lit_floor(light), sppm(radius=0.1), 8, 1)[0]
    expected = np.array([1.8, 1.0, 0.4]) / np.pi
    np.testing.assert_allclose(image.mean((0, 1)), expected, rtol=0.01)
    np.testing.assert_allclose(image, np.broadcast_to(expected, image.shape), rtol=0.2)


@TIERS
@DIRECT
def test_several_emitters_count_by_their_powers(tier, direct):
    """A choice among them that is not made up for would show in the colours."""
    kinds = ("area", "point", "spot", "constant")
    colours = [rgb(1, 0.2, 0.2), rgb(0.1, 3, 0.1), rgb(0.3, 0.3, 9), rgb(0.2, 0.1, 0.1)]
    lights = {kind: dict(LIGHTS[kind]) for kind in kinds}
    lights["area"]["emitter"] = {"type": "area", "radiance": colours[0]}
    for kind, colour in zip(kinds[1:], colours[1:], strict=True):
        key = "radiance" if kind == "constant" else "intensity"
        lights[kind][key] = colour
    area = lights.pop("area")
    if direct == "photons":
        coarse = lit_floor(area, size=(36, 24)) | lights
        compare(tier, coarse, 32, spp=2048, radius=0.07, direct=direct)
    else:
        fine = lit_floor(area, size=(144, 96)) | lights
        compare(tier, fine, 10, spp=128, block=16, radius=0.07, photons=1000, direct=direct)


@TIERS
def test_photons_and_rays_meet_instances(tier):
    """Two turned copies of a heap: photons and camera rays land on shapes of a group."""
    turn = mi.ScalarTransform4f
    heap = {
        "type": "shapegroup",
        "ball": {"type": "sphere", "radius": 0.35, "bsdf": diffuse(0.3, 0.5, 0.7)},
        "plate": {
            "type": "rectangle",
            "to_world": turn().translate([0, 0, 0.36]).scale(0.5),
            "bsdf": two_sided(0.7, 0.5, 0.3),
        },
    }
    copies = {
        f"copy {k}": {
            "type": "instance",
            "heap": {"type": "ref", "id": "heap"},
            "to_world": turn().translate([x, 0, 0.45]).rotate([0.8, 0.6, 0], angle),
        }
        for k, (x, angle) in enumerate([(-0.6, 20), (0.6, -35)])
    }
    compare(tier, studio(WHITE, heap=heap, **copies), 48, spp=2048, radius=0.03, bias=0.02)


# --- path lengths -----------------------------------------------------------------------------


def seen_in_a_mirror(scene: Scene) -> Scene:
    """The same view by way of a mirror that stands half a unit before the camera."""
    origin, target = np.array([0.2, -3, 2]), np.array([0, 0.3, 0.1])
    d = (target - origin) / np.linalg.norm(target - origin)
    middle = origin + 0.5 * d
    n = np.cross(d, [0, 0, 1])
    n = n / np.linalg.norm(n) + d
    n /= np.linalg.norm(n)
    mirrored = origin - 2 * np.dot(origin - middle, n) * n
    return scene | {
        "sensor": camera(mirrored.tolist(), middle.tolist(), 30, (24, 16)),
        "mirror": rectangle(middle.tolist(), (middle + n).tolist(), 1, 1, {"type": "conductor"}),
    }


@TIERS
@pytest.mark.parametrize("max_depth", [3, 4])
@pytest.mark.parametrize("by", ["mirror", "glass"])
def test_max_depth_means_what_it_means_in_path(tier, max_depth, by):
    """An edge more on the camera's side is one less on the light's."""
    if by == "mirror":
        scene = seen_in_a_mirror(studio(WHITE))
    else:
        ball = {"type": "sphere", "center": [0.4, 0, 0.36], "radius": 0.35}
        scene = studio(WHITE, glass=ball | {"bsdf": {"type": "dielectric", "int_ior": 1.5}})
    truth = {"type": "path", "max_depth": max_depth}
    compare(tier, scene, mean=0.01, radius=0.05, truth=truth)


def test_two_edges_do_not_show_a_lit_floor_in_a_mirror():
    image = render(seen_in_a_mirror(studio(WHITE)), sppm(5000, max_depth=2), 4, 1)
    np.testing.assert_array_equal(image, 0)


@pytest.mark.parametrize(("max_depth", "radiance"), [(0, 0.0), (1, 0.5), (2, 0.75), (3, 0.875)])
def test_the_furnace_grows_bounce_by_bounce(max_depth, radiance):
    """½ from the sphere itself, half as much again from each bounce."""
    integrator = sppm(5000, radius=0.2) | {"max_depth": max_depth}
    image = render(furnace("area"), integrator, 8, 1)[0]
    np.testing.assert_allclose(image.mean(), radiance, rtol=0.01)
    if max_depth < 2:
        np.testing.assert_allclose(image, radiance, rtol=1e-5)
