"""Closures of Blender as BSDFs of Mitsuba: what they reflect, and that Mitsuba takes them."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.blender.materials import translate
from gpf.blender.scene_dict import Translation
from gpf.blender.textures import Textures

PLAIN = Textures(work=None, folder=None, images={})  # type: ignore[arg-type]


def closure(name: str, **inputs: Any) -> dict[str, Any]:
    return {"closure": name, "color": [0.8, 0.5, 0.2], "roughness": 0.0, "ior": 1.5} | inputs


def principled(**inputs: Any) -> dict[str, Any]:
    return {
        "closure": "principled",
        "base_color": [0.8, 0.5, 0.2],
        "roughness": 0.5,
        "metallic": 0.0,
        "transmission_weight": 0.0,
    } | inputs


def albedo(bsdf: dict[str, Any], count: int = 1 << 16) -> np.ndarray:
    """What a surface reflects and lets through under a uniform sky, (3,)."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(5, count)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    si.n = mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(si.n)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    found, weight = mi.load_dict(bsdf).sample(context, si, sampler.next_1d(), sampler.next_2d())
    return dr.select(found.pdf > 0, weight, 0).numpy().mean(axis=1)


@pytest.mark.parametrize("roughness", [0.1, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_a_layer_leaves_the_rest_to_what_is_below(roughness, level):
    """a + c (1 - a) for each channel, with the same a."""
    made = translate(principled(roughness=roughness, specular_ior_level=level), PLAIN)
    found, colour = albedo(made.whole()), np.array([0.8, 0.5, 0.2])
    layer = (found - colour) / (1 - colour)
    assert 0.02 * level <= layer.mean() + 1e-6 and layer.mean() <= 0.2 * level + 0.002
    np.testing.assert_allclose(layer, layer.mean(), atol=0.02)


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.4])
@pytest.mark.parametrize("name", ["principled", "glossy"])
def test_light_that_bounces_in_rough_metal_is_not_lost(roughness, name):
    """A mirror reflects its colour, and a rough one a little less, because it bounces twice."""
    made = translate(
        principled(metallic=1.0, roughness=roughness)
        if name == "principled"
        else closure("glossy", roughness=roughness),
        PLAIN,
    )
    found = albedo(made.whole())
    edge = 0.05 if name == "principled" else 0.0  # Fresnel
    np.testing.assert_allclose(found, [0.8, 0.5, 0.2], atol=0.025 + edge)
    assert not made.notes


def test_glass_loses_nothing():
    for roughness in (0.0, 0.3):
        made = translate(closure("glass", color=[0.9, 0.9, 0.9], roughness=roughness), PLAIN)
        np.testing.assert_allclose(albedo(made.whole()), 0.9, atol=0.01)


def test_very_rough_metal_says_that_it_is_darker():
    made = translate(principled(metallic=1.0, roughness=1.0, base_color=[0.9, 0.9, 0.9]), PLAIN)
    assert made.notes == ["darker: light that bounces within rough metal is lost"]


def test_translucent_surfaces_send_all_light_to_the_other_side():
    found = albedo(translate(closure("translucent"), PLAIN).whole())
    np.testing.assert_allclose(found, [0.8, 0.5, 0.2], rtol=0.02)


def test_emission():
    made = translate(principled(emission_color=[1.0, 0.5, 0.0], emission_strength=4.0), PLAIN)
    assert made.emission == {"type": "rgb", "value": [4.0, 2.0, 0.0]}
    assert translate(principled(emission_strength=0.0), PLAIN).emission is None
    glow = closure("emission", strength=3.0)
    mixed = {"closure": "mix", "factor": 0.25, "first": closure("diffuse"), "second": glow}
    np.testing.assert_allclose(translate(mixed, PLAIN).emission["value"], [0.6, 0.375, 0.15])
    added = {"closure": "add", "first": glow, "second": closure("diffuse")}
    found = translate(added, PLAIN)
    np.testing.assert_allclose(found.emission["value"], [2.4, 1.5, 0.6])
    assert found.bsdf["type"] == "diffuse"


@pytest.mark.parametrize("first", ["diffuse", "translucent"])
def test_a_sum_has_the_light_of_both(first):
    """As long as both together reflect no more than all light."""
    colours = [0.6, 0.1, 0.2], [0.1, 0.4, 0.3]
    parts = [closure(name, color=c) for name, c in zip((first, "glossy"), colours, strict=True)]
    both = {"closure": "add", "first": parts[0], "second": parts[1]}
    made = translate(both, PLAIN)
    np.testing.assert_allclose(albedo(made.whole()), np.sum(colours, axis=0), rtol=0.02)
    glow = {
        "closure": "mix",
        "factor": 0.5,
        "first": parts[1],
        "second": closure("emission", strength=3.0),
    }
    shining = translate(both | {"second": glow}, PLAIN)
    np.testing.assert_allclose(shining.emission["value"], [1.2, 0.75, 0.3])
    assert not made.notes and not shining.notes
    assert translate(both | {"second": closure("glass")}, PLAIN).notes == [
        "a sum of two surfaces, approximated"
    ]


def test_a_mixture_with_nothing_is_an_opacity():
    clear, solid = closure("transparent", color=[1.0, 1.0, 1.0]), closure("diffuse")
    for first, second, opacity in ((solid, clear, 0.7), (clear, solid, 0.3)):
        made = translate({"closure": "mix", "factor": 0.3, "first": first, "second": second}, PLAIN)
        assert made.whole()["type"] == "mask" and made.opacity == pytest.approx(opacity)


@pytest.mark.parametrize(
    "found",
    [
        *(closure(name) for name in ("diffuse", "glossy", "glass", "refraction", "translucent")),
        *(closure(name) for name in ("transparent", "toon", "sheen", "subsurface")),
        closure("metallic", base_color=[0.9, 0.6, 0.3], roughness=0.4),
        {"closure": "other", "node": "Hair BSDF"},
        {"closure": "none"},
        principled(transmission_weight=1.0, roughness=0.3),
        principled(transmission_weight=0.5),
        principled(metallic=0.5),
        principled(coat_weight=1.0, coat_roughness=0.1, sheen_weight=0.3, alpha=0.5),
        {"closure": "mix", "factor": 0.5, "first": closure("glass"), "second": closure("glossy")},
        {"closure": "add", "first": closure("diffuse"), "second": closure("glossy")},
    ],
    ids=lambda found: found["closure"],
)
def test_mitsuba_takes_it_and_no_light_is_gained(found):
    whole = translate(found, PLAIN).whole()
    value = albedo(whole)
    assert np.isfinite(value).all() and value.max() < 1.06


def test_parts_of_a_scene_have_different_names():
    names = Translation({})
    made = [
        names.label(name) for name in ("Cube", "cube", "Cube.001", "Cube", "3D", "type", "Ä", "Ö")
    ]
    assert made == [
        "Cube",
        "cube_2",
        "Cube_001",
        "Cube_3",
        "part_3D",
        "type_2",
        "part__",
        "part___2",
    ]
    many = [names.label("leaf") for _ in range(20_000)]
    assert len({*many}) == 20_000
