"""Cameras on spheres around what a camera looks at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy
from gpf.core.vectors import normalise
from gpf.placement.view_checks import places_of, points_seen
from gpf.scene.views import View


@dataclass(frozen=True)
class Orbit:
    """Cameras on spheres around a point.

    Attributes
    ----------
    start: the camera at azimuth and elevation 0.
    pivot: the middle of what ``start`` sees, (3,).
    distance: distance from ``start`` to ``pivot``, world units.
    up: the axis of the scene that is nearest to the up vector of ``start``, (3,).
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
        seen = places_of(points_seen(scene, [view], aspect)[0])
        origin = np.array(view.origin)
        forward = normalise(np.subtract(view.target, view.origin))
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
            up = normalise(view.up - forward * (forward @ view.up))
        return cls(view, origin + distance * forward, distance, up)

    def views(
        self,
        scene: mi.Scene,
        poses: Sequence[tuple[float, float, float]],
        asides: np.ndarray | None = None,
    ) -> list[View]:
        """Cameras on the orbit that stay in the free space around the start.

        If a surface lies between the start and a camera's place, the camera is put at four fifths
        of the way to that surface.

        Parameters
        ----------
        poses: the azimuth and elevation of each camera, degrees, and its distance from the pivot,
            in units of the start's distance.
        asides: how far each camera looks past the pivot, to the right and upwards, in the same
            unit, (V, 2); 0 by default.
        """
        start = np.array(self.start.origin)
        back = normalise(start - self.pivot)
        right = normalise(np.cross(self.up, back))
        ways = []
        for azimuth, elevation, distance in poses:
            raised = _rotate(back, right, -np.radians(elevation))
            turned = _rotate(raised, self.up, np.radians(azimuth))
            ways.append(self.pivot + distance * self.distance * turned - start)
        way = np.array(ways)
        length = np.maximum(np.linalg.norm(way, axis=1), 1e-9)
        ray = mi.Ray3f(
            from_numpy(mi.Point3f, np.tile(start, (len(way), 1))),
            from_numpy(mi.Vector3f, way / length[:, None]),
        )
        free = np.asarray(scene.ray_intersect_preliminary(ray).t.numpy(), dtype=float)
        origins = start + way * np.minimum(1.0, 0.8 * free / length)[:, None]
        sides = np.zeros((len(way), 2)) if asides is None else asides
        targets = self.pivot + self.distance * (sides @ np.stack([right, self.up]))
        return [
            self._camera(origin, target) for origin, target in zip(origins, targets, strict=True)
        ]

    def circle(self, count: int) -> list[View]:
        """Cameras at equal angles on a full circle around the axis ``up`` through the pivot,
        beginning at the start; surfaces in the way are ignored."""
        back = np.array(self.start.origin) - self.pivot
        turns = 2 * np.pi * np.arange(count) / count
        return [
            self._camera(self.pivot + _rotate(back, self.up, turn), self.pivot) for turn in turns
        ]

    def _camera(self, origin: np.ndarray, target: np.ndarray) -> View:
        return View(
            name="candidate",
            origin=_rounded(origin),
            target=_rounded(target),
            up=_rounded(self.up),
            fov=self.start.fov,
            fov_axis=self.start.fov_axis,
            shift=self.start.shift,
        )


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
