"""Whether a view is of use: where its camera stands, and what its pixels end on."""

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

# A view has to end on diffuse surfaces with at least this share of its pixels.
LEAST_DIFFUSE = 0.5
# Of the pixels that end on diffuse surfaces, so many have to receive some light.
LEAST_LIT = 0.1
# The camera keeps this distance from all surfaces, in median distances of what the view sees.
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
    lit_share: part of those pixels that photons reach, or a path tracer finds light for.
    clearance: distance from the camera to the nearest surface, over the median distance of what
        the view sees.
    inside: whether the camera is inside of a refracting object: most of the refracting surfaces
        around it are met from within.
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
        """What speaks against the view, in words; nothing where it is fit for use.

        ``home_inside``: cameras of this scene are meant to be inside, under water for instance.
        """
        found = []
        if self.diffuse_share < LEAST_DIFFUSE:
            share = f"{100 * self.diffuse_share:.0f}%"
            found.append(f"only {share} of its pixels end on a diffuse surface")
        elif self.lit_share < LEAST_LIT:
            found.append("no light reaches what it sees: it may be inside of an object")
        if self.clearance < LEAST_CLEARANCE:
            found.append("its camera touches a surface")
        if self.inside and not home_inside:
            found.append("its camera is inside of a refracting object")
        return found


def report_views(
    scene: mi.Scene, views: Sequence[View], aspect: float = 1.0, seed: int = 0
) -> list[ViewReport]:
    """Look into a scene through each view, at 48 rows of pixels, and around each camera.

    One pass of photons with a wide kernel tells what is lit; where it finds little, a few samples
    of a path tracer are asked too.
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
    """The share of the valid pixels for which a path tracer finds light."""
    tracer = mi.load_dict({"type": "path", "max_depth": 12})
    image = mi.render(scene, sensor=make_sensor(view, width, _ROWS), integrator=tracer, spp=16)
    found = np.array(image).reshape(-1, 3).max(axis=1) > 0
    return float(found[valid].mean())


def spacing(points: np.ndarray) -> float:
    """Median distance of points (N, 3) to their nearest neighbours, world units."""
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def covered(points: np.ndarray, by: np.ndarray, within: float) -> np.ndarray:
    """Which of ``points`` (N, 3) have one of ``by`` (M, 3) that near, (N,)."""
    distance, _ = cKDTree(by).query(points, distance_upper_bound=within)
    return np.asarray(np.isfinite(distance))


def look_around(scene: mi.Scene, origin: Sequence[float]) -> tuple[float, bool]:
    """Distance to the nearest surface, world units, and whether a position is inside.

    Of some thousand directions, evenly spread, those count in which the first surface refracts: it
    is met from within by most of them.
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
    """Whether light changes its medium at a surface: it lets light in, and is no thin sheet."""
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, dr.mulsign(mi.Float(1), si.wi.z))
    # At normal incidence, the last of the sampled outcomes is the transmission.
    almost_one = 1 - dr.epsilon(mi.Float)
    sample, _ = si.bsdf().sample(mi.BSDFContext(), upright, almost_one, mi.Point2f(0.5), active)
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Transmission) & (sample.eta != 1)
