"""Samples of surfaces that are lit or seen: points to supervise where no training view looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.density import PhotonDensity
from gpf.errors import UserError
from gpf.seeds import pass_seed
from gpf.structs import Photons, VisiblePoints, concatenate

# The share of the points that lie beyond what is seen.
BEYOND = 0.1


@dataclass(frozen=True)
class Places:
    """Where surface points may lie.

    Attributes
    ----------
    lit: photons where cameras look.
    seen: visible points of cameras, all of them valid.
    beyond: photons where no camera looks that is known, but one that stands elsewhere may.
    """

    lit: Photons
    seen: VisiblePoints | None = None
    beyond: Photons | None = None


def sample_surface_points(
    places: Places, count: int, radius: float, bounds: tuple[Any, Any], seed: int
) -> VisiblePoints:
    """Positions of photons and of what cameras see, ``count`` or as many as there are.

    One half is drawn from the photons alike, so that bright regions have many. The other is drawn
    from photons and visible points, with probabilities in inverse proportion to their density on
    their surface (within ``radius``, world units), which makes it nearly uniform over all that is
    lit or seen, and twice as dense along edges: joints and shadows get photons too seldom to be
    learned from photons alone. A share, :data:`BEYOND`, is spread likewise over the rest.
    """
    lit = dr.width(places.lit.p)
    if lit == 0:
        raise UserError(
            "scene", "no photon reached a diffuse surface", "Check where the emitters point."
        )
    sets = [s for s in (places.lit, places.seen, places.beyond) if s is not None]
    p, n = concatenate([s.p for s in sets]), concatenate([s.n for s in sets])
    every, beyond = dr.width(p), 0 if places.beyond is None else dr.width(places.beyond.p)
    known = every - beyond
    sparse = 1 / _density(p, n, radius, bounds)
    rng = np.random.default_rng(pass_seed(seed, 0, stream=5))

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
    chosen = mi.UInt32(np.sort(np.concatenate([first, second, third])).astype(np.uint32))
    return VisiblePoints(
        p=dr.gather(mi.Point3f, p, chosen),
        n=dr.gather(mi.Normal3f, n, chosen),
        reflectance=mi.Color3f(1),
        throughput=mi.Color3f(1),
        emission=mi.Color3f(0),
        depth=mi.UInt32(0),
        valid=dr.full(mi.Bool, True, count),
        lit=mi.Bool(False),
    )


def _density(p: mi.Point3f, n: mi.Normal3f, radius: float, bounds: tuple[Any, Any]) -> np.ndarray:
    """How many points (N, 3) lie around each of them, up to a factor, (N,)."""
    count = dr.width(p)
    power = mi.Color3f(dr.full(mi.Float, 1, count))
    alike = Photons(p=p, n=n, power=power, depth=dr.zeros(mi.UInt32, count))
    density = PhotonDensity(alike, radius, bounds).irradiance(p, n)
    return np.asarray(density.x.numpy(), dtype=np.float64)
