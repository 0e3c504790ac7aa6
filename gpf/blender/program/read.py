"""Read a scene with Blender, and write it in plain values: ``scene.json``, meshes, and arrays.

    python read.py FILE FOLDER            # a Python with the package bpy
    blender -b --factory-startup --python read.py -- FILE FOLDER

FILE is a ``.blend`` file, or one that Blender imports. Scripts and drivers in it are not run. Each
line on standard output that begins with ``gpf:`` says what is being done; ``gpf-error:`` comes
before an error of the file.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
from collections import Counter
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import bpy
import geometry
import numpy as np
from bake import UV, Baking
from cameras import read_cameras
from lamps import read_lamp, read_world
from nodes import Closure, read_material, values

MOST_COPIED = 100_000
"""Triangles of a mesh's copies, together; with more, the copies are instances."""


THIN = 1e-5
"""Distance between the two sides of a sheet that shines, in diagonals of the scene."""


class Unreadable(Exception):
    """What is wrong with the file."""


def tell(what: str) -> None:
    """Say what is being done."""
    print(f"gpf: {what}", flush=True)


def open_file(file: Path) -> None:
    """Open or import a file as the current scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    kind = file.suffix.lower()
    openers: dict[str, Any] = {
        ".blend": lambda path: bpy.ops.wm.open_mainfile(
            filepath=path, load_ui=False, use_scripts=False
        ),
        ".glb": lambda path: bpy.ops.import_scene.gltf(filepath=path),
        ".gltf": lambda path: bpy.ops.import_scene.gltf(filepath=path),
        ".fbx": lambda path: bpy.ops.wm.fbx_import(filepath=path),
        ".obj": lambda path: bpy.ops.wm.obj_import(filepath=path),
    }
    for suffix in (".usd", ".usda", ".usdc", ".usdz"):
        openers[suffix] = lambda path: bpy.ops.wm.usd_import(filepath=path)
    try:
        openers[kind](str(file))
    except RuntimeError as error:
        lines = (line.strip() for line in str(error).splitlines())
        words = [line for line in lines if line and not line.startswith("Location:")]
        first = words[0].removeprefix("Error:").strip() if words else "cannot be opened"
        raise Unreadable(words[-1] if "Traceback" in first else first) from None
    version = tuple(bpy.data.version)[:2]
    if kind == ".blend" and version > bpy.app.version[:2]:
        tell(f"note: the file is of Blender {version[0]}.{version[1]}, newer than this one")


def make_local() -> list[str]:
    """Make what comes from linked libraries editable; names of those that are missing."""
    missing = [
        lib.filepath
        for lib in bpy.data.libraries
        if not Path(bpy.path.abspath(lib.filepath)).is_file()
    ]
    if bpy.data.libraries:
        bpy.ops.object.make_local(type="ALL")
    return missing


class Writer:
    """Writes the meshes of a scene while Blender renders it, as Blender renders them."""

    def __init__(self, folder: Path, extent: float) -> None:
        self.folder, self.extent = folder, extent
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
                    tell(f"geometry {done} of {total}")
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
        named = {v["attribute"] for c in self._own(name) for v in _inputs(c) if "attribute" in v}
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


def _inputs(closure: Closure) -> list[dict[str, Any]]:
    return [owner[key] for owner, key in values(closure)]


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
            baking.bake(thing, own)
        found |= {(thing.name, slot): closure for slot, closure in own.items()}
    return found


def _needs_baking(closure: Closure, colours: set[str]) -> bool:
    inputs = _inputs(closure)
    named = {v["attribute"] for v in inputs if "attribute" in v}
    return (
        closure.get("displaced", False)
        or any("bake" in v for v in inputs)
        or not named <= colours
        or len(named) > 1
    )


def write_images(closures: dict[tuple[str, int], Closure], folder: Path) -> dict[str, Any]:
    """Write the images that closures use; for each, its file and whether it is sRGB."""
    names = {v["image"] for c in closures.values() for v in _inputs(c) if "image" in v}
    images = {}
    for number, name in enumerate(sorted(names)):
        image = bpy.data.images[name]
        space = image.colorspace_settings.name
        stem = f"textures/image_{number}"
        images[name] = {"srgb": space == "sRGB", "file": None, "name": name}
        data = None
        if not min(image.size):  # no image at all, or none that Blender can read
            images[name]["missing"] = str(image.filepath)
            continue
        if image.packed_file is not None:
            data = bytes(image.packed_file.data)
        elif image.source == "FILE":
            path = Path(bpy.path.abspath(image.filepath, library=image.library))
            data = path.read_bytes() if path.is_file() else None
            if data is None:
                images[name]["missing"] = str(image.filepath)
                continue
        kinds = {
            "PNG": "png",
            "JPEG": "jpg",
            "OPEN_EXR": "exr",
            "HDR": "hdr",
            "TARGA": "tga",
            "BMP": "bmp",
        }
        if data is not None and image.file_format in kinds and space in ("sRGB", "Non-Color"):
            file = f"{stem}.{kinds[image.file_format]}"
            (folder / file).write_bytes(data)
        else:
            pixels = np.empty(image.size[0] * image.size[1] * image.channels, np.float32)
            image.pixels.foreach_get(pixels)
            file = f"{stem}.npy"
            np.save(folder / file, pixels.reshape(image.size[1], image.size[0], -1))
            images[name]["srgb"] = space == "sRGB" and not image.is_float
        images[name]["file"] = file
    return images


def used_files() -> list[str]:
    """The files that the scene uses beside its own."""
    paths = [bpy.path.abspath(lib.filepath) for lib in bpy.data.libraries]
    for image in bpy.data.images:
        if image.source == "FILE" and image.packed_file is None and image.filepath:
            paths.append(bpy.path.abspath(image.filepath, library=image.library))
    return sorted({str(Path(path).resolve()) for path in paths})


def scene_extent() -> float:
    """Length of the diagonal of all objects."""
    corners = [
        np.array(thing.matrix_world) @ [*c, 1]
        for thing in bpy.data.objects
        if thing.type == "MESH"
        for c in thing.bound_box
    ]
    return float(np.linalg.norm(np.ptp(corners, axis=0))) if corners else 1.0


def plain_closure(closure: Closure) -> Closure:
    """A closure without Blender's own objects."""
    kept: Closure = {}
    for key, value in closure.items():
        if isinstance(value, dict):
            value = plain_closure(value)
        if key not in ("origin", "otherwise", "bake"):
            kept[key] = value
    return kept


