"""What a scene has, in one frame or in several."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bake import Baking
from cameras import read_cameras
from images import missing_images, used_files, write_images
from lamps import World
from nodes import Closure, plain_closure, plain_inputs, read_material
from writer import Known, Writer


class Reader:
    """Writes a scene in one frame after another. What is baked, rendered or written for a frame
    serves for others, too, where it is the same.

    Parameters
    ----------
    folder: for what is written; it has folders ``meshes`` and ``textures``.
    missing: names of libraries that are missing.

    Attributes
    ----------
    tell: is told what is being done.
    files: further files that the scene uses.
    """

    def __init__(
        self, scene: Any, folder: Path, missing: list[str], tell: Callable[[str], None]
    ) -> None:
        self.scene, self.folder, self.tell, self._missing = scene, folder, tell, missing
        self._size = [scene.render.resolution_x, scene.render.resolution_y]
        self._extent = scene_extent()
        self._world = World(folder, self._tell)
        self._baking = Baking(folder, self._extent, self._tell)
        self._images: dict[str, Any] = {}
        self._known = Known()
        self.files: list[str] = []

    def _tell(self, what: str) -> None:
        self.tell(what)

    def write(self, name: str, frame: int | None = None) -> None:
        """Write the scene as it is now to ``NAME.json``.

        Parameters
        ----------
        frame: its number, if there are others; by default, cameras that move have their path.
        """
        scene = self.scene
        self.tell("cameras")
        cameras = read_cameras(scene, path=frame is None)
        exposure = 2.0 ** float(scene.view_settings.exposure)
        world = self._world.read(scene)
        closures = read_closures(self._baking)
        baked = self._baking.unwrapped
        shared = closures, baked, self._known, frame
        writer = Writer(self.folder, self._extent, self._tell, *shared)
        self.tell("geometry")
        render_into(writer, scene)
        write_images(closures, self.folder, self._images)
        found = {
            "blender": bpy.app.version_string,
            "size": self._size,
            "exposure": exposure,
            "cameras": cameras,
            "world": world,
            "lamps": writer.lamps,
            "shapes": writer.shapes,
            "groups": writer.groups,
            "instances": writer.instances,
            "closures": [
                {"object": thing, "slot": slot, "closure": plain_closure(closure)}
                for (thing, slot), closure in closures.items()
            ],
            "images": self._images,
            "missing_images": missing_images(),
            "missing_libraries": self._missing,
            "files": sorted({*used_files(), *self.files}),
            "notes": writer.notes,
        }
        (self.folder / f"{name}.json").write_text(json.dumps(found), encoding="utf-8")

    def repeated(self) -> list[str]:
        """What had to be baked or rendered more than once, and why."""
        notes = [
            f"{name}: baked {n} times, as its materials or its faces change"
            for name, n in self._baking.times.items()
            if n > 1
        ]
        if self._world.times > 1:
            notes.append(f"the world: rendered {self._world.times} times, as it changes")
        return notes


def read_closures(baking: Baking) -> dict[tuple[str, int], Closure]:
    """The closure of each slot of each object; what is no plain value or image is baked."""
    found: dict[tuple[str, int], Closure] = {}
    for thing in list(bpy.data.objects):
        if thing.type not in ("MESH", "CURVE", "FONT", "SURFACE", "META") or thing.hide_render:
            continue
        slots = range(max(len(thing.material_slots), 1))
        own = {
            k: read_material(thing.material_slots[k].material if thing.material_slots else None)
            for k in slots
        }
        colours = {a.name for a in thing.data.color_attributes} if thing.type == "MESH" else set()
        if any(_needs_baking(closure, colours) for closure in own.values()):
            own = baking.bake(thing, own)
        found |= {(thing.name, slot): closure for slot, closure in own.items()}
    return found


def _needs_baking(closure: Closure, colours: set[str]) -> bool:
    inputs = plain_inputs(closure)
    named = {v["attribute"] for v in inputs if "attribute" in v}
    return (
        closure.get("displaced", False)
        or any("bake" in v for v in inputs)
        or not named <= colours
        or len(named) > 1
    )


def scene_extent() -> float:
    """Length of the diagonal of all objects."""
    corners = [
        np.array(thing.matrix_world) @ [*c, 1]
        for thing in bpy.data.objects
        if thing.type == "MESH"
        for c in thing.bound_box
    ]
    return float(np.linalg.norm(np.ptp(corners, axis=0))) if corners else 1.0


def render_into(writer: Writer, scene: Any) -> None:
    """Let Blender evaluate the scene as for a rendering, and write what it would render."""
    failed: list[BaseException] = []

    class Engine(bpy.types.RenderEngine):
        bl_idname, bl_label = "GPF_READ", "gpf read"

        def render(self, graph: Any) -> None:
            try:
                writer.write(graph)
            except BaseException as error:
                failed.append(error)

    bpy.utils.register_class(Engine)
    settings = scene.render
    settings.engine = "GPF_READ"
    settings.resolution_percentage, settings.use_border = 100, False
    settings.resolution_x = settings.resolution_y = 8
    settings.use_compositing = settings.use_sequencer = False
    eye = None
    if scene.camera is None:
        eye = bpy.data.objects.new("gpf", bpy.data.cameras.new("gpf"))
        scene.collection.objects.link(eye)
        scene.camera = eye
    bpy.ops.render.render()
    if eye is not None:
        bpy.data.objects.remove(eye)
    bpy.utils.unregister_class(Engine)
    if failed:
        raise failed[0]
