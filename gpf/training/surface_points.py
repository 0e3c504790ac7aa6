"""Supervised points on surfaces, lit or visible, and some beyond what is visible."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.visible_points import find_visible_points
from gpf.core.errors import UserError
from gpf.core.morton import order_in_space
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import Photons, VisiblePoints, concatenate, take, to_numpy
from gpf.guiding.density_control import count_in_cells, oriented_places
from gpf.guiding.emission_plan import EmissionPlan
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.sppm.fixed_points import FixedPoints
from gpf.sppm.passes import PassSettings

# Largest share of the surface points beyond the visible region, and of the work of gathering
# photons at them. Without this limit they could dominate the cost: a room next door may be the
# brightest.
BEYOND = 0.1

# Edge of the cells in which points are counted, in kernel radii: their area is that of the kernel.
CELL = 1.77

# Largest number of paths whose photons show what is lit beyond the visible region.
ARRIVAL_PATHS = 100_000


@dataclass(frozen=True)
class Places:
    """Points among which surface points are chosen.

    Attributes
    ----------
    lit: photons in the visible region.
    seen: visible points of cameras, all of them valid.
    arrivals: photons of some paths, also outside the visible region.
    beyond: the photons of ``arrivals`` outside the visible region; cameras at other places may see
        them.
    """

    lit: Photons
    seen: VisiblePoints | None = None
    arrivals: Photons | None = None
    beyond: Photons | None = None


def surface_points(
    scene: mi.Scene,
    plan: EmissionPlan,
    settings: PassSettings,
    count: int,
    seed: int,
    photons: Photons | None = None,
) -> VisiblePoints:
    """Supervised points on surfaces.

    Parameters
    ----------
    plan: where photons are needed.
    count: largest number of points.
    photons: points are chosen among these and among visible points; by default photons of twice as
        many paths as in a pass, so that there are more than needed.
    """
    if photons is None:
        photons = plan.collect(scene, 2 * settings.photons_per_pass, seed, settings.rr_depth)
    places = Places(photons)
    if plan.region is not None:
        arrivals = record_photons(
            scene,
            PathSettings(
                min(ARRIVAL_PATHS, settings.photons_per_pass),
                rr_depth=settings.rr_depth,
                source=plan.source,
            ),
            seed=pass_seed(seed, 0, Stream.ARRIVALS),
        )
        beyond = plan.region.reject(arrivals)
        seen = see_further(scene, plan.region.points, pass_seed(seed, 0, Stream.FURTHER))
        places = Places(photons, seen, arrivals, beyond)
    return sample_surface_points(places, count, settings.initial_radius, scene_bounds(scene), seed)


def see_further(scene: mi.Scene, points: VisiblePoints, seed: int) -> VisiblePoints:
    """The points, and those from which their diffuse light comes: visible points of one ray from
    each, with directions distributed in proportion to the cosine; N to 2 N points."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, dr.width(points.p))
    ray, _ = FixedPoints(scene, points).cosine_rays(sampler.next_2d())
    found = concatenate([points, find_visible_points(scene, sampler, ray)[0]])
    return take(found, dr.compress(found.valid))


def sample_surface_points(
    places: Places, count: int, radius: float, bounds: tuple[Any, Any], seed: int
) -> VisiblePoints:
    """At most ``count`` positions of photons and visible points, ordered along a curve in space.

    One half are photons with equal probability, so that bright regions have many points. The other
    half are photons and visible points, with probabilities in inverse proportion to their density
    on the surface. This half is nearly uniform over lit and visible surfaces and twice as dense
    along edges: too few photons land in corners and shadows to learn their light from photons
    alone. A share of at most :data:`BEYOND` is spread in the same way beyond the visible region.

    Parameters
    ----------
    radius: radius of a kernel, world units; densities are measured in cells of its size.

    Raises
    ------
    UserError: no photon landed in the visible region.
    """
    lit = dr.width(places.lit.p)
    if lit == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    beyond = 0 if places.beyond is None else dr.width(places.beyond.p)
    sets = [places.lit, places.seen, places.beyond if beyond else None]
    p = np.concatenate([to_numpy(s.p) for s in sets if s is not None])
    n = np.concatenate([to_numpy(s.n) for s in sets if s is not None])
    every = len(p)
    known = every - beyond
    width = CELL * radius
    cells = oriented_places(p, n, width)
    sparse = 1 / count_in_cells(cells, width, cells)[0]
    rng = np.random.default_rng(pass_seed(seed, 0, Stream.SURFACE_POINTS))

    def spread(start: int, stop: int, number: int) -> np.ndarray:
        if number == 0:
            return np.zeros(0, np.int64)
        chances = sparse[start:stop]
        return start + rng.choice(stop - start, number, False, chances / chances.sum())

    count = min(count, every)
    far = min(round(BEYOND * count), beyond)
    near = min(count - far, known)
    third = spread(known, every, count - near)
    first = rng.choice(lit, min(near // 2, lit), replace=False)
    sparse[first] = 0  # they are chosen already
    second = spread(0, known, near - len(first))
    here = np.concatenate([first, second])
    if len(third) and places.arrivals is not None:
        arrivals = oriented_places(to_numpy(places.arrivals.p), to_numpy(places.arrivals.n), width)
        work = [
            count_in_cells(cells[points], width, arrivals)[0].mean() for points in (here, third)
        ]
        third = rng.permutation(third)[: round(min(1, work[0] / work[1]) * len(third))]
    points = np.sort(np.concatenate([here, third]))
    points = points[order_in_space(p[points], radius / 2)]
    return VisiblePoints.seen_directly(p[points], n[points])
