"""Training and novel views for a scene that has only its own camera.

Candidate cameras orbit around the middle of what the scene's own camera sees, in the free space
around that camera. Views are chosen from the candidates without faults
(:mod:`gpf.importing.view_checks`): the training views together see as much as possible, and each
novel view sees something that no training view sees.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import count

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.stats import qmc

from gpf.core.errors import UserError
from gpf.importing.report import PHOTONS
from gpf.importing.view_checks import COVERED_WITHIN, ViewReport, covered, report_views, spacing
from gpf.photons.tracing import PathSettings
from gpf.scene.sensors import make_sensor
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View, ViewSets
from gpf.sppm.passes import PassSettings, propose_radius
from gpf.sppm.reference import ReferenceRenderer

TRAINING, NOVEL, FRAMES = 3, 5, 24
LEAST_NOVEL = 4

# The candidates: angles on the orbit in degrees, and distances in units of the own camera's.
_AZIMUTHS = (-36, -24, -12, 0, 12, 24, 36)
_ELEVATIONS = (-12, 0, 12, 24)
_DISTANCES = (0.55, 0.8, 1.05)
# They look past the pivot by up to this share of the distance, each in another direction.
_ASIDE = 0.15

# The share of a novel view's points that training views see should be between these two.
_COVERED = (0.6, 0.97)


def place_views(scene: mi.Scene, own: Sequence[View], aspect: float) -> SceneViews:
    """Training and novel views and a camera path, placed around the first of the ``own`` cameras.

    Own views without faults are the first training views.

    Raises
    ------
    UserError: too few views without faults are found.
    """
    orbit = Orbit.around(scene, own[0], aspect)
    poses = [(a, e, d) for d in _DISTANCES for e in _ELEVATIONS for a in _AZIMUTHS if a or e]
    asides = _ASIDE * (2 * qmc.Halton(2, scramble=False).random(len(poses) + 1)[1:] - 1)
    candidates = [
        orbit.view(scene, *pose, aside) for pose, aside in zip(poses, asides, strict=True)
    ]
    reports = report_views(scene, [*own, *candidates], aspect)
    views = [*own, *candidates]
    fit = _fit(reports, len(own))
    if len(fit) < TRAINING + LEAST_NOVEL:
        home = reports[0].inside
        reasons = Counter(fault for report in reports for fault in report.faults(home))
        raise UserError(
            f"view {own[0].name!r}",
            f"only {len(fit)} of {len(views)} cameras around the scene's own are of use. The most "
            f"common faults: {'; '.join(fault for fault, _ in reasons.most_common(2))}",
            "Move the scene's sensor to a place with free space around it, from where most of its "
            "pixels show lit diffuse surfaces.",
        )
    clouds = [reports[k].seen() for k in fit]
    within = COVERED_WITHIN * spacing(clouds[0])
    must = [i for i, k in enumerate(fit) if k < len(own)]
    training = _cover(clouds, must, TRAINING, within)
    novel = _choose_novel([views[k] for k in fit], clouds, training, orbit.distance, within)

    taken = {view.name for view in own}

    def named(rows: Sequence[int], prefix: str) -> tuple[View, ...]:
        chosen: list[View] = []
        for row in rows:
            view = views[fit[row]]
            if fit[row] >= len(own):
                free = (f"{prefix}_{k}" for k in count(1 + len(chosen)))
                view = view.model_copy(update={"name": next(n for n in free if n not in taken)})
                taken.add(view.name)
            chosen.append(view)
        return tuple(chosen)

    return SceneViews(
        exposure=propose_exposure(scene, views[fit[training[0]]], aspect),
        aspect=round(aspect, 6),
        fov_axis="x",
        views=ViewSets(train=named(training, "train"), novel=named(novel, "novel")),
        path=_place_path(scene, orbit, aspect, reports[0].inside),
    )


def _fit(reports: Sequence[ViewReport], own: int) -> list[int]:
    """Numbers of the own views without faults, and of candidates that show as much lit surface.

    "As much" is at least 0.9 of what the best own view shows. If that gives few candidates, the
    limit is lowered: around an open room, many cameras see the dark backs of its walls.
    """
    home = reports[0].inside
    useful = np.array([0 if r.faults(home) else r.diffuse_share * r.lit_share for r in reports])
    best = useful[:own].max() or useful.max()
    for share in (0.9, 0.75, 0.5, 0.0):
        fit = [k for k, u in enumerate(useful) if u > 0 and (k < own or u >= share * best)]
        if len(fit) >= own + 4 * (TRAINING + NOVEL):
            break
    return fit


@dataclass(frozen=True)
class Orbit:
    """Cameras on spheres around a point.

    Attributes
    ----------
    start: the camera at azimuth and elevation 0.
    pivot: the middle of what the start sees, (3,).
    distance: from the start to the pivot, world units.
    up: the axis of the scene that is nearest to the start's own up, (3,).
    """

    start: View
    pivot: np.ndarray
    distance: float
    up: np.ndarray

    @classmethod
    def around(cls, scene: mi.Scene, view: View, aspect: float) -> Orbit:
        """The orbit whose pivot is on the view's axis, at the median depth of its visible points.

        Raises
        ------
        UserError: the view sees no diffuse surface.
        """
        seen = report_views(scene, [view], aspect)[0].seen()
        origin = np.array(view.origin)
        forward = _unit(np.subtract(view.target, view.origin))
        if len(seen) == 0:
            raise UserError(
                f"view {view.name!r}",
                "sees no diffuse surface",
                "Point the scene's sensor at something with a diffuse material.",
            )
        distance = float(np.median((seen - origin) @ forward))
        axis = int(np.argmax(np.abs(view.up)))
        up = np.eye(3)[axis] * np.sign(view.up[axis])
        if np.linalg.norm(np.cross(up, forward)) < 0.2:  # the camera looks along that axis
            up = np.array(view.up, dtype=float)
        return cls(view, origin + distance * forward, distance, up)

    def view(
        self,
        scene: mi.Scene,
        azimuth: float,
        elevation: float,
        distance: float,
        aside: Sequence[float] | np.ndarray = (0.0, 0.0),
    ) -> View:
        """A camera on the orbit that stays in the free space around the start.

        If a surface lies between the start and the camera's place, the camera stands at four fifths
        of the way to that surface.

        Parameters
        ----------
        azimuth, elevation: degrees.
        distance: from the pivot, in units of the start's distance.
        aside: how far the camera looks past the pivot, to the right and upwards; same unit.
        """
        origin = np.array(self.start.origin)
        back = _unit(origin - self.pivot)
        right = _unit(np.cross(self.up, back))
        back = _rotate(_rotate(back, right, -np.radians(elevation)), self.up, np.radians(azimuth))
        way = self.pivot + distance * self.distance * back - origin
        length = float(np.linalg.norm(way))
        if length > 0:
            ray = mi.Ray3f(mi.Point3f(origin.tolist()), mi.Vector3f((way / length).tolist()))
            dr.make_opaque(ray)
            free = float(scene.ray_intersect_preliminary(ray).t[0])
            origin = origin + way * min(1.0, 0.8 * free / length)
        return View(
            name="candidate",
            origin=_rounded(origin),
            target=_rounded(self.pivot + self.distance * (aside[0] * right + aside[1] * self.up)),
            up=_rounded(self.up),
            fov=self.start.fov,
            fov_axis=self.start.fov_axis,
        )


def propose_exposure(scene: mi.Scene, view: View, aspect: float, passes: int = 8) -> float:
    """The exposure at which nine tenths of a view's pixels are below 0.8 of display white."""
    height = 48
    sensor = make_sensor(view, max(1, round(height * aspect)), height)
    points = report_views(scene, [view], aspect)[0].points
    radius = 2 * propose_radius(scene, points, PathSettings(PHOTONS))
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    renderer = ReferenceRenderer(scene, {view.name: sensor}, {}, settings, seed=0)
    sums = renderer.run(passes)
    luminance = renderer.image(view.name, sums) @ [0.2126, 0.7152, 0.0722]
    bright = float(np.percentile(luminance, 90))
    return float(f"{0.8 / bright:.2g}") if bright > 0 else 1.0


