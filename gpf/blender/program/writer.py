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
from looks import Looks, materials_of
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
    triangles: of meshes that may bend, by their key.
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
    looks: reads what meshes look like.
    tints: of lamps with nodes, by the name of their data.
    known: what was written for other frames; this one adds its own.
    frame: the number of the frame; None if there are no others.
    shapes, groups, instances, lamps, notes: what was found.
    """

    folder: Path
    extent: float
    tell: Callable[[str], None]
    looks: Looks
    tints: dict[str, np.ndarray]
    known: Known
    frame: int | None = None
    shapes: list[dict[str, Any]] = field(default_factory=list)
    groups: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    instances: list[dict[str, Any]] = field(default_factory=list)
    lamps: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _count: int = 0
    _meshes: dict[str, dict[int, int]] = field(default_factory=dict)

    def write(self, graph: Any) -> None:
        """Write everything that a dependency graph renders, unless something must be baked first:
        that waits in ``looks``, and the scene must be rendered again."""
        self._meshes.clear()
        uses, sizes = Counter[str](), dict[str, int]()
        for instance in graph.object_instances:
            if self._is_mesh(instance):
                key = self._key(instance)
                uses[key] += 1
                if key not in sizes:
                    mesh = instance.object.data
                    mesh.calc_loop_triangles()
                    sizes[key] = len(mesh.loop_triangles)
                    self.looks.read(key, instance.object)
        if self.looks.waiting:
            return
        copied = {
            key
            for key, n in uses.items()
            if n > 1
            and n * sizes[key] > MOST_COPIED
            and not any(map(_shines, self.looks.closures[key].values()))
        }
        total, done = sum(uses.values()), 0
        for instance in graph.object_instances:
            matrix = np.array(instance.matrix_world, dtype=np.float64)
            if self._is_mesh(instance):
                done += 1
                if done % 100 == 1:
                    self.tell(f"geometry {done} of {total}")
                self._write_mesh(instance, matrix, self._key(instance) in copied)
            elif (thing := instance.object).type == "LIGHT" and instance.show_self:
                tint = self.tints.get(thing.data.name, np.ones(3))
                found = read_lamp(thing.name, thing.data, matrix, tint)
                if found is not None:
                    self.lamps.append(found)
            elif thing.type in ("VOLUME", "POINTCLOUD", "CURVES"):
                self.notes.append(f"{thing.name}: {thing.type.lower()} left out")

    def _is_mesh(self, instance: Any) -> bool:
        thing = instance.object
        shown = instance.show_self and isinstance(thing.data, bpy.types.Mesh)
        return shown and len(thing.data.polygons) > 0

    def _key(self, instance: Any) -> str:
        """A name for an object's mesh; geometry nodes may give it several."""
        name = instance.object.original.name
        own = self._meshes.setdefault(name, {})
        return f"{own.setdefault(instance.object.data.session_uid, len(own))} {name}"

    def _write_mesh(self, instance: Any, matrix: np.ndarray, copied: bool) -> None:
        thing, key = instance.object, self._key(instance)
        if copied and key in self.groups:
            self.instances.append({"group": key, "matrix": matrix.tolist()})
            return
        closures = self.looks.closures[key]
        inputs = [value for closure in closures.values() for value in plain_inputs(closure)]
        named = {value["attribute"] for value in inputs if "attribute" in value}
        bent = None
        if self.frame is not None and _may_bend(thing.original):
            bent = self.known.triangles.setdefault(key, {})
        unwrapped = self.looks.unwrapped.get(key)
        corners = geometry.read_corners(thing.data, unwrapped, next(iter(named), None), bent)
        materials = [
            (material and material.name, _shines(closures.get(slot, {})))
            for slot, material in enumerate(materials_of(thing))
        ]
        place = None if copied else matrix
        digest = corners.digest(key, materials, None if copied else matrix.tolist())
        if digest not in self.known.shapes:
            made = self._write_parts(key, corners.parts(), place, materials)
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
        key: str,
        parts: list[geometry.Part],
        place: np.ndarray | None,
        materials: list[tuple[str | None, bool]],
    ) -> list[dict[str, Any]]:
        """Write the parts of an object's mesh."""
        shapes: list[dict[str, Any]] = []
        name = key.partition(" ")[2]
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
                shape = {"name": name, "mesh": key, "file": f"meshes/{stem}.ply"}
                shapes.append(shape | {"slot": slot, "material": material})
        return shapes


def _shines(closure: Closure) -> bool:
    """Whether a closure has emission."""
    inner = [closure[key] for key in ("first", "second") if key in closure]
    before = "" if "strength" in closure else "emission_"
    strength, colour = closure.get(f"{before}strength", 0), closure.get(f"{before}color", [1])
    own = strength != 0 and (not isinstance(colour, list) or any(colour))
    return own or any(map(_shines, inner))


def _may_bend(thing: Any) -> bool:
    """Whether the mesh of an object may have another shape in another frame."""
    if thing.type != "MESH" or thing.parent_type in ("ARMATURE", "LATTICE"):
        return True
    return bool(thing.modifiers or thing.data.shape_keys)
