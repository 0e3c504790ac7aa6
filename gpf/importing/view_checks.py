"""Checks of views: where the camera stands, and on what its pixels end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.camera.film import sample_film
from gpf.core.structs import VisiblePoints, concatenate, to_numpy
from gpf.scene.sensors import make_sensor
from gpf.scene.views import View
from gpf.sppm.passes import PassSettings, PhotonPasses

# Least share of the pixels that end on diffuse surfaces.
LEAST_DIFFUSE = 0.5
# Least share of those pixels that receive some light.
LEAST_LIT = 0.1
# Least distance of the camera from all surfaces, in units of the views' median distance.
LEAST_CLEARANCE = 1e-3

# Another view sees a point if one of its own points is within this many spacings.
COVERED_WITHIN = 2.5

_ROWS = 48
_DIRECTIONS = 1024


@dataclass(frozen=True)
class ViewReport:
    """What was found out about a view.

    Attributes
    ----------
    name: of the view.
    diffuse_share: share of the pixels whose path ends on a diffuse surface.
    lit_share: share of those pixels where photons or a path tracer find light.
    clearance: distance from the camera to the nearest surface, in units of the median distance
        from the cameras to their visible points.
    inside: whether the camera is inside a refracting object: most of the refracting surfaces
        around it show it their inner side.
    points: the visible points, one per pixel.
    """

    name: str
    diffuse_share: float
    lit_share: float
    clearance: float
    inside: bool
    points: VisiblePoints

    def seen(self) -> np.ndarray:
        """The visible points on diffuse surfaces, (N, 3)."""
        return to_numpy(self.points.p)[np.asarray(self.points.valid.numpy())]

    def faults(self, home_inside: bool = False) -> list[str]:
        """The view's faults in words; empty for a good view.

        ``home_inside``: the scene's cameras may be inside a refracting object, as under water.
        """
        found = []
        if self.diffuse_share < LEAST_DIFFUSE:
            share = f"{100 * self.diffuse_share:.0f}%"
            found.append(f"only {share} of its pixels end on a diffuse surface")
        elif self.lit_share < LEAST_LIT:
            found.append("no light reaches what it sees: it may be inside an object")
        if self.clearance < LEAST_CLEARANCE:
            found.append("its camera touches a surface")
        if self.inside and not home_inside:
            found.append("its camera is inside a refracting object")
        return found


def report_views(
    scene: mi.Scene, views: Sequence[View], aspect: float = 1.0, seed: int = 0
) -> list[ViewReport]:
    """Examine views by images of 48 rows of pixels, and by rays in all directions of the camera.

    One photon pass with a wide kernel tells which points are lit. If it lights fewer than
    ``LEAST_LIT`` of a view's points, a path tracer with 16 samples per pixel is tried too.
    """
    width = max(1, round(_ROWS * aspect))
    points = []
    for number, view in enumerate(views):
        sensor = make_sensor(view, width, _ROWS)
        points.append(sample_film(scene, sensor, seed + number).points)
        dr.eval(points[-1])
    valid = [np.asarray(seen.valid.numpy()) for seen in points]
    distances = [
        float(np.median(np.linalg.norm(to_numpy(seen.p)[ok] - view.origin, axis=1)))
        for seen, ok, view in zip(points, valid, views, strict=True)
        if ok.any()
    ]
    typical = float(np.median(distances)) if distances else 1.0
    settings = PassSettings(
        photons_per_pass=200_000, initial_radius=0.03 * typical, direct="photons"
    )
    irradiance = PhotonPasses(scene, settings, seed).trace(1).irradiance(concatenate(points))
    lit = np.asarray((dr.max(irradiance) > 0).numpy()).reshape(len(views), -1)
    reports = []
    for view, seen, ok, bright in zip(views, points, valid, lit, strict=True):
        lit_share = float(bright[ok].mean()) if ok.any() else 0.0
        if ok.any() and lit_share < LEAST_LIT:
            lit_share = max(lit_share, _share_found_by_paths(scene, view, width, ok))
        clearance, inside = look_around(scene, view.origin)
        reports.append(
            ViewReport(
                name=view.name,
                diffuse_share=float(ok.mean()),
                lit_share=lit_share,
                clearance=clearance / typical,
                inside=inside,
                points=seen,
            )
        )
    return reports


def _share_found_by_paths(scene: mi.Scene, view: View, width: int, valid: np.ndarray) -> float:
    """The share of the valid pixels where a path tracer finds light."""
    tracer = mi.load_dict({"type": "path", "max_depth": 12})
    image = mi.render(scene, sensor=make_sensor(view, width, _ROWS), integrator=tracer, spp=16)
    found = np.array(image).reshape(-1, 3).max(axis=1) > 0
    return float(found[valid].mean())


def spacing(points: np.ndarray) -> float:
    """Median distance of points (N, 3) to their nearest neighbours, world units."""
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def covered(points: np.ndarray, by: np.ndarray, within: float) -> np.ndarray:
    """Which of ``points`` (N, 3) have one of ``by`` (M, 3) within this distance, (N,) bool."""
    distance, _ = cKDTree(by).query(points, distance_upper_bound=within)
    return np.asarray(np.isfinite(distance))


def look_around(scene: mi.Scene, origin: Sequence[float]) -> tuple[float, bool]:
    """Distance from a position to the nearest surface, world units, and whether it is inside.

    1024 rays are sent in evenly spread directions. The position is inside if more than half of the
    rays that meet a refracting surface first meet it from its inner side.
    """
    index = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / _DIRECTIONS, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)])
    d = mi.Vector3f(directions.astype(np.float32))
    o = mi.Point3f(*origin)
    dr.make_opaque(o)
    si = scene.ray_intersect(mi.Ray3f(o, d))
    refracts = si.is_valid() & _refracts(si, si.is_valid())
    within = refracts & (dr.dot(si.n, d) > 0)
    counts = (float(dr.count(within)[0]), float(dr.count(refracts)[0]))
    return float(dr.min(si.t)[0]), 2 * counts[0] > counts[1]


def _refracts(si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Whether light changes its medium at a surface; thin sheets and opaque surfaces do not."""
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, dr.mulsign(mi.Float(1), si.wi.z))
    # With a random number near 1, the outcome sampled at normal incidence is the transmission.
    almost_one = 1 - dr.epsilon(mi.Float)
    sample, _ = si.bsdf().sample(mi.BSDFContext(), upright, almost_one, mi.Point2f(0.5), active)
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Transmission) & (sample.eta != 1)
