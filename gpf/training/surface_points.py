"""Samples of surfaces that are lit or seen: points to supervise where no training view looks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.morton import order_in_space
from gpf.core.random import Stream, pass_seed
from gpf.core.structs import OrientedPoints, Photons, VisiblePoints, concatenate, to_numpy
from gpf.guiding.emission_plan import EmissionPlan
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.sppm.density import PhotonDensity
from gpf.sppm.passes import PassSettings
from gpf.sppm.reference import fixed_points

# The share of the points, and of the work of gathering photons at them, that lies beyond what is
# seen: where most of the light is, as in the room next door, points cost most.
BEYOND = 0.1

# Name of the set of surface samples among sets of points that views see; no view can be called so.
SURFACES = "surfaces of the scene"

# Paths whose photons tell what is lit beyond the visible region, at most. They are weighed by how
# many lie within a pass's kernel: the cost of more grows with their square.
ARRIVAL_PATHS = 100_000


@dataclass(frozen=True)
class Places:
    """Where surface points may lie.

    Attributes
    ----------
    lit: photons where cameras look.
    seen: visible points of cameras, all of them valid.
    arrivals: photons of some paths, wherever they landed.
    beyond: those of them where no camera looks that is known, but one that stands elsewhere may.
    """

    lit: Photons
    seen: VisiblePoints | None = None
    arrivals: Photons | None = None
    beyond: Photons | None = None


def share_of_pixels(points: int, pixels: int) -> float:
    """The share of ``pixels`` that has so many points."""
    return min(1.0, points / pixels)


def target_points(
    scene: mi.Scene,
    sensors: Mapping[str, mi.Sensor],
    plan: EmissionPlan,
    settings: PassSettings,
    share: float,
    surfaces: int,
    seed: int,
    photons: Photons | None = None,
) -> dict[str, VisiblePoints]:
    """Points to supervise: fixed points of a share of each view's pixels, by the view's name, and
    at most so many samples of surfaces, as :data:`SURFACES`.

    Parameters
    ----------
    photons: surface samples lie where these do, and where cameras look; by default twice as many
        as a pass has, so that there is a choice.
    """
    points = {
        name: fixed_points(scene, sensor, name, settings, seed, share)
        for name, sensor in sensors.items()
    }
    if surfaces > 0:
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
            places = Places(photons, plan.region.points, arrivals, beyond)
        points[SURFACES] = sample_surface_points(
            places, surfaces, settings.initial_radius, scene_bounds(scene), seed
        )
    return points


def sample_surface_points(
    places: Places, count: int, radius: float, bounds: tuple[Any, Any], seed: int
) -> VisiblePoints:
    """Positions of photons and of what cameras see, ``count`` or as many as there are.

    One half is drawn from the photons alike, so that bright regions have many. The other is drawn
    from photons and visible points, with probabilities in inverse proportion to their density on
    their surface (within ``radius``, world units), which makes it nearly uniform over all that is
    lit or seen, and twice as dense along edges: joints and shadows get photons too seldom to be
    learned from photons alone. A share, :data:`BEYOND`, is spread likewise over what lies beyond.
    Those that follow each other lie close together.
    """
    lit = dr.width(places.lit.p)
    if lit == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    beyond = 0 if places.beyond is None else dr.width(places.beyond.p)
    sets = [places.lit, places.seen, places.beyond if beyond else None]
    p = concatenate([s.p for s in sets if s is not None])
    n = concatenate([s.n for s in sets if s is not None])
    every = dr.width(p)
    known = every - beyond
    sparse = 1 / _at(
        PhotonDensity.of_points(OrientedPoints(p, n), radius, bounds), p, n, np.arange(every)
    )
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
    sparse[first] = 0  # they are in already
    second = spread(0, known, near - len(first))
    here = np.concatenate([first, second])
    if len(third) and places.arrivals is not None:
        landed = OrientedPoints(places.arrivals.p, places.arrivals.n)
        arrivals = PhotonDensity.of_points(landed, radius, bounds)
        work = [_at(arrivals, p, n, points).mean() for points in (here, third)]
        third = rng.permutation(third)[: round(min(1, work[0] / work[1]) * len(third))]
    points = np.sort(np.concatenate([here, third]))
    points = points[order_in_space(to_numpy(p)[points], radius / 2)]
    chosen = mi.UInt32(points.astype(np.uint32))
    return VisiblePoints(
        p=dr.gather(mi.Point3f, p, chosen),
        n=dr.gather(mi.Normal3f, n, chosen),
        reflectance=mi.Color3f(1),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0),
        depth=mi.UInt32(0),
        valid=dr.full(mi.Bool, True, dr.width(chosen)),
    )


def _at(density: PhotonDensity, p: mi.Point3f, n: mi.Normal3f, chosen: np.ndarray) -> np.ndarray:
    """A density at some of the points, (len(chosen),)."""
    lanes = mi.UInt32(chosen.astype(np.uint32))
    found = density.irradiance(dr.gather(mi.Point3f, p, lanes), dr.gather(mi.Normal3f, n, lanes))
    return np.asarray(found.x.numpy(), dtype=np.float64)
