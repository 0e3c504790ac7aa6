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

BY_RAY = 4
"""Near lamps, one of so many samples is a ray that may meet them: otherwise, lamps a millimetre
away would cause samples that are a million times too bright."""

PILOT, PILOT_RAYS, CLOSE = 64, 8, 0.05
"""Near is where one of ``PILOT`` samples has a direction that rays take more often than samples do,
or where one of ``PILOT_RAYS`` rays meets a lamp within ``CLOSE`` times the size of the largest."""

BRIGHTEST = 16
"""Elsewhere, no sample counts for more than so many rays that meet the lamp."""

RUN = 64
"""So many neighbouring points take rays at the same time."""

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
        self._known_near: dict[tuple[int, ...] | None, mi.Bool] = {}

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
        lamps = Lamps(self.scene) if lamps is None else lamps
        return self._sample(sample, lamps, mi.Bool(True))[0]

    def _sample(
        self, sample: mi.Point2f, lamps: Lamps, active: mi.Bool
    ) -> tuple[mi.Color3f, mi.DirectionSample3f]:
        """:meth:`direct_irradiance`, and the point on the emitter."""
        light, weight = lamps.sample(self._interactions(), sample, active)
        seen = (light.pdf > 0) & (dr.dot(light.d, self.points.n) > 0)
        return dr.select(seen, weight * self.share(light.d), 0), light

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

        With the densities p_e of these samples and p_f = cos θ / π of rays, of which there is one
        in :data:`BY_RAY` = k near lamps, their shares by the balance heuristic are

            w_e = (k - 1) p_e / ((k - 1) p_e + p_f),    w_f = 1 - w_e.

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
        near, phase = self._near(lamps), mi.UInt32(0)
        if dr.hint(near is not None, mode="scalar"):
            lane = dr.arange(mi.UInt32, dr.width(self.points.p))
            phase = mi.UInt32(BY_RAY * dr.gather(mi.Float, start.x, lane // RUN * RUN))
        while dr.hint(number < end, exclude=[start, end]):
            plain = spread_sample(start, number)
            sample, weight = mi.Point2f(plain), mi.Float(1)
            if dr.hint(warp is not None, mode="scalar"):
                sample, weight = warp(sample)  # type: ignore[misc]
            found = mi.Color3f(0)
            if dr.hint(near is not None, mode="scalar"):
                if near & ((number + phase) % BY_RAY == 0):
                    found = self._met(plain, lamps) * BY_RAY
                else:
                    found, light = self._sample(sample, lamps, mi.Bool(True))
                    hit = (light.pdf > 0) & ~light.delta  # points in spheres have NaN as d
                    by_ray = dr.select(hit, self._density(light.d), 0)
                    pdf = dr.maximum(light.pdf, 1e-30)
                    share = (BY_RAY - 1) * pdf / ((BY_RAY - 1) * pdf + by_ray)
                    share *= BY_RAY / (BY_RAY - 1)
                    most = dr.select(_is_infinite(light), 1, BRIGHTEST * pdf / by_ray)
                    found *= weight * dr.select(near, share, dr.minimum(1, most))
            else:
                found = self._sample(sample, lamps, mi.Bool(True))[0] * weight
            total += found
            squares += found * found
            number += 1
        dr.eval(total, squares)
        return total, squares

    def _near(self, lamps: Lamps) -> mi.Bool | None:
        """Which points are near lamps, (N,); None if none can be."""
        if not (lamps and lamps.can_be_near):
            return None
        key = None if lamps.indices is None else tuple(lamps.indices)
        if key not in self._known_near:
            self._known_near[key] = self._look_for(lamps)
        return self._known_near[key]

    @loops_traced_once
    @dr.syntax
    def _look_for(self, lamps: Lamps) -> mi.Bool:
        here, number = self._interactions(), mi.UInt32(0)
        start = random_start(PILOT, dr.width(self.points.p))
        near = dr.zeros(mi.Bool, dr.width(self.points.p))
        while number < PILOT:
            light, _ = lamps.choose(here, spread_sample(start, number), mi.Bool(True))
            found = ~light.delta & ~_is_infinite(light) & (light.pdf > 0)
            near |= found & (light.pdf < self._density(light.d))
            number += 1
        number = mi.UInt32(0)
        while number < PILOT_RAYS:
            ray, cosine = self.cosine_rays(spread_sample(start, number))
            ray.maxt = CLOSE * lamps.size
            near |= dr.any(lamps.met(here, ray, cosine, 0, cosine > 0) > 0)
            number += 1
        dr.eval(near)
        return near

    def _density(self, direction: mi.Vector3f) -> mi.Float:
        """Of :meth:`cosine_rays`, 1/sr, (N,)."""
        return dr.maximum(dr.dot(direction, self.points.n), 0) * dr.inv_pi

    def _met(self, sample: mi.Point2f, lamps: Lamps) -> mi.Color3f:
        """The share of a ray in the irradiance, (N, 3)."""
        ray, cosine = self.cosine_rays(sample)
        pdf, facing = cosine * dr.inv_pi, cosine > 0
        light = lamps.met(self._interactions(), ray, pdf, BY_RAY - 1, facing)
        return dr.select(facing, light * self.share(ray.d) / pdf, 0)

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


def _is_infinite(light: mi.DirectionSample3f) -> mi.Bool:
    """Whether light comes from a sky, (N,): its density may be small where another part is bright,
    but no part is near."""
    return mi.has_flag(light.emitter.flags(), mi.EmitterFlags.Infinite)
