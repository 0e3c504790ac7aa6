"""Points that stay the same for all passes, and the direct light that reaches them."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.loops import loops_traced_once
from gpf.core.random import random_start, spread_sample
from gpf.core.structs import VisiblePoints, to_numpy
from gpf.scene.lamps import Lamps
from gpf.scene.materials import diffuse_context

# Maps random numbers, (N, 2), to others, and gives the weights of their samples, (N,).
Warp = Callable[["mi.Point2f"], tuple["mi.Point2f", "mi.Float"]]


class FixedPoints:
    """Points whose irradiance is accumulated, all of them valid.

    Parameters
    ----------
    points: positions, and normals on the side where light is gathered, (N).
    lasting: whether their surfaces are found once, and kept in memory. Not in a recorded loop.
    """

    def __init__(self, scene: mi.Scene, points: VisiblePoints, lasting: bool = True) -> None:
        self.scene, self.points, self._lasting = scene, points, lasting

    @cached_property
    def _surface(self) -> mi.SurfaceInteraction3f:
        """The surfaces of the points, (N,), found by short rays from above; invalid where a ray
        misses the surface."""
        above = self._interactions()
        ray = above.spawn_ray(self.points.n)
        height = dr.norm(ray.o - self.points.p)
        ray.d = -self.points.n
        ray.maxt = 4 * height
        si = self.scene.ray_intersect(ray)
        same = si.is_valid() & (dr.abs(dr.dot(si.n, self.points.n)) > 0.7)
        si.t = dr.select(same, si.t, dr.inf)
        if self._lasting:
            dr.eval(si)
        return si

    def direct_irradiance(self, sample: mi.Point2f, lamps: Lamps | None = None) -> mi.Color3f:
        """Irradiance from one point on one emitter, W/m², (N, 3).

            E = L_e / p_e(ω) T |cos θ| g(ω)

        where T is the fraction of the light that arrives, θ is measured in the shading frame, and g
        is that of :func:`gpf.scene.materials.diffuse_transfer`. Photons from the same point would
        give the same irradiance.

        Parameters
        ----------
        sample: random numbers in [0, 1)², (N, 2).
        lamps: the emitters to sample; all by default.
        """
        here, n = self._interactions(), self.points.n
        lamps = Lamps(self.scene) if lamps is None else lamps
        light, weight = lamps.sample(here, sample, mi.Bool(True))
        seen = (light.pdf > 0) & (dr.dot(light.d, n) > 0)
        return dr.select(seen, weight * self.share(light.d), 0)

    @loops_traced_once
    @dr.syntax
    def direct_sums(  # type: ignore[no-untyped-def]
        self,
        start: mi.Point2f,
        first: int,
        count: int = 1,
        lamps: Lamps | None = None,
        warp: Warp | None = None,
    ) -> tuple[mi.Color3f, mi.Color3f]:
        """Sums of the irradiance, and of its square, over samples of the emitters, (N, 3) each.

        Parameters
        ----------
        start: start of each point's sequence of samples, (N, 2); see
            :func:`gpf.core.random.random_start`.
        first, count: the samples are elements ``first`` to ``first + count - 1`` of the sequence.
        lamps: the emitters to sample; all by default.
        warp: replaces the sequence's random numbers, and gives the weights of their light.
        """
        lamps = Lamps(self.scene) if lamps is None else lamps
        total, squares = (dr.zeros(mi.Color3f, dr.width(self.points.p)) for _ in range(2))
        # One kernel serves any range of samples; it is traced once for all of them.
        number, end = dr.opaque(mi.UInt32, first), dr.opaque(mi.UInt32, first + count)
        _ = self._surface  # cannot be computed within a loop
        while dr.hint(number < end, exclude=[start, end]):
            sample, weight = spread_sample(start, number), mi.Float(1)
            if dr.hint(warp is not None, mode="scalar"):
                sample, weight = warp(sample)  # type: ignore[misc]
            found = self.direct_irradiance(sample, lamps) * weight
            total += found
            squares += found * found
            number += 1
        dr.eval(total, squares)
        return total, squares

    def cosine_rays(self, sample: mi.Point2f) -> tuple[mi.Ray3f, mi.Float]:
        """Rays from the points, (N,), with density cos θ / π, and their cos θ, (N,).

        ``sample``: random numbers in [0, 1)², (N, 2).
        """
        local = mi.warp.square_to_cosine_hemisphere(sample)
        direction = mi.Frame3f(self.points.n).to_world(local)
        return mi.Ray3f(self._interactions().spawn_ray(direction)), local.z

    def _interactions(self) -> mi.SurfaceInteraction3f:
        """The points as origins of rays, (N,)."""
        here = dr.zeros(mi.SurfaceInteraction3f, dr.width(self.points.p))
        here.p, here.n = self.points.p, self.points.n
        return here

    def share(self, direction: mi.Vector3f) -> mi.Color3f:
        """Irradiance due to light from direction ω, relative to light of the same radiance from
        straight above, (N, 3): the cosine of the direction times g(ω)."""
        n, si = self.points.n, self._surface
        cosine = dr.dot(direction, n)
        # As for a photon that lands: the BSDF for light from ω over that for light from above.
        context, known = diffuse_context(), si.is_valid()
        upright = mi.SurfaceInteraction3f(si)
        upright.wi = mi.Vector3f(0, 0, dr.select(dr.dot(si.sh_frame.n, n) > 0, 1, -1))
        bsdf, wo = si.bsdf(), si.to_local(direction)
        straight = bsdf.eval(context, upright, upright.wi, known)
        slanted = bsdf.eval(context, upright, wo, known)
        shaded = dr.select(straight > 0, slanted / straight, dr.maximum(wo.z * upright.wi.z, 0))
        return dr.select(known, shaded, cosine)

    def mean_direct(self, lamps: Lamps, samples: int, seed: int) -> np.ndarray:
        """Irradiance from lamps, W/m², (N, 3) float32: means of evenly spread samples,
        ``samples`` for each of :meth:`Lamps.groups`."""
        total = dr.zeros(mi.Color3f, dr.width(self.points.p))
        start = random_start(seed, dr.width(self.points.p))
        for number, group in enumerate(lamps.groups()):
            total += self.direct_sums(start, number * samples + 1, samples, group)[0]
        return to_numpy(total) / np.float32(samples)
