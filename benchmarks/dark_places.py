"""The time of a sample in hard places, relative to a usual one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi

import gpf
from benchmarks.check_scenes import tumbler, two_rooms
from benchmarks.timing import Row, time_in_turn
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

PASSES = 24
GOAL, GOAL_CUT_GLASS = "1.5", "10"

USUAL = "usual"

BOX = {
    USUAL: View(name=USUAL, origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3),
    "from outside": View(name="outside", origin=(3, 1, 2), target=(0, 0, 0), fov=39.3),
    "from behind": View(name="behind", origin=(0.5, 0.5, -3.9), target=(0, 0, 0), fov=39.3),
    "from far away": View(name="far", origin=(0, 10, 80), target=(0, 0, 0), fov=39.3),
}

# The lamp is in the room at -x; the camera of the fit looks there, away from the other room.
ROOMS = {
    USUAL: View(name=USUAL, origin=(-0.3, 1.6, 1.5), target=(-3, 0.8, -0.8), fov=60),
    "dark room": View(name="dark", origin=(0.4, 1.6, -1.5), target=(3.5, 0.8, 1.2), fov=60),
}

TABLE = {
    USUAL: View(name=USUAL, origin=(-0.5, 1.05, 0.62), target=(-0.5, 0.77, 0.2), fov=34),
    "filled by glass": View(name="glass", origin=(0.2, 0.85, 0.25), target=(0, 0.82, 0), fov=14),
}


def dark_rows(rows: int) -> Iterator[Row]:
    """One sample per pixel from places that the fit did not look at: outside the box, behind it,
    far away, and in the dark room beside the lit one; and close to a tumbler of cut glass."""
    yield from compare("Cornell Box", mi.cornell_box(), BOX, rows)
    yield from compare("two rooms", two_rooms(), ROOMS, rows)
    yield from compare("tumbler", tumbler(), TABLE, rows, GOAL_CUT_GLASS)


def compare(
    name: str, description: Any, views: Mapping[str, View], rows: int, goal: str = GOAL
) -> Iterator[Row]:
    """Fit a field for the usual view of a scene, and time all views in turn."""
    scene = mi.load_dict(description, optimize=False)
    sensors = {place: make_sensor(view, rows, rows) for place, view in views.items()}
    field = gpf.fit(scene, [sensors[USUAL]], passes=PASSES)
    integrator = mi.load_dict({"type": "gpf", "record": True})
    integrator.field = field

    def render(sensor: mi.Sensor, seed: int) -> None:
        dr.eval(mi.render(scene, sensor=sensor, integrator=integrator, spp=1, seed=seed))

    work = {place: partial(render, sensor) for place, sensor in sensors.items()}
    timings = time_in_turn(work)
    for place in list(sensors)[1:]:
        yield Row(
            f"the same, {rows}², {name}, {place}, vs the usual view",
            f"{timings.milliseconds(place):.1f} ms",
            f"{timings.milliseconds(USUAL):.1f} ms",
            f"{timings.ratio(place, USUAL):.2f}",
            goal,
        )
