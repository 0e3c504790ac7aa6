"""A description (:mod:`baselines.translation.description`) as a scene of Blender."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from cycles_materials import (  # type: ignore[import-not-found]  # in the folder of this script
    TANGENTS,
    Shader,
)
from cycles_world import add_lamp  # type: ignore[import-not-found]
from mathutils import Matrix

NEAR = 1e-4
"""How far a lamp is in front of the surface that it stands for, in its sizes."""


class Scene:
    """Builds a scene.

    Parameters
    ----------
    folder: with the description.
    caustics: whether lamps, smooth glass and diffuse surfaces take part in shadow caustics.
    """

    def __init__(self, folder: Path, caustics: bool) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.folder, self.caustics = folder, caustics
        self.found = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
        self._images: dict[str, Any] = {}
        self._materials: dict[str, Any] = {}
        self._meshes: dict[str, Any] = {}
        for shape in self.found["shapes"]:
            self._add(shape)
        for lamp in self.found["lamps"]:
            light = add_lamp(lamp, folder, self._images)
            # With the world among them, Cycles 5.0 loses or doubles the light of other lamps.
            if caustics and light is not bpy.context.scene.world:
                light.cycles.is_caustics_light = True

    def _add(self, shape: dict[str, Any]) -> None:
        material = self.found["materials"][shape["material"]]
        shines, lamp = shape.get("radiance"), None
        if shines is not None and shape["outline"] and not isinstance(shines, dict):
            lamp = self._add_lamp(shape)
        if lamp is not None:
            shines = None
            if shape["outline"] == "sphere":  # the lamp hides what is within
                return
        mesh = self._mesh(shape["mesh"])
        thing = bpy.data.objects.new(shape["name"], mesh)
        bpy.context.scene.collection.objects.link(thing)
        if shape["matrix"] is not None:
            thing.matrix_world = Matrix(shape["matrix"])
        if not mesh.materials:
            mesh.materials.append(None)
        slot = thing.material_slots[0]  # of the object: instances may differ
        slot.link = "OBJECT"
        slot.material = self._material(shape["material"], shines)
        if self.caustics:
            kinds = kinds_in(material)
            thing.cycles.is_caustics_caster = "smooth glass" in kinds
            thing.cycles.is_caustics_receiver = bool({"diffuse", "plastic", "principled"} & kinds)

    def _add_lamp(self, shape: dict[str, Any]) -> Any:
        """A lamp of Blender in place of a shape that shines; None if it cannot be one."""
        matrix = np.array(shape["placed"])
        axes, place = matrix[:3, :3], matrix[:3, 3]
        sizes = np.linalg.norm(axes, axis=0)
        if shape["outline"] != "sphere":
            sizes = sizes[:2]
        across = axes[:, : len(sizes)] / sizes
        if not np.allclose(across.T @ across, np.eye(len(sizes)), atol=1e-4):
            return None
        radiance = np.broadcast_to(shape["radiance"], 3)
        if shape["outline"] == "sphere":
            if np.ptp(sizes) > 1e-4 * sizes[0]:
                return None
            data = bpy.data.lights.new(shape["name"], "POINT")
            data.shadow_soft_size, data.use_soft_falloff = sizes[0], False
            power = radiance * 4 * math.pi**2 * sizes[0] ** 2
            world = np.eye(4)
        else:
            normal = np.linalg.inv(axes).T[:, 2]
            normal /= np.linalg.norm(normal)
            data = bpy.data.lights.new(shape["name"], "AREA")
            flat = shape["outline"] == "disk"
            data.shape = "ELLIPSE" if flat else "RECTANGLE"
            data.size, data.size_y = 2 * sizes
            surface = sizes[0] * sizes[1] * (math.pi if flat else 4)
            power = radiance * math.pi * surface
            world = np.eye(4)
            world[:3, 0], world[:3, 2] = across[:, 0], -normal
            world[:3, 1] = np.cross(world[:3, 2], world[:3, 0])
            place = place + NEAR * sizes.min() * normal
        world[:3, 3] = place
        data.energy = power.max()
        data.color = power / max(power.max(), 1e-30)
        thing = bpy.data.objects.new(shape["name"], data)
        bpy.context.scene.collection.objects.link(thing)
        thing.matrix_world = Matrix(world.tolist())
        thing.visible_camera = True
        data.cycles.is_caustics_light = self.caustics
        return thing

    def _material(self, index: int, radiance: Any) -> Any:
        key = f"{index} {radiance}"
        if key not in self._materials:
            shader = Shader(f"material {key}"[:60], self.folder, self._images)
            surface = shader.build(self.found["materials"][index])
            if radiance is not None:
                surface = shader.shine(surface, radiance)
            self._materials[key] = shader.finish(surface)
        return self._materials[key]

    def _mesh(self, name: str) -> Any:
        if name not in self._meshes:
            with np.load(self.folder / name) as arrays:
                self._meshes[name] = make_mesh(name, dict(arrays))
        return self._meshes[name]


def kinds_in(material: dict[str, Any]) -> set[str]:
    """The kinds of a material and of all that it contains; those that are black do not count."""
    kinds = {material["kind"]}
    if material["kind"] == "diffuse" and material["color"] == 0:
        kinds = set()
    if material["kind"] == "dielectric" and material["alpha"] == [0.0, 0.0]:
        kinds = {"smooth glass"}
    for value in material.values():
        if isinstance(value, dict) and "kind" in value:
            kinds |= kinds_in(value)
    return kinds


def make_mesh(name: str, arrays: dict[str, np.ndarray]) -> Any:
    """A mesh of triangles."""
    points, faces = arrays["points"], arrays["faces"].astype(np.int32)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(points))
    mesh.loops.add(faces.size)
    mesh.polygons.add(len(faces))
    mesh.vertices.foreach_set("co", points.ravel())
    mesh.loops.foreach_set("vertex_index", faces.ravel())
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    if "uv" in arrays:
        uv = arrays["uv"][faces.ravel()]
        mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", uv.ravel())
        turned = uv.reshape(-1, 3, 2) * (1, handedness(faces, arrays))
        mesh.uv_layers.new(name=TANGENTS).uv.foreach_set(
            "vector", turned.astype(np.float32).ravel()
        )
    if "color" in arrays:
        colours = np.ones((len(points), 4), np.float32)
        colours[:, :3] = arrays["color"]
        layer = mesh.color_attributes.new("color", "FLOAT_COLOR", "POINT")
        layer.data.foreach_set("color", colours.ravel())
    mesh.update(calc_edges=True)
    if "normals" in arrays:
        mesh.shade_smooth()
        mesh.normals_split_custom_set_from_vertices(arrays["normals"])
    else:
        mesh.shade_flat()
    return mesh


def handedness(faces: np.ndarray, arrays: dict[str, np.ndarray]) -> float:
    """1 if v is to the left of u on most of a surface, as seen from outside, else -1."""
    uv = arrays["uv"][faces]
    edges = uv[:, 1:] - uv[:, :1]
    turns = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    return 1.0 if np.sign(turns).sum() >= 0 else -1.0
