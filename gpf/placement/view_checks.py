"""Checks of views: where the camera is, and what its pixels end on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.spatial import cKDTree

from gpf.camera.visible_points import find_visible_points
from gpf.core.structs import Photons, VisiblePoints, from_numpy, take, to_numpy
from gpf.guiding.surface_patch import SurfacePatch
from gpf.photons.tracing import PathSettings, record_photons
from gpf.scene.bounds import scene_bounds
from gpf.scene.lamps import Lamps
from gpf.scene.media import medium_at
from gpf.scene.pinhole import make_pinhole
from gpf.scene.views import View

# Least share of the pixels that end on diffuse surfaces.
LEAST_DIFFUSE = 0.5
# Least share of those pixels that receive some light.
LEAST_LIT = 0.1
# Least distance of the camera from all surfaces, in units of the views' median distance.
LEAST_CLEARANCE = 1e-3

# At least this share of a candidate's pixels must show light, or nearly as large a share as in the
# best of the own views, if that shows less. Around an open room, many cameras would see the dark
# backs of its walls.
SHOWS_LIGHT, NEARLY = 0.82, 0.95

# A view covers another's point if one of its own points is within this many spacings.
COVERED_WITHIN = 2.5

_ROWS = 48
_DIRECTIONS = 1024
_EMITTER_SAMPLES = 8


@dataclass(frozen=True)
class ViewReport:
    """Facts found about a view.

    Attributes
    ----------
    name: the view's name.
    diffuse_share: share of the pixels whose path ends on a diffuse surface.
    lit_share: share of those pixels that show a lit point.
    light_share: share of all pixels that show a lit surface, a lamp or the sky, directly or through
        specular surfaces.
    clearance: distance from the camera to the nearest surface, in units of the median distance
        from the cameras to their visible points.
    inside: whether the camera is inside a refracting object without a medium, i.e. it sees most of
        the refracting surfaces around it from their inner side.
    points: the visible points, one per pixel.
    """

    name: str
    diffuse_share: float
    lit_share: float
    light_share: float
    clearance: float
    inside: bool
    points: VisiblePoints

    def seen(self) -> np.ndarray:
        """The visible points on diffuse surfaces, (N, 3)."""
        return places_of(self.points)

    def faults(self, home_inside: bool = False) -> list[str]:
        """The view's faults in words; empty for a good view.

        ``home_inside``: the scene's cameras may be inside a refracting object, such as water.
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


def points_seen(
    scene: mi.Scene, views: Sequence[View], aspect: float, seed: int = 0
) -> tuple[VisiblePoints, mi.Sampler]:
    """The visible points in images of 48 rows, one per pixel, view by view; and their sampler."""
    size = max(1, round(_ROWS * aspect)), _ROWS
    rng = np.random.default_rng(seed)
    rays = [_camera_rays(view, size, rng) for view in views]
    o, d = (np.concatenate(parts, axis=1) for parts in zip(*rays, strict=True))
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, o.shape[1])
    ray = mi.Ray3f(from_numpy(mi.Point3f, o.T), from_numpy(mi.Vector3f, d.T))
    return find_visible_points(scene, sampler, ray)[0], sampler


def places_of(points: VisiblePoints) -> np.ndarray:
    """Where walks ended on diffuse surfaces, (N, 3)."""
    return to_numpy(points.p)[np.asarray(points.valid.numpy())]


def light_at_hand(scene: mi.Scene, seed: int = 0) -> Photons:
    """Photons that tell :func:`report_views` where light is, (N,)."""
    return record_photons(scene, PathSettings(200_000), seed)


def report_views(
    scene: mi.Scene,
    views: Sequence[View],
    aspect: float = 1.0,
    seed: int = 0,
    photons: Photons | None = None,
) -> list[ViewReport]:
    """Examine views by their visible points, and with rays in all directions from the camera.

    A point is lit if one of a few emitter samples reaches it, or if a photon lands near it.

    ``photons``: those of :func:`light_at_hand`; by default they are traced here.
    """
    points, sampler = points_seen(scene, views, aspect, seed)
    lanes = dr.width(points.p) // len(views)
    valid = np.asarray(points.valid.numpy()).reshape(len(views), lanes)
    place = to_numpy(points.p).reshape(len(views), lanes, 3)
    distances = [
        float(np.median(np.linalg.norm(p[ok] - view.origin, axis=1)))
        for p, ok, view in zip(place, valid, views, strict=True)
        if ok.any()
    ]
    typical = float(np.median(distances)) if distances else 1.0
    near = dr.full(mi.Bool, False, lanes * len(views))
    photons = light_at_hand(scene, seed) if photons is None else photons
    if dr.width(photons.p) > 0:
        patch = SurfacePatch(photons.p, photons.n, 0.03 * typical, scene_bounds(scene))
        near = patch.contains(points.p, points.n, points.valid)
    lit = np.asarray(_is_lit(scene, points, near, sampler).numpy()).reshape(valid.shape)
    shines = np.asarray((dr.max(points.emission) > 0).numpy()).reshape(valid.shape)
    clearances, inside = look_around(scene, [view.origin for view in views])
    every = dr.arange(mi.UInt32, lanes)
    return [
        ViewReport(
            name=view.name,
            diffuse_share=float(valid[k].mean()),
            lit_share=float(lit[k].sum() / max(valid[k].sum(), 1)),
            light_share=float((lit[k] | shines[k]).mean()),
            clearance=float(clearances[k]) / typical,
            # A camera in a medium, such as water, is meant to be there.
            inside=bool(inside[k]) and medium_at(scene, views[k].origin) is None,
            points=take(points, every + dr.opaque(mi.UInt32, k * lanes)),
        )
        for k, view in enumerate(views)
    ]


