"""The parts of a loaded scene, and whether photon mapping can render it."""

from __future__ import annotations

import warnings
from collections import Counter

import drjit as dr
import mitsuba as mi
import numpy as np

from gpf.core.errors import UserError
from gpf.scene.bounds import bounding_box
from gpf.scene.materials import NOT_DIFFUSE, require_separable
from gpf.scene.media_checks import check_media
from gpf.scene.shapes import all_shapes, parameters

MOST_OFFSET = 4e-3
"""Largest distance of rays from surfaces at which they begin, relative to the scene's diagonal. The
light of a Cornell Box with a glass ball is right within .2 % at 2.6e-3, and 4 % wrong at 2.6e-2."""


def check_scene(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` if photon mapping cannot render the scene.

    A scene needs emitters, diffuse surfaces, materials whose diffuse part can be separated,
    triangles in each mesh, and finite numbers. ``where`` names the scene in the message.
    """
    check_meshes(scene, where)
    check_media(scene, where)
    warn_of_rounding(scene)
    check_numbers(scene, where)
    if not scene.emitters():
        raise UserError(where, "has no emitters, so there are no photons", "Add a light.")
    require_separable(scene, where)
    if loses_dim_sky(scene):
        raise UserError(
            where,
            "has an envmap with mis_compensation, whose dim parts would emit no photons",
            "Load the scene with gpf.load_scene_file, or remove mis_compensation.",
        )
    materials = scene_materials(scene).values()
    if not any(mi.has_flag(bsdf.flags(), mi.BSDFFlags.Diffuse) for bsdf in materials):
        raise UserError(
            where,
            "has no diffuse surface, so no photon can be stored",
            "Give at least one shape a material with a diffuse component.",
        )


def warn_of_rounding(scene: mi.Scene) -> None:
    """Give a Python warning if the scene is too small, or too far from the origin, for Mitsuba.

    Rays begin ``(1 + max |p|) ε`` above surfaces: that depends on the coordinates alone.
    """
    box = bounding_box(scene)
    size = float(np.linalg.norm(box[1] - box[0]))
    offset = mi.math.RayEpsilon * (1 + float(np.abs(box).max()))
    if offset > MOST_OFFSET * size > 0:
        far = np.abs(box).max() > 10 * size
        todo = "Move it to the origin" if far else "Scale it to a size of 1 or more"
        warnings.warn(
            f"The scene extends from {box[0].round(4)} to {box[1].round(4)}, where single "
            f"precision keeps rays {offset:.1g} from surfaces: light is lost in gaps, and leaks at "
            f"edges. {todo}.",
            stacklevel=1,
        )


def loses_dim_sky(scene: mi.Scene, directions: int = 4096) -> bool:
    """Whether the scene has an environment map with ``mis_compensation``.

    Parts of such a map that are dimmer than its mean are never sampled. A path tracer finds them
    through BSDF sampling; photons, and emitter sampling alone, do not.
    """
    sky = scene.environment()
    if sky is None or sky.class_name() != "EnvironmentMapEmitter" or not dr.is_jit_v(mi.Float):
        return False  # photons need a wavefront variant
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, directions)
    si, light = dr.zeros(mi.SurfaceInteraction3f), dr.zeros(mi.DirectionSample3f)
    light.d = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    si.wi = -light.d
    radiance = dr.mean(sky.eval(si))
    lost = dr.select(sky.pdf_direction(dr.zeros(mi.Interaction3f), light) > 0, 0, radiance)
    return float(dr.sum(lost)[0]) > 1e-3 * float(dr.sum(radiance)[0])


def check_meshes(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` if a mesh of the scene has no triangles.

    A ray that hits it would cause a Dr.Jit error: a gather from an empty array.
    """
    for shape in all_shapes(scene):
        if isinstance(shape, mi.Mesh) and not shape.face_count():
            name = shape.id() or f"a shape ({shape.class_name()})"
            raise UserError(where, f"has no triangles in the mesh of {name}", "Remove the shape.")


def check_numbers(scene: mi.Scene, where: str = "scene") -> None:
    """Raise a :class:`UserError` if a number of an emitter or a material, or a pixel of its images,
    is NaN or infinite: it would spread to all of the light."""
    lights = [(emitter.id() or emitter.class_name(), emitter) for emitter in scene.emitters()]
    for name, part in (*lights, *scene_materials(scene).items()):
        for key, value, _ in parameters(part):
            if not dr.is_array_v(value) or not dr.is_float_v(value):
                continue
            if not dr.all(dr.isfinite(value), axis=None):
                what = f"has NaN or infinite numbers in {key} of {name}"
                raise UserError(where, what, "Correct that image or number.")


def scene_materials(scene: mi.Scene) -> dict[str, mi.BSDF]:
    """The materials of all surfaces that a ray can hit, by id, or else by class and shape."""
    found: dict[str, mi.BSDF] = {}
    known = set()
    numbers: Counter[str] = Counter()
    for shape in all_shapes(scene):
        # The material of an instance is not used: the shapes of its group have their own.
        bsdf = shape.bsdf()
        if bsdf is None or shape.class_name() in ("Instance", "ShapeGroupPlugin"):
            continue
        name = plain = bsdf.id() or f"{bsdf.class_name()} of {shape.id() or shape.class_name()}"
        if (plain, bsdf) in known:
            continue
        known.add((plain, bsdf))
        while name in found:
            numbers[plain] += 1
            name = f"{plain} ({numbers[plain] + 1})"
        found[name] = bsdf
    return found


def divides_walks(scene: mi.Scene) -> bool:
    """Whether a camera walk can take both paths at its first surface: transmission and reflection
    at smooth glass, or the diffuse component of a material and its others.

    The scene must have such a surface, and at all smooth glass, a random number alone must choose
    between the two directions: no blended materials, and no masks.
    """
    through = int(mi.BSDFFlags.DeltaTransmission) | int(mi.BSDFFlags.Null)
    diffuse, glossy = int(mi.BSDFFlags.Diffuse), int(mi.BSDFFlags.Glossy)
    kinds = [(bsdf.class_name(), int(bsdf.flags())) for bsdf in scene_materials(scene).values()]
    glass = {
        name
        for name, flags in kinds
        if flags & int(mi.BSDFFlags.DeltaReflection)
        and flags & through
        and not flags & (diffuse | glossy)
    }
    layered = any(flags & diffuse and flags & NOT_DIFFUSE for _, flags in kinds)
    return (bool(glass) or layered) and glass <= {"SmoothDielectric", "ThinDielectric"}
