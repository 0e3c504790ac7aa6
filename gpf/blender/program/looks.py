"""What meshes look like: the closures of their materials, as Blender renders them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from bake import Baking
from geometry import column, digest_of_faces
from nodes import Closure, plain_inputs, read_material
from sources import sources


@dataclass
class Looks:
    """Reads the closures of meshes in a frame.

    Attributes
    ----------
    baking: bakes what is no plain value or image.
    closures: of each slot that a mesh uses, by the mesh's key.
    unwrapped: where baked images lie on meshes, by their keys: UVs of each corner, (L, 2).
    waiting: what must be baked before these are complete, as the words of :meth:`Baking.bake`.
    """

    baking: Baking
    closures: dict[str, dict[int, Closure]] = field(default_factory=dict)
    unwrapped: dict[str, np.ndarray] = field(default_factory=dict)
    waiting: list[tuple[Any, ...]] = field(default_factory=list)

    def read(self, key: str, thing: Any) -> None:
        """Read what an evaluated object's mesh looks like, if that is not known."""
        if key in self.closures:
            return
        mesh, materials = thing.data, materials_of(thing)
        used = np.unique(column(mesh.polygons, "material_index", 1, np.int32))
        slots = np.unique(np.minimum(used, len(materials) - 1)).tolist()
        own = {slot: read_material(materials[slot]) for slot in slots}
        self.closures[key] = own
        colours = {attribute.name for attribute in mesh.color_attributes}
        if any(_needs_baking(closure, colours) for closure in own.values()):
            origin = digest_of_faces(mesh).hex() + "".join(map(sources, own.values()))
            if not self._take(key, origin, own):
                self.waiting.append((key, origin, own, thing.original, _copy(mesh, materials)))

    def bake(self) -> None:
        """Bake what is waiting."""
        for task in self.waiting:
            self.baking.bake(*task)
            self._take(*task[:3])
        self.waiting.clear()

    def _take(self, key: str, origin: str, closures: dict[int, Closure]) -> bool:
        """Take what was baked before, if it is the same."""
        known = self.baking.find(key, origin, closures)
        if known is not None:
            self.closures[key], self.unwrapped[key] = known
        return known is not None


def _copy(mesh: Any, materials: list[Any]) -> Any:
    """A copy that stays when Blender has rendered the scene, with the same generated coordinates,
    and with the materials of its object's slots."""
    place, size = mesh.texspace_location.copy(), mesh.texspace_size.copy()
    copy = mesh.copy()
    copy.use_auto_texspace, copy.texspace_location, copy.texspace_size = False, place, size
    while len(copy.materials) < len(materials):
        copy.materials.append(None)
    for slot, material in enumerate(materials):
        copy.materials[slot] = material
    return copy


def materials_of(thing: Any) -> list[Any]:
    """The materials of an evaluated object's slots, None where there is none; at least one."""
    slots = [slot.material for slot in thing.material_slots] or [None]
    return [material and material.original for material in slots]


def _needs_baking(closure: Closure, colours: set[str]) -> bool:
    inputs = plain_inputs(closure)
    named = {v["attribute"] for v in inputs if "attribute" in v}
    return (
        closure.get("displaced", False)
        or any("bake" in v for v in inputs)
        or not named <= colours
        or len(named) > 1
    )
