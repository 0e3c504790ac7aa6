"""Light between diffuse surfaces, gathered at points by rays that end in a field.

Photons need a kernel, which blurs their light and leaks it through thin walls. A ray needs none:
what the surface that it meets sends follows from what arrives there, and a field gives that (final
gathering). The surface is usually far away, so small errors of the field average out. Caustics are
left to the photons, direct light to samples of the emitters.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.camera.next_event import direct_light
from gpf.core.loops import loops_traced_once
from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.core.structs import VisiblePoints
from gpf.field.field import GaussianPhotonField
from gpf.field.shared_query import query_shared
from gpf.scene.lamps import Lamps
from gpf.scene.materials import diffuse_context, diffuse_reflectance, has_diffuse
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.sampled_light import SampledLight

NEAR = 0.25
"""Below this distance, in cells of the field's levels, a ray does not end in the field but goes on
as a path. In a centimetre-wide gap between a cupboard and a wall, the field would give the light of
the wall beside it."""

# Most surfaces that a ray meets: near ones, and those that it goes straight through.
_MOST_SURFACES = 8


class GatheredLight(SampledLight):
    """Light from diffuse surfaces at points.

    Parameters
    ----------
    field: gives the irradiance of the surfaces that the rays meet.
    since: photon passes before the first that has samples.
    """

    LEAST, MOST_PER_PASS, COST = 4, 1.0, 0.6

    def __init__(
        self, points: FixedPoints, field: GaussianPhotonField, seed: int, since: int = 0
    ) -> None:
        super().__init__(points, seed)
        self.field, self.since = field, since

    def sample(self, passes: int) -> None:
        """Add the samples that go with this many passes."""
        super().sample(passes - self.since)

    def tensors(self) -> dict[str, np.ndarray]:
        """The samples so far, and the passes before them, for a file."""
        return super().tensors() | {"lit": np.array([self.since])}

    def _light(self, half: int, first: int, count: int) -> mi.Color3f:
        seed = pass_seed(self.seed, half, Stream.GATHER_RAYS)
        start = random_start(seed, dr.width(self.points.points.p))
        total = mi.Color3f(0)
        for number in range(first, first + count):
            others = pass_seed(self.seed, half, Stream.GATHER_LAMPS, number)
            total += gather(self.points, self.field, spread_sample(start, number), others)
            dr.eval(total)
        return total


def gather(
    points: FixedPoints, field: GaussianPhotonField, sample: mi.Point2f, seed: int
) -> mi.Color3f:
    """Irradiance from diffuse surfaces, along one ray from each point, W/m², (N, 3).

        E = π / cos θ · L · |cos θ| g(ω),    L = ρ E_f / π,

    with directions distributed in proportion to cos θ. E_f is the irradiance of the surface that
    the ray meets: the field's answer, with samples of the lamps that the field does not store; ρ is
    the diffuse reflectance there. If that surface is nearer than :data:`NEAR`, L is that of a path:
    samples of all emitters, and a further ray.

    Parameters
    ----------
    sample: random numbers in [0, 1)², (N, 2).
    seed: for the random numbers beyond the first surface.
    """
    ray, cosine = points.cosine_rays(sample)
    weight = dr.select(cosine > 0, dr.pi / cosine, 0) * points.share(ray.d)
    ends = _look(points.scene, field, ray, cosine > 0, seed)
    dr.eval(ends, weight)
    arriving, _ = query_shared(field, ends.p, ends.n, ends.valid)
    return weight * ends.radiance(dr.maximum(arriving, 0))


@loops_traced_once
@dr.syntax
def _look(  # type: ignore[no-untyped-def]
    scene: mi.Scene, field: GaussianPhotonField, ray: mi.Ray3f, active: mi.Bool, seed: int
) -> VisiblePoints:
    """Where gather rays end, and the light that they bring besides, ``emission``, (N,)."""
    width = dr.width(ray.d)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width)
    context, every = diffuse_context(), Lamps(scene)
    lamps = field.settings.sampled_lamps(scene)
    resolved = dr.opaque(mi.Float, _resolved(field))

    ends = dr.zeros(VisiblePoints, width)
    p, n, reflectance = ends.p, ends.n, ends.reflectance
    emission, through = ends.emission, mi.Color3f(1)
    valid = mi.Bool(False)
    surfaces, active = mi.UInt32(0), mi.Bool(active)
    while dr.hint(active, exclude=[resolved]):
        si = scene.ray_intersect(ray, active=active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        diffuse = active & has_diffuse(bsdf, si)
        straight = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        near = diffuse & (si.t < resolved) & ~straight
        if straight:
            # Cloth with holes: the ray goes through, or ends there.
            passing = bsdf.eval_null_transmission(si, straight)
            chance = dr.select(diffuse, dr.mean(passing), 1)
            straight &= sampler.next_1d(straight) < chance
            through *= dr.select(straight, passing / chance, 1 / (1 - chance))
        known = diffuse & ~near & ~straight
        sent, further = mi.Color3f(0), ray.d
        if known:
            p = mi.Point3f(si.p)
            n = mi.Normal3f(dr.mulsign(si.n, -dr.dot(si.n, ray.d)))
            reflectance = diffuse_reflectance(bsdf, si, known)
            valid = mi.Bool(True)
            if dr.hint(bool(lamps), mode="scalar"):
                sent += direct_light(scene, sampler, context, bsdf, si, known, lamps)
        if near:
            sent += direct_light(scene, sampler, context, bsdf, si, near, every)
        emission += through * sent

        if near:
            bounce, weight = bsdf.sample(
                context, si, sampler.next_1d(near), sampler.next_2d(near), near
            )
            through *= dr.select(near, weight, 1)
            further = dr.select(near, si.to_world(bounce.wo), further)
        surfaces += 1
        active = (straight | near) & dr.any(through > 0) & (surfaces < _MOST_SURFACES)
        ray = si.spawn_ray(further)
    return VisiblePoints(
        p=p,
        n=n,
        reflectance=reflectance,
        throughput=through,
        emission=emission,
        depth=surfaces,
        valid=valid,
    )


def _resolved(field: GaussianPhotonField) -> float:
    """:data:`NEAR` in world units; if the field has no levels, it counts search radii."""
    detail = field.detail
    return NEAR * (field.settings.search_radius if detail is None else detail.width)
