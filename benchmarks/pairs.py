"""`python -m benchmarks.pairs`: whether memory or arithmetic limits a pair of photon and point.

Points of a 512² film gather photons of 100,000 paths in the Cornell box with a glass sphere; then a
quarter of these photons with twice the radius, and so on: as many pairs, in less and less memory.
If memory set the time per pair, it would fall as soon as the photons fit into a cache. The table
also has the time of the same search without the photons' normals and powers, and of one that does
not read photons at all.
"""

from __future__ import annotations

import math
from typing import Any

import drjit as dr
import mitsuba as mi
from rich.console import Console
from rich.table import Table

from benchmarks.glass_sphere import PHOTONS, load_scene
from benchmarks.timing import time_in_turn
from gpf.camera.film import sample_film
from gpf.core.runtime import choose_variant
from gpf.core.spatial_hash import SpatialHash
from gpf.core.structs import Photons
from gpf.photons.density import PhotonDensity
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds

SIZE, RADIUS, PARTS = 512, 0.05, (1, 4, 16, 64)


def main() -> None:
    """Print a row for each share of the photons."""
    choose_variant()
    scene = load_scene(SIZE, SIZE)
    points = sample_film(scene, scene.sensors()[0], 1).points
    photons = record_photons(scene, PathSettings(PHOTONS), seed=1)
    dr.eval(points)
    table = Table("photons", "MB", "pairs, M", "in the ball, M", title=f"{SIZE}², radius {RADIUS}")
    for name in ("estimate", "positions only", "loop only"):
        table.add_column(f"{name}, ns per pair")
    for part in PARTS:
        chosen = part * dr.arange(mi.UInt32, dr.width(photons.p) // part)
        some = dr.gather(Photons, photons, chosen)
        table.add_row(*measure(some, points, RADIUS * math.sqrt(part), scene_bounds(scene)))
    Console(width=120).print(table)


def measure(photons: Photons, points: Any, radius: float, bounds: Any) -> list[str]:
    """The cells of a row."""
    density = PhotonDensity(photons, radius, bounds)
    grid = SpatialHash(photons.p, cell=1.01 * radius, bounds=bounds)
    reach = dr.opaque(mi.Float, radius)

    def pairs(only_inside: bool) -> mi.UInt32:
        def add(count, index, record, distance2, inside):  # type: ignore[no-untyped-def]
            return count + dr.select(inside, mi.UInt32(1), 0) if only_inside else count + 1

        return grid.visit(points.p, reach, add, mi.UInt32(0), points.valid)

    def estimate(_: int) -> None:
        dr.eval(density.irradiance(points.p, points.n, points.valid))

    work = {
        "estimate": estimate,
        "positions": lambda _: dr.eval(pairs(True)),
        "loop": lambda _: dr.eval(pairs(False)),
    }
    timings = time_in_turn(work)
    looked_at, inside = (float(dr.sum(mi.Float64(pairs(only)))[0]) for only in (False, True))
    nanoseconds = [f"{1e6 * timings.milliseconds(name) / looked_at:.2f}" for name in work]
    size = 32e-6 * dr.width(photons.p)  # eight floats each
    cells = [f"{size:.2f}", f"{1e-6 * looked_at:.0f}", f"{1e-6 * inside:.0f}"]
    return [str(dr.width(photons.p)), *cells, *nanoseconds]


if __name__ == "__main__":
    main()
