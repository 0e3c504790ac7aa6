"""Light between diffuse surfaces, gathered at points by rays that end in a field.

Photons need a kernel, which blurs their light and brings it through thin walls. A ray needs none:
the surface that it meets sends what arrives there by the word of a field (final gathering). That
surface is mostly far away, so small errors of the field average out. Caustics are left to the
photons, direct light to samples of the emitters.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from gpf.camera.next_event import direct_light
from gpf.core.random import Stream, pass_seed, random_start, spread_sample
from gpf.field.field import GaussianPhotonField
from gpf.scene.lamps import Lamps
from gpf.scene.materials import diffuse_context, diffuse_reflectance, has_diffuse
from gpf.sppm.fixed_points import FixedPoints
from gpf.training.sampled_light import SampledLight

NEAR = 0.25
"""Below this distance, in cells of the field's levels, a ray does not end in the field but goes on,
as a path does. In a gap of a centimetre between a cupboard and a wall, the field has the light of
the wall beside it."""

# A ray meets at most so many surfaces: near ones, and those that it goes straight through.
_MOST_SURFACES = 8


class GatheredLight(SampledLight):
    """Light from diffuse surfaces at points.

    Parameters
    ----------
    field: says what arrives at the surfaces.
    """

    LEAST, MOST_PER_PASS, COST = 4, 0.25, 0.2

    def __init__(self, points: FixedPoints, field: GaussianPhotonField, seed: int) -> None:
        super().__init__(points, seed)
        self.field = field

    def _light(self, half: int, number: int) -> mi.Color3f:
        seed = pass_seed(self.seed, half, Stream.GATHER_RAYS)
        start = random_start(seed, dr.width(self.points.points.p))
        others = pass_seed(self.seed, half, Stream.GATHER_LAMPS, number)
        return gather(self.points, self.field, spread_sample(start, number), others)


@dr.syntax
def gather(
    points: FixedPoints, field: GaussianPhotonField, sample: mi.Point2f, seed: int
) -> mi.Color3f:
    """Irradiance from diffuse surfaces, along one ray from each point, W/m², (N, 3).

        E = π / cos θ · L · |cos θ| g(ω),    L = ρ E_f / π,

    with directions in proportion to cos θ; E_f is what the field says that arrives at the surface
    which the ray meets, with samples of the lamps that the field does not store, and ρ the diffuse
    reflectance there. If that surface is nearer than :data:`NEAR`, L is that of a path: samples of
    all emitters, and a further ray.

    Parameters
    ----------
    sample: random numbers in [0, 1)², (N, 2).
    seed: of the random numbers beyond the first surface.
    """
    scene, width = points.scene, dr.width(points.points.p)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, width)
    context, every = diffuse_context(), Lamps(scene)
    lamps = field.settings.sampled_lamps(scene)
    resolved = dr.opaque(mi.Float, _resolved(field))

    ray, cosine = points.cosine_rays(sample)
    direction = mi.Vector3f(ray.d)
    radiance, through = dr.zeros(mi.Color3f, width), mi.Color3f(1)
    surfaces, active = mi.UInt32(0), mi.Bool(cosine > 0)
    while active:
        si = scene.ray_intersect(ray, active=active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        diffuse = active & has_diffuse(bsdf, si)
        straight = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        near = diffuse & (si.t < resolved) & ~straight
        known = diffuse & ~near
        sent, further = mi.Color3f(0), ray.d
        if known:
            facing = mi.Normal3f(dr.mulsign(si.n, -dr.dot(si.n, ray.d)))
            arriving, _ = field.query(si.p, facing, known)
            reflectance = diffuse_reflectance(bsdf, si, known)
            sent = dr.select(known, dr.maximum(arriving, 0) * reflectance / dr.pi, 0)
            if dr.hint(bool(lamps), mode="scalar"):
                sent += direct_light(scene, sampler, context, bsdf, si, known, lamps)
        if near:
            sent += direct_light(scene, sampler, context, bsdf, si, near, every)
        radiance += through * sent

        if straight:
            through *= dr.select(straight, bsdf.eval_null_transmission(si, straight), 1)
        if near:
            bounce, weight = bsdf.sample(
                context, si, sampler.next_1d(near), sampler.next_2d(near), near
            )
            through *= dr.select(near, weight, 1)
            further = dr.select(near, si.to_world(bounce.wo), further)
        surfaces += 1
        active = (straight | near) & dr.any(through > 0) & (surfaces < _MOST_SURFACES)
        ray = si.spawn_ray(further)
    weight = dr.select(cosine > 0, dr.pi / cosine, 0)
    return radiance * weight * points.share(direction)


def _resolved(field: GaussianPhotonField) -> float:
    """:data:`NEAR` in world units; without levels, in search radii."""
    detail = field.detail
    return NEAR * (field.settings.search_radius if detail is None else detail.width)
