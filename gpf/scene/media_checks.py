"""What a scene's media need before light can be traced in them."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.core.structs import from_numpy
from gpf.scene.bounds import scene_bounds
from gpf.scene.media import Media

RAYS = 4096
"""Rays that look for boundaries whose media do not fit together."""

# Boundaries that a ray may cross, and the share of them that may be wrong: rays along an edge can
# miss one of two surfaces.
_CROSSINGS, _WRONG = 16, 0.01


def check_media(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` if light cannot be traced in the scene's media: a coefficient is
    impossible, or surfaces disagree about what is between them."""
    media = Media(scene).every
    for medium in media:
        _check_coefficients(medium, where)
    if not media or not dr.is_jit_v(mi.Float):  # rays by the thousand need a wavefront variant
        return
    wrong, number = wrong_boundaries(scene)
    if number and wrong > _WRONG * number:
        raise UserError(
            where,
            f"has media that do not fit together: at {wrong} of {number} boundaries, the medium "
            "behind a ray is not the one that the surface names",
            "Name the medium on both sides of each boundary (interior, exterior), and let no "
            "boundaries intersect.",
        )


def _check_coefficients(medium: mi.Medium, where: str) -> None:
    name = f"the medium {medium.id()}" if medium.id() else "a medium"
    for key, value in mi.traverse(medium).items():
        part = key.split(".")[0]
        if part not in ("albedo", "sigma_t", "scale"):
            continue
        numbers = np.array(value, np.float64).ravel()
        what = "albedo" if part == "albedo" else "density"
        if not np.isfinite(numbers).all():
            raise UserError(where, f"has NaN or infinite values in the {what} of {name}", _REMEDY)
        if numbers.min() < 0 or (part == "albedo" and numbers.max() > 1):
            limits = "[0, 1]" if part == "albedo" else "[0, ∞)"
            found = numbers.min() if numbers.min() < 0 else numbers.max()
            words = f"has {found:.4g} in the {what} of {name}, which is outside {limits}"
            raise UserError(where, words, _REMEDY)


_REMEDY = "Correct it in the scene."


def wrong_boundaries(scene: mi.Scene) -> tuple[int, int]:
    """How many boundaries, met by random rays through the scene, name another medium behind the ray
    than the one that it was in; and how many were met."""
    lower, upper = (np.array(corner) for corner in scene_bounds(scene))
    rng = np.random.default_rng(0)
    origin = from_numpy(mi.Point3f, rng.uniform(lower, upper, (RAYS, 3)))
    direction = mi.warp.square_to_uniform_sphere(from_numpy(mi.Point2f, rng.random((RAYS, 2))))
    ray = mi.Ray3f(origin, direction)
    media, active = Media(scene), dr.full(mi.Bool, True, RAYS)
    medium, wrong, number = media.around(ray, active), 0, 0
    for _ in range(_CROSSINGS):
        si = scene.ray_intersect(ray, mi.RayFlags.Minimal, False, active)
        active &= si.is_valid()
        crosses = active & si.is_medium_transition()
        behind, ahead = si.target_medium(-ray.d), si.target_medium(ray.d)
        wrong += int(dr.count(crosses & (behind != medium))[0])
        number += int(dr.count(crosses)[0])
        medium = dr.select(crosses, ahead, medium)
        ray = si.spawn_ray(ray.d)
        dr.eval(ray, medium, active)
    return wrong, number
