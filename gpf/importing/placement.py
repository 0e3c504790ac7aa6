"""Training and novel views for a scene that has only its own camera.

Candidate cameras orbit the middle of what the scene's own camera sees, in the free space around
that camera. Views are chosen from the candidates without faults
(:mod:`gpf.importing.view_checks`): the training views together see as much as possible, and each
novel view sees something that no training view sees.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import count

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.images import propose_exposure
from gpf.core.structs import from_numpy
from gpf.importing.orbit import Orbit, unit_vector
from gpf.importing.report import PHOTONS
from gpf.importing.view_checks import COVERED_WITHIN, ViewReport, covered, report_views, spacing
from gpf.photons.tracing import PathSettings
from gpf.scene.sensors import film_aspect, make_sensor, scene_cameras, views_of_sensors
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View, ViewSets
from gpf.sppm.passes import PassSettings, propose_radius
from gpf.sppm.reference import ReferenceRenderer

TRAINING, NOVEL, FRAMES = 3, 5, 24
LEAST_NOVEL = 4

# Rows of the films of :func:`place_sensors`.
ROWS = 256

# The candidates: angles on the orbit in degrees, and distances in units of the own camera's.
_AZIMUTHS = (-36, -24, -12, 0, 12, 24, 36)
_ELEVATIONS = (-12, 0, 12, 24)
_DISTANCES = (0.42, 0.7, 1)
# They look past the pivot by up to this share of the distance, each in a different direction.
_ASIDE = 0.15

# If too few of these candidates are usable, others nearer to the own camera are tried: angles and
# changes of distance are multiplied by these factors.
_SPREADS = (1, 0.6, 0.35, 0.2)

# At least this share of a candidate's pixels must show light, or nearly as large a share as in the
# best of the own views, if that shows less. Around an open room, many cameras would see the dark
# backs of its walls.
_SHOWS_LIGHT, _NEARLY = 0.82, 0.95

# Cameras that are examined together; each report takes half a megabyte.
_BLOCK = 64

# Least number of cameras at which an orbit is examined.
_LEAST_CIRCLE = 24

# The share of a novel view's points that training views see should be between these two.
_COVERED = (0.6, 0.97)


def place_views(scene: mi.Scene, own: Sequence[View], aspect: float) -> SceneViews:
    """Training and novel views, a camera path and an exposure; see :func:`place_cameras`."""
    cameras = place_cameras(scene, own, aspect)
    return SceneViews(
        exposure=measure_exposure(scene, cameras.train[0], aspect),
        aspect=round(aspect, 6),
        fov_axis="x",
        views=cameras,
        path=_place_path(
            scene,
            Orbit.around(scene, own[0], aspect),
            aspect,
            report_views(scene, own[:1], aspect)[0],
        ),
    )


def place_sensors(scene: mi.Scene) -> list[mi.Sensor]:
    """Cameras around the scene's own, with films of :data:`ROWS` rows.

    Raises
    ------
    UserError: the scene has no perspective camera, or too few views without faults are found.
    """
    own = views_of_sensors(scene)
    if not own:
        raise UserError(
            "scene", "has no perspective camera", "Add one to the scene, or give sensors."
        )
    aspect = film_aspect(scene_cameras(scene)[0])
    placed = place_cameras(scene, own, aspect)
    width = max(1, round(ROWS * aspect))
    return [make_sensor(view, width, ROWS) for view in (*placed.train, *placed.novel)]


def place_cameras(scene: mi.Scene, own: Sequence[View], aspect: float) -> ViewSets:
    """Training and novel views, placed around the first of the ``own`` cameras.

    Own views without faults are the first training views.

    Raises
    ------
    UserError: too few views without faults are found.
    """
    orbit = Orbit.around(scene, own[0], aspect)
    views, reports = list(own), report_views(scene, own, aspect)
    for spread in _SPREADS:
        candidates = _candidates(scene, orbit, spread)
        views += candidates
        reports += report_views(scene, candidates, aspect)
        fit = _fit(reports, len(own))
        if len(fit) >= len(own) + 4 * (TRAINING + NOVEL):
            break
    if len(fit) < TRAINING + LEAST_NOVEL:
        home = reports[0].inside
        reasons = Counter(fault for report in reports for fault in report.faults(home))
        raise UserError(
            f"view {own[0].name!r}",
            f"only {len(fit)} of {len(views)} cameras around the scene's own are usable; most "
            f"common faults: {'; '.join(fault for fault, _ in reasons.most_common(2))}",
            "Move the scene's sensor to a place with free space around it, from which most of its "
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

    return ViewSets(train=named(training, "train"), novel=named(novel, "novel"))


def _candidates(scene: mi.Scene, orbit: Orbit, spread: float) -> list[View]:
    """Cameras on the orbit; ``spread`` multiplies their distance from the own camera."""
    poses = [(a, e, d) for d in _DISTANCES for e in _ELEVATIONS for a in _AZIMUTHS if a or e]
    # Multiples of the plastic number's powers modulo 1: evenly spread in the square.
    asides = _ASIDE * (2 * (np.outer(np.arange(1, len(poses) + 1), [0.7548777, 0.5698403]) % 1) - 1)
    nearer = [(spread * a, spread * e, 1 + spread * (d - 1)) for a, e, d in poses]
    return orbit.views(scene, nearer, asides)


def _fit(reports: Sequence[ViewReport], own: int) -> list[int]:
    """Indices of the own views without faults, and of candidates that also show enough light."""
    home = reports[0].inside
    enough = _enough_light(reports[:own])
    return [
        k
        for k, report in enumerate(reports)
        if not report.faults(home) and (k < own or report.light_share >= enough)
    ]


def _enough_light(own: Sequence[ViewReport]) -> float:
    """The share of a view's pixels that must show light."""
    return min(_SHOWS_LIGHT, _NEARLY * max(report.light_share for report in own))