def _cover(
    clouds: Sequence[np.ndarray], must: Sequence[int], wanted: int, within: float
) -> list[int]:
    """Numbers of ``wanted`` clouds that together cover the most points; ``must`` come first.

    Greedy: each step takes the cloud that covers the most points that are not covered yet.
    """
    pool = np.concatenate(clouds)
    pool = pool[:: max(1, len(pool) // 4000)]
    reach = np.array([covered(pool, cloud, within) for cloud in clouds])
    chosen = list(must[:wanted])
    while len(chosen) < wanted:
        done = reach[chosen].any(axis=0) if chosen else np.zeros(len(pool), bool)
        gain = (reach & ~done).sum(axis=1)
        gain[chosen] = -1
        chosen.append(int(np.argmax(gain)))
    return chosen


def _choose_novel(
    views: Sequence[View],
    clouds: Sequence[np.ndarray],
    training: Sequence[int],
    unit: float,
    within: float,
) -> list[int]:
    """Numbers of novel views, far from each other and from the training views.

    Views that the training views cover in part (``_COVERED``) are taken first, others after them.
    """
    seen = np.concatenate([clouds[k] for k in training])
    share = np.array([covered(cloud, seen, within).mean() for cloud in clouds])
    poses = np.array([_pose(view, unit) for view in views])
    chosen: list[int] = []
    rest = [k for k in range(len(views)) if k not in training]
    while rest and len(chosen) < NOVEL:
        partly = [k for k in rest if _COVERED[0] <= share[k] <= _COVERED[1]] or rest
        taken = poses[[*training, *chosen]]
        gaps = [np.linalg.norm(taken - poses[k], axis=1).min() for k in partly]
        chosen.append(partly[int(np.argmax(gaps))])
        rest.remove(chosen[-1])
    return chosen


def _pose(view: View, unit: float) -> np.ndarray:
    forward = _unit(np.subtract(view.target, view.origin))
    return np.concatenate([np.array(view.origin) / unit, forward])


def _place_path(
    scene: mi.Scene, orbit: Orbit, aspect: float, home_inside: bool
) -> CameraPath | None:
    """The widest closed loop through the own camera whose frames have no faults; None if none."""
    for width in (20, 14, 10, 7, 5, 3):
        turns = np.radians([0, 60, 120, 180, 240, 300])
        keys = [
            orbit.view(
                scene, width * np.sin(t), 0.4 * width * (1 - np.cos(t)), 1 - 0.1 * (1 - np.cos(t))
            )
            for t in turns
        ]
        path = CameraPath(
            frames=FRAMES,
            closed=True,
            keyframes=tuple(Keyframe(**k.model_dump(exclude={"name", "fov_axis"})) for k in keys),
        )
        frames = SceneViews(aspect=aspect, views=ViewSets(train=()), path=path).frames()
        reports = report_views(scene, frames, aspect)
        if not any(report.faults(home_inside) for report in reports):
            return path
    return None


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


def _rotate(vector: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' rotation about a unit axis."""
    return np.asarray(
        vector * np.cos(angle)
        + np.cross(axis, vector) * np.sin(angle)
        + axis * (axis @ vector) * (1 - np.cos(angle))
    )


def _rounded(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(f"{value:.6g}") for value in vector)
    return x, y, z
