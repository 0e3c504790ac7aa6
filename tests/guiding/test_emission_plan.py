"""Where photons are needed, how they are emitted, and how many."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.core.structs import take
from gpf.guiding.arriving_noise import least_noisy
from gpf.guiding.emission_plan import EmissionPlan, VisibleRegionSettings
from gpf.guiding.pilot import Pilot, trace_pilot
from gpf.photons.emission import Emitted, emit_light
from gpf.photons.tracing import PathSettings
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from tests.furnace import cornell_box
from tests.guiding.rooms import RIGHT_ROOM, two_rooms


def plan(efficiency: float, photons_per_path: float) -> EmissionPlan:
    """As after a pilot in which that share of the paths brought anything, all of them alike."""
    paths = 100_000
    power = np.zeros(paths)
    power[: round(efficiency * paths)] = 1
    photons = np.full(paths, photons_per_path)
    return EmissionPlan(None, PathSettings(paths), Pilot(power, photons, seed=0))


@pytest.mark.parametrize(
    ("efficiency", "photons_per_path", "for_passes", "for_photons"),
    [
        (1.0, 3.0, 100_000, 100_000),
        (0.25, 0.7, 200_000, 400_000),
        (0.13, 0.1, 400_000, 3_000_000),
    ],
)
def test_automatic_numbers_of_paths(efficiency, photons_per_path, for_passes, for_photons):
    emission = plan(efficiency, photons_per_path)
    assert emission.paths_for_passes(50_000) == for_passes
    assert emission.paths_for_gaussians(100_000) == for_photons


def test_a_cap_that_bites_is_said(caplog):
    emission = plan(0.01, 0.001)
    assert emission.paths_for_passes(50_000) == 500_000
    assert "5,000,000 photon paths would be needed; auto takes at most 500,000" in caplog.text


def make_plan(scene: mi.Scene, view: View, **settings: bool) -> EmissionPlan:
    few = VisibleRegionSettings(rays=1 << 16, pilot_paths=100_000, **settings)
    return EmissionPlan.make(scene, [make_sensor(view, 8, 6)], few)


def test_emission_is_guided_where_most_photons_would_miss_the_region():
    rooms = two_rooms(gap=0.1)
    guided = make_plan(rooms, RIGHT_ROOM)
    plain = make_plan(rooms, RIGHT_ROOM, guide=False)
    everywhere = make_plan(rooms, RIGHT_ROOM, use=False)
    assert [p.facts()["emission_guided"] for p in (guided, plain, everywhere)] == [
        True,
        False,
        False,
    ]
    assert guided.pilot.efficiency > 1.2 * plain.pilot.efficiency
    assert everywhere.region is None and plain.region is not None
    assert everywhere.pilot.photons_per_path > 10 * plain.pilot.photons_per_path


@pytest.mark.parametrize("count", [8, 100])
def test_few_visible_points_tell_which_source_has_less_noise(count):
    rooms = two_rooms(gap=0.1)
    region = make_plan(rooms, RIGHT_ROOM, guide=False).region
    assert region is not None
    few = take(region.points, dr.arange(mi.UInt32, count))

    def unsteady(scene: mi.Scene, sampler: mi.Sampler) -> Emitted:
        """Most of the light comes from one path in ten."""
        ray, power, emitter = emit_light(scene, sampler)
        return ray, power * dr.select(sampler.next_1d() < 0.1, 10, 0), emitter

    for sources, best in (([emit_light, unsteady], 0), ([unsteady, emit_light], 1)):
        assert least_noisy(rooms, few, sources, PathSettings(200_000), seed=1) == best


def test_a_source_serves_frames_that_it_lights_as_well():
    def again(plan, **room):
        few = VisibleRegionSettings(rays=1 << 16, pilot_paths=100_000)
        return plan.again(two_rooms(**room), [make_sensor(RIGHT_ROOM, 8, 6)], few)

    first = make_plan(two_rooms(gap=0.1), RIGHT_ROOM)
    wider = again(first, gap=0.12)
    assert wider is not None and wider.source is first.source
    assert wider.pilot.efficiency > first.pilot.efficiency
    assert wider.region is not None
    # The light comes in elsewhere.
    assert again(first, gap=0.1, height=-0.8) is None


def test_a_box_that_is_seen_whole_needs_no_guide():
    box = cornell_box()
    del box["sensor"]
    front = View(name="front", origin=(0, 0, 3.6), target=(0, 0, 0), fov=45)
    emission = make_plan(mi.load_dict(box, optimize=False), front)
    assert emission.region is not None and emission.source is emit_light
    assert 0.3 < emission.pilot.efficiency <= 1


def test_where_direct_light_is_sampled_emission_is_guided_to_the_other_photons():
    """A black floor and a white wall, each before a lamp of its own: most photons that land there
    are direct light from the floor's, and most others come from the wall."""

    def lamp(place: list[float], target: list[float], radiance: float) -> dict[str, object]:
        to_world = mi.ScalarTransform4f().look_at(origin=place, target=target, up=[0, 0.1, 1])
        emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
        return {"type": "rectangle", "to_world": to_world.scale(0.2), "emitter": emitter}

    def matt(reflectance: float) -> dict[str, object]:
        return {"type": "diffuse", "reflectance": {"type": "rgb", "value": reflectance}}

    T = mi.ScalarTransform4f
    floor, wall = T().rotate([1, 0, 0], -90), T().translate([0, 2, -3]).scale(2)
    parts = {
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": matt(0.02)},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": matt(0.9)},
        "above": lamp([0, 2, 0], [0, 0, 0], 10),
        "before": lamp([0, 2, -2], [0, 2, -3], 1),
    }
    parts |= {f"away_{k}": lamp([0, 5 + k, 0], [0, 9, 0], 10) for k in range(4)}
    # Optimized scenes have their lamps in any order, and the guide would be another one each time.
    scene = mi.load_dict({"type": "scene"} | parts, optimize=False)
    view = View(name="floor", origin=(0, 1.5, 1.5), target=(0, 0, 0), fov=30)
    few = VisibleRegionSettings(rays=1 << 16, pilot_paths=100_000)
    powers = {}
    for direct in ("emitters", "photons"):
        plan = EmissionPlan.make(scene, [make_sensor(view, 8, 6)], few, direct=direct)
        assert plan.source is not emit_light
        others = PathSettings(200_000, source=plan.source, indirect=True)
        powers[direct] = trace_pilot(scene, plan.region, others, seed=1)
    assert powers["emitters"].efficiency > 2 * powers["photons"].efficiency
    totals = [pilot.power.sum() for pilot in powers.values()]
    assert totals[0] == pytest.approx(totals[1], rel=0.05)