def read(file: Path, folder: Path) -> None:
    """Read a file, and write everything into a folder."""
    tell("opening")
    open_file(file)
    missing = make_local()
    scene = bpy.context.scene
    for name in ("meshes", "textures"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    tell("cameras")
    cameras = read_cameras(scene)
    exposure = 2.0 ** float(scene.view_settings.exposure)
    size = [scene.render.resolution_x, scene.render.resolution_y]
    tell("world")
    world = read_world(scene, folder)
    extent = scene_extent()
    writer, baking = Writer(folder, extent), Baking(folder, extent, tell)
    writer.closures = read_closures(baking)
    tell("geometry")
    render_into(writer, scene)
    closures = [
        {"object": thing, "slot": slot, "closure": plain_closure(closure)}
        for (thing, slot), closure in writer.closures.items()
    ]
    found = {
        "blender": bpy.app.version_string,
        "size": size,
        "exposure": exposure,
        "cameras": cameras,
        "world": world,
        "lamps": writer.lamps,
        "shapes": writer.shapes,
        "groups": writer.groups,
        "instances": writer.instances,
        "closures": closures,
        "images": write_images(writer.closures, folder),
        "missing_libraries": missing,
        "files": used_files(),
        "notes": writer.notes,
    }
    (folder / "scene.json").write_text(json.dumps(found), encoding="utf-8")
    tell("done")


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
    if scene.camera is None:
        eye = bpy.data.objects.new("gpf", bpy.data.cameras.new("gpf"))
        scene.collection.objects.link(eye)
        scene.camera = eye
    bpy.ops.render.render()
    bpy.utils.unregister_class(Engine)
    if failed:
        raise failed[0]


def main(words: list[str]) -> int:
    """The program."""
    file, folder = (Path(word).resolve() for word in words)
    if sys.platform == "linux":  # end with the process that started this one
        set_death_signal = 1
        ctypes.CDLL(None).prctl(set_death_signal, signal.SIGKILL)
        if os.getppid() == 1:
            return 1
    try:
        read(file, folder)
    except Unreadable as error:
        print(f"gpf-error: {error}", flush=True)
        return 2
    return 0


if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(arguments))
