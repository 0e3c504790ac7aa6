"""The diffuse lobe that photons and visible points see, against the BSDF that it was taken from.

A photon from ``light`` and a camera ray from ``view`` never meet; what they contribute together,
g(light) ρ(view) / π, has to be what the BSDF says about the pair.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import from_numpy, to_numpy
from gpf.scene.inventory import divides_walks
from gpf.scene.materials import (
    diffuse_context,
    diffuse_reflectance,
    diffuse_transfer,
    has_diffuse,
    specular_context,
)
from tests.furnace import Scene, bitmap, diffuse, floor, rgb, two_sided

COUNT = 4000


def texture(seed: int = 1, low: float = 0.1, high: float = 0.9) -> Scene:
    values = np.random.default_rng(seed).uniform(low, high, (5, 7, 3))
    return bitmap(values, filter_type="nearest")


def tilted_normals() -> Scene:
    """A map of normals that lie up to some 30° beside the surface's."""
    n = np.random.default_rng(2).normal(0, 0.25, (5, 7, 3))
    n[..., 2] = 1
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    return bitmap((n + 1) / 2, filter_type="nearest")


PLASTIC = {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2)}
ROUGH_PLASTIC = {"type": "roughplastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2)}
CONDUCTOR = {"type": "roughconductor", "material": "Al", "alpha": 0.2}
# Where a perturbed normal turns away from the viewer, Mitsuba can flip it: a lobe that depends on
# the pair of directions, which no product of two factors is. Left out.
PERTURBED = {"type": "normalmap", "flip_invalid_normals": False}

LOBES = {
    "diffuse": diffuse(0.6, 0.4, 0.2),
    "textured": {"type": "diffuse", "reflectance": texture()},
    "two sided": two_sided(0.6, 0.4, 0.2),
    "plastic": PLASTIC,
    "nonlinear plastic": PLASTIC | {"nonlinear": True, "int_ior": 1.9},
    "textured plastic": {"type": "plastic", "diffuse_reflectance": texture(3)},
    "two-sided plastic": {"type": "twosided", "material": PLASTIC},
    "roughplastic": ROUGH_PLASTIC | {"alpha": 0.1},
    "very rough plastic": ROUGH_PLASTIC | {"alpha": 0.5, "distribution": "ggx", "nonlinear": True},
    "pplastic": {"type": "pplastic", "diffuse_reflectance": rgb(0.6, 0.4, 0.2), "alpha": 0.2},
    "mask": {"type": "mask", "opacity": 0.6, "material": two_sided(0.6, 0.4, 0.2)},
    "blend": {"type": "blendbsdf", "weight": 0.3, "a": diffuse(0.6, 0.4, 0.2), "b": CONDUCTOR},
    "normal map": PERTURBED | {"material": diffuse(0.6, 0.4, 0.2), "normalmap": tilted_normals()},
    "two-sided normal map": {
        "type": "twosided",
        "material": PERTURBED | {"material": diffuse(0.6, 0.4, 0.2), "normalmap": tilted_normals()},
    },
    "normal map on plastic": PERTURBED | {"material": PLASTIC, "normalmap": tilted_normals()},
    "bump map": {
        "type": "bumpmap",
        "flip_invalid_normals": False,
        "material": diffuse(0.6, 0.4, 0.2),
        "relief": bitmap(np.random.default_rng(4).uniform(0, 0.3, (9, 8, 3))),
    },
}


def hemisphere(seed: int, side: np.ndarray) -> np.ndarray:
    """Directions up to 80° from the normal, on the given side of the surface, (N, 3)."""
    rng = np.random.default_rng(seed)
    z, phi = rng.uniform(0.17, 1, len(side)), rng.uniform(0, 2 * np.pi, len(side))
    s = np.sqrt(1 - z * z)
    return np.stack([s * np.cos(phi), s * np.sin(phi), z * side], axis=1)


def surface(spec: Scene) -> tuple[mi.BSDF, mi.SurfaceInteraction3f]:
    """A material and random points of a floor made of it; ``wi`` is still to be set."""
    bsdf = mi.load_dict(spec)
    scene = mi.load_dict({"type": "scene", "floor": floor(bsdf, size=2)})
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-1, 1, (2, COUNT)).astype(np.float32)
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(x, y, 1), mi.Vector3f(0, 0, -1)))
    dr.eval(si)
    return bsdf, si


def to_vectors(array: np.ndarray) -> mi.Vector3f:
    return from_numpy(mi.Vector3f, array)


def sides_of(kind: str) -> np.ndarray:
    both = np.where(np.arange(COUNT) % 2 == 0, 1.0, -1.0)
    return both if kind.startswith(("two", "mask")) else np.ones(COUNT)


def from_direction(si: mi.SurfaceInteraction3f, d: np.ndarray) -> mi.SurfaceInteraction3f:
    turned = mi.SurfaceInteraction3f(si)
    turned.wi = to_vectors(d)
    return turned


