"""Samples of some of a scene's emitters, and which emitters are small."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.errors import UserError
from gpf.core.random import random_start, spread_sample
from gpf.core.structs import VisiblePoints, from_numpy, to_numpy
from gpf.field.field import GaussianPhotonField
from gpf.field.settings import FieldSettings
from gpf.scene.bounds import scene_bounds
from gpf.scene.lamps import MOST_AT_ONCE, Lamps, small_lamps
from gpf.sppm.fixed_points import FixedPoints
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
    sppm,
)
from tests.plain_field import flat_gaussians, to_device

LIGHTS: dict[str, Scene] = {
    "bulb": point_light((0.5, 0, 1), 3, 2, 1),
    "panel": lamp((-1, 0, 2), (0, 0, 0), 0.6, 9, 9, 9),
    "spark": lamp((0, 1, 2), (0, 0, 0), 0.02, 900, 0, 0),
    "sun": {"type": "directional", "direction": [0, 1, -1], "irradiance": rgb(0.3)},
    "torch": {
        "type": "spot",
        "to_world": mi.ScalarTransform4f().look_at([0, -1, 2], [0, 0, 0], [0, 1, 0]),
        "intensity": rgb(2, 4, 6),
    },
    "sky": {"type": "constant", "radiance": rgb(0.1, 0.2, 0.4)},
}


def lit_floor(names: Any) -> Scene:
    screen = floor(diffuse(0.4), z=0.5, size=0.2)  # throws shadows
    return {
        "type": "scene",
        "sensor": camera((0, -3, 3), (0, 0, 0), 30, (12, 8)),
        "floor": floor(diffuse(0.6)),
        "screen": screen,
    } | {name: LIGHTS[name] for name in names}


def place(scene: mi.Scene, name: str) -> int:
    """The place of a light in ``scene.emitters()``."""
    radiance = mi.traverse(mi.load_dict(lit_floor([name]), optimize=False).emitters()[0])
    kinds = [e.class_name() for e in scene.emitters()]
    alone = mi.load_dict(lit_floor([name]), optimize=False).emitters()[0]
    same = [k for k, kind in enumerate(kinds) if kind == alone.class_name()]
    if len(same) == 1:
        return same[0]
    values = [mi.traverse(scene.emitters()[k])["radiance.value"] for k in same]
    mine = radiance["radiance.value"]
    return same[[np.allclose(value, mine) for value in values].index(True)]


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    return mi.load_dict(lit_floor(LIGHTS), optimize=False)


def irradiance(scene: mi.Scene, lamps: Lamps, samples: int = 256) -> np.ndarray:
    """Direct irradiance at points of the floor, some of them in shadow, (N, 3)."""
    points = dr.zeros(VisiblePoints, 400)
    x, y = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20))
    points.p = from_numpy(mi.Point3f, np.float32([x.ravel(), y.ravel(), 0 * x.ravel()]).T)
    points.n = mi.Normal3f(0, 0, 1)
    fixed, start = FixedPoints(scene, points), random_start(7, 400)
    total = dr.zeros(mi.Color3f, 400)
    for k in range(samples):
        total += fixed.direct_irradiance(spread_sample(start, k + 1), lamps)
        dr.eval(total)
    return to_numpy(total) / samples


@pytest.mark.parametrize("names", [("bulb",), ("sun",), ("bulb", "torch"), ("panel", "sky")])
def test_some_emitters_bring_what_they_bring_alone(scene, names):
    some = Lamps(scene, [place(scene, name) for name in names])
    alone = mi.load_dict(lit_floor(names), optimize=False)
    expected, found = irradiance(alone, Lamps(alone)), irradiance(scene, some)
    exact = names in {("bulb",), ("sun",)}
    assert expected.max() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-5 if exact else 0.15 * expected.max())
    np.testing.assert_allclose(found.mean(0), expected.mean(0), rtol=1e-5 if exact else 0.02)


def test_groups_are_all_of_them(scene):
    """The groups' light adds up; each emitter without a size has no noise in a group alone."""
    names = ("bulb", "sun", "torch")
    some = Lamps(scene, [place(scene, name) for name in names])
    groups = some.groups()
    assert [len(group.indices) for group in groups] == [1, 1, 1]
    singles = [irradiance(scene, Lamps(scene, [place(scene, name)]), 1) for name in names]
    together = sum(irradiance(scene, group, 1) for group in groups)
    np.testing.assert_allclose(together, sum(singles), rtol=1e-5, atol=1e-6)
    many = Lamps(scene, range(6)).groups()
    assert len(many) == MOST_AT_ONCE
    assert sorted(k for group in many for k in group.indices) == list(range(6))
    assert len(Lamps(scene).groups()) == 1 and not Lamps(scene, ()) and Lamps(scene)


