"""What a scene has, in one frame or in several."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from around import answer_as_for_surfaces
from bake import Baking
from cameras import read_cameras
from images import missing_images, used_files, write_images
from lamps import Lamps
from looks import Looks
from nodes import plain_closure
from world import World
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
        self._world, self._lamps = World(folder, self._tell), Lamps(folder)
        self._baking = Baking(folder, self._extent, self._tell)
        self._images: dict[str, Any] = {}
        self._known = Known()
        self._notes = choose_layer(scene)
        if scene.world is not None and answer_as_for_surfaces(scene.world.node_tree):
            self._notes.append("the world: as surfaces see it, also for the camera")
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
        exposure = 2.0**scene.view_settings.exposure * scene.cycles.film_exposure
        world = self._world.read(scene)
        looks = Looks(self._baking)
        shared = looks, self._lamps.tints(), self._known, frame
        writer = Writer(self.folder, self._extent, self._tell, *shared)
        self.tell("geometry")
        render_into(writer, scene)
        if looks.waiting:
            looks.bake()
            render_into(writer, scene)
        closures = [
            {"mesh": key, "slot": slot, "closure": closure}
            for key, own in looks.closures.items()
            for slot, closure in own.items()
        ]
        write_images([each["closure"] for each in closures], self.folder, self._images)
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
            "closures": [plain_closure(each) for each in closures],
            "images": self._images,
            "missing_images": missing_images(),
            "missing_libraries": self._missing,
            "files": sorted({*used_files(), *self.files}),
            "notes": [*self._notes, *self._world.notes, *self._lamps.notes, *writer.notes],
        }
        (self.folder / f"{name}.json").write_text(json.dumps(found), encoding="utf-8")

    def repeated(self) -> list[str]:
        """What had to be baked or rendered more than once, and why."""
        notes = [
            f"{key.partition(' ')[2]}: baked {n} times, as its materials or its faces change"
            for key, n in self._baking.times.items()
            if n > 1
        ]
        if self._world.times > 1:
            notes.append(f"the world: rendered {self._world.times} times, as it changes")
        return notes


def choose_layer(scene: Any) -> list[str]:
    """Have a scene rendered by one of its view layers, as each would bring all of its light; notes
    about the others."""
    used = [layer for layer in scene.view_layers if layer.use] or list(scene.view_layers)
    chosen = bpy.context.view_layer if bpy.context.view_layer in used else used[0]
    for layer in scene.view_layers:
        layer.use = layer == chosen
    return [f"{layer.name}: view layer left out" for layer in used if layer != chosen]


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
