"""Training and novel views for a scene that has only its own camera.

Candidate cameras orbit the middle of what the scene's own camera sees, in the free space around
that camera. Views are chosen from the candidates without faults
(:mod:`gpf.placement.view_checks`): the training views together see as much as possible, and each
novel view sees something that no training view sees.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from itertools import count

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.vectors import normalise
from gpf.placement.orbit import Orbit
from gpf.placement.view_checks import (
    COVERED_WITHIN,
    ViewReport,
    covered,
    enough_light,
    light_at_hand,
    report_views,
    spacing,
)
from gpf.scene.sensors import (
    film_aspect,
    make_sensor,
    scene_cameras,
    shown_differently,
    views_of_sensors,
)
from gpf.scene.views import View, ViewSets

TRAINING, NOVEL = 3, 5
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

# The share of a novel view's points that training views see should be between these two.
_COVERED = (0.6, 0.97)

log = logging.getLogger(__name__)


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
    for what in shown_differently(scene):
        log.warning(what)
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
    photons = light_at_hand(scene)
    views, reports = list(own), report_views(scene, own, aspect, photons=photons)
    for spread in _SPREADS:
        candidates = _candidates(scene, orbit, spread)
        views += candidates
        reports += report_views(scene, candidates, aspect, photons=photons)
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
    enough = enough_light(reports[:own])
    return [
        k
        for k, report in enumerate(reports)
        if not report.faults(home) and (k < own or report.light_share >= enough)
    ]


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
    forward = normalise(np.subtract(view.target, view.origin))
    return np.concatenate([np.array(view.origin) / unit, forward])