def test_the_others_are_all_but_some(scene):
    count = len(scene.emitters())
    assert list(Lamps(scene, [1, 3]).others().indices) == [0, 2, *range(4, count)]
    assert Lamps(scene, ()).others().indices is None and not Lamps(scene).others()


@pytest.mark.parametrize("direct", ["photons", "emitters"])
def test_lamps_shine_that_mitsuba_does_not_sample(direct):
    """Two lamps in the middle of a furnace, of which one has the sampling weight 0."""
    scene = furnace("point")
    half = scene["light"] | {"intensity": rgb(np.pi / 2)}
    scene |= {"light": half, "more": half | {"sampling_weight": 0.0}}
    image = render(scene, sppm(20_000, 0.1, direct=direct), 4, 1)
    assert image.mean() == pytest.approx(1, abs=0.02)


GAUZE = {"type": "mask", "opacity": 0.3, "nested": diffuse(0.5)}
PANE = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}
CLOUDY = {"type": "mask", "opacity": 1.0, "nested": diffuse(0.5)}
OF_PANE = 0.96 / 1.04  # (1 - R) / (1 + R) with R = 0.04, at right angles


@pytest.mark.parametrize("light", ["bulb", "sky"])
@pytest.mark.parametrize(
    ("sheets", "share"),
    [
        ((), 1),
        ((GAUZE,), 0.7),
        ((GAUZE, GAUZE), 0.49),
        ((PANE, GAUZE), 0.7 * OF_PANE),
        ((CLOUDY, GAUZE), 0),
        ((diffuse(0.5), GAUZE), 0),
    ],
)
@pytest.mark.parametrize("chosen", [False, True])
def test_light_comes_straight_through_cloth_and_panes(sheets, share, light, chosen):
    """What is left of the light from above; through glass, the sky comes at a slant, too."""
    lights: Scene = {
        "bulb": point_light((0, 0, 4), 3, 2, 1),
        "sky": {"type": "constant", "radiance": rgb(0.1, 0.2, 0.4)},
    }
    own = {"type": "scene", "light": lights[light]}
    own |= {f"sheet {k}": floor(s, z=1 + k, size=1e5) for k, s in enumerate(sheets)}
    scene = mi.load_dict(own, optimize=False)
    points = dr.zeros(VisiblePoints, 2048)
    points.n = mi.Normal3f(0, 0, 1)
    fixed = FixedPoints(scene, points)
    sample = spread_sample(mi.Point2f(0.3), dr.arange(mi.UInt32, 2048))
    lamps = Lamps(scene, [0]) if chosen else Lamps(scene)
    found = fixed.direct_irradiance(sample, lamps).numpy().mean(axis=-1)
    clear = np.array([3, 2, 1]) / 16 if light == "bulb" else np.pi * np.array([0.1, 0.2, 0.4])
    slanted = light == "sky" and PANE in sheets  # R of diffuse light is 0.09
    expected = share * clear * ((0.91 / 1.09) / OF_PANE if slanted else 1)
    tolerance = 1e-4 if light == "bulb" else 0.02 + 0.03 * slanted
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=1e-7)
    if sheets:
        blocked = Lamps(scene, lamps.indices, through_null=False)
        assert not fixed.direct_irradiance(sample, blocked).numpy().any()