def place_orbit(scene: mi.Scene, own: View, aspect: float, count: int) -> tuple[View, ...]:
    """``count`` views on a circle around what the view ``own`` looks at, at equal angles.

    If surfaces are in the way, or some of the views are unusable, they are on the widest closed
    loop through the own camera instead.

    Raises
    ------
    UserError: the view sees no diffuse surface, or there is no room for a loop, either.
    """
    orbit, home = Orbit.around(scene, own, aspect), report_views(scene, [own], aspect)[0]
    fine = orbit.circle(max(count, _LEAST_CIRCLE))
    enough = _enough_light([home])
    if _is_free(scene, fine) and _are_of_use(scene, fine, aspect, home, enough):
        found = orbit.circle(count)
    else:
        path = _place_path(scene, orbit, aspect, home)
        if path is None:
            raise UserError(
                f"view {own.name!r}",
                "has no free space around it for an orbit",
                "Give cameras with --views, or move the scene's sensor.",
            )
        longer = path.model_copy(update={"frames": max(count, 2)})
        found = list(SceneViews(aspect=aspect, path=longer).frames())[:count]
    return tuple(view.model_copy(update={"name": f"orbit_{k:03d}"}) for k, view in enumerate(found))


def _is_free(scene: mi.Scene, circle: Sequence[View]) -> bool:
    """Whether no surface lies between neighbours on a circle of cameras."""
    start = np.array([view.origin for view in circle])
    way = np.roll(start, -1, axis=0) - start
    ray = mi.Ray3f(
        from_numpy(mi.Point3f, start),
        from_numpy(mi.Vector3f, way),
        maxt=mi.Float(1),
        time=mi.Float(0),
        wavelengths=mi.Color0f(),
    )
    return not bool(dr.any(scene.ray_test(ray)))


def _are_of_use(
    scene: mi.Scene, views: Sequence[View], aspect: float, home: ViewReport, enough: float
) -> bool:
    """Whether all views are without faults and show enough light."""
    blocks = (views[k : k + _BLOCK] for k in range(0, len(views), _BLOCK))
    return all(
        not report.faults(home.inside) and report.light_share >= enough
        for block in blocks
        for report in report_views(scene, block, aspect)
    )


def measure_exposure(scene: mi.Scene, view: View, aspect: float, passes: int = 8) -> float:
    """An exposure for a view, from a small image; see :func:`gpf.core.images.propose_exposure`."""
    height = 48
    sensor = make_sensor(view, max(1, round(height * aspect)), height)
    points = report_views(scene, [view], aspect)[0].points
    radius = 2 * propose_radius(scene, points, PathSettings(PHOTONS))
    settings = PassSettings(photons_per_pass=PHOTONS, initial_radius=radius, direct="photons")
    renderer = ReferenceRenderer(scene, {view.name: sensor}, {}, settings, seed=0)
    sums = renderer.run(passes)
    return float(f"{propose_exposure(renderer.image(view.name, sums)):.2g}")


def _cover(
    clouds: Sequence[np.ndarray], must: Sequence[int], wanted: int, within: float
) -> list[int]:
    """Indices of ``wanted`` clouds that together cover the most points; ``must`` come first.

    Greedy: each step takes the cloud that covers the most points not yet covered.
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
    """Indices of novel views, far from each other and from the training views.

    Views that the training views cover in part (``_COVERED``) are taken first, then the others.
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
    forward = unit_vector(np.subtract(view.target, view.origin))
    return np.concatenate([np.array(view.origin) / unit, forward])


def _place_path(
    scene: mi.Scene, orbit: Orbit, aspect: float, home: ViewReport
) -> CameraPath | None:
    """The widest closed loop through the own camera whose frames are usable, or None.

    ``home``: the report of the own camera.
    """
    enough = _enough_light([home])
    turns = np.radians([0, 60, 120, 180, 240, 300])
    for width in (20, 14, 10, 7, 5, 3):
        poses = [
            (width * np.sin(t), 0.4 * width * (1 - np.cos(t)), 1 - 0.1 * (1 - np.cos(t)))
            for t in turns
        ]
        path = CameraPath(
            frames=FRAMES,
            closed=True,
            keyframes=tuple(
                Keyframe(**key.model_dump(exclude={"name", "fov_axis"}))
                for key in orbit.views(scene, poses)
            ),
        )
        frames = SceneViews(aspect=aspect, path=path).frames()
        if _are_of_use(scene, frames, aspect, home, enough):
            return path
    return None
