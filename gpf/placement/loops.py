"""Closed loops of cameras: through a scene's own camera, or all the way around what it sees."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy
from gpf.placement.orbit import Orbit
from gpf.placement.view_checks import ViewReport, enough_light, light_at_hand, report_views
from gpf.scene.views import CameraPath, Keyframe, SceneViews, View

# Frames of a path.
_FRAMES = 24

# Cameras that are examined together; each report takes half a megabyte.
_BLOCK = 64

# Least number of cameras at which an orbit is examined.
_LEAST_CIRCLE = 24


def place_path(scene: mi.Scene, own: View, aspect: float) -> CameraPath | None:
    """The widest closed loop through the camera ``own`` whose frames are usable, or None."""
    orbit, home = Orbit.around(scene, own, aspect), report_views(scene, [own], aspect)[0]
    turns = np.radians([0, 60, 120, 180, 240, 300])
    for width in (20, 14, 10, 7, 5, 3):
        poses = [
            (width * np.sin(t), 0.4 * width * (1 - np.cos(t)), 1 - 0.1 * (1 - np.cos(t)))
            for t in turns
        ]
        path = CameraPath(
            frames=_FRAMES,
            closed=True,
            keyframes=tuple(
                Keyframe(**key.model_dump(exclude={"name", "fov_axis"}))
                for key in orbit.views(scene, poses)
            ),
        )
        frames = SceneViews(aspect=aspect, path=path).frames()
        if _are_of_use(scene, frames, aspect, home):
            return path
    return None


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
    if _is_free(scene, fine) and _are_of_use(scene, fine, aspect, home):
        found = orbit.circle(count)
    else:
        path = place_path(scene, own, aspect)
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


def _are_of_use(scene: mi.Scene, views: Sequence[View], aspect: float, home: ViewReport) -> bool:
    """Whether all views are without faults and show enough light, compared with ``home``."""
    enough, photons = enough_light([home]), light_at_hand(scene)
    blocks = (views[k : k + _BLOCK] for k in range(0, len(views), _BLOCK))
    return all(
        not report.faults(home.inside) and report.light_share >= enough
        for block in blocks
        for report in report_views(scene, block, aspect, photons=photons)
    )
