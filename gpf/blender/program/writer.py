"""The meshes and lamps of a scene, while Blender renders it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import geometry
import numpy as np
from bake import UV
from lamps import read_lamp
from nodes import Closure, plain_inputs

MOST_COPIED = 100_000
"""Triangles of a mesh's copies, together; with more, the copies are instances."""

THIN = 1e-5
"""Distance between the two sides of a sheet that shines, in diagonals of the scene."""


class Writer:
    """Writes the meshes of a scene while Blender renders it, as Blender renders them."""

    def __init__(self, folder: Path, extent: float, tell: Callable[[str], None]) -> None:
        self.folder, self.extent, self.tell = folder, extent, tell
        self.closures: dict[tuple[str, int], Closure] = {}
        self.shapes: list[dict[str, Any]] = []
        self.groups: dict[str, list[dict[str, Any]]] = {}
        self.instances: list[dict[str, Any]] = []
        self.lamps: list[dict[str, Any]] = []
        self.notes: list[str] = []

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
        mesh = thing.data
        baked = UV if UV in mesh.uv_layers else None
        named = {
            v["attribute"] for c in self._own(name) for v in plain_inputs(c) if "attribute" in v
        }
        parts = geometry.read_parts(mesh, baked, next(iter(named), None))
        shapes: list[dict[str, Any]] = []
        for part in parts:
            if not geometry.is_finite(part):
                self.notes.append(f"{name}: coordinates that are no numbers; left out")
                continue
            if geometry.area(part) == 0:
                self.notes.append(f"{name}: triangles without area; left out")
                continue
            if not copied:
                part = geometry.transformed(part, matrix)
            slot = min(part.slot, max(len(thing.material_slots) - 1, 0))
            sides = [part]
            if _shines(self.closures.get((name, slot))) and geometry.is_open(part):
                sides.append(geometry.other_side(part, THIN * self.extent))
            for side in sides:
                shapes.append(self._save(thing, side, slot, len(shapes)))
        if copied:
            self.groups[key] = shapes
            self.instances.append({"group": key, "matrix": matrix.tolist()})
        else:
            self.shapes += shapes

    def _save(self, thing: Any, part: geometry.Part, slot: int, before: int) -> dict[str, Any]:
        number = len(self.shapes) + sum(map(len, self.groups.values())) + before
        file = f"meshes/{number:04}.ply"
        geometry.write_ply(self.folder / file, part)
        material = _material(thing, slot)
        return {"name": thing.original.name, "file": file, "slot": slot, "material": material}

    def _own(self, name: str) -> list[Closure]:
        return [closure for (thing, _), closure in self.closures.items() if thing == name]


def _shines(closure: Closure | None) -> bool:
    """Whether a closure has emission."""
    if closure is None:
        return False
    inner = [v for v in closure.values() if isinstance(v, dict) and "closure" in v]
    own = closure.get("strength", closure.get("emission_strength", 0.0))
    return own != 0 or any(map(_shines, inner))


def _material(thing: Any, slot: int) -> str | None:
    slots = thing.material_slots
    return slots[slot].material.name if slots and slots[slot].material else None
