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
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
import bpy
import numpy as np
from bake import Baking
from cameras import read_cameras
from images import missing_images, used_files, write_images
from lamps import read_world
from nodes import Closure, plain_inputs, read_material
from writer import Writer


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
    writer, baking = Writer(folder, extent, tell), Baking(folder, extent, tell)
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
        "missing_images": missing_images(),
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
