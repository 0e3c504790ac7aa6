"""SPPM where the radiance is known: furnaces, visible lamps, thin walls."""

from __future__ import annotations

import numpy as np
import pytest

from tests.furnace import (
    Scene,
    camera,
    diffuse,
    floor,
    furnace,
    lamp,
    point_light,
    render,
    rgb,
    room,
    sppm,
    two_sided,
)
from tests.tiers import tiers

PATH = {"type": "path", "max_depth": -1}


@tiers(quick=1 / 4)
@pytest.mark.parametrize("light", ["point", "area"])
@pytest.mark.parametrize("integrator", ["path", "ptracer", "sppm"])
def test_furnace(integrator, light, tier):
    """Radiance 1 in every direction, whoever computes it.

    In the quick tier, the mean of all has a standard error of 0.1 to 0.4 %, a pixel of 1 to 2.5 %.
    """
    settings = {
        "path": (PATH, tier.samples(256)),
        "ptracer": ({"type": "ptracer", "max_depth": -1}, tier.samples(20_000)),
        "sppm": (sppm(tier.samples(100_000), radius=0.1), 10),
    }
    images = render(furnace(light), *settings[integrator], seeds=4)
    assert images.mean() == pytest.approx(1, abs=tier.noise(5e-3))
    np.testing.assert_allclose(images.mean(0), 1, atol=tier.noise(0.08))
    np.testing.assert_allclose(images.mean((0, 1, 2)), 1, atol=tier.noise(0.01))


def test_a_directly_visible_lamp_counts_once():
    """A black lamp has its own radiance to the last digit; a grey one reflects on top of it."""
    scene = {
        "type": "scene",
        "sensor": camera((0, 0, 1), (0, 0, 0), 20),
        "lamp": lamp((0, 0, 0), (0, 0, 1), 4, 3, 2, 1),
    }
    image = render(scene, sppm(1000), 3, 1)[0]
    np.testing.assert_allclose(image, np.broadcast_to([3, 2, 1], image.shape), rtol=1e-5)

    image = render(furnace("area"), sppm(20_000, radius=0.1), 20, 1)[0]
    np.testing.assert_allclose(image, 1, atol=0.1)


def test_a_lamp_in_a_mirror_counts_once():
    mirror = {"type": "conductor", "material": "none", "specular_reflectance": rgb(0.5, 0.4, 0.3)}
    scene = {
        "type": "scene",
        "sensor": camera((0, -1, 1), (0, 0, 0), 10),
        "mirror": floor(mirror),
        "lamp": lamp((0, 2, 2), (0, 0, 0), 2.5, 3, 2, 1),
    }
    image = render(scene, sppm(1000), 3, 1)[0]
    np.testing.assert_allclose(image, np.broadcast_to([1.5, 0.8, 0.3], image.shape), rtol=1e-5)


# --- thin walls -------------------------------------------------------------------------------


def thin_box(thickness: float) -> Scene:
    """A lit box in a dark one: its walls are sheets, or two sheets a little apart."""
    inner = room(two_sided(0.8), (0.5, 0.4, 0.3))
    scene = {"type": "scene", "inner": inner, "outer": room(diffuse(0.8), (2, 2, 2))}
    if thickness:
        half = tuple(h + thickness for h in (0.5, 0.4, 0.3))
        scene["shell"] = room(two_sided(0.8), half)
    return scene | {"light": point_light((0.1, -0.1, 0.05), 5)}


@pytest.mark.parametrize("thickness", [0, 0.01])
def test_light_does_not_leak_through_a_thin_wall(thickness):
    """The photons on its other side are nearer than the radius and must not count at all."""
    scene = thin_box(thickness)
    outside = scene | {"sensor": camera((1.6, 1.5, 1.4), (0, 0, 0), 40)}
    dark = render(outside, sppm(50_000, radius=0.1), 4, 1)
    np.testing.assert_array_equal(dark, 0)

    inside = scene | {"sensor": camera((-0.3, 0.2, 0.1), (0.5, -0.2, -0.1), 60)}
    assert render(inside, sppm(50_000, radius=0.1), 4, 1).min() > 1


def test_a_wall_that_light_passes_is_lit_on_both_sides():
    """The same box of glass: it is the wall that keeps the light in, not the camera."""
    scene = thin_box(0) | {"sensor": camera((1.6, 1.5, 1.4), (0, 0, 0), 40)}
    scene["inner"] = scene["inner"] | {"bsdf": {"type": "thindielectric"}}
    assert render(scene, sppm(50_000, radius=0.1), 4, 1).min() > 0.05