def test_glossy_lobes_are_not_lit_through_cloth_twice():
    """Their rays through it bring all of its light."""
    gloss = {"type": "roughconductor", "material": "none", "alpha": 0.4, "distribution": "ggx"}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": camera((0, -3, 1), (0, 0, 0), 20, (8, 6)),
            "floor": floor(gloss),
            "gauze": floor(GAUZE, z=1.5, size=2000),
            "panel": lamp((0, 1, 2.5), (0, 0, 0), 1.5, 5),
        },
        optimize=False,
    )
    dark = flat_gaussians(np.zeros((1, 3)), np.zeros((1, 3)), size=5)
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = GaussianPhotonField(
        to_device(dark), FieldSettings(search_radius=9, direct="emitters"), scene_bounds(scene)
    )
    found = integrator.render(scene, spp=4096).numpy()
    # From the floor to the lamp, and on the way once through the gauze, which also sends light.
    expected = mi.render(
        scene, integrator=mi.load_dict({"type": "volpath", "max_depth": 3}), spp=4096
    ).numpy()
    assert found.mean() == pytest.approx(expected.mean(), rel=0.02)


def test_no_emitter_brings_no_light(scene):
    assert np.all(irradiance(scene, Lamps(scene, ()), 1) == 0)


def test_small_emitters(scene):
    delta = {place(scene, name) for name in ("bulb", "sun", "torch")}
    assert set(small_lamps(scene, 0.01)) == delta
    assert set(small_lamps(scene, 0.1)) == delta | {place(scene, "spark")}
    assert set(small_lamps(scene, 1.0)) == delta | {place(scene, n) for n in ("spark", "panel")}


def test_a_beam_is_never_small():
    """``directionalarea``: samples of its points do not find the points that it lights."""
    beam = lamp((0, 0, 2), (0, 0, 0), 0.02, 1)
    beam["emitter"] = {"type": "directionalarea", "radiance": rgb(1)}
    scene = mi.load_dict(lit_floor([]) | {"beam": beam}, optimize=False)
    assert small_lamps(scene, 1.0) == []


@pytest.mark.parametrize("names", [("bulb",), ("sun", "torch"), ("bulb", "sun", "torch")])
def test_a_renderer_adds_their_light_to_the_field(names):
    """Beside a field without light: what ``path`` finds with these lights alone."""
    full = mi.load_dict(lit_floor(("bulb", "sun", "torch")), optimize=False)
    alone = mi.load_dict(lit_floor(names), optimize=False)
    dark = flat_gaussians(np.zeros((1, 3)), np.zeros((1, 3)), size=5)
    settings = FieldSettings(search_radius=9, direct=tuple(place(full, n) for n in names))
    integrator = mi.load_dict({"type": "gpf"})
    integrator.field = GaussianPhotonField(to_device(dark), settings, scene_bounds(full))
    found = integrator.render(full, spp=4096).numpy()
    path = mi.load_dict({"type": "path", "max_depth": 2})
    expected = mi.render(alone, integrator=path, spp=4096).numpy()
    np.testing.assert_allclose(found.mean((0, 1)), expected.mean((0, 1)), rtol=0.01)
    np.testing.assert_allclose(found, expected, atol=0.05 * expected.max())


@pytest.mark.parametrize("places", [(3,), (0, 99), (-1,)])
def test_emitters_that_do_not_exist_are_told(places):
    lamp = {"type": "point", "position": [0, 1, 0]}
    scene = mi.load_dict({"type": "scene", "a": lamp, "b": lamp, "c": {"type": "sphere"}})
    with pytest.raises(UserError, match=r"field: names emitters .*, but the scene has 2\. Use a"):
        Lamps(scene, places)
