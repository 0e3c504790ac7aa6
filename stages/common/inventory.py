"""The parts of a scene, as JSON values."""

from __future__ import annotations

from collections import Counter
from typing import Any

import mitsuba as mi

from gpf.scene.bounds import bounding_box
from gpf.scene.inventory import scene_materials


def scene_info(scene: mi.Scene) -> dict[str, Any]:
    """The parts of a scene as JSON values.

    Keys: ``bbox`` (``min``, ``max``), ``emitters`` (``count``, ``types``: number by class),
    ``shapes`` (``id``, ``type``, ``bsdf`` each) and ``bsdfs``. The last has, for each material
    name (:func:`gpf.scene.inventory.scene_materials`), its ``type``, whether the field is
    ``queried`` there (it has a diffuse component) and whether paths are ``traced`` further (it has
    another component). For a layered material, both are true.
    """
    lobes = mi.BSDFFlags
    materials = scene_materials(scene)
    names = {id(bsdf): name for name, bsdf in materials.items()}
    shapes = [
        {"id": shape.id(), "type": shape.class_name(), "bsdf": names.get(id(shape.bsdf()))}
        for shape in scene.shapes()
    ]
    bsdfs = {}
    for name, bsdf in materials.items():
        flags = bsdf.flags()
        bsdfs[name] = {
            "type": bsdf.class_name(),
            "queried": bool(mi.has_flag(flags, lobes.Diffuse)),
            "traced": any(
                bool(mi.has_flag(flags, lobe))
                for lobe in (lobes.Glossy, lobes.Delta, lobes.Delta1D, lobes.Null)
            ),
        }
    emitters = scene.emitters()
    lower, upper = bounding_box(scene).tolist()
    return {
        "bbox": {"min": lower, "max": upper},
        "emitters": {
            "count": len(emitters),
            "types": dict(sorted(Counter(emitter.class_name() for emitter in emitters).items())),
        },
        "shapes": shapes,
        "bsdfs": bsdfs,
    }
