"""The visible region: the surfaces where photons and targets are needed.

In the scene ``veach_ajar``, about 4% of the photons get through the door; the others light a room
that no camera sees. The field must serve every camera in the space that the training views look
into. It needs Gaussians only on the surfaces that such a camera can see, including those
in mirrors and behind glass.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.visible_points import find_visible_points
from gpf.core.errors import UserError
from gpf.core.random import Stream, pass_seed
from gpf.core.spacing import measure_spacing
from gpf.core.structs import Photons, VisiblePoints, concatenate, from_numpy, take
from gpf.guiding.surface_patch import SurfacePatch
from gpf.scene.bounds import scene_bounds

# The minimum number of visible points; the region's radius is estimated from their distances.
LEAST_POINTS = 8


class VisibleRegion:
    """The diffuse surfaces that are visible from the space that some views look into.

    Half of the rays are camera rays of the views. Each of the others starts at a random place on a
    camera ray, before its first surface, in a random direction. The visible region is the surface
    within ``radius`` of the visible points of all these rays.

    Parameters
    ----------
    sensors: the views.
    seed: seed of the rays.
    samples: number of rays.

    Raises
    ------
    UserError: fewer than :data:`LEAST_POINTS` rays end on a diffuse surface.

    Attributes
    ----------
    points: the visible points, (N,).
    radius: how far the region extends around each visible point, world units.
    """

    def __init__(
        self, scene: mi.Scene, sensors: Sequence[mi.Sensor], seed: int, samples: int = 1 << 19
    ) -> None:
        each = max(1, samples // len(sensors))
        points = sample_visible_points(
            scene, sensors, each, pass_seed(seed, 0, Stream.VISIBLE_REGION)
        )
        lanes = dr.compress(points.valid)
        if dr.width(lanes) < LEAST_POINTS:
            raise UserError(
                "training views",
                "see no diffuse surface",
                "Point them at one, or disable the region (VisibleRegionSettings: use = false).",
            )
        self.points = take(points, lanes)
        p, n = self.points.p, self.points.n
        bounds = scene_bounds(scene)
        self.radius = _reach(p, bounds)
        self._patch = SurfacePatch(p, n, self.radius, bounds)

    def contains(self, p: mi.Point3f, n: mi.Normal3f, active: mi.Bool | bool = True) -> mi.Bool:
        """Whether surface points (N, 3) with oriented normals (N, 3) lie in the region, (N,)."""
        return self._patch.contains(p, n, active)

    def select(self, photons: Photons) -> Photons:
        """The photons in the region."""
        return self._take(photons, True)

    def reject(self, photons: Photons) -> Photons:
        """The photons outside the region."""
        return self._take(photons, False)

    def _take(self, photons: Photons, inside: bool) -> Photons:
        if dr.width(photons.p) == 0:  # in the dark; operations on nothing fail
            return photons
        return take(photons, dr.compress(self.contains(photons.p, photons.n) == inside))


def sample_visible_points(
    scene: mi.Scene,
    sensors: Sequence[mi.Sensor],
    samples: int,
    seed: int,
    elsewhere: float = 0.5,
) -> VisiblePoints:
    """Visible points of camera rays, ``samples`` of each sensor in order, of which a share starts
    ``elsewhere`` on a ray, in any direction. One walk for all sensors: with many materials, tracing
    its Python code takes a tenth of a second."""
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, samples * len(sensors))
    numbers = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
    o, d = [], []
    for number, sensor in enumerate(sensors):
        lanes = dr.arange(mi.UInt32, samples) + dr.opaque(mi.UInt32, number * samples)
        own, _ = sensor.sample_ray(0.0, *(dr.gather(type(n), n, lanes) for n in numbers))
        # Rays without a lens have one origin, those of an orthographic camera one direction.
        o.append(own.o + dr.zeros(mi.Point3f, samples))
        d.append(own.d + dr.zeros(mi.Vector3f, samples))
    ray = mi.Ray3f(concatenate(o), concatenate(d))
    si = scene.ray_intersect_preliminary(ray)
    along = sampler.next_1d()
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    wanders = si.is_valid() & (sampler.next_1d() < elsewhere)
    ray.o = dr.select(wanders, ray.o + along * si.t * ray.d, ray.o)
    ray.d = dr.select(wanders, direction, ray.d)
    return find_visible_points(scene, sampler, mi.Ray3f(ray))[0]


def by_sensor(points: VisiblePoints, sensors: int) -> list[VisiblePoints]:
    """The parts of :func:`sample_visible_points`."""
    each = dr.width(points.p) // sensors
    rows = dr.arange(mi.UInt32, each)
    return [take(points, rows + dr.opaque(mi.UInt32, k * each)) for k in range(sensors)]


def _reach(p: mi.Point3f, bounds: tuple[mi.Point3f, mi.Point3f]) -> float:
    """A radius within which 99.9% of the points have at least three neighbours."""
    rng = np.random.default_rng(0)
    chosen = from_numpy(mi.UInt32, rng.integers(0, dr.width(p), 16384))
    return measure_spacing(p, dr.gather(mi.Point3f, p, chosen), 4, bounds, percentile=99.9)
