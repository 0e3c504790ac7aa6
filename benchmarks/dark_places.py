"""`python -m benchmarks.dark_places`: time of a sample in hard places, relative to a usual one.

The field is fitted for the scene's usual camera. One sample per pixel at 256 rows is timed from
this camera and from places that the fit did not look at: outside the box, behind it, far away, and
in the dark room beside the lit one; and close to a tumbler of cut glass. `goal` is the largest
ratio aimed at.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from rich.console import Console
from rich.table import Table

import gpf
from benchmarks.check_scenes import tumbler, two_rooms
from benchmarks.timing import time_in_turn
from gpf.rendering.aovs import MOST_COVERAGE
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View

ROWS, PASSES = 256, 24
GOAL, GOAL_CUT_GLASS = 1.5, 10

USUAL = "usual"

BOX = {
    USUAL: View(name=USUAL, origin=(0, 0, 3.9), target=(0, 0, 0), fov=39.3),
    "outside": View(name="outside", origin=(3, 1, 2), target=(0, 0, 0), fov=39.3),
    "behind": View(name="behind", origin=(0.5, 0.5, -3.9), target=(0, 0, 0), fov=39.3),
    "far away": View(name="far", origin=(0, 10, 80), target=(0, 0, 0), fov=39.3),
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


def main() -> None:
    """Print one line for each place."""
    table = Table("scene", "place", "ms", "× usual", "no light stored", "goal")
    add_rows(table, "Cornell Box", mi.cornell_box(), BOX)
    add_rows(table, "two rooms", two_rooms(), ROOMS)
    add_rows(table, "tumbler", tumbler(), TABLE, GOAL_CUT_GLASS)
    Console(width=100).print(table)


def add_rows(
    table: Table, name: str, description: Any, views: Mapping[str, View], goal: float = GOAL
) -> None:
    """Fit a field for the usual view of a scene, and time all views in turn."""
    scene = mi.load_dict(description, optimize=False)
    sensors = {place: make_sensor(view, ROWS, ROWS) for place, view in views.items()}
    field = gpf.fit(scene, [sensors[USUAL]], passes=PASSES)
    integrator = mi.load_dict({"type": "gpf", "record": True})
    looking = mi.load_dict({"type": "gpf", "aovs": "coverage"})
    integrator.field = looking.field = field

    def render(sensor: mi.Sensor, seed: int) -> None:
        dr.eval(mi.render(scene, sensor=sensor, integrator=integrator, spp=1, seed=seed))

    work: dict[str, Callable[[int], None]] = {
        place: partial(render, sensor) for place, sensor in sensors.items()
    }
    timings = time_in_turn(work)
    for place, sensor in sensors.items():
        layers = np.array(mi.render(scene, sensor=sensor, integrator=looking, spp=1))
        empty = (layers[..., 3] >= 0.5 * MOST_COVERAGE).mean()
        table.add_row(
            name,
            place,
            f"{timings.milliseconds(place):.1f}",
            f"{timings.ratio(place, USUAL):.2f}",
            f"{empty:.0%} of the pixels",
            "" if place == USUAL else f"{goal}",
        )


if __name__ == "__main__":
    from gpf.core.runtime import choose_variant

    choose_variant("auto")
    main()