@pytest.mark.parametrize("kind", LOBES)
def test_transfer_and_reflectance_make_up_the_lobe(kind):
    """What a photon of 1 W/m² contributes: f_d(light, view) cos' / cos.

    cos is the angle at the surface, cos' that at the normal which the BSDF uses.
    """
    bsdf, si = surface(LOBES[kind])
    side = sides_of(kind)
    light, view = hemisphere(6, side), hemisphere(7, side)
    seen, lit = from_direction(si, view), from_direction(si, light)
    response = to_numpy(bsdf.eval(diffuse_context(), seen, to_vectors(light), mi.Bool(True)))
    response = response / np.abs(light[:, 2:])
    g = to_numpy(diffuse_transfer(bsdf, lit, mi.Bool(True)))
    rho = to_numpy(diffuse_reflectance(bsdf, seen, mi.Bool(True)))
    split = g * rho / np.pi
    assert response.max() > 0.05
    # Where a perturbed normal turns away from the camera or from the light, nothing is seen.
    clear = response > 0
    assert clear.mean() > 0.8
    np.testing.assert_allclose(split[clear], response[clear], rtol=0.01, atol=1e-4)
    if "map" not in kind:
        assert clear.all()


@pytest.mark.parametrize("kind", ["diffuse", "textured", "two sided"])
def test_a_lambertian_lobe_is_its_albedo(kind):
    bsdf, si = surface(LOBES[kind])
    d = from_direction(si, hemisphere(8, sides_of(kind)))
    np.testing.assert_allclose(to_numpy(diffuse_transfer(bsdf, d, mi.Bool(True))), 1, rtol=1e-5)
    rho = to_numpy(diffuse_reflectance(bsdf, d, mi.Bool(True)))
    albedo = to_numpy(bsdf.eval_diffuse_reflectance(d, mi.Bool(True)))
    np.testing.assert_allclose(rho, np.broadcast_to(albedo, rho.shape), rtol=1e-5)
    assert np.ptp(rho[:, 0]) > (0.5 if kind == "textured" else -1)


def test_a_black_lobe_passes_the_power_on():
    """Photons on black surfaces keep their power: a black room measures a lamp."""
    bsdf, si = surface(diffuse(0))
    d = from_direction(si, hemisphere(8, np.ones(COUNT)))
    np.testing.assert_array_equal(to_numpy(diffuse_transfer(bsdf, d, mi.Bool(True))), 1)
    np.testing.assert_array_equal(to_numpy(diffuse_reflectance(bsdf, d, mi.Bool(True))), 0)


@pytest.mark.parametrize("kind", LOBES)
def test_the_two_contexts_divide_a_bsdf(kind):
    """Diffuse and specular part add up to the whole: nothing is lost, nothing counted twice."""
    bsdf, si = surface(LOBES[kind])
    side = sides_of(kind)
    d, wo = from_direction(si, hemisphere(9, side)), to_vectors(hemisphere(10, side))
    contexts = diffuse_context(), specular_context(), mi.BSDFContext()
    diffuse_part, others, whole = (to_numpy(bsdf.eval(c, d, wo, mi.Bool(True))) for c in contexts)
    np.testing.assert_allclose(diffuse_part + others, whole, rtol=1e-4, atol=1e-6)
    assert diffuse_part.max() > 0


@pytest.mark.parametrize(
    ("spec", "front", "back"),
    [
        (diffuse(0.5), True, False),
        (two_sided(0.5), True, True),
        (PLASTIC, True, False),
        (ROUGH_PLASTIC, True, False),
        ({"type": "twosided", "material": PLASTIC}, True, True),
        (LOBES["blend"], True, False),
        (LOBES["mask"], True, True),
        ({"type": "conductor"}, False, False),
        (CONDUCTOR, False, False),
        ({"type": "dielectric"}, False, False),
        ({"type": "thindielectric"}, False, False),
        ({"type": "roughdielectric"}, False, False),
        ({"type": "null"}, False, False),
    ],
    ids=lambda v: v["type"] if isinstance(v, dict) else None,
)
def test_sides_with_a_diffuse_component(spec, front, back):
    bsdf, si = surface(spec)
    for sign, expected in ((1, front), (-1, back)):
        d = from_direction(si, hemisphere(11, np.full(COUNT, float(sign))))
        found = mi.Bool(has_diffuse(bsdf, d))
        assert dr.all(found == expected)


@pytest.mark.parametrize(
    ("bsdf", "answer"),
    [
        ({"type": "dielectric"}, True),
        ({"type": "thindielectric"}, True),
        ({"type": "roughdielectric"}, False),
        ({"type": "mask", "opacity": 0.5, "bsdf": {"type": "dielectric"}}, False),
        ({"type": "conductor"}, False),
        ({"type": "plastic"}, True),
        ({"type": "roughplastic"}, True),
        ({"type": "mask", "opacity": 0.5, "bsdf": {"type": "diffuse"}}, True),
        (
            {
                "type": "blendbsdf",
                "weight": 0.3,
                "first": {"type": "dielectric"},
                "second": {"type": "conductor"},
            },
            False,
        ),
    ],
)
def test_walks_divide_unless_glass_is_a_part_of_a_mixture(bsdf, answer):
    shapes = {"floor": floor(diffuse(0.5)), "glass": {"type": "sphere", "bsdf": bsdf}}
    assert divides_walks(mi.load_dict({"type": "scene"} | shapes)) is answer


def test_glass_in_groups_of_shapes_counts():
    masked = {"type": "mask", "opacity": 0.5, "bsdf": {"type": "dielectric"}}
    shapes = {
        "plain": {"type": "sphere", "bsdf": {"type": "dielectric"}},
        "group": {"type": "shapegroup", "inner": {"type": "rectangle", "bsdf": masked}},
        "instance": {"type": "instance", "group": {"type": "ref", "id": "group"}},
    }
    assert not divides_walks(mi.load_dict({"type": "scene"} | shapes))
