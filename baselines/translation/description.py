"""A scene of Mitsuba as a folder that other programs can read.

``scene.json`` has

- ``shapes``: each with ``name``, ``mesh`` (a file), ``matrix`` (of an instance, or None for the
  world), ``material`` (an index), and if it shines, ``radiance`` of its front. ``outline`` is then
  None, or "rectangle", "disk" or "sphere"; ``placed`` maps that shape around the origin to the
  world;
- ``materials``: :mod:`baselines.translation.materials`;
- ``lamps``: :mod:`baselines.translation.lamps`.

A mesh is an ``.npz``: ``points`` (N, 3), ``faces`` (M, 3), counter-clockwise from outside, and as
far as there are any, at each point: ``normals`` (N, 3), ``uv`` (N, 2), ``color`` (N, 3), linear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from baselines.translation.lamps import read_lamp
from baselines.translation.materials import GREY, Material, translate
from baselines.translation.meshes import FINE, read_mesh
from baselines.translation.nodes import Node
from baselines.translation.values import Values
from gpf.core.files import write_json

DEFAULT: Material = {"kind": "sides", "front": GREY, "back": {"kind": "diffuse", "color": 0.0}}
"""What Mitsuba gives to shapes without a material."""

OUTLINES = ("rectangle", "disk", "sphere")


def describe(root: Node, scene: mi.Scene, folder: Path, where: str) -> Mapping[str, Any]:
    """Write a scene into a folder; its description.

    Parameters
    ----------
    root: the scene's plugins.
    scene: the same scene, loaded without merging shapes.
    where: names the scene in messages.

    Raises
    ------
    CannotServe: the scene has something that is not translated.
    """
    folder.mkdir(parents=True, exist_ok=True)
    writer = _Writer(folder, where, Values(folder, where))
    loaded = list(scene.shapes())
    listed = [node for node in root.of_kind(mi.ObjectType.Shape) if node.plugin != "shapegroup"]
    if len(loaded) != len(listed):
        raise ValueError(f"{where}: {len(loaded)} shapes are loaded, {len(listed)} are in the file")
    for node, shape in zip(listed, loaded, strict=True):
        if node.plugin == "instance":
            writer.add_instance(node, scene)
        else:
            writer.add(node, shape)
    lamps = [read_lamp(node, writer.values) for node in root.of_kind(mi.ObjectType.Emitter)]
    found = {"shapes": writer.shapes, "materials": writer.materials, "lamps": lamps}
    write_json(folder / "scene.json", found)
    return found


@dataclass
class _Writer:
    """Shapes and materials so far."""

    folder: Path
    where: str
    values: Values
    shapes: list[dict[str, Any]] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    _meshes: dict[int, str] = field(default_factory=dict)
    _known: dict[int, int] = field(default_factory=dict)

    def add_instance(self, node: Node, scene: mi.Scene) -> None:
        """Add the shapes of a group, in the instance's place."""
        (group,) = node.of_kind(mi.ObjectType.Shape)
        parts = mi.traverse(scene).hierarchy.items()
        of_group = [
            shape
            for shape, (parent, _) in parts
            if isinstance(shape, mi.Shape)
            and parent is not None
            and parent.class_name() == "ShapeGroupPlugin"
            and parent.id() == group.id
        ]
        matrix = np.array(node.values["to_world"].matrix, dtype=float).reshape(4, 4)
        for inner, shape in zip(group.of_kind(mi.ObjectType.Shape), of_group, strict=True):
            self.add(inner, shape, matrix)

    def add(self, node: Node, shape: mi.Shape, matrix: np.ndarray | None = None) -> None:
        """Add a shape."""
        if node.of_kind(mi.ObjectType.Medium):
            raise self.values.refuse("participating media are not translated")
        found: dict[str, Any] = {
            "name": node.id or f"shape {len(self.shapes)}",
            "mesh": self._mesh(node, shape),
            "matrix": None if matrix is None else matrix.tolist(),
            "material": self._material(node),
        }
        for emitter in node.of_kind(mi.ObjectType.Emitter):
            if emitter.plugin != "area":
                raise self.values.refuse(f"lamps of type {emitter.plugin} are not translated")
            found["radiance"] = self.values.radiance(emitter, "radiance")
            plain = node.plugin in OUTLINES and not shape.has_flipped_normals()
            found["outline"] = node.plugin if plain else None
            if plain:
                place = np.array(mi.traverse(shape)["to_world"].matrix, dtype=float)
                found["placed"] = place.reshape(4, 4).tolist()
        self.shapes.append(found)

    def _material(self, node: Node) -> int:
        bsdfs = node.of_kind(mi.ObjectType.BSDF)
        key = id(bsdfs[0]) if bsdfs else 0
        if key not in self._known:
            self._known[key] = len(self.materials)
            self.materials.append(translate(bsdfs[0], self.values) if bsdfs else DEFAULT)
        return self._known[key]

    def _mesh(self, node: Node, shape: mi.Shape) -> str:
        if id(node) in self._meshes:
            return self._meshes[id(node)]
        mesh = read_mesh(shape, self.where, FINE)
        arrays: dict[str, Any] = {
            "points": mesh.points.astype(np.float32),
            "faces": mesh.faces.astype(np.int32),
        }
        for name in ("normals", "uv"):
            if (values := getattr(mesh, name)) is not None:
                arrays[name] = values.astype(np.float32)
        known = mi.traverse(shape)
        if "vertex_color" in known:
            arrays["color"] = np.array(known["vertex_color"], dtype=np.float32).reshape(-1, 3)
        name = self._meshes[id(node)] = f"mesh_{len(self._meshes)}.npz"
        np.savez(self.folder / name, **arrays)
        return name