def enough_light(own: Sequence[ViewReport]) -> float:
    """The share of a view's pixels that must show light."""
    return min(SHOWS_LIGHT, NEARLY * max(report.light_share for report in own))


@dr.syntax
def _is_lit(scene, points, near, sampler):  # type: ignore[no-untyped-def]
    """Whether light reaches points directly, or photons land ``near`` them, (N,)."""
    lit, lamps = mi.Bool(near), Lamps(scene)
    here = dr.zeros(mi.SurfaceInteraction3f, dr.width(points.p))
    here.p, here.n = points.p, points.n
    k = mi.UInt32(0)
    while points.valid & ~lit & (k < _EMITTER_SAMPLES):
        light, weight = lamps.sample(here, sampler.next_2d(), mi.Bool(True))
        lit |= (light.pdf > 0) & (dr.dot(light.d, points.n) > 0) & (dr.max(weight) > 0)
        k += 1
    return lit


def _camera_rays(
    view: View, size: tuple[int, int], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (3, N) of rays through a random place in each pixel, row by row."""
    camera = make_pinhole(view, size)
    x, y = np.meshgrid(*(np.arange(n) - c for n, c in zip(size, camera.centre, strict=True)))
    place = np.stack([x.ravel(), y.ravel()]) + rng.random((2, x.size))
    across = np.vstack([place, np.full(x.size, camera.focal)])
    directions = camera.rotation @ (across / np.linalg.norm(across, axis=0))
    origins = np.repeat(camera.origin[:, None], x.size, axis=1)
    return origins.astype(np.float32), directions.astype(np.float32)


def spacing(points: np.ndarray) -> float:
    """Median distance of points (N, 3) to their nearest neighbours, world units."""
    distance, _ = cKDTree(points).query(points, k=2)
    return float(np.median(distance[:, 1]))


def covered(points: np.ndarray, by: np.ndarray, within: float) -> np.ndarray:
    """Which of ``points`` (N, 3) have one of ``by`` (M, 3) within this distance, (N,) bool."""
    distance, _ = cKDTree(by).query(points, distance_upper_bound=within)
    return np.asarray(np.isfinite(distance))


def look_around(
    scene: mi.Scene, origins: Sequence[Sequence[float]]
) -> tuple[np.ndarray, np.ndarray]:
    """Distances from V positions to the nearest surface, world units, and which are inside, (V,).

    1024 rays are sent from each in evenly spread directions. A position is inside if more than half
    of the rays that meet a refracting surface first meet it from its inner side.
    """
    index = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / _DIRECTIONS, np.pi * (1 + 5**0.5) * index
    ring = np.sqrt(1 - height**2)
    directions = np.stack([ring * np.cos(angle), height, ring * np.sin(angle)])
    d = from_numpy(mi.Vector3f, np.tile(directions, len(origins)).T)
    starts = np.repeat(np.asarray(origins, dtype=np.float32), _DIRECTIONS, axis=0)
    si = scene.ray_intersect(mi.Ray3f(from_numpy(mi.Point3f, starts), d))
    refracts = si.is_valid() & _refracts(si, si.is_valid())
    within = refracts & (si.wi.z < 0)

    def by_origin(value: Any) -> np.ndarray:
        return np.asarray(value.numpy()).reshape(len(origins), _DIRECTIONS)

    counts = [by_origin(found).sum(axis=1) for found in (within, refracts)]
    return by_origin(si.t).min(axis=1), 2 * counts[0] > counts[1]


def _refracts(si: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
    """Whether light enters another medium at a surface; not so at thin sheets or opaque ones."""
    upright = mi.SurfaceInteraction3f(si)
    upright.wi = mi.Vector3f(0, 0, dr.mulsign(mi.Float(1), si.wi.z))
    # With a random number near 1, the outcome sampled at normal incidence is the transmission.
    almost_one = 1 - dr.epsilon(mi.Float)
    sample, _ = si.bsdf().sample(mi.BSDFContext(), upright, almost_one, mi.Point2f(0.5), active)
    return mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Transmission) & (sample.eta != 1)
