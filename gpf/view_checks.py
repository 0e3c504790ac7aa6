"""Whether a view is of use: where its camera stands, and what its pixels end on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.progressive import PassSettings, gather_pass, sample_film
from gpf.structs import VisiblePoints, concatenate, scene_bounds, to_numpy
from gpf.views import View, make_sensor

# A view has to end on diffuse surfaces with at least this share of its pixels.
LEAST_DIFFUSE = 0.5
# Of the pixels that end on diffuse surfaces, so many have to receive some light.
LEAST_LIT = 0.1
# The camera keeps this distance from all surfaces, in diagonals of the scene's bounding box.
LEAST_CLEARANCE = 1e-3

# Points of a view that another one sees have one of its points within so many spacings.
COVERED_WITHIN = 2.5

_ROWS = 48
_DIRECTIONS = 1024


@dataclass(frozen=True)
class ViewReport:
    """What was found out about a view.

    Attributes
    ----------
    name: of the view.
    diffuse_share: part of the pixels whose path ends on a diffuse surface.
    lit_share: part of those pixels that photons reach.
    clearance: distance from the camera to the nearest surface, in diagonals of the scene.
    inside_share: of the directions in which the camera meets a refracting surface before an
        opaque one or behind it, the part that meets it from within.
    points: the visible points, one per pixel.
    """

    name: str
    diffuse_share: float
    lit_share: float
    clearance: float
    inside_share: float
    points: VisiblePoints

    def seen(self) -> np.ndarray:
        """The visible points on diffuse surfaces, (N, 3)."""
        return to_numpy(self.points.p)[np.asarray(self.points.valid.numpy())]

    def faults(self) -> list[str]:
        """What speaks against the view, in words; nothing where it is fit for use."""
        found = []
        if self.diffuse_share < LEAST_DIFFUSE:
            share = f"{100 * self.diffuse_share:.0f}%"
            found.append(f"only {share} of its pixels end on a diffuse surface")
        elif self.lit_share < LEAST_LIT:
            found.append("no light reaches what it sees: it may be inside of an object")
        if self.clearance < LEAST_CLEARANCE:
            found.append("its camera touches a surface")
        if self.inside_share > 0.5:
            found.append("its camera is inside of a refracting object")
        return found


def report_views(
    scene: mi.Scene, views: Sequence[View], aspect: float = 1.0, seed: int = 0
) -> list[ViewReport]:
    """Look into a scene through each view, at 48 rows of pixels, and around each camera.

    One pass of photons with a wide kernel tells what is lit.
    """
    width = max(1, round(_ROWS * aspect))
    points = []
    for number, view in enumerate(views):
        sampler = mi.load_dict({"type": "independent", "sample_count": 1})
        sampler.seed(seed + number, width * _ROWS)
        points.append(sample_film(scene, make_sensor(view, width, _ROWS), sampler).points)
        dr.eval(points[-1])
    diagonal = _diagonal(scene)
    settings = PassSettings(photons_per_pass=200_000, initial_radius=1e-2 * diagonal)
    irradiance = gather_pass(scene, concatenate(points), 1, settings, seed)
    lit = np.asarray((dr.max(irradiance) > 0).numpy()).reshape(len(views), -1)
    reports = []
    for view, seen, bright in zip(views, points, lit, strict=True):
        valid = np.asarray(seen.valid.numpy())
        clearance, inside = look_around(scene, view.origin)
        reports.append(
            ViewReport(
                name=view.name,
                diffuse_share=float(valid.mean()),
                lit_share=float(bright[valid].mean()) if valid.any() else 0.0,
                clearance=clearance / diagonal,
                inside_share=inside,
                points=seen,
            )
        )
    return reports


def spacing(points: np.ndarray) -> float:
    """Median distance of points (N, 3) to their nearest neighbours, world units."""
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def covered(points: np.ndarray, by: np.ndarray, within: float) -> np.ndarray:
    """Which of ``points`` (N, 3) have one of ``by`` (M, 3) that near, (N,)."""
    distance, _ = cKDTree(by).query(points, distance_upper_bound=within)
    return np.asarray(np.isfinite(distance))


def look_around(scene: mi.Scene, origin: Sequence[float]) -> tuple[float, float]:
    """Distance to the nearest surface, world units, and the ``inside_share`` of a position.

    In each of some thousand directions, evenly spread, the first refracting surface is looked for,
    opaque ones being passed through. In a solid that is closed by opaque walls, as water in a
    basin, the rays that meet a refracting surface at all meet it from behind.
    """
    index = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / _DIRECTIONS, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)])
    d = mi.Vector3f(directions.astype(np.float32))
    o = mi.Point3f(*origin)
    dr.make_opaque(o)
    ray = mi.Ray3f(o, d)
    nearest = float(dr.min(scene.ray_intersect_preliminary(ray).t)[0])

    searching = dr.full(mi.Bool, True, _DIRECTIONS)
    within, without = mi.Bool(False), mi.Bool(False)
    for _ in range(32):  # surfaces along a ray; more are not looked at
        si = scene.ray_intersect(ray, active=searching)
        searching &= si.is_valid()
        refracts = searching & _refracts(si, searching)
        within |= refracts & (dr.dot(si.n, d) > 0)
        without |= refracts & (dr.dot(si.n, d) <= 0)
        searching &= ~refracts
        ray = si.spawn_ray(d)
        dr.eval(searching, within, without, ray)
        if not dr.any(searching):
            break
    met = float(dr.count(within)[0]), float(dr.count(without)[0])
    return nearest, met[0] / max(sum(met), 1)


def _refracts(si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Whether light changes its medium at a surface: it lets light in, and is no thin sheet."""
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, dr.mulsign(mi.Float(1), si.wi.z))
    # At normal incidence, the last of the sampled outcomes is the transmission.
    almost_one = 1 - dr.epsilon(mi.Float)
    sample, _ = si.bsdf().sample(mi.BSDFContext(), upright, almost_one, mi.Point2f(0.5), active)
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Transmission) & (sample.eta != 1)


def _diagonal(scene: mi.Scene) -> float:
    lower, upper = scene_bounds(scene)
    return float(dr.norm(upper - lower))
