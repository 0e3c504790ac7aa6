"""The meshes and lamps of a scene, while Blender renders it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import geometry
import numpy as np
from lamps import read_lamp
from nodes import Closure, plain_inputs

MOST_COPIED = 100_000
"""Triangles of a mesh's copies, together; with more, the copies are instances."""

THIN = 1e-5
"""Distance between the two sides of a sheet that shines, in diagonals of the scene."""


@dataclass
class Known:
    """What was written for other frames.

    Attributes
    ----------
    shapes: those of each mesh, by its digest.
    triangles: of meshes that may bend, by the name of their object.
    """

    shapes: dict[bytes, list[dict[str, Any]]] = field(default_factory=dict)
    triangles: dict[str, geometry.Triangles] = field(default_factory=dict)


@dataclass
class Writer:
    """Writes the meshes of a scene while Blender renders it, as Blender renders them.

    Attributes
    ----------
    folder: meshes are written into its folder ``meshes``.
    extent: length of the scene's diagonal.
    tell: is told what is being written.
    closures: those of the scene, by object and slot.
    unwrapped: where baked images lie on meshes, by object.
    known: what was written for other frames; this one adds its own.
    frame: the number of the frame; None if there are no others.
    shapes, groups, instances, lamps, notes: what was found.
    """

    folder: Path
    extent: float
    tell: Callable[[str], None]
    closures: dict[tuple[str, int], Closure]
    unwrapped: dict[str, geometry.Unwrapping]
    known: Known
    frame: int | None = None
    shapes: list[dict[str, Any]] = field(default_factory=list)
    groups: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    instances: list[dict[str, Any]] = field(default_factory=list)
    lamps: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _count: int = 0

    def write(self, graph: Any) -> None:
        """Write everything that a dependency graph renders."""
        uses, sizes = Counter[str](), dict[str, int]()
        for instance in graph.object_instances:
            if self._is_mesh(instance):
                key = self._key(instance)
                uses[key] += 1
                if key not in sizes:
                    mesh = instance.object.data
                    mesh.calc_loop_triangles()
                    sizes[key] = len(mesh.loop_triangles)
        shining = {name for (name, _), closure in self.closures.items() if _shines(closure)}
        copied = {
            key
            for key, n in uses.items()
            if n > 1 and n * sizes[key] > MOST_COPIED and key.partition("/")[0] not in shining
        }
        total, done = sum(uses.values()), 0
        for instance in graph.object_instances:
            matrix = np.array(instance.matrix_world, dtype=np.float64)
            if self._is_mesh(instance):
                done += 1
                if done % 100 == 1:
                    self.tell(f"geometry {done} of {total}")
                self._write_mesh(instance, matrix, self._key(instance) in copied)
            elif instance.object.type == "LIGHT" and instance.show_self:
                found = read_lamp(instance.object.name, instance.object.data, matrix)
                if found is not None:
                    self.lamps.append(found)
            elif instance.object.type in ("VOLUME", "POINTCLOUD", "CURVES"):
                self.notes.append(
                    f"{instance.object.name}: {instance.object.type.lower()} left out"
                )

    def _is_mesh(self, instance: Any) -> bool:
        return instance.show_self and isinstance(instance.object.data, bpy.types.Mesh)

    def _key(self, instance: Any) -> str:
        thing = instance.object
        return f"{thing.original.name}/{thing.data.name}"

    def _write_mesh(self, instance: Any, matrix: np.ndarray, copied: bool) -> None:
        thing, key = instance.object, self._key(instance)
        name = thing.original.name
        if copied and key in self.groups:
            self.instances.append({"group": key, "matrix": matrix.tolist()})
            return
        named = {
            v["attribute"] for c in self._own(name) for v in plain_inputs(c) if "attribute" in v
        }
        unwrapping = self.unwrapped.get(name)
        if unwrapping is not None and not unwrapping.fits(thing.data):
            self.notes.append(f"{name}: some of its meshes without the images that were baked")
            unwrapping = None
        bent = None
        if self.frame is not None and _may_bend(thing.original):
            bent = self.known.triangles.setdefault(name, {})
        corners = geometry.read_corners(thing.data, unwrapping, next(iter(named), None), bent)
        if corners is None:
            return
        materials = [
            (_material(thing, slot), _shines(self.closures.get((name, slot))))
            for slot in range(max(len(thing.material_slots), 1))
        ]
        place = None if copied else matrix
        digest = corners.digest(name, materials, None if copied else matrix.tolist())
        if digest not in self.known.shapes:
            made = self._write_parts(name, corners.parts(), place, materials)
            self.known.shapes[digest] = made
        shapes = self.known.shapes[digest]
        self._count += len(shapes)
        if copied:
            self.groups[key] = shapes
            self.instances.append({"group": key, "matrix": matrix.tolist()})
        else:
            self.shapes += shapes

    def _write_parts(
        self,
        name: str,
        parts: list[geometry.Part],
        place: np.ndarray | None,
        materials: list[tuple[str | None, bool]],
    ) -> list[dict[str, Any]]:
        """Write the parts of an object's mesh."""
        shapes: list[dict[str, Any]] = []
        for part in parts:
            if not geometry.is_finite(part):
                self.notes.append(f"{name}: coordinates that are no numbers; left out")
                continue
            if geometry.area(part) == 0:
                self.notes.append(f"{name}: triangles without area; left out")
                continue
            if place is not None:
                part = geometry.transformed(part, place)
            slot = min(part.slot, len(materials) - 1)
            material, shines = materials[slot]
            sides = [part]
            if shines and geometry.is_open(part):
                sides.append(geometry.other_side(part, THIN * self.extent))
            for side in sides:
                stem = f"{self._count + len(shapes):04}"
                if self.frame is not None:
                    stem += f"_{self.frame:04}"
                geometry.write_ply(self.folder / f"meshes/{stem}.ply", side)
                shape = {"name": name, "file": f"meshes/{stem}.ply"}
                shapes.append(shape | {"slot": slot, "material": material})
        return shapes

    def _own(self, name: str) -> list[Closure]:
        return [closure for (thing, _), closure in self.closures.items() if thing == name]


def _shines(closure: Closure | None) -> bool:
    """Whether a closure has emission."""
    if closure is None:
        return False
    inner = [v for v in closure.values() if isinstance(v, dict) and "closure" in v]
    own = closure.get("strength", closure.get("emission_strength", 0.0))
    return own != 0 or any(map(_shines, inner))


def _may_bend(thing: Any) -> bool:
    """Whether the mesh of an object may have another shape in another frame."""
    if thing.type != "MESH" or thing.parent_type in ("ARMATURE", "LATTICE"):
        return True
    return bool(thing.modifiers or thing.data.shape_keys)


def _material(thing: Any, slot: int) -> str | None:
    slots = thing.material_slots
    return slots[slot].material.name if slots and slots[slot].material else None
