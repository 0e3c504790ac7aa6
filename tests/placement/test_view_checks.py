"""Views that are of use, and those that are not."""

import gc

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from gpf.placement.view_checks import covered, look_around, report_views, spacing
from gpf.scene.views import View

T = mi.ScalarTransform4f


def basin(water: bool = True) -> mi.Scene:
    """A box x, y, z in [-1, 1] open on top, water up to y = 0, a small glass ball and a crate."""
    crate = T().translate([0.5, -0.5, 0.5]).scale(0.2)
    grey = {"type": "twosided", "bsdf": {"type": "diffuse"}}
    glass = {"type": "dielectric"}
    scene = {
        "type": "scene",
        "ball": {"type": "sphere", "center": [0, 0.6, 0], "radius": 0.2, "bsdf": glass},
        "crate": {
            "type": "cube",
            "to_world": crate,
            "bsdf": grey,
        },
        "sun": {"type": "point", "position": [0.3, 3, 0.2]},
    }
    for name, axis, angle in [
        ("floor", [1, 0, 0], -90), ("back", [0, 1, 0], 0), ("left", [0, 1, 0], 90),
        ("right", [0, 1, 0], -90), ("front", [0, 1, 0], 180),
    ]:  # fmt: skip
        turn = T().rotate(axis, angle).translate([0, 0, -1])
        scene[name] = {"type": "rectangle", "to_world": turn}
    if water:
        flat = T().rotate([1, 0, 0], -90)
        scene["water"] = {"type": "rectangle", "to_world": flat, "bsdf": glass}
    return mi.load_dict(scene, optimize=False)


@pytest.fixture(scope="module")
def scene() -> mi.Scene:
    return basin()


def report(scene, origin, target, **more):
    return report_views(scene, [View(name="a", origin=origin, target=target, fov=50, **more)])[0]


def test_a_good_view_has_no_faults(scene):
    found = report(scene, (0.3, 0.5, 0.8), (0, -0.5, -0.5))
    assert found.faults() == []
    assert found.diffuse_share > 0.9 and found.lit_share > 0.8
    # Its nearest surface is the wall at z = 1; it sees things more than a unit away.
    assert 0.2 / 2.5 < found.clearance < 0.2 / 1


@pytest.mark.parametrize(
    ("origin", "target", "fault"),
    [
        ((0, -0.4, 0.8), (0, -0.5, -0.5), "inside a refracting object"),
        ((0, 0.6, 0.1), (0, 0, -1), "inside a refracting object"),
        ((0.5, -0.5, 0.45), (0.5, -0.5, 0), "no light reaches what it sees"),
        ((0, 0.5, 0.9), (0, 3, 0.8), "% of its pixels end on a diffuse surface"),
        ((0.5, 0.5, 0.999), (0, 0, 0), "its camera touches a surface"),
    ],
    ids=["under water", "in the ball", "in the crate", "at the sky", "at the wall"],
)  # fmt: skip
def test_a_bad_view_is_told_why(scene, origin, target, fault):
    assert any(fault in found for found in report(scene, origin, target).faults())


def test_without_water_the_same_camera_is_in_the_air():
    assert look_around(basin(), [(0, -0.4, 0.8)])[1][0]
    assert not look_around(basin(water=False), [(0, -0.4, 0.8)])[1][0]


def test_behind_opaque_walls_a_camera_is_in_the_air_below_the_water_level():
    assert not look_around(basin(), [(1.5, -0.5, 0)])[1][0]


def test_a_scene_may_be_meant_to_be_seen_from_inside(scene):
    found = report(scene, (0, -0.4, 0.8), (0, -0.5, -0.5))
    assert found.inside and found.faults(home_inside=True) == []


def test_a_small_thing_on_a_large_plane_can_be_looked_at():
    """Sizes are those of what the camera sees, not of the scene's bounding box."""
    plane = T().rotate([1, 0, 0], -90).scale(3000)
    thing = mi.load_dict(
        {
            "type": "scene",
            "plane": {"type": "rectangle", "to_world": plane},
            "cube": {"type": "cube", "to_world": T().translate([0, 0.5, 0]).scale(0.5)},
            "sky": {"type": "constant"},
        },
        optimize=False,
    )
    assert report(thing, (3, 1, 2.6), (0, 0.4, 0)).faults() == []


def test_distance_is_to_the_nearest_surface_in_any_direction(scene):
    distance, _ = look_around(scene, [(0.5, 0.5, 0.7)])
    assert distance[0] == pytest.approx(0.3, rel=0.01)


def test_several_views_have_reports_of_their_own(scene):
    views = [
        View(name="a", origin=(0.3, 0.5, 0.8), target=(0, -0.5, -0.5), fov=50),
        View(name="b", origin=(0, 0.5, 0.9), target=(0, 3, 0.8), fov=50),
    ]
    first, second = report_views(scene, views, aspect=1.5)
    assert (first.name, second.name) == ("a", "b")
    assert first.diffuse_share > 0.9 and second.diffuse_share < 0.2
    for found in (first, second):
        assert found.seen().shape == (round(found.diffuse_share * 48 * 72), 3)


def test_points_are_covered_by_near_ones():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], float)
    by = np.array([[0, 0, 0.1], [1, 0.3, 0]], float)
    assert covered(points, by, within=0.2).tolist() == [True, False, False]
    assert spacing(points) == 1


def test_where_no_lamp_shines_nothing_is_lit():
    """Not a single photon lands, as under a sun below the horizon."""
    sky = {"type": "constant", "radiance": 0}
    dark = mi.load_dict({"type": "scene", "floor": {"type": "rectangle"}, "sky": sky})
    view = View(name="a", origin=(0, 0, 2), target=(0, 0.1, 0), fov=20)
    found = report_views(dark, [view])[0]
    assert found.lit_share == 0 and found.diffuse_share == 1


def test_further_views_have_no_kernels_of_their_own(scene):
    views = [
        View(name=str(k), origin=(0.1 * k, 0.5, 0.8), target=(0, -0.5, -0.5), fov=50)
        for k in range(5)
    ]
    gc.collect()  # kernels are made for the materials of all scenes in memory
    few = kernels_of(lambda: report_views(scene, views[:2]))
    assert len(few) > 5 and kernels_of(lambda: report_views(scene, views)) == few


def kernels_of(call) -> set[str]:
    """The kernels that a call launches."""
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        call()
        return {entry["hash"] for entry in dr.kernel_history([dr.KernelType.JIT])}
