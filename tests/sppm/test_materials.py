"""SPPM images of every material against those of ``path``."""

from __future__ import annotations

import numpy as np
import pytest

from tests.furnace import (
    bitmap,
    rectangle,
    render,
    rgb,
    smooth_floor,
    sppm,
    studio,
    two_sided,
)
from tests.sppm.against_path import PATH, TIERS, WHITE, compare
from tests.tiers import Tier

TEXTURE = bitmap(np.random.default_rng(1).uniform(0.1, 0.9, (8, 9, 3)), filter_type="nearest")


TILTED = np.array([0.35, -0.2, 0.9]) / np.linalg.norm([0.35, -0.2, 0.9])


FLOORS = {
    "plastic": {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.5, 0.4), "int_ior": 1.7},
    "roughplastic": {
        "type": "roughplastic",
        "diffuse_reflectance": rgb(0.6, 0.5, 0.4),
        "alpha": 0.25,
        "nonlinear": True,
    },
    "bitmap texture": {"type": "diffuse", "reflectance": TEXTURE},
    "rough conductor": {"type": "roughconductor", "material": "Al", "alpha": 0.3},
    "blend": {
        "type": "blendbsdf",
        "weight": 0.4,
        "a": WHITE,
        "b": {"type": "roughconductor", "material": "Al", "alpha": 0.3},
    },
    "normal map": {
        "type": "normalmap",
        "material": WHITE,
        "normalmap": bitmap(np.broadcast_to((TILTED + 1) / 2, (2, 2, 3))),
    },
    "bump map": {
        "type": "bumpmap",
        "material": WHITE,
        "relief": bitmap(np.random.default_rng(2).uniform(0, 0.4, (8, 9, 1))),
    },
    "two-sided": two_sided(0.6, 0.5, 0.4),
    "principled": {
        "type": "separable_principled",
        "base_color": TEXTURE,
        "roughness": bitmap(np.linspace(0.2, 0.9, 16).reshape(4, 4, 1)),
        "sheen": 0.5,
        "flatness": 0.4,
    },
    "principled metal and lacquer": {
        "type": "separable_principled",
        "base_color": rgb(0.6, 0.5, 0.4),
        "metallic": 0.4,
        "roughness": 0.4,
        "clearcoat": 1.0,
    },
}


SHEETS = {
    "rough dielectric": {"type": "roughdielectric", "alpha": 0.2, "int_ior": 1.3},
    "thin dielectric": {"type": "thindielectric", "int_ior": 1.8},
    "mask": {"type": "mask", "opacity": 0.6, "material": two_sided(0.6, 0.5, 0.4)},
    "principled glass": {
        "type": "separable_principled",
        "base_color": rgb(0.9, 0.8, 0.7),
        "spec_trans": 0.7,
        "roughness": 0.4,
        "eta": 1.3,
    },
    "principled paper": {
        "type": "separable_principledthin",
        "base_color": rgb(0.9, 0.8, 0.7),
        "diff_trans": 1.0,
        "roughness": 0.6,
        "flatness": 0.3,
    },
    "thin principled glass": {
        "type": "separable_principledthin",
        "base_color": rgb(0.9, 0.8, 0.7),
        "diff_trans": 0.4,
        "spec_trans": 0.5,
        "roughness": 0.4,
        "eta": 1.3,
    },
}


@TIERS
@pytest.mark.parametrize("direct", ["photons", pytest.param("emitters", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", FLOORS)
def test_floors_of_every_material_look_as_by_path(tier, kind, direct):
    # What a normal map reflects onwards is a matter of its own, see below.
    truth = PATH | {"max_depth": 2} if kind in ("normal map", "bump map") else PATH
    # One direction per sample: noise of its own.
    glossy = kind in ("rough conductor", "blend") or "principled" in kind
    passes, photons = (12, 100_000) if direct == "photons" else (48, 25_000)
    mean = 0.01 if glossy else 5e-3
    compare(
        tier,
        studio(FLOORS[kind]),
        passes,
        radius=0.05,
        mean=mean,
        truth=truth,
        photons=photons,
        direct=direct,
    )


NORMALS = np.array([[0.3, 0, 1], [-0.2, 0.4, 1], [0, -0.3, 1], [0.4, 0.2, 1]])
"""At the corners of a flat floor, up to 25° beside it."""


def test_shading_normals_keep_all_the_light():
    """Flux arrives at the geometric surface, the BSDF sees the shading frame.

    Without the adjoint of the normals, 1.5 % of the light is missing: a quick tier would not see
    it.
    """
    compare(Tier(1), studio(WHITE, floor=smooth_floor(WHITE, NORMALS)), radius=0.05)


@TIERS
@pytest.mark.xfail(reason="Mitsuba samples normal maps without their adjoint, in `ptracer` as well")
def test_light_that_a_normal_map_reflects_onwards_is_that_of_path(tier):
    compare(tier, studio(FLOORS["normal map"]), radius=0.05)


@TIERS
@pytest.mark.parametrize("direct", [pytest.param("photons", marks=pytest.mark.slow), "emitters"])
@pytest.mark.parametrize("kind", SHEETS)
def test_sheets_that_let_light_through_look_as_by_path(tier, kind, direct):
    """A sheet over half of the floor: seen through it, lit through it, in its shadow.

    For masks, Mitsuba's ``path`` (3.9) counts the opacity twice, ``prb`` once.
    """
    sheet = rectangle((0.4, 0.2, 0.4), (0.4, 0.2, 0), 1.0, 1.2, SHEETS[kind])
    truth = PATH | {"type": "prb"} if kind == "mask" else PATH
    passes = 40 if direct == "photons" else 64
    compare(tier, studio(WHITE, sheet=sheet), passes, radius=0.05, truth=truth, direct=direct)


def test_principled_as_mitsuba_has_it_is_refused():
    """Its diffuse part cannot be told from the rest: an image with both twice would be wrong."""
    scene = studio({"type": "principled", "base_color": rgb(0.6, 0.5, 0.4), "roughness": 0.4})
    with pytest.raises((RuntimeError, ValueError)) as refused:
        render(scene, sppm(radius=0.05), 8, 1)
    assert "principled" in f"{refused.value} {refused.value.__cause__}"
